"""Trains, profiles and inputs for the tests of laws, observers and compensations."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from plant_trains import line_of

from plant_sim.consist import Consist
from plant_sim.line import Line
from train_ato.control.air_brake.policy import BrakeSpec, make_brake_policy
from train_ato.control.contract import LawInput, Preview
from train_ato.control.gains import PRINTED, has_gains
from train_ato.control.registry import COMPENSATIONS, LAWS
from train_ato.control.stack import ControlStack
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import DisturbanceEstimate, Measurement, Reference
from train_ato.profile.profile import Profile

LEVEL = line_of(100e3, name="level")
HILLY = line_of(20e3, grades=[{"at": 1000, "grade": 0.004}, {"at": 3000, "grade": -0.005}, {"at": 6000, "grade": 0.0}])

MOTORED = {
    "mass": 80e3, "length": 80.0, "resistance": {"n_per_kg": [1.176e-2, 7.7616e-4, 1.6e-5]},
    "traction": [{"to": 50.0, "force": 400e3}], "brake": [{"to": 50.0, "force": 400e3}],
}  # fmt: skip
WAGON = {"mass": 100e3, "length": 12.0, "resistance": {"n_per_kn_kmh": [0.92, 0.0048, 0.000125]}}
LOCOMOTIVE = {
    "mass": 184e3, "length": 35.222, "resistance": {"n_per_kn_kmh": [1.20, 0.0065, 0.000279]},
    "traction": [{"to": 33.3, "force": 760e3}], "brake": [{"to": 33.3, "force": 461e3}],
}  # fmt: skip
SPRING = {"kind": "linear", "stiffness": 160e3, "damping": 800.0}


def consist(
    types: dict[str, Any], train: list[tuple[str, int]], gear: dict[str, Any] | None = None, **more: Any
) -> Consist:
    """Return a small train."""
    data: dict[str, Any] = {
        "schema": "train_ato/consist/1", "name": "bench", "vehicle_types": types, **more,
        "train": [{"type": name, "count": count} for name, count in train],
    }  # fmt: skip
    if gear is not None:
        data |= {"draft_gears": {"gear": gear}, "default_gear": "gear"}
    return Consist.model_validate(data)


SINGLE = consist({"car": MOTORED}, [("car", 1)])
FIVE = consist({"car": MOTORED}, [("car", 5)], SPRING)
PUSHED = consist({"loco": LOCOMOTIVE, "wagon": WAGON}, [("loco", 1), ("wagon", 3), ("loco", 1)], SPRING)
HAULED = consist({"loco": LOCOMOTIVE, "wagon": WAGON}, [("loco", 1), ("wagon", 4)], SPRING | {"stiffness": 20e6})


def model(
    train: Consist = SINGLE,
    line: Line = LEVEL,
    delay: float = 0.0,
    lag: float = 0.0,
    tick: float = 0.1,
    delay_brake: float | None = None,
    sensors: tuple[int, ...] = (),
) -> TrainModel:
    """Return the nominal model of a train."""
    units = len(train.power_units)
    brake = delay if delay_brake is None else delay_brake
    return TrainModel(train, line, np.full(units, delay), np.full(units, brake), lag, tick, sensors)


def profile(tick: float = 0.1, speed: float = 20.0, pull: float = 0.5, cruise: float = 60.0) -> Profile:
    """Return a smooth run: raised-cosine start, cruise, raised-cosine stop."""
    ramp = 2.0 * speed / pull
    time = np.arange(0.0, 2 * ramp + cruise + tick, tick)
    up = np.clip(time / ramp, 0, 1)
    down = np.clip((time - ramp - cruise) / ramp, 0, 1)
    velocity = 0.5 * speed * (np.cos(np.pi * down) - np.cos(np.pi * up))
    slope = 0.5 * speed * np.pi / ramp
    inside_up, inside_down = (up > 0) & (up < 1), (down > 0) & (down < 1)
    acceleration = slope * (np.sin(np.pi * up) * inside_up - np.sin(np.pi * down) * inside_down)
    position = speed * (
        0.5 * (ramp * (up - np.sin(np.pi * up) / np.pi) + ramp * (down + np.sin(np.pi * down) / np.pi))
        + np.clip(time - ramp, 0, None)
        - ramp * down
        - np.clip(time - 2 * ramp - cruise, 0, None)
    )
    return Profile.uniform(0.0, tick, position, velocity, acceleration)


def printed(name: str) -> dict[str, Any]:
    """Return the choice of the printed gains of a law; empty for a law without a choice."""
    return {"gains": PRINTED} if has_gains(LAWS.get(name)) else {}


def printed_law(name: str, values: Mapping[str, Any], of: TrainModel, period: float) -> Any:
    """Return a law with the printed values of the parameters that are not given."""
    return LAWS.make(name, {**printed(name), **values}, of, period)


def inputs(of: TrainModel, **changes: Any) -> LawInput:
    """Return the input of a law for a train at 10 m/s without errors."""
    n, one = of.n_units, np.ones(of.n_units)
    fields: dict[str, Any] = dict(  # noqa: C408
        t=50.0, position=500.0 - of.offsets, velocity=10.0 * one, applied=0.0 * one,
        reference_position=500.0 - of.offsets, reference_velocity=10.0 * one, reference_acceleration=0.0 * one,
        delay_to_effect=0.0, acceleration_at_effect=0.0, jerk_at_effect=0.0, feedforward=0.0 * one,
        preview=Preview(np.full(60, 500.0), np.full(60, 10.0), np.zeros(60)), disturbance=0.0 * one,
        deflection=np.zeros(len(of.sensors)), rate=np.zeros(len(of.sensors)), coupler_force=np.zeros(len(of.sensors)),
        shoe_force=0.0 * one, train_shoe_force=0.0, commands_in_flight=np.zeros((0, n)), force_min=np.full(n, -400e3),
        force_max=np.full(n, 400e3), saturated=False,
    )  # fmt: skip
    return LawInput(**{**fields, **changes})


def stack(
    of: TrainModel,
    controller: str = "pid",
    parameters: dict[str, Any] | None = None,
    compensation: str = "none",
    compensation_parameters: dict[str, Any] | None = None,
    period: float | None = None,
    along: Profile | None = None,
    brake: BrakeSpec | None = None,
) -> ControlStack:
    """Return a control stack."""
    period = of.tick if period is None else period
    return ControlStack(
        model=of, period=period, controller=controller,
        controller_parameters={controller: parameters or {}},
        compensation=COMPENSATIONS.make(compensation, compensation_parameters or {}, of, period),
        brake_policy=make_brake_policy(brake or BrakeSpec(), of, of.line),
        profile=profile(of.tick) if along is None else along, hold_limit=1.0,
        make_law=lambda name, values, step: LAWS.make(name, values, of, step),
    )  # fmt: skip


def measured(of: TrainModel, stamp: int, position: Any, velocity: Any, applied: Any) -> Measurement:
    """Return a measurement without coupler sensors; scalars are of vehicle 0."""
    one = np.ones(of.n_units)
    none = np.zeros(len(of.sensors))
    place = position * one - (of.offsets if np.isscalar(position) else 0.0)
    return Measurement(stamp, place, velocity * one, applied * one, none, none, none)


def asked(of: TrainModel, along: Profile, stamp: int) -> tuple[Reference, DisturbanceEstimate]:
    """Return the reference and an estimate of 0 at a stamp."""
    position, velocity, acceleration, _ = along.at(stamp * 1e-9)
    return Reference(stamp, position, velocity, acceleration), DisturbanceEstimate(stamp, np.zeros(of.n_units))
