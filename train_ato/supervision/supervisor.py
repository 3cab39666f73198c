"""Supervisor: states of the speed supervision, brake demands and their release.

It uses its own odometry only, and no message of the ATO. SUBSET-026, 3.13.10 (commands of the speed and distance
monitoring) and 3.14 (roll away).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from train_ato.messages.types import Odometry
from train_ato.supervision.ceiling import SupervisionSpeeds
from train_ato.supervision.position_estimate import PositionEstimator, TrainMotion
from train_ato.supervision.settings import SupervisionSpec
from train_ato.supervision.track_supervision import TrackSupervision

STANDSTILL_SPEED = 0.1
"""Estimated speed below which the train is at standstill [m/s]."""
REPEAT_DISTANCE = 50.0
"""Distance from the end of an emergency brake within which a second one is not released at standstill [m]."""
TARGET_NEAR = "a target is near"
"""Reason of the state indication."""
NO_SPEEDS = SupervisionSpeeds(0.0, 0.0, 0.0, 0.0)


class SupervisionState(IntEnum):
    """State of the supervision, by rising severity: SUBSET-026, 4.7 (supervision status) and 3.13.10."""

    NORMAL = 0
    INDICATION = 1
    OVERSPEED = 2
    WARNING = 3
    SERVICE_BRAKE = 4
    EMERGENCY_BRAKE = 5

    @property
    def text(self) -> str:
        """State in words."""
        return self.name.lower().replace("_", " ")


@dataclass(frozen=True, slots=True)
class SupervisionDecision:
    """Result of one period: state, its reason, limits [m/s], estimated motion (None: no valid odometry)."""

    state: SupervisionState
    reason: str
    speeds: SupervisionSpeeds
    motion: TrainMotion | None

    @property
    def released(self) -> tuple[bool, bool, bool]:
        """Release of traction, service brake and emergency brake."""
        free = self.state < SupervisionState.SERVICE_BRAKE
        return free, free, self.state < SupervisionState.EMERGENCY_BRAKE


def limit_text(motion: TrainMotion, limit: float) -> str:
    """Return speed and place of a train above a limit [m/s] as text."""
    return f"{motion.speed * 3.6:.1f} km/h at {motion.front:.0f} m, limit {limit * 3.6:.1f} km/h"


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
    interventions : int
        Number of brake interventions.
    """

    def __init__(self, track: TrackSupervision, spec: SupervisionSpec) -> None:
        self.track, self._spec = track, spec
        self._estimator = PositionEstimator()
        self._state = SupervisionState.NORMAL
        self._reason = ""
        self._stamp: int | None = None
        self._rolled = 0.0
        self._latched = False
        self._stopped_at = -np.inf
        self.interventions = 0

    def join(self) -> None:
        """Begin without the states of the run before: with the emergency brake, released at standstill."""
        self._stamp = None
        self._intervene(SupervisionState.EMERGENCY_BRAKE, "node supervisor restarted")

    def step(self, odometry: Odometry | None) -> SupervisionDecision:
        """Return the decision of one period from its odometry; None without a valid one."""
        motion = None if odometry is None else self._estimator.step(odometry)
        if motion is None:
            self._intervene(SupervisionState.EMERGENCY_BRAKE, "no valid odometry")
            return SupervisionDecision(self._state, self._reason, NO_SPEEDS, None)
        speeds = self.track.evaluate(motion.front, motion.estimate)
        self._release(motion, speeds)
        self._supervise_speed(motion, speeds)
        self._supervise_direction(motion)
        self._stamp = motion.stamp
        return SupervisionDecision(self._state, self._reason, speeds, motion)

    def _intervene(self, state: SupervisionState, reason: str) -> None:
        """Raise the state; a lower one than the present has no effect."""
        if state > self._state:
            if state >= SupervisionState.SERVICE_BRAKE > self._state:
                self.interventions += 1
            self._state, self._reason = state, reason

    def _release(self, motion: TrainMotion, speeds: SupervisionSpeeds) -> None:
        """Lower the state where its release condition holds: 3.13.10.3, 3.13.10.4.

        Overspeed, warning and service brake end at the permitted speed, the emergency brake at standstill; a second one
        within :data:`REPEAT_DISTANCE`, and that of a movement backwards, need an acknowledgement, which no run has.
        """
        state = self._state
        standstill = abs(motion.speed) < STANDSTILL_SPEED
        within = motion.speed <= speeds.permitted
        if state is SupervisionState.EMERGENCY_BRAKE:
            ended = standstill and not self._latched
        elif state is SupervisionState.SERVICE_BRAKE:
            ended = standstill or within
        else:
            ended = within
        if ended:
            if state is SupervisionState.EMERGENCY_BRAKE:
                self._stopped_at = motion.front
            self._state, self._reason = SupervisionState.NORMAL, ""

    def _supervise_speed(self, motion: TrainMotion, speeds: SupervisionSpeeds) -> None:
        speed = motion.speed
        if abs(speed) < STANDSTILL_SPEED:
            return
        if speed > speeds.emergency:
            self._intervene(SupervisionState.EMERGENCY_BRAKE, limit_text(motion, speeds.emergency))
            self._latched |= motion.front - self._stopped_at < REPEAT_DISTANCE
        elif speed > speeds.service and self._spec.service_brake:
            self._intervene(SupervisionState.SERVICE_BRAKE, limit_text(motion, speeds.service))
        elif speed > speeds.warning:
            self._intervene(SupervisionState.WARNING, limit_text(motion, speeds.warning))
        elif speed > speeds.permitted:
            self._intervene(SupervisionState.OVERSPEED, limit_text(motion, speeds.permitted))
        elif self.track.indicates(motion.front, speed, motion.estimate):
            self._intervene(SupervisionState.INDICATION, TARGET_NEAR)

    def _supervise_direction(self, motion: TrainMotion) -> None:
        """Supervise the movement backwards: 3.14.2 (roll away), 3.14.3 (reverse movement).

        The distance is the integral of the speed: a balise corrects the position estimate by more than the limit.  The
        release needs an acknowledgement (TSI OPE, appendix A, 6.37), which no run has; otherwise a train that is
        pushed back rolls by the limit again and again.
        """
        since = motion.stamp if self._stamp is None else self._stamp
        moved = motion.speed * (motion.stamp - since) * 1e-9
        self._rolled = max(self._rolled - moved, 0.0) if motion.speed < 0.0 else 0.0
        if self._rolled > self._spec.roll_away:
            self._intervene(SupervisionState.EMERGENCY_BRAKE, f"the train rolled back {self._rolled:.1f} m")
            self._latched = True
