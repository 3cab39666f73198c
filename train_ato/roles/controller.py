"""The control stack with its parameters, swapped while the train runs."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from train_ato.compensate.registry import COMPENSATIONS
from train_ato.control.registry import LAWS
from train_ato.control.stack import ControlStack
from train_ato.links import MessageLink
from train_ato.profile.profile import Profile
from train_ato.roles.outgoing import Outgoing, due, stamped
from train_ato.roles.step_times import StepTimes
from train_ato.run_setup import RunSetup
from train_ato.topics import Role
from train_ato.types import (
    Command,
    Diagnostic,
    DisturbanceEstimate,
    Measurement,
    Pipe,
    Reference,
)

if TYPE_CHECKING:
    pass


class ControllerRole:
    """The control stack: law, compensation, brake policy; swapped by parameter while the train runs."""

    role = Role.CONTROLLER

    def __init__(self, setup: RunSetup) -> None:
        self.setup = setup
        self._parameters: dict[str, dict[str, Any]] = {
            name: dict(values) for name, values in setup.controller_parameters.items()
        }
        self._profile: Profile | None = None
        self._stack: ControlStack | None = None
        self._swaps = sorted(setup.swaps, key=lambda swap: swap.at)
        links, step, seed = setup.links, setup.step_ns, setup.seed
        self._measurement_link = MessageLink(links.measurement, step, seed, "measurement")
        self._reference_link = MessageLink(links.reference, step, seed, "reference")
        self._estimate_link = MessageLink(links.estimate, step, seed, "estimate")
        self.controller = setup.controller
        self.step_times = StepTimes([])

    def set_profile(self, profile: Profile) -> None:
        """Take the profile; the stack is made when the first one has come."""
        self._profile = profile
        if self._stack is None:
            setup = self.setup
            self._stack = ControlStack(
                model=setup.model,
                period=setup.control_period,
                tick=setup.tick,
                controller=self.controller,
                controller_parameters=self._parameters,
                compensation=COMPENSATIONS.make(
                    setup.compensation, setup.compensation_parameters, setup.model, setup.control_period
                ),
                brake_policy=setup.brake_policy(),
                profile=profile,
                hold_limit=setup.scenario.hold_limit,
            )
        else:
            self._stack.set_profile(profile)

    def validate(self, name: str, value: Any) -> None:
        """Check one parameter (``controller`` or ``law.parameter``) without side effects.

        Raises
        ------
        ValueError
            With the reason for the refusal.
        """
        if name == "controller":
            self.setup.law(value, self._parameters.get(value, {}))
            return
        law, _, parameter = name.partition(".")
        merged = {**self._parameters.get(law, {}), parameter: value}
        if law == self.controller:
            self.setup.law(law, merged)
        else:
            LAWS.make(law, merged, self.setup.model, self.setup.control_period)

    def apply(self, name: str, value: Any) -> None:
        """Take over a parameter that was validated; a change of the running law swaps it without a jump in force."""
        if name == "controller":
            self.controller = str(value)
        else:
            law, _, parameter = name.partition(".")
            self._parameters.setdefault(law, {})[parameter] = value
            if law != self.controller:
                return
        if self._stack is not None:
            self._stack.swap(self.controller, self._parameters.get(self.controller, {}))

    def step(
        self, measurement: Measurement, reference: Reference, estimate: DisturbanceEstimate
    ) -> tuple[Command, Pipe | None, Outgoing]:
        """Return the command, the brake-pipe demand if there is an air brake, and what to send.

        ``ato/command`` comes last among the messages, because it ends the step.
        """
        assert self._stack is not None, "the profile comes before the first step"
        begin = time.perf_counter_ns()
        stamp = measurement.stamp
        while self._swaps and self._swaps[0].at * 1e9 <= stamp:
            self.apply("controller", self._swaps.pop(0).controller)
        force, pressure = self._stack.step(
            stamped(self._measurement_link.pass_on(stamp, measurement), stamp),
            self._reference_link.pass_on(stamp, reference),
            self._estimate_link.pass_on(stamp, estimate),
        )
        self.step_times.nanoseconds.append(time.perf_counter_ns() - begin)
        command = Command(stamp, force)
        messages: Outgoing = []
        pipe = None
        if pressure is not None:
            pipe = Pipe(stamp, pressure)
            messages.append(("ato/brake_pipe", pipe))
        if (report := self.diagnostic(stamp)) is not None:
            messages.append(("/diagnostics", report))
        messages.append(("ato/command", command))
        return command, pipe, messages

    def diagnostic(self, stamp: int) -> Diagnostic | None:
        """Return the state of the controller once a second, and at every step that only repeats the last command."""
        if self._stack is None or not (due(stamp, self.setup.tick_ns) or self._stack.holding):
            return None
        model = self.setup.model
        values = {
            "controller": self.controller,
            "compensation": self.setup.compensation,
            "delay": repr(model.delay.tolist()),
            "delay_brake": repr(model.delay_brake.tolist()),
            "lag": repr(model.lag),
            **self._stack.diagnostics(),
        }
        if self._stack.holding:
            return Diagnostic(stamp, "controller", 1, "holding the last command", values)
        return Diagnostic(stamp, "controller", 0, "engaged", values)
