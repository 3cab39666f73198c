"""Closed loop of every law, without messages: an 80 t vehicle through the same table of manoeuvres."""

import dataclasses
import functools
import itertools
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from case_costs import sampled
from law_trains import HILLY, LEVEL, SINGLE, asked, model, printed, profile, stack

from plant_sim.plant_setup import PlantSetup
from plant_sim.train import Train
from train_ato.control.air_brake.policy import BrakeSpec, make_brake_policy
from train_ato.control.observers.contract import ObserverStack
from train_ato.control.registry import LAWS, OBSERVERS
from train_ato.messages.types import Array

TICK = 0.1
TICK_NS = 100_000_000
SECONDS = 200.0
STEP_NS = 5_000_000


@dataclass(frozen=True)
class Manoeuvre:
    """Run of 0 - 72 - 0 km/h with a fault: a wrong start, an unmodelled grade or a gap."""

    hill: bool = False
    behind: float = 0.0
    gap: range = range(0)
    delay: float = 0.0
    lag: float = 0.0


MANOEUVRES = {
    "run": Manoeuvre(), "hill": Manoeuvre(hill=True), "behind": Manoeuvre(behind=2.0),
    "gap": Manoeuvre(gap=range(300, 308)), "delay": Manoeuvre(delay=0.6, lag=0.4),
}  # fmt: skip


@dataclass(frozen=True)
class Setting:
    """Law with its observer and compensation for this train."""

    law: str
    values: dict[str, Any] = field(default_factory=dict)
    observer: str = "none"
    compensation: str = "predictor"


SETTINGS = {
    "pid": Setting("pid", {"kp": 1.0, "ki": 0.3}), "smc": Setting("smc"), "rbf_smc": Setting("rbf_smc"),
    "rbf_switching_smc": Setting("rbf_switching_smc"), "fixed_time_smc": Setting("fixed_time_smc", observer="eso"),
    "lag_smc": Setting("lag_smc", observer="eso"), "funnel": Setting("funnel"),
    "gpc": Setting("gpc", compensation="none"), "mpc": Setting("mpc", compensation="none"),
    "mpc, declared noise": Setting("mpc", {"speed_noise": 0.002}, compensation="none"),
}  # fmt: skip


@functools.cache
def driven(law: str, manoeuvre: str) -> tuple[Array, Array, Array]:
    """Return position error, speed error and command at every tick."""
    setting, case = SETTINGS.get(law, Setting(law)), MANOEUVRES[manoeuvre]
    late = case.delay > 0.0
    of, along = model(SINGLE, LEVEL, case.delay, case.lag), profile(pull=0.8)
    control = stack(
        of, setting.law, printed(setting.law) | setting.values,
        setting.compensation if late else "none", along=along,
    )  # fmt: skip
    observer = ObserverStack(
        of, OBSERVERS.make(setting.observer, {}, of, TICK), make_brake_policy(BrakeSpec(), of, of.line)
    )
    begin = 500.0
    along = along.shifted(begin)
    control.set_profile(along)
    plant = PlantSetup.model_validate({"start": {"position": begin - case.behind}, "lag": case.lag})
    train = Train(SINGLE, HILLY if case.hill else LEVEL, plant, step_ns=STEP_NS, tick_ns=TICK_NS)
    queue = [np.zeros(1)] * round(case.delay / TICK)
    errors, commands = [], []
    for k in range(round(SECONDS / TICK)):
        reference, _ = asked(of, along, k * TICK_NS)
        seen = train.observe().measurement
        errors.append((float(seen.position[0]) - reference.position, float(seen.velocity[0]) - reference.velocity))
        if k in case.gap:
            seen = dataclasses.replace(seen, velocity=seen.velocity * math.nan)
        queue.append(control.step(seen, reference, observer.step(seen))[0])
        commands.append(float(queue[-1][0]))
        train.advance(np.tile(queue.pop(0), (train.substeps, 1)))
    place, speed = np.array(errors).T
    return place, speed, np.array(commands)


BOUNDS = yaml.safe_load((Path(__file__).with_name("data") / "manoeuvre_bounds.yaml").read_text(encoding="utf-8"))
# Of every law and manoeuvre: rms of the speed error from 20 s on [mm/s], largest position error from then on (after a
# wrong start from 60 s on) [m], largest speed error [m/s], and how much the command moves, mean [kN/s]. Measured, and
# 12 % more; gpc has no loop on the position, as printed.
OURS = sorted(name for name in LAWS.names() if LAWS.get(name).__module__.startswith("train_ato."))


def bounds_of(law: str, manoeuvre: str) -> Array:
    """Return the bounds of a law; one without bounds of its own must be no worse than the worst of the others."""
    others = [row[manoeuvre] for row in BOUNDS.values()]
    return np.array(BOUNDS.get(law, {}).get(manoeuvre, np.max(others, axis=0)))


@pytest.mark.parametrize(("law", "manoeuvre"), sampled(itertools.product(OURS, MANOEUVRES), every=2))
def test_the_manoeuvre_is_driven(law: str, manoeuvre: str) -> None:
    """Breaks if a law, its observer or its compensation tracks worse than before, or moves its command more."""
    place, speed, command = driven(law, manoeuvre)
    rolling, settled = slice(200, 1500), slice(600 if manoeuvre == "behind" else 200, 1500)
    found = (
        1e3 * float(np.sqrt((speed[rolling] ** 2).mean())),
        float(np.abs(place[settled]).max()),
        float(np.abs(speed[5:1500]).max()),
        float(np.abs(np.diff(command)).sum()) / SECONDS / 1e3,
    )
    assert np.isfinite(command).all() and np.abs(command).max() <= 400e3
    assert (np.array(found) <= bounds_of(law, manoeuvre)).all(), found


@pytest.mark.parametrize("law", ["mpc", "mpc, declared noise"])
def test_departure_does_not_need_the_declared_noise_of_the_sensor(law: str) -> None:
    """Breaks if a train slower than the assumed noise counts as one at standstill: 0.036 m/s from 0.05 m/s on."""
    _, speed, _ = driven(law, "run")
    assert float(np.abs(speed[5:1500]).max()) < 0.5 * BOUNDS["pid"]["run"][2]


@pytest.mark.parametrize(
    ("law", "values"),
    [("gpc", {}), ("fixed_time_smc", {"unmatched": True}), ("pid", {"kd": 0.5}), ("funnel", {"variant": "printed"})],
)
def test_a_gap_is_no_jump(law: str, values: dict[str, Any]) -> None:
    """0.8 s without a measurement at 20 m/s must not act like a step of 16 m."""
    # Breaks if a law ignores the missed steps: the samples of gpc, d1 of paper 002 and every difference quotient.
    of, along = model(SINGLE, LEVEL), profile(pull=0.8)
    peaks = []
    for gap in (range(0), range(300, 308)):
        control = stack(of, law, printed(law) | values, along=along)
        train = Train(SINGLE, LEVEL, PlantSetup(), step_ns=STEP_NS, tick_ns=TICK_NS)
        errors = []
        for k in range(600):
            reference, estimate = asked(of, along, k * TICK_NS)
            seen = train.observe().measurement
            errors.append(float(seen.velocity[0]) - reference.velocity)
            if k in gap:
                seen = dataclasses.replace(seen, velocity=seen.velocity * math.nan)
            train.advance(np.tile(control.step(seen, reference, estimate)[0], (train.substeps, 1)))
        peaks.append(np.abs(errors[250:]).max())
    assert peaks[1] < peaks[0] + 0.03
