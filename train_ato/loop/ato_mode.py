"""Mode of the ATO: state machine, requests, and the command while the law does not drive."""

import numpy as np

from train_ato.control.assurance import AssuranceMonitor
from train_ato.control.ato_state import AtoStateMachine
from train_ato.control.guard import is_valid_state
from train_ato.control.plausibility import MeasurementCheck
from train_ato.messages.topic import FIXED_NAMES, Owner
from train_ato.messages.types import Array, AtoReport, AtoState, Measurement, ProtectionState, SupervisedSpeeds
from train_ato.profile.planner.plan_from_state import STOP_TOLERANCE
from train_ato.scenario.interventions import REQUEST_KEY, AtoRequest, Request
from train_ato.scenario.setup import RunSetup
from train_ato.supervision.supervisor import STANDSTILL_SPEED

PLANNING_TIME = 10.0
"""Time within which the new profile must arrive after an engagement [s]; then the ATO fails."""
NOTHING_LEFT = "engage: the train is at the last stop of its profile or beyond it; no part of the profile is left"


class AtoMode:
    """State of the ATO in the control loop.

    Attributes
    ----------
    machine : AtoStateMachine
        State and its transitions.
    awaits_profile : bool
        True from an engagement during the run to the profile planned for it.
    drives : bool
        True if the law drives the train.
    changed_at : int
        Stamp of the last change of the state or accepted request [ns].
    assurance : AssuranceMonitor or None
        Choice between the law and the braking law.
    assured : bool
        True while the braking law drives in place of the law.
    returned_at : int
        Stamp of the last step at which the law drove again after the braking law [ns].
    standstill : bool
        True if the train is at standstill.
    check : MeasurementCheck
        Comparison of the measurement with the odometry.
    last_stop : float
        Last place of vehicle 0 in the profile [m]; infinite if another program plans the profile.
    """

    def __init__(self, setup: RunSetup) -> None:
        self.machine = AtoStateMachine()
        self.awaits_profile, self.drives = False, True
        self.changed_at = self.returned_at = -1
        self._model, self._offset = setup.model, setup.model.offsets[:1]
        spec, offset = setup.scenario.supervision, float(setup.model.offsets[0]) if setup.model.n_units else 0.0
        self.check = MeasurementCheck(spec, offset + setup.consist.vehicles[0].length / 2.0)
        self.assurance = AssuranceMonitor(setup.assurance_reaction, spec) if spec.assurance else None
        self.assured = False
        self.waiting = sorted(setup.scenario.ato_requests, key=lambda request: request.at)
        self._accepted = -1, ""
        self.standstill = False
        self.last_stop = np.inf
        self._speed = self._place = 0.0

    def _settle(self) -> None:
        self.drives = self.machine.state is AtoState.ENGAGED and not self.awaits_profile

    def take_profile(self) -> None:
        """End the wait for a profile."""
        self.awaits_profile = False
        self._settle()

    def request(self, do: Request) -> None:
        """Queue a request for the next step of the supervisor; ValueError with the reason of a refusal."""
        self.machine.check(do, standstill=self.standstill)
        if do == "engage" and self._at_end:
            raise ValueError(NOTHING_LEFT)
        self.waiting.insert(0, AtoRequest(at=0.0, do=do))

    @property
    def _at_end(self) -> bool:
        return self._place + STOP_TOLERANCE >= self.last_stop

    def fail(self, stamp: int, reason: str) -> None:
        """Enter the state failure at a stamp [ns]."""
        self.machine.fail(stamp, reason)
        self.changed_at = stamp
        self._settle()

    def stop(self, stamp: int, reason: str) -> None:
        """End an engagement at a stamp [ns] and brake to a stop."""
        self.machine.stop(stamp, reason)
        self.changed_at = stamp
        self.take_profile()

    def take_speed(self, speed: float) -> None:
        """Take the speed of the supervisor [m/s]."""
        self._speed = abs(speed)
        self.standstill = self._speed < STANDSTILL_SPEED

    def update(
        self, measurement: Measurement, protection: ProtectionState | None, speeds: SupervisedSpeeds | None
    ) -> AtoReport:
        """Apply conditions and requests at a step of the supervisor; return the report of this step.

        Parameters
        ----------
        measurement
            Newest measurement.
        protection, speeds
            Newest state of traction cut-off and brakes, and limits; None locks the ATO as a brake does.
        """
        stamp, machine = measurement.stamp, self.machine
        valid = is_valid_state(measurement)
        self.standstill = False
        if speeds is not None:
            self.take_speed(speeds.speed.item(0))
        before = machine.state
        machine.update(stamp, valid=valid, standstill=self.standstill, locked=_lock(protection, speeds))
        if self.awaits_profile and stamp - machine.since > PLANNING_TIME * 1e9:
            self.awaits_profile = False
            machine.fail(stamp, "no profile from the present place; see the diagnostics of the profile")
        difference = "" if speeds is None else self.check.step(measurement, speeds)
        if difference and machine.state is AtoState.ENGAGED:
            machine.fail(stamp, difference)
        position = measurement.position[:1] + self._offset
        self._place = position.item(0)
        self._take_request(stamp)
        self._settle()
        if machine.state is not before or self._accepted[0] == stamp:
            self.changed_at = stamp
        if self.assurance is not None and speeds is not None and self.assurance.step(speeds):
            self.changed_at, self.assured = stamp, self.assurance.brakes
            if not self.assured:
                self.returned_at = stamp
        return AtoReport(stamp, position, measurement.velocity[:1], np.array([float(machine.state)]))

    def _take_request(self, stamp: int) -> None:
        """Apply the first request that is due and possible."""
        for request in self.waiting:
            if round(request.at * 1e9) > stamp:
                return
            try:
                self.machine.request(stamp, request.do, standstill=self.standstill)
            except ValueError:  # a planned request waits for its state
                continue
            self.waiting.remove(request)
            self._accepted = stamp, request.do
            self.awaits_profile = request.do == "engage" and not self._at_end
            if request.do == "engage" and self._at_end:
                self.machine.fail(stamp, NOTHING_LEFT)
            return

    def command(self, measurement: Measurement) -> tuple[Array, float | None]:
        """Return force [N] and brake-pipe pressure [Pa] while the law does not drive: coasting, then braking."""
        model = self._model
        brake = model.consist.air_brake
        force = np.zeros(model.n_units)
        if not self.machine.brakes(measurement.stamp) or self.standstill:
            return force, None if brake is None else brake.charged
        return self.braking_force(measurement), None if brake is None else brake.charged - brake.reduction[-1]

    def braking_force(self, measurement: Measurement) -> Array:
        """Return the force of the braking law [N], shape (units,): the full electric brake.

        Without a valid measurement the speed is that of the supervisor.
        """
        velocity = measurement.velocity
        if not is_valid_state(measurement):
            velocity = np.full(self._model.n_units, self._speed)
        return np.asarray(np.minimum(self._model.force_limits(velocity)[0], 0.0))

    def diagnostics(self, stamp: int) -> dict[str, str]:
        """Return state, reason and assurance as text, and the request accepted at a stamp [ns]."""
        values = {"ato_state": self.machine.state.text, "ato_reason": self.machine.reason}
        if self.assurance is not None:
            values["takeovers"] = str(self.assurance.takeovers)
            if self.assured:
                values["takeover"] = self.assurance.reason
        accepted_at, request = self._accepted
        return {**values, REQUEST_KEY: request} if accepted_at == stamp else values


def _lock(protection: ProtectionState | None, speeds: SupervisedSpeeds | None) -> str:
    """Return the traction cut-off or brake in effect, or a missing message, as text; "" without one."""
    if protection is None or speeds is None:
        return f"no valid {'train/protection' if protection is None else 'atp/speeds'}"
    active = protection.active.tolist()
    if not any(active):
        return ""
    names = [name for name, value in zip(FIXED_NAMES[Owner.BRAKE_LINE], active, strict=True) if value]
    return f"{names[-1].replace('_', ' ')} in effect"
