"""Supervisor: states of the speed supervision, brake demands and their release, monitors of the train.

SUBSET-026, 3.13.10 (commands of the speed and distance monitoring) and 3.14 (standstill, roll away).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from train_ato.messages.types import AtoReport, AtoState, Odometry
from train_ato.supervision.ceiling import SupervisionSpeeds
from train_ato.supervision.odometry import speed_measurement_error
from train_ato.supervision.position_estimate import PositionEstimator, TrainMotion
from train_ato.supervision.settings import SupervisionSpec
from train_ato.supervision.track_supervision import TrackSupervision

STANDSTILL_SPEED = 0.1
"""Estimated speed below which the train is at standstill [m/s]."""
KEPT_NS = 60_000_000_000
"""Time for which a motion is kept for a late report of the ATO [ns]."""
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


class Supervisor:
    """Speed and distance supervision of one train.

    Parameters
    ----------
    track
        Limits of the train on its line.
    spec
        Settings.
    front_offset
        Distance of the front from the centre of vehicle 0 [m], the position of the ATO.

    Attributes
    ----------
    interventions : int
        Number of brake interventions.
    """

    def __init__(self, track: TrackSupervision, spec: SupervisionSpec, front_offset: float) -> None:
        self._track, self._spec, self._front_offset = track, spec, front_offset
        self._estimator = PositionEstimator()
        self._state = SupervisionState.NORMAL
        self._reason = ""
        self._stamp = 0
        self._rolled = self._crept = 0.0
        self._stood = self._latched = False
        self._motions: dict[int, TrainMotion] = {}
        self._differs_since: int | None = None
        self.interventions = 0

    def step(self, odometry: Odometry | None, ato: AtoReport | None) -> SupervisionDecision:
        """Return the decision of one period.

        Parameters
        ----------
        odometry
            Odometry of this period, or None without a valid one.
        ato
            Newest report of the ATO, or None without a recent one.
        """
        motion = None if odometry is None else self._estimator.step(odometry)
        if motion is None:
            self._intervene(SupervisionState.EMERGENCY_BRAKE, self._estimator.problem or "no valid odometry")
            return SupervisionDecision(self._state, self._reason, NO_SPEEDS, None)
        speeds = self._track.evaluate(motion.front, motion.estimate)
        self._release(motion, speeds)
        self._supervise_speed(motion, speeds)
        self._supervise_standstill(motion, ato)
        self._compare(motion, ato)
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

        Overspeed, warning and service brake end at the permitted speed, the emergency brake at standstill; after a
        movement from standstill it ends after an acknowledgement (3.14), and no run has one.
        """
        state = self._state
        stands = abs(motion.speed) < STANDSTILL_SPEED
        within = motion.speed <= speeds.permitted
        if state is SupervisionState.EMERGENCY_BRAKE:
            ended = stands and not self._latched
        elif state is SupervisionState.SERVICE_BRAKE:
            ended = stands or (within and self._differs_since is None)
        else:
            ended = within
        if ended:
            self._state, self._reason = SupervisionState.NORMAL, ""

    def _supervise_speed(self, motion: TrainMotion, speeds: SupervisionSpeeds) -> None:
        speed = motion.speed
        if abs(speed) < STANDSTILL_SPEED:
            return
        limit = f"{speed * 3.6:.1f} km/h at {motion.front:.0f} m"
        if speed > speeds.emergency:
            self._intervene(SupervisionState.EMERGENCY_BRAKE, f"{limit}, limit {speeds.emergency * 3.6:.1f} km/h")
        elif speed > speeds.service and self._spec.service_brake:
            self._intervene(SupervisionState.SERVICE_BRAKE, f"{limit}, limit {speeds.service * 3.6:.1f} km/h")
        elif speed > speeds.warning:
            self._intervene(SupervisionState.WARNING, f"{limit}, limit {speeds.warning * 3.6:.1f} km/h")
        elif speed > speeds.permitted:
            self._intervene(SupervisionState.OVERSPEED, f"{limit}, limit {speeds.permitted * 3.6:.1f} km/h")
        elif self._track.indicates(motion.front, speed, motion.estimate):
            self._intervene(SupervisionState.INDICATION, "a target is near")

    def _supervise_standstill(self, motion: TrainMotion, ato: AtoReport | None) -> None:
        """Supervise movements backwards, and of a train at standstill without an engaged ATO: 3.14.2, 3.14.3.

        The distance is the integral of the speed: a balise corrects the position estimate by more than the limit.
        """
        moved = motion.speed * (motion.stamp - self._stamp) * 1e-9
        self._rolled = max(self._rolled - moved, 0.0) if motion.speed < 0.0 else 0.0
        if self._rolled > self._spec.roll_away:
            self._latched = True
            self._intervene(SupervisionState.EMERGENCY_BRAKE, f"the train rolled back {self._rolled:.1f} m")
        if ato is not None and ato.state[0] == AtoState.ENGAGED:
            self._stood = False
        elif abs(motion.speed) < STANDSTILL_SPEED and not self._stood:
            self._stood, self._crept = True, 0.0
        elif self._stood:
            self._crept += abs(moved)
            if self._crept > self._spec.roll_away:
                self._latched = True
                self._intervene(
                    SupervisionState.EMERGENCY_BRAKE, f"the train moved {self._crept:.1f} m from standstill"
                )
                self._crept = 0.0

    def _compare(self, motion: TrainMotion, ato: AtoReport | None) -> None:
        """Compare the measurement of the ATO with the odometry of the same stamp, while the train moves."""
        self._motions = {stamp: other for stamp, other in self._motions.items() if motion.stamp - stamp <= KEPT_NS}
        self._motions[motion.stamp] = motion
        if ato is None or ato.stamp not in self._motions:
            return
        then = self._motions.pop(ato.stamp)
        self._motions = {stamp: other for stamp, other in self._motions.items() if stamp > ato.stamp}
        difference = self._difference(then, float(ato.position[0]), float(ato.velocity[0]))
        if not difference:
            self._differs_since = None
            return
        if self._differs_since is None:
            self._differs_since = ato.stamp
        moves = abs(motion.speed) > STANDSTILL_SPEED or ato.state[0] == AtoState.ENGAGED
        if moves and motion.stamp - self._differs_since >= self._spec.confirmation * 1e9:
            self._intervene(SupervisionState.SERVICE_BRAKE, f"measurement of the ATO: {difference}")

    def _difference(self, then: TrainMotion, position: float, speed: float) -> str:
        """Return the implausible difference of a measurement [m, m/s] from the estimate as text, "" without one."""
        if not (np.isfinite(position) and np.isfinite(speed)):
            return "not finite"
        allowed = self._spec.speed_difference + speed_measurement_error(then.speed)
        if abs(speed - then.speed) > allowed:
            return f"{speed * 3.6:.1f} km/h, odometry {then.speed * 3.6:.1f} km/h"
        front = position + self._front_offset
        if abs(front - then.front) > self._spec.position_difference + then.estimate.under_reading:
            return f"{front:.0f} m, odometry {then.front:.0f} m"
        return ""
