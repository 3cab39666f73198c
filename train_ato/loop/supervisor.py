"""Supervisor stage: decisions of the supervisor as messages."""

from __future__ import annotations

import numpy as np

from train_ato.loop.inputs import StageInputs
from train_ato.loop.setup import RunSetup
from train_ato.loop.stage_messages import SupervisorMessages, diagnostics_due
from train_ato.messages.topics import Role
from train_ato.messages.types import BrakeRelease, Diagnostic, Odometry, SupervisedSpeeds
from train_ato.supervision.odometry_check import OdometryCheck
from train_ato.supervision.supervisor import SupervisionDecision, SupervisionState


class SupervisorStage:
    """Speed and distance supervision of the train, independent of the ATO.

    Attributes
    ----------
    odometry_check : OdometryCheck
        Plausibility of the odometry.
    supervisor : Supervisor
        Decisions.
    """

    role = Role.SUPERVISOR

    def __init__(self, setup: RunSetup) -> None:
        self.setup = setup
        self._inputs = StageInputs(setup, self.role)
        self.odometry_check = OdometryCheck()
        self._inputs.check("train/odometry", self.odometry_check.problem)
        self.supervisor = setup.supervisor()
        self._period_ns = setup.supervision_ticks * setup.tick_ns
        self._reported = SupervisionState.NORMAL
        self._count: int | None = None

    def join(self) -> None:
        """Join a run in progress, in place of an ended supervisor."""
        self.supervisor.join()

    def step(self, odometry: Odometry) -> SupervisorMessages:
        """Return the decision for the stamp of the odometry; without a valid one, the motion is the last known."""
        stamp = odometry.stamp
        decision = self.supervisor.step(self._inputs.receive("train/odometry", stamp, odometry))
        own = decision.own
        changed = self._inputs.take_changed() or own.state != self._reported
        if changed:
            self._reported = decision.state
        # after a restart of the node the alive counter goes on as if it had never stopped
        self._count = stamp // self._period_ns if self._count is None else self._count + 1
        alive, foremost = float(self._count), own.front + own.position_error
        return SupervisorMessages(
            BrakeRelease(stamp, np.array(decision.released, dtype=np.float64), np.array([alive, alive, alive])),
            SupervisedSpeeds(
                stamp,
                np.array([own.front, foremost, foremost, foremost, foremost]),
                np.array([own.speed, *decision.speeds]),
            ),
            self._diagnostic(stamp, decision) if changed or diagnostics_due(stamp, self._period_ns) else None,
        )

    def _diagnostic(self, stamp: int, decision: SupervisionDecision) -> Diagnostic:
        """Return the state of the supervision with the reason of the last change."""
        values = {"brake_interventions": str(self.supervisor.interventions), **self._inputs.diagnostics()}
        if decision.motion is not None:
            values |= {
                "front": repr(decision.motion.front),
                "position_error": repr(decision.motion.estimate.under_reading),
                "acceleration": repr(decision.motion.estimate.acceleration),
            }
        if decision.reason:
            values["reason"] = decision.reason
        level = int(decision.state > SupervisionState.INDICATION) + int(decision.state > SupervisionState.WARNING)
        return Diagnostic(stamp, "supervisor", level, decision.state.text, values)
