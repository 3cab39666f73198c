"""Supervisor, train protection and mode of the ATO before and after compiled ticks without effect of the supervisor."""

from __future__ import annotations

from plant_sim.odometry import OdometerState, OdometryReading, SlipRecord
from plant_sim.record import Records, zeros
from train_ato.control.assurance import AssuranceConstants, AssuranceState
from train_ato.control.plausibility import CheckConstants
from train_ato.loop.spans.stages import Stages
from train_ato.loop.spans.supervision_kernel import SupervisedRun, SupervisionArrays, SupervisionStates
from train_ato.loop.train_protection import Protection
from train_ato.messages.types import AtoState
from train_ato.supervision.deceleration_curve import Arc
from train_ato.supervision.limits import Target
from train_ato.supervision.position_estimate import PastSpeed
from train_ato.supervision.supervisor import SupervisionState, SupervisorConstants, SupervisorState
from train_ato.supervision.track_supervision import Ceiling, LineLimits


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
        self._run["period"], self._run["half"] = self._period, stages.plant._half
        self._run["assured"] = stages.controller.ato.assurance is not None

    @property
    def is_quiet(self) -> bool:
        """True if neither supervisor nor train protection nor the mode of the ATO changes the commands."""
        plant, controller = self._stages.plant, self._stages.controller
        protection = plant.protection
        if protection.requested or protection.level is not Protection.NONE or plant._reported is not Protection.NONE:
            return False
        if plant.lost or plant._outage_changed or controller._outage or controller._takeover or controller._error:
            return False
        if self._stages.supervisor is None:
            return True
        stamp, stage, ato, profile = plant.stamp, self._stages.supervisor, controller.ato, self._stages.profile
        supervisor = stage.supervisor
        if stage._count is None or not supervisor.state["begun"][0] or not profile._engaged or profile._joins:
            return False
        if supervisor.state["state"][0] >= SupervisionState.SERVICE_BRAKE or ato.machine.state is not AtoState.ENGAGED:
            return False
        if ato.awaits_profile or ato.assured or ato.check.since is not None:
            return False
        if any(round(request.at * 1e9) <= stamp and request.do == "disengage" for request in ato._waiting):
            return False
        return bool(stage.odometry_check.last["stamp"][0] >= 0) and protection.is_idle(stamp, self._period)

    def next_request(self, stamp: int) -> list[int]:
        """Return the stamps of the requests to the ATO after a stamp [ns]."""
        return [at for request in self._stages.controller.ato._waiting if (at := round(request.at * 1e9)) > stamp]

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
            SupervisionStates(*states), kept, odometers.slips, own.constants, own.past, own.track.records, constants,
            own.past if watch is None else watch.past, ato.check.constants, zeros(SupervisorState, most),
            zeros(OdometryReading, most),
        )  # fmt: skip

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
    limits = LineLimits(zeros(Ceiling, 1), zeros(Target, 0), zeros(Arc, 0))
    return SupervisionArrays(
        states, states, zeros(SlipRecord, 0), zeros(SupervisorConstants, 1), zeros(PastSpeed, 1), limits,
        zeros(AssuranceConstants, 1), zeros(PastSpeed, 1), zeros(CheckConstants, 1), zeros(SupervisorState, 1),
        zeros(OdometryReading, 1),
    )  # fmt: skip
