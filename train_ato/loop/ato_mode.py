"""Mode of the ATO: state machine, requests, and the command while the law does not drive."""

from __future__ import annotations

import numpy as np

from train_ato.control.algorithms.guard import is_valid_state
from train_ato.control.ato_state import AtoStateMachine
from train_ato.control.train_model import STANDSTILL_SPEED
from train_ato.loop.setup import RunSetup
from train_ato.messages.layout import FIXED_NAMES, Owner
from train_ato.messages.types import Array, AtoReport, AtoState, Measurement, ProtectionState
from train_ato.scenario.ato_requests import KEY, AtoRequest, Request

PLANNING_TIME = 10.0
"""Time within which the new profile must arrive after an engagement [s]; then the ATO fails."""


class AtoMode:
    """State of the ATO in the control loop.

    Parameters
    ----------
    setup
        Prepared run with the planned requests.

    Attributes
    ----------
    machine : AtoStateMachine
        State and its transitions.
    awaits_profile : bool
        True from an engagement during the run to the profile planned for it.
    changed : bool
        True at a step with a change of the state.
    """

    def __init__(self, setup: RunSetup) -> None:
        self.machine = AtoStateMachine()
        self.awaits_profile = False
        self.changed = False
        self._model = setup.model
        self._waiting = sorted(setup.scenario.ato_requests, key=lambda request: request.at)
        self._accepted = ""
        self._stands = False

    @property
    def drives(self) -> bool:
        """True if the law drives the train."""
        return self.machine.state is AtoState.ENGAGED and not self.awaits_profile

    def request(self, do: Request) -> None:
        """Queue a request for the next step of the supervisor.

        Raises
        ------
        ValueError
            With the reason of a refusal.
        """
        self.machine.check(do, stands=self._stands)
        self._waiting.insert(0, AtoRequest(at=0.0, do=do))

    def fail(self, stamp: int, reason: str) -> None:
        """Enter the state failure at a stamp [ns]."""
        self.machine.fail(stamp, reason)
        self.changed = True

    def begin_step(self) -> None:
        """Begin a tick: change and accepted request of the tick before are reported once."""
        self.changed, self._accepted = False, ""

    def update(self, measurement: Measurement, protection: ProtectionState) -> AtoReport:
        """Apply conditions and requests at a step of the supervisor; return the report of this step."""
        stamp, machine = measurement.stamp, self.machine
        valid = is_valid_state(measurement)
        self._stands = valid and float(np.abs(measurement.velocity).max()) < STANDSTILL_SPEED
        names = zip(FIXED_NAMES[Owner.BRAKE_LINE], protection.active.tolist(), strict=True)
        active = [name.replace("_", " ") for name, value in names if value]
        before = machine.state
        machine.update(stamp, valid=valid, stands=self._stands, locked=f"{active[-1]} in effect" if active else "")
        if self.awaits_profile and stamp - machine.since > PLANNING_TIME * 1e9:
            self.awaits_profile = False
            machine.fail(stamp, "no profile from the present place; see the diagnostics of the profile")
        self._take_request(stamp)
        self.changed = machine.state is not before or bool(self._accepted)
        return AtoReport(
            stamp,
            measurement.position[:1] + self._model.offsets[:1],
            measurement.velocity[:1],
            np.array([float(machine.state)]),
        )

    def _take_request(self, stamp: int) -> None:
        """Apply the first request that is due and possible."""
        for request in self._waiting:
            if round(request.at * 1e9) > stamp:
                return
            try:
                self.machine.request(stamp, request.do, stands=self._stands)
            except ValueError:  # a planned request waits for its state
                continue
            self._waiting.remove(request)
            self._accepted = request.do
            self.awaits_profile = request.do == "engage"
            return

    def command(self, measurement: Measurement) -> tuple[Array, float | None]:
        """Return force [N] and brake-pipe pressure [Pa] while the law does not drive: coasting, then braking."""
        model = self._model
        brake = model.consist.air_brake
        force = np.zeros(model.n_units)
        if not self.machine.brakes(measurement.stamp) or self._stands:
            return force, None if brake is None else brake.charged
        if is_valid_state(measurement):
            force = np.minimum(model.force_limits(measurement.velocity)[0], 0.0)
        return force, None if brake is None else brake.charged - brake.reduction[-1]

    def diagnostics(self) -> dict[str, str]:
        """Return state, reason and accepted request as text."""
        values = {"ato_state": self.machine.state.text, "ato_reason": self.machine.reason}
        return {**values, KEY: self._accepted} if self._accepted else values
