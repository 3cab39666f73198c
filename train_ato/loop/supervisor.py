"""Supervisor stage: decisions of the supervisor as messages."""

import numpy as np

from train_ato.loop.inputs import StageInputs
from train_ato.loop.stage_messages import SupervisorMessages
from train_ato.loop.train_ahead import MovingAuthority
from train_ato.messages.topics import Role
from train_ato.messages.types import BrakeRelease, Diagnostic, Odometry, SupervisedSpeeds, TrainAhead
from train_ato.scenario.setup import RunSetup
from train_ato.supervision.odometry import OdometryCheck
from train_ato.supervision.supervisor import SupervisionDecision, SupervisionState


class SupervisorStage:
    """Speed and distance supervision of the train, independent of the ATO.

    Attributes
    ----------
    odometry_check : OdometryCheck
        Plausibility of the odometry.
    supervisor : Supervisor
        Decisions.
    authority : MovingAuthority or None
        End of authority behind the train ahead; None without one.
    """

    role = Role.SUPERVISOR

    def __init__(self, setup: RunSetup) -> None:
        self.setup = setup
        self.inputs = StageInputs(setup, self.role)
        self.odometry_check = OdometryCheck()
        self.inputs.ends["train/odometry"].check = self.odometry_check.problem
        self.supervisor = setup.supervisor()
        leader = setup.scenario.leader
        moves = leader is not None and leader.authority is not None
        self.authority = MovingAuthority(setup, self.supervisor.track) if moves else None
        self._period_ns = setup.supervision_ticks * setup.tick_ns
        self.reported: int = SupervisionState.NORMAL
        self.count: int | None = None

    def join(self) -> None:
        """Join a run in progress, in place of an ended supervisor."""
        self.supervisor.join()

    def step(self, odometry: Odometry, ahead: TrainAhead | None = None) -> SupervisorMessages:
        """Return the decision for the stamp of the odometry; without a valid one, the motion is the last known.

        ``ahead`` is the live report of the train ahead.
        """
        stamp = odometry.stamp
        if self.authority is not None:
            self.authority.receiver.hear(ahead)
            self.authority.move(stamp)
        decision = self.supervisor.step(self.inputs.ends["train/odometry"].receive(stamp, odometry))
        own = decision.own
        reported = self.inputs.report_due(stamp) or own.state != self.reported
        self.reported = own.state
        # after a restart of the node the alive counter goes on as if it had never stopped
        self.count = stamp // self._period_ns if self.count is None else self.count + 1
        alive, foremost = float(self.count), own.front + own.position_error
        return SupervisorMessages(
            SupervisedSpeeds(stamp, np.array([own.front, *[foremost] * 4]), np.array([own.speed, *decision.speeds])),
            self.diagnostic(stamp, decision) if reported else None,
            BrakeRelease(stamp, np.array(decision.released, dtype=np.float64), np.array([alive, alive, alive])),
        )

    def diagnostic(self, stamp: int, decision: SupervisionDecision) -> Diagnostic:
        """Return the state of the supervision with the reason of the last change."""
        values = {"brake_interventions": str(self.supervisor.interventions), **self.inputs.diagnostics()}
        if self.authority is not None:
            values |= self.authority.diagnostics(stamp)
        if decision.own.known:
            values |= {key: repr(getattr(decision.own, key)) for key in ("front", "position_error", "acceleration")}
        if decision.reason:
            values["reason"] = decision.reason
        level = int(decision.state > SupervisionState.INDICATION) + int(decision.state > SupervisionState.WARNING)
        return Diagnostic(stamp, "supervisor", level, decision.state.text, values)
