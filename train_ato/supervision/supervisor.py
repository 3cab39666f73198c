"""Supervisor: states of the speed supervision, brake demands and their release.

It uses its own odometry only, and no message of the ATO. SUBSET-026, 3.13.10 (commands of the speed and distance
monitoring) and 3.14 (roll away).
"""

from collections import namedtuple
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from math import inf
from typing import Any, cast

from plant_sim.compiled import compiled
from plant_sim.odometry import OdometryReading, write_reading
from plant_sim.record import Records, dtype_of, quantity, zeros
from plant_sim.units import KMH
from train_ato.messages.types import Odometry, WordEnum
from train_ato.supervision.odometry import (
    MotionEstimate,
    MotionRecord,
    PastSpeed,
    estimate_motion,
    motion_of,
    past_speeds,
)
from train_ato.supervision.settings import SupervisionSpec
from train_ato.supervision.step_function import SupervisionSpeeds
from train_ato.supervision.track_supervision import (
    CURVE_ENDS,
    INDICATED,
    LineLimits,
    TrackSupervision,
    indicated,
    most_restrictive,
)

STANDSTILL_SPEED = 0.1
"""Estimated speed below which the train is at standstill [m/s]."""
REPEAT_DISTANCE = 50.0
"""Distance from the end of an emergency brake within which a second one is not released at standstill [m]."""
NO_SPEEDS = SupervisionSpeeds(0.0, 0.0, 0.0, 0.0)


class SupervisionState(WordEnum):
    """State of the supervision, by rising severity: SUBSET-026, 4.7 (supervision status) and 3.13.10."""

    NORMAL = 0
    INDICATION = 1
    OVERSPEED = 2
    WARNING = 3
    SERVICE_BRAKE = 4
    EMERGENCY_BRAKE = 5


class Reason(IntEnum):
    """Reason of a state."""

    NONE = 0
    TARGET_NEAR = 1
    ABOVE_LIMIT = 2
    ROLLED_BACK = 3
    NO_ODOMETRY = 4
    RESTARTED = 5


@dataclass
class SupervisorConstants:
    """Settings of the supervisor."""

    service_brake: bool = quantity("", "the service brake intervenes before the emergency brake")
    roll_away: float = quantity("m", "largest movement backwards")


@dataclass
class SupervisorState(MotionRecord):
    """State of the supervisor after a step, which is its decision; the motion is the last known one."""

    known: bool = quantity("", "the odometry of this step is valid")
    begun: bool = quantity("", "there was a step before")
    permitted: float = quantity("m/s", "permitted speed")
    warning: float = quantity("m/s", "speed of the warning")
    service: float = quantity("m/s", "speed of the service-brake intervention")
    emergency: float = quantity("m/s", "speed of the emergency-brake intervention")
    state: int = quantity("", "state of the supervision")
    reason: int = quantity("", "reason of the state")
    reason_speed: float = quantity("m/s", "speed at the begin of the state")
    reason_front: float = quantity("m", "front position at the begin of the state")
    reason_limit: float = quantity("m/s", "exceeded limit")
    reason_rolled: float = quantity("m", "movement backwards at the begin of the state")
    rolled: float = quantity("m", "movement backwards")
    latched: bool = quantity("", "standstill does not release the emergency brake")
    stopped_at: float = quantity("m", "front position at the end of the last emergency brake")
    interventions: int = quantity("", "number of brake interventions")


@compiled
def intervene(own: SupervisorState, state: int, reason: int, limit: float) -> None:
    """Raise the state; a lower one than the present has no effect."""
    if state > own.state:
        if state >= SupervisionState.SERVICE_BRAKE > own.state:
            own.interventions += 1
        own.state, own.reason, own.reason_limit = state, reason, limit
        own.reason_speed, own.reason_front, own.reason_rolled = own.speed, own.front, own.rolled


@compiled
def release(own: SupervisorState) -> None:
    """Lower the state where its release condition holds: 3.13.10.3, 3.13.10.4.

    Overspeed, warning and service brake end at the permitted speed, the emergency brake at standstill; a second one
    within :data:`REPEAT_DISTANCE`, and that of a movement backwards, need an acknowledgement, which no run has.
    """
    standstill, within = abs(own.speed) < STANDSTILL_SPEED, own.speed <= own.permitted
    if own.state == SupervisionState.EMERGENCY_BRAKE:
        ended = standstill and not own.latched
    elif own.state == SupervisionState.SERVICE_BRAKE:
        ended = standstill or within
    else:
        ended = within
    if ended:
        if own.state == SupervisionState.EMERGENCY_BRAKE:
            own.stopped_at = own.front
        own.state, own.reason = SupervisionState.NORMAL, Reason.NONE


@compiled
def supervise_speed(p: SupervisorConstants, own: SupervisorState, track: LineLimits) -> bool:
    """Raise the state above a limit or beyond an indication; return False if a curve does not have the speed."""
    speed = own.speed
    if abs(speed) < STANDSTILL_SPEED:
        return True
    if speed > own.emergency:
        intervene(own, SupervisionState.EMERGENCY_BRAKE, Reason.ABOVE_LIMIT, own.emergency)
        own.latched |= own.front - own.stopped_at < REPEAT_DISTANCE
    elif speed > own.service and p.service_brake:
        intervene(own, SupervisionState.SERVICE_BRAKE, Reason.ABOVE_LIMIT, own.service)
    elif speed > own.warning:
        intervene(own, SupervisionState.WARNING, Reason.ABOVE_LIMIT, own.warning)
    elif speed > own.permitted:
        intervene(own, SupervisionState.OVERSPEED, Reason.ABOVE_LIMIT, own.permitted)
    else:
        found = indicated(track, own.front, speed, motion_of(own))
        if found == INDICATED:
            intervene(own, SupervisionState.INDICATION, Reason.TARGET_NEAR, 0.0)
        return bool(found != CURVE_ENDS)
    return True


@compiled
def supervise_direction(p: SupervisorConstants, own: SupervisorState, span: float) -> None:
    """Supervise the movement backwards over a time [ns]: 3.14.2 (roll away), 3.14.3 (reverse movement).

    The distance is the integral of the speed: a balise corrects the position estimate by more than the limit.  The
    release needs an acknowledgement (TSI OPE, appendix A, 6.37), which no run has; otherwise a train that is pushed
    back rolls by the limit again and again.
    """
    own.rolled = max(own.rolled - own.speed * span * 1e-9, 0.0) if own.speed < 0.0 else 0.0
    if own.rolled > p.roll_away:
        intervene(own, SupervisionState.EMERGENCY_BRAKE, Reason.ROLLED_BACK, 0.0)
        own.latched = True


@compiled
def supervise(
    p: SupervisorConstants, own: SupervisorState, past: Records[PastSpeed], track: LineLimits, odometry: OdometryReading
) -> bool:
    """Decide on one period from its odometry; return False if a braking curve does not have the speed of the train."""
    before = own.stamp
    own.known = estimate_motion(own, past, odometry)
    if not own.known:
        intervene(own, SupervisionState.EMERGENCY_BRAKE, Reason.NO_ODOMETRY, 0.0)
        return True
    own.permitted, own.warning, own.service, own.emergency = most_restrictive(track, own.front, motion_of(own))
    release(own)
    within = supervise_speed(p, own, track)
    supervise_direction(p, own, own.stamp - before if own.begun else 0)
    own.begun = True
    return bool(within)


@compiled
def _supervise(p: Any, own: Any, past: Any, ceilings: Any, targets: Any, arcs: Any, odometry: Any) -> bool:
    return bool(supervise(p[0], own[0], past, LineLimits(ceilings, targets, arcs), odometry[0]))


@compiled
def _brake(own: Any, reason: int) -> None:
    """Apply the emergency brake, without a valid odometry."""
    own[0].known = False
    intervene(own[0], SupervisionState.EMERGENCY_BRAKE, reason, 0.0)


REASONS: dict[int, str] = {
    Reason.TARGET_NEAR: "a target is near",
    Reason.NO_ODOMETRY: "no valid odometry",
    Reason.RESTARTED: "node supervisor restarted",
}
"""Reasons without numbers as text."""


_values_of: Callable[[Any], SupervisorState]
_values_of = cast(Any, namedtuple)("SupervisorValues", dtype_of(SupervisorState).names)._make
"""Return a tuple with the fields of a state, from their values."""


class SupervisionDecision:
    """Result of one period, the values of a :class:`SupervisorState`; texts are made at their use."""

    __slots__ = ("own",)

    def __init__(self, record: Any) -> None:
        self.own = _values_of(record.item())

    @property
    def state(self) -> SupervisionState:
        """State of the supervision."""
        return SupervisionState(self.own.state)

    @property
    def reason(self) -> str:
        """Reason of the state as text, "" without one."""
        own = self.own
        if own.reason == Reason.ABOVE_LIMIT:
            speed, limit = own.reason_speed * KMH, own.reason_limit * KMH
            return f"{speed:.1f} km/h at {own.reason_front:.0f} m, limit {limit:.1f} km/h"
        if own.reason == Reason.ROLLED_BACK:
            return f"the train rolled back {own.reason_rolled:.1f} m"
        return REASONS.get(own.reason, "")

    @property
    def speeds(self) -> SupervisionSpeeds:
        """Limits [m/s], 0 without a valid odometry."""
        own = self.own
        return SupervisionSpeeds(own.permitted, own.warning, own.service, own.emergency) if own.known else NO_SPEEDS

    @property
    def motion(self) -> MotionEstimate:
        """Estimated motion, the last known one without a valid odometry."""
        own = self.own
        return MotionEstimate(own.acceleration, own.speed_error, own.position_error, own.position_error)

    @property
    def released(self) -> tuple[bool, bool, bool]:
        """Release of traction, service brake and emergency brake."""
        free = self.own.state < SupervisionState.SERVICE_BRAKE
        return free, free, self.own.state < SupervisionState.EMERGENCY_BRAKE


class Supervisor:
    """Speed and distance supervision of one train.

    Parameters
    ----------
    track
        Limits of the train on its line.
    spec
        Settings.

    Attributes
    ----------
    constants : Array of :class:`SupervisorConstants`, shape (1,)
        Settings.
    state : Array of :class:`SupervisorState`, shape (1,)
        State and decision.
    past : Array of :class:`train_ato.supervision.odometry.PastSpeed`
        Speeds of the averaged acceleration.
    """

    def __init__(self, track: TrackSupervision, spec: SupervisionSpec) -> None:
        self.track = track
        self.constants, self.state, self.past = zeros(SupervisorConstants, 1), zeros(SupervisorState, 1), past_speeds()
        self.constants["service_brake"], self.constants["roll_away"] = spec.service_brake, spec.roll_away
        self.state["stopped_at"] = -inf
        self._reading = zeros(OdometryReading, 1)

    @property
    def interventions(self) -> int:
        """Number of brake interventions."""
        return int(self.state["interventions"][0])

    def join(self) -> None:
        """Begin without the states of the run before: with the emergency brake, released at standstill."""
        self.state["begun"] = False
        _brake(self.state, int(Reason.RESTARTED))

    def step(self, odometry: Odometry | None) -> SupervisionDecision:
        """Return the decision of one period from its odometry; None without a valid one.

        Raises
        ------
        ValueError
            If a braking curve does not have the speed of the train.
        """
        if odometry is None:
            _brake(self.state, int(Reason.NO_ODOMETRY))
            return SupervisionDecision(self.state[0])
        write_reading(self._reading, odometry)
        within = _supervise(self.constants, self.state, self.past, *self.track.records, self._reading)
        decision = SupervisionDecision(self.state[0])
        if not within:
            self.track.indicates(decision.own.front, decision.own.speed, decision.motion)
        return decision
