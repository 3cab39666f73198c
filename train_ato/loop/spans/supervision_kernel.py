"""Steps of the supervisor in the ticks of the compiled loop: odometers, supervisor, and the checks of the ATO.

A step with an effect (a brake, a takeover, an implausible value) is left to the stages, which call the same functions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from plant_sim.compiled import compiled
from plant_sim.odometry import OdometerState, OdometryReading, SlipRecord, count_distance, read_odometers
from plant_sim.record import Records, quantity
from train_ato.control.assurance import AssuranceConstants, AssuranceState, assure
from train_ato.control.plausibility import PLAUSIBLE, CheckConstants, difference
from train_ato.supervision.ceiling import SupervisionSpeeds
from train_ato.supervision.odometry_check import odometry_problem
from train_ato.supervision.position_estimate import PastSpeed
from train_ato.supervision.supervisor import SupervisionState, SupervisorConstants, SupervisorState, supervise
from train_ato.supervision.track_supervision import LineLimits

MAX_POSITION, MAX_SPEED = 1e6, 100.0
"""Position [m] and speed [m/s] beyond which a step is left to Python, far inside the limits of validity."""


@dataclass
class SupervisedRun:
    """Steps of the supervisor in a span."""

    period: int = quantity("ns", "period of the supervisor, 0 without one")
    steps: int = quantity("", "steps so far")
    half: float = quantity("m", "distance from the centre of vehicle 0 to the front")
    assured: bool = quantity("", "the braking law can take over")


class SupervisionStates(NamedTuple):
    """Records that a step changes, one each: those of the stages, which the loop continues."""

    run: Records[SupervisedRun]
    odometers: Records[OdometerState]
    last: Records[OdometryReading]
    supervisor: Records[SupervisorState]
    assurance: Records[AssuranceState]


class SupervisionArrays(NamedTuple):
    """Records of the supervision in a span; ``steps`` and ``readings`` have the results, one row per step."""

    states: SupervisionStates
    kept: SupervisionStates
    slips: Records[SlipRecord]
    constants: Records[SupervisorConstants]
    past: Records[PastSpeed]
    track: LineLimits
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
    run, own, odometers = arrays.states.run[0], arrays.states.supervisor[0], arrays.states.odometers[0]
    count_distance(odometers, arrays.slips, stamp, x_front + run.half)
    if stamp % run.period != 0:
        return True
    reading = arrays.readings[run.steps]
    read_odometers(odometers, arrays.slips, stamp, v_front, reading)
    if not (abs(v_front) < MAX_SPEED and abs(x_front) < MAX_POSITION):
        return False
    if odometry_problem(reading, arrays.states.last[0]) != PLAUSIBLE:
        return False
    within = supervise(arrays.constants[0], own, arrays.past, arrays.track, reading)
    if not within or own.state >= SupervisionState.SERVICE_BRAKE:
        return False
    if run.assured:
        assured, limits = (
            arrays.states.assurance[0],
            SupervisionSpeeds(own.permitted, own.warning, own.service, own.emergency),
        )
        assure(arrays.assurance[0], assured, arrays.assured_past, stamp, own.front, own.speed, limits)
        if assured.brakes:
            return False
    foremost = own.front + own.position_error
    if difference(arrays.check, position, velocity, own.front, foremost, own.speed) != PLAUSIBLE:
        return False
    arrays.states.last[0] = reading
    arrays.steps[run.steps] = own
    run.steps += 1
    return True
