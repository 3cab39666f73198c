"""Supervisor stage: decisions of the supervisor as messages."""

from __future__ import annotations

import numpy as np

from train_ato.loop.inputs import StageInputs
from train_ato.loop.setup import RunSetup
from train_ato.loop.stage_messages import SupervisorMessages, diagnostics_due
from train_ato.messages.topics import Role
from train_ato.messages.types import AtoReport, BrakeRelease, Diagnostic, Odometry, SupervisedSpeeds
from train_ato.supervision.supervisor import SupervisionDecision, SupervisionState


class SupervisorStage:
    """Speed and distance supervision of the train, independent of the ATO."""

    role = Role.SUPERVISOR

    def __init__(self, setup: RunSetup) -> None:
        self.setup = setup
        self._inputs = StageInputs(setup, self.role)
        self._supervisor = setup.supervisor()
        self._period_ns = setup.supervision_ticks * setup.tick_ns
        self._reported = SupervisionState.NORMAL

    def step(self, odometry: Odometry, ato: AtoReport | None) -> SupervisorMessages:
        """Return the decision for the stamp of the odometry.

        Parameters
        ----------
        odometry
            Odometry of this period.
        ato
            Report of the ATO of the period before; None at the first.
        """
        stamp = odometry.stamp
        decision = self._supervisor.step(
            self._inputs.receive("train/odometry", stamp, odometry), self._inputs.receive("ato/state", stamp, ato)
        )
        changed = self._inputs.take_changed() or decision.state is not self._reported
        self._reported = decision.state
        speed = 0.0 if decision.motion is None else decision.motion.speed
        return SupervisorMessages(
            BrakeRelease(stamp, np.array(decision.released, dtype=np.float64)),
            SupervisedSpeeds(stamp, np.array([speed, *decision.speeds])),
            self._diagnostic(stamp, decision) if changed or diagnostics_due(stamp, self._period_ns) else None,
        )

    def _diagnostic(self, stamp: int, decision: SupervisionDecision) -> Diagnostic:
        """Return the state of the supervision with the reason of the last change."""
        values = {"interventions": str(self._supervisor.interventions), **self._inputs.diagnostics()}
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
