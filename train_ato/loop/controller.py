"""The control stack with its parameters, swapped while the train runs."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from train_ato.changes import KEY, LAW, Changes, as_text, changes_of, stamp_of
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
    """The control stack: law, compensation, brake policy; swapped by parameter while the train runs.

    Attributes
    ----------
    controller : str
        Law in charge.
    changed : dict
        Parameters that the last step began to use, planned in the scenario or set from outside.
    """

    role = Role.CONTROLLER

    def __init__(self, setup: RunSetup) -> None:
        self.setup = setup
        self._parameters: dict[str, dict[str, Any]] = {
            name: dict(values) for name, values in setup.controller_parameters.items()
        }
        self._profile: Profile | None = None
        self._stack: ControlStack | None = None
        self._planned = sorted(setup.swaps, key=lambda swap: swap.at)
        self._fresh = True
        self._law_changed = False
        self._asked: Changes = {}
        links, step, seed = setup.links, setup.step_ns, setup.seed
        self._measurement_link = MessageLink(links.measurement, step, seed, "measurement")
        self._reference_link = MessageLink(links.reference, step, seed, "reference")
        self._estimate_link = MessageLink(links.estimate, step, seed, "estimate")
        self.controller = setup.controller
        self.changed: Changes = {}
        self.step_times = StepTimes([])

    def set_profile(self, profile: Profile) -> None:
        """Take the profile; the stack is made when the first one has come."""
        self._profile = profile
        if self._stack is None:
            self._stack = self._new_stack(profile)
        else:
            self._stack.set_profile(profile)

    def _new_stack(self, profile: Profile) -> ControlStack:
        setup = self.setup
        return ControlStack(
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

    def begin_with(self, name: str, value: Any) -> None:
        """Take over a parameter that was validated and given at the start, instead of the scenario's."""
        self._take(name, value)

    def apply(self, name: str, value: Any) -> None:
        """Take over a parameter that was validated; it takes effect with the next step, which reports it."""
        self._asked.pop(name, None)
        self._asked[name] = value
        self._law_changed |= self._take(name, value)

    def _take(self, name: str, value: Any) -> bool:
        """Keep a value; tell whether it concerns the law in charge."""
        if name == LAW:
            self.controller = str(value)
            return True
        law, _, parameter = name.partition(".")
        self._parameters.setdefault(law, {})[parameter] = value
        return law == self.controller

    def _change(self, stamp: int) -> None:
        """Begin to use what was set since the last step or is planned for this one.

        A change of the running law swaps it without a jump in force; before the first step nothing can jump.
        """
        while self._planned and stamp_of(self._planned[0]) <= stamp:
            for name, value in changes_of(self._planned.pop(0)).items():
                self.apply(name, value)
        self.changed, self._asked = self._asked, {}
        if self._law_changed:
            assert self._stack is not None
            assert self._profile is not None
            if self._fresh:
                self._stack = self._new_stack(self._profile)
            else:
                self._stack.swap(self.controller, self._parameters.get(self.controller, {}))
        self._fresh = self._law_changed = False

    def step(
        self, measurement: Measurement, reference: Reference, estimate: DisturbanceEstimate
    ) -> tuple[Command, Pipe | None, Outgoing]:
        """Return the command, the brake-pipe demand if there is an air brake, and what to send.

        ``ato/command`` comes last among the messages, because it ends the step.
        """
        assert self._stack is not None, "the profile comes before the first step"
        begin = time.perf_counter_ns()
        stamp = measurement.stamp
        self._change(stamp)
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
        """Return the state of the controller once a second, and at every step that has more to tell.

        That is one which begins to use another law or parameter, or only repeats the last command.
        """
        if self._stack is None or not (due(stamp, self.setup.tick_ns) or self._stack.holding or self.changed):
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
        if self.changed:
            values[KEY] = as_text(self.changed)
        if self._stack.holding:
            return Diagnostic(stamp, "controller", 1, "holding the last command", values)
        return Diagnostic(stamp, "controller", 0, "engaged", values)
