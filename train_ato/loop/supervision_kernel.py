"""Supervisor in the ticks of the compiled loop, with the states of its stages before and after them.

A step with an effect (a brake, a takeover, an implausible value) is left to the stages, which call the same functions.
"""

from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.odometry import OdometerState, OdometryReading, count_distance, read_odometers
from plant_sim.plant_setup import WheelSlip
from plant_sim.record import Records, quantity, zeros
from train_ato.control.assurance import AssuranceConstants, AssuranceState, assure
from train_ato.control.plausibility import PLAUSIBLE, CheckConstants, implausible_quantity
from train_ato.loop.stages import Stages
from train_ato.messages.types import AtoState, Protection
from train_ato.supervision.deceleration_curve import Arc
from train_ato.supervision.limits import Target
from train_ato.supervision.odometry import PastSpeed, odometry_problem
from train_ato.supervision.step_function import SupervisionSpeeds
from train_ato.supervision.supervisor import SupervisionState, SupervisorConstants, SupervisorState, supervise
from train_ato.supervision.track_supervision import Ceiling, LineLimits

MAX_POSITION, MAX_SPEED = 1e6, 100.0
"""Position [m] and speed [m/s] beyond which a step is left to Python, far inside the limits of validity."""


@dataclass
class SupervisedRun:
    """Steps of the supervisor in a span."""

    period: int = quantity("ns", "period of the supervisor, 0 without one")
    steps: int = quantity("", "steps so far")
    half: float = quantity("m", "distance from the centre of vehicle 0 to the front")
    assured: bool = quantity("", "the braking law can take over")


@dataclass
class LimitRows:
    """Rows of the limits that hold at a step: those of one end of authority."""

    targets: int = quantity("", "row of the first target")
    targets_end: int = quantity("", "row behind the last target")
    arcs: int = quantity("", "row of the first arc")
    arcs_end: int = quantity("", "row behind the last arc")


class SupervisionStates(NamedTuple):
    """Records that a step changes, one each: those of the stages, which the loop continues."""

    run: Records[SupervisedRun]
    odometers: Records[OdometerState]
    last: Records[OdometryReading]
    supervisor: Records[SupervisorState]
    assurance: Records[AssuranceState]


class SupervisionArrays(NamedTuple):
    """Records of the supervision in a span; ``steps`` and ``readings`` have the results, one row per step.

    ``rows`` has one entry per step; a step without one is left to Python.
    """

    states: SupervisionStates
    kept: SupervisionStates
    slips: Records[WheelSlip]
    constants: Records[SupervisorConstants]
    past: Records[PastSpeed]
    track: LineLimits
    rows: Records[LimitRows]
    assurance: Records[AssuranceConstants]
    assured_past: Records[PastSpeed]
    check: Records[CheckConstants]
    steps: Records[SupervisorState]
    readings: Records[OdometryReading]


@compiled
def copy_states(source: SupervisionStates, target: SupervisionStates, stamp: int) -> None:
    """Copy the records that a tick changes: between two steps of the supervisor only those of the odometers.

    The speeds of the averages stay, because an older state does not read the newest ones.
    """
    target.odometers[0] = source.odometers[0]
    if stamp % source.run[0].period == 0:
        target.run[0] = source.run[0]
        target.last[0] = source.last[0]
        target.supervisor[0] = source.supervisor[0]
        target.assurance[0] = source.assurance[0]


@compiled
def supervised_tick(
    stamp: int, x_front: float, v_front: float, position: float, velocity: float, arrays: SupervisionArrays
) -> bool:
    """Run the supervisor at a stamp; return False for a tick that is left to Python, whose states are then undefined.

    Parameters
    ----------
    stamp
        Stamp of the tick [ns].
    x_front, v_front
        True position [m] and speed [m/s] of vehicle 0.
    position, velocity
        Measured position [m] and speed [m/s] of the first power unit.
    arrays
        Records of the supervision.
    """
    run, own, odometers = arrays.states.run[0], arrays.states.supervisor[0], arrays.states.odometers
    count_distance(odometers, arrays.slips, stamp, x_front + run.half)
    if stamp % run.period != 0:
        return True
    reading = arrays.readings[run.steps]
    read_odometers(odometers, arrays.slips, stamp, v_front, arrays.readings[run.steps :])
    if not (abs(v_front) < MAX_SPEED and abs(x_front) < MAX_POSITION):
        return False
    if run.steps >= arrays.rows.size or odometry_problem(reading, arrays.states.last[0]) != PLAUSIBLE:
        return False
    track, rows = arrays.track, arrays.rows[run.steps]
    targets, arcs = track.targets[rows.targets : rows.targets_end], track.arcs[rows.arcs : rows.arcs_end]
    limits = LineLimits(track.ceilings, targets, arcs)
    within = supervise(arrays.constants[0], own, arrays.past, limits, reading)
    if not within or own.state >= SupervisionState.SERVICE_BRAKE:
        return False
    if run.assured:
        assured = arrays.states.assurance[0]
        speeds = SupervisionSpeeds(own.permitted, own.warning, own.service, own.emergency)
        assure(arrays.assurance[0], assured, arrays.assured_past, stamp, own.front, own.speed, speeds)
        if assured.brakes:
            return False
    foremost = own.front + own.position_error
    if implausible_quantity(arrays.check, position, velocity, own.front, foremost, own.speed) != PLAUSIBLE:
        return False
    arrays.states.last[0] = reading
    arrays.steps[run.steps] = own
    run.steps += 1
    return True


class SupervisedTicks:
    """Supervision of the compiled ticks of a run.

    Parameters
    ----------
    stages
        Setup and stages of the loop; without a supervisor the compiled ticks have no step of it.
    """

    def __init__(self, stages: Stages) -> None:
        self._stages, self._run = stages, zeros(SupervisedRun, 1)
        self._period = 0 if stages.supervisor is None else stages.setup.supervision_ticks * stages.setup.tick_ns
        self._run["period"], self._run["half"] = self._period, stages.plant.half
        self._run["assured"] = stages.controller.ato.assurance is not None

    @property
    def is_quiet(self) -> bool:
        """True if neither supervisor nor train protection nor the mode of the ATO changes the commands."""
        plant, controller = self._stages.plant, self._stages.controller
        protection = plant.protection
        if protection.requested or protection.level is not Protection.NONE or plant.reported is not Protection.NONE:
            return False
        if controller.takeover or controller.error:
            return False
        if self._stages.supervisor is None:
            return True
        stamp, stage, ato, profile = plant.stamp, self._stages.supervisor, controller.ato, self._stages.profile
        supervisor = stage.supervisor
        if not supervisor.state["begun"][0] or not profile.engaged:
            return False
        if supervisor.state["state"][0] >= SupervisionState.SERVICE_BRAKE or ato.machine.state is not AtoState.ENGAGED:
            return False
        if ato.awaits_profile or ato.assured or ato.check.since is not None:
            return False
        if any(round(request.at * 1e9) <= stamp and request.do == "disengage" for request in ato.waiting):
            return False
        return bool(stage.odometry_check.last["stamp"][0] >= 0) and protection.is_idle(stamp, self._period)

    def arrays(self, ticks: int) -> SupervisionArrays:
        """Return the records of the stages, and rows for the steps in some ticks."""
        stage, odometers, ato = self._stages.supervisor, self._stages.plant.odometers, self._stages.controller.ato
        self._run["steps"] = 0
        if stage is None or odometers is None:
            return _without_supervisor(self._run)
        own, watch, most = stage.supervisor, ato.assurance, 1 + ticks * self._stages.setup.tick_ns // self._period
        states = (
            self._run, odometers.state, stage.odometry_check.last, own.state,
            zeros(AssuranceState, 1) if watch is None else watch.state,
        )  # fmt: skip
        kept = SupervisionStates(*(records.copy() for records in states))
        constants = zeros(AssuranceConstants, 1) if watch is None else watch.constants
        return SupervisionArrays(
            SupervisionStates(*states), kept, odometers.slips, own.constants, own.past, *self._limits(most), constants,
            own.past if watch is None else watch.past, ato.check.constants, zeros(SupervisorState, most),
            zeros(OdometryReading, most),
        )  # fmt: skip

    def _limits(self, steps: int) -> tuple[LineLimits, Records[LimitRows]]:
        """Return the limits of some steps and their rows: behind a train ahead each step has its end of authority."""
        stage, stamp = self._stages.supervisor, self._stages.plant.stamp
        assert stage is not None
        limits = stage.supervisor.track.records
        rows: Any = zeros(LimitRows, steps)
        found: list[Any] = []
        if stage.authority is None:
            rows["targets_end"], rows["arcs_end"] = limits.targets.size, limits.arcs.size
            return limits, rows
        first = -(-stamp // self._period)
        with suppress(ValueError):  # an end in front of which the brake is too weak; its step in Python names it
            found.extend(stage.authority.move(step * self._period) for step in range(first, first + steps))
        if not found:
            return limits, rows[:0]
        for name in ("targets", "arcs"):
            rows[f"{name}_end"][: len(found)] = np.cumsum([getattr(each, name).size for each in found])
            rows[name][1:] = rows[f"{name}_end"][:-1]
        targets, arcs = ([getattr(each, name) for each in found] for name in ("targets", "arcs"))
        joined: Any = np.concatenate(targets), np.concatenate(arcs)
        return LineLimits(limits.ceilings, *joined), rows[: len(found)]

    def store(self, ticks: int) -> None:
        """Set the states of train protection and ATO to those after some ticks."""
        if self._stages.supervisor is None:
            return
        self._stages.plant.protection.stamps.skip_draws(ticks)
        if self._run["steps"][0]:
            speed = self._stages.supervisor.supervisor.state["speed"]
            self._stages.controller.ato.take_speed(float(speed[0]))


def _without_supervisor(run: Records[SupervisedRun]) -> SupervisionArrays:
    """Return records of the same types that no tick uses."""
    kinds = OdometerState, OdometryReading, SupervisorState, AssuranceState
    states = SupervisionStates(run, *(zeros(kind, 1) for kind in kinds))
    limits = LineLimits(zeros(Ceiling, 1), zeros(Target, 0), zeros(Arc, 0)), zeros(LimitRows, 1)
    return SupervisionArrays(
        states, states, zeros(WheelSlip, 0), zeros(SupervisorConstants, 1), zeros(PastSpeed, 1), *limits,
        zeros(AssuranceConstants, 1), zeros(PastSpeed, 1), zeros(CheckConstants, 1), zeros(SupervisorState, 1),
        zeros(OdometryReading, 1),
    )  # fmt: skip
