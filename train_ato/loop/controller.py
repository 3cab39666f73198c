"""Controller stage: the control stack and its changes during a run."""

import time
from array import array
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from train_ato.control.assurance import BRAKING_LAW
from train_ato.control.component_fault import ComponentFailed, unless_raised
from train_ato.control.gains import Gains
from train_ato.control.registry import COMPENSATIONS, LAWS
from train_ato.control.stack import ControlStack
from train_ato.control.takeover import DEFAULT_JERK, TakeoverRamp, transition_jerk
from train_ato.control.train_model import stands
from train_ato.loop.ato_mode import AtoMode
from train_ato.loop.inputs import StageInputs
from train_ato.loop.stage_messages import ControllerMessages
from train_ato.loop.train_ahead import AuthorityAhead
from train_ato.messages.delay_lines import MessageLink
from train_ato.messages.topics import Role
from train_ato.messages.types import (
    Array,
    AtoReport,
    AtoState,
    Command,
    Diagnostic,
    DisturbanceEstimate,
    ForceParts,
    Measurement,
    Pipe,
    ProtectionState,
    Reference,
    SupervisedSpeeds,
    TrainAhead,
)
from train_ato.profile.profile import Profile
from train_ato.program.errors import RunFailed
from train_ato.program.interrupt import ComponentCall
from train_ato.scenario import changes as scenario_changes
from train_ato.scenario.setup import RunSetup

MAX_REFERENCE_SHIFT = 1.0
"""Largest difference of a reference from the profile at its stamp [m]."""


class Received(NamedTuple):
    """Messages of a step as they have arrived, at a step of the supervisor with the last three."""

    measurement: Measurement
    reference: Reference | None
    estimate: DisturbanceEstimate | None
    report: AtoReport | None = None
    protection: ProtectionState | None = None
    speeds: SupervisedSpeeds | None = None


class Answer(NamedTuple):
    """Messages that have arrived, and force and pressure of the control stack or its exception."""

    received: Received
    output: tuple[Array, float | None] | BaseException


class ControllerStage:
    """Control stack of law, compensation and brake policy, with changes by parameter during a run.

    Attributes
    ----------
    stack : ControlStack or None
        Control stack for the profile; None before it.
    inputs : StageInputs
        Receiving ends.
    authority : AuthorityAhead or None
        Moving end of authority that the law sees; None without a train ahead.
    controller : str
        Current law.
    changed : dict
        Parameters applied at the last step, planned in the scenario or set during the run.
    foreign_profile : bool
        True if a program outside of this project plans the profile.
    step_times : array of int
        Wall time of every step [ns].
    received : Received
        Messages of the last :meth:`receive`.
    failed : ComponentFailed or None
        Failure of a component of the loop, before the step that brakes because of it.
    answer : Answer or None
        Result of :meth:`answered` in a compiled tick that is left to Python, used in place of a second one.
    """

    role = Role.CONTROLLER

    def __init__(self, setup: RunSetup) -> None:
        self.setup = setup
        self._parameters: dict[str, dict[str, Any]] = {
            name: dict(values) for name, values in setup.scenario.laws.items()
        }
        self.profile: Profile | None = None
        limits = setup.scenario.profile.limits
        self._jerk_limit = max(limits.jerk or DEFAULT_JERK, limits.jerk_braking or 0.0)
        self.stack: ControlStack | None = None
        leader = setup.scenario.leader
        self.authority = None if leader is None or leader.authority is None else AuthorityAhead(setup)
        self.planned = sorted(setup.scenario.law_changes, key=lambda change: change.at)
        self._fresh = True
        self._law_changed = False
        self._given: scenario_changes.Changes = {}
        self.asked: scenario_changes.Changes = {}
        self.inputs = StageInputs(setup, self.role)
        self.inputs.ends["ato/reference"].check = self._reference_problem
        links, step, seed = setup.scenario.links, setup.step_ns, setup.scenario.seed
        self._measurement_link = MessageLink(links.measurement, step, seed, "measurement")
        self._reference_link = MessageLink(links.reference, step, seed, "reference")
        self._estimate_link = MessageLink(links.estimate, step, seed, "estimate")
        self.call = ComponentCall(f"law '{setup.scenario.law}'")
        self.controller = setup.scenario.law
        self.changed: scenario_changes.Changes = {}
        self.received: Received
        self.answer: Answer | None = None
        self._received_ns = 0
        self.error: ComponentFailed | None = None
        self.failed: ComponentFailed | None = None
        self.ato = AtoMode(setup)
        self.foreign_profile = False
        self.outage = ""
        self.takeover: TakeoverRamp | None = None
        self.step_times = array("q")
        self._fit = self._fit_of(setup.scenario.law)
        self._constants = {
            "compensation": setup.scenario.compensation,
            "delay": repr(setup.model.delay.tolist()),
            "delay_brake": repr(setup.model.delay_brake.tolist()),
            "lag": repr(setup.model.lag),
        }

    def join(self, stamp: int) -> None:
        """Join a run that has reached a stamp [ns], in place of an ended controller.

        Planned changes up to this stamp are in effect, and reported with the law at the first step, because the ended
        controller may have had others. Planned requests up to it are not repeated.
        """
        while self.planned and scenario_changes.requested_stamp(self.planned[0]) <= stamp:
            self.asked |= scenario_changes.values_of(self.planned.pop(0))
        for name, value in self.asked.items():
            self._take(name, value)
        self.asked.pop(scenario_changes.LAW, None)
        self.asked[scenario_changes.LAW] = self.controller
        self._fit = self._fit_of(self.controller)
        self.ato.waiting = [request for request in self.ato.waiting if round(request.at * 1e9) > stamp]
        self.follow_outage("node controller restarted")

    @property
    def in_flight(self) -> Array:
        """Commands sent and not yet in effect [N], oldest first, shape (d, units)."""
        assert self.stack is not None
        return self.stack.in_flight.copy()

    def follow_outage(self, reason: str) -> None:
        """End an engagement at the next step, because a node of the loop was away, and brake to a stop.

        The demand begins at the present force. It then changes as in a takeover by the braking law.
        """
        self.outage = reason

    def fail(self, failure: ComponentFailed) -> None:
        """Brake to standstill from the next step on, because a component of the loop has failed; then raise it."""
        self.failed = failure

    def _brake(self, stamp: int, failure: RunFailed) -> None:
        """End the engagement because of a failure; after one of a component the brake follows from the last command."""
        assert self.profile is not None
        assert self.stack is not None
        self.ato.fail(stamp, " ".join(str(failure).split()))
        if isinstance(failure, ComponentFailed):
            self.error = failure
            jerk = transition_jerk(self.profile, self._jerk_limit)
            self.takeover = TakeoverRamp(self.setup.model, jerk, np.array(self.stack.last))

    def set_profile(self, profile: Profile) -> None:
        """Set the profile; the first one creates the stack."""
        self.profile = profile
        if not self.foreign_profile:
            self.ato.last_stop = float(profile.position.max())
        if self.stack is None or self.ato.awaits_profile:
            self.ato.take_profile()
            self.stack = self._new_stack(profile)
        else:
            self.stack.set_profile(profile)

    def _new_stack(self, profile: Profile) -> ControlStack:
        setup = self.setup
        return ControlStack(
            model=setup.model,
            period=setup.control_period,
            controller=self.controller,
            controller_parameters=self._parameters,
            make_law=partial(setup.component, LAWS),
            compensation=setup.component(
                COMPENSATIONS, setup.scenario.compensation, setup.compensation_parameters, setup.control_period
            ),
            brake_policy=setup.brake_policy(),
            profile=profile,
            hold_limit=setup.scenario.hold_limit,
            distribution=setup.force_distribution(),
            displacement=setup.planned_displacement(),
            jerk_limit=self._jerk_limit,
            authority=None if self.authority is None else self.authority.at,
        )

    def validate(self, changes: scenario_changes.Changes) -> str:
        """Check parameters set together (``controller``, ``law.parameter``) without side effects; return the advice.

        Raises
        ------
        ValueError
            With the reason for the refusal.
        """
        blocks = scenario_changes.values_by_law(changes)
        driving = changes.get(scenario_changes.LAW, self.controller)
        for law, values in blocks.items():
            if law != driving:
                merged = {**self._parameters.get(law, {}), **values}
                LAWS.make(law, merged, self.setup.model, self.setup.control_period)
        return self.advice(driving, blocks.get(driving)) if scenario_changes.LAW in changes or driving in blocks else ""

    def gains(self, law: str) -> Gains:
        """Return the present parameters of a law."""
        return self.setup.gains(law, self._parameters.get(law, {}))

    def advice(self, law: str, values: Mapping[str, Any] | None = None) -> str:
        """Return :meth:`RunSetup.advice` for a law with its present parameters and others."""
        return self.setup.advice(law, {**self._parameters.get(law, {}), **(values or {})})

    def _fit_of(self, law: str) -> dict[str, str]:
        """Return source of the gains and advice of a law for the diagnostics, without empty ones."""
        fit = {"gains": self.gains(law).reason, "advice": self.advice(law)}
        return {key: text for key, text in fit.items() if text}

    def begin_with(self, name: str, value: Any) -> None:
        """Replace a parameter of the scenario by a validated start parameter."""
        self._take(name, value)
        self._given[name] = value
        self._fit = self._fit_of(self.controller)

    def apply(self, name: str, value: Any) -> None:
        """Set a validated parameter; the next step applies and reports it."""
        self.asked.pop(name, None)
        self.asked[name] = value
        self._law_changed |= self._take(name, value)

    def _take(self, name: str, value: Any) -> bool:
        """Store a value; return True if it changes the current law."""
        if name == scenario_changes.LAW:
            self.controller = str(value)
            self.call.name = f"law '{value}'"
            return True
        law, _, parameter = name.rpartition(".")
        self._parameters.setdefault(law, {})[parameter] = value
        return law == self.controller

    def _change(self, stamp: int) -> None:
        """Apply the changes set since the last step or planned for this one.

        A change after the first step changes the law without a jump of the force.
        """
        while self.planned and scenario_changes.requested_stamp(self.planned[0]) <= stamp:
            for name, value in scenario_changes.values_of(self.planned.pop(0)).items():
                self.apply(name, value)
        self.changed, self.asked = self.asked, {}
        if self._law_changed:
            assert self.stack is not None
            assert self.profile is not None
            if self._fresh:
                self.stack = self._new_stack(self.profile)
            else:
                self.stack.swap(self.controller, self._parameters.get(self.controller, {}))
            self._fit = self._fit_of(self.controller)
        self._fresh = self._law_changed = False

    def receive(
        self,
        measurement: Measurement,
        reference: Reference,
        estimate: DisturbanceEstimate,
        protection: ProtectionState | None = None,
        speeds: SupervisedSpeeds | None = None,
        *,
        ahead: TrainAhead | None = None,
    ) -> None:
        """Take the messages of a step, from which :meth:`command` makes the command.

        Parameters
        ----------
        measurement, reference, estimate
            Messages of one stamp.
        protection, speeds, ahead
            At a step of the supervisor: fail-safe state of the train, limits, and live report of the train ahead.
        """
        assert self.stack is not None, "the profile comes before the first step"
        begin = time.perf_counter_ns()
        stamp = measurement.stamp
        ends = self.inputs.ends
        if self.authority is not None:
            self.authority.receiver.hear(ahead)
        seen = self.inputs.measurement(measurement)
        expected = ends["ato/reference"].receive(stamp, reference)
        disturbance = ends["ato/estimate"].receive(stamp, estimate)
        answer = self.answer
        received = self._passed_on(stamp, seen, expected, disturbance) if answer is None else answer.received
        if self.outage:
            assert self.profile is not None
            self.ato.stop(stamp, self.outage)
            self.takeover = TakeoverRamp(self.setup.model, transition_jerk(self.profile, self._jerk_limit))
            self.outage = ""
        if protection is not None and speeds is not None:
            state = ends["train/protection"].receive(stamp, protection)
            limits = ends["atp/speeds"].receive(stamp, speeds)
            report = self.ato.update(received.measurement, state, limits)
            received = received._replace(report=report, protection=state, speeds=limits)
        if self.failed is not None:
            self._brake(stamp, self.failed)
            self.failed = None
        self.received = received
        self._received_ns = time.perf_counter_ns() - begin

    def _passed_on(
        self, stamp: int, measurement: Measurement, reference: Reference | None, estimate: DisturbanceEstimate | None
    ) -> Received:
        """Return the newest messages that their links have delivered at a stamp [ns]."""
        seen = self._measurement_link.pass_on(stamp, measurement)
        seen = seen if seen.stamp == stamp else replace(seen, stamp=stamp)  # the stamp of its use
        expected = self._reference_link.pass_on(stamp, reference)
        return Received(seen, expected, self._estimate_link.pass_on(stamp, estimate))

    def answered(self, measurement: Measurement, reference: Reference, estimate: DisturbanceEstimate) -> Answer:
        """Return force and pressure of the control stack in a compiled tick, with the messages that it received."""
        received = self._passed_on(measurement.stamp, measurement, reference, estimate)
        assert self.stack is not None
        with self.call:
            try:
                return Answer(received, self.stack.step(*received[:3]))
            except BaseException as error:  # raised again by the tick in Python
                return Answer(received, error)

    def command(self) -> ControllerMessages:
        """Return the command for the stamp of the messages, and the brake-pipe command if there is an air brake."""
        begin = time.perf_counter_ns() - self._received_ns
        seen, report = self.received.measurement, self.received.report
        stamp = seen.stamp
        if self.error is not None:  # it ends the run at standstill or at the last tick
            stands_now = self.ato.standstill if self.setup.layout.supervised else stands(seen.velocity)
            if stands_now or stamp >= (self.setup.ticks - 1) * self.setup.tick_ns:
                raise self.error
        with self.call:
            self._change(stamp)
            if self.ato.drives:
                self.takeover = None
                force, pressure = self._engaged_step(seen, self.received.reference, self.received.estimate)
            else:
                force, pressure = self.ato.command(seen)
            if self.takeover is not None:
                force = self.takeover.step(force, seen.applied)
                self.takeover = None if self.takeover.ended else self.takeover
        self.step_times.append(time.perf_counter_ns() - begin)
        pipe = None if pressure is None else Pipe(stamp, pressure)
        return ControllerMessages(pipe, report, self.diagnostic(stamp), Command(stamp, force))

    def force_parts(self, command: Command) -> ForceParts | None:
        """Return the parts of the last command; None if the law has not made it."""
        if self.stack is None or not self.ato.drives or self.ato.assured:
            return None
        feed_forward, disturbance = self.stack.fed
        return ForceParts(command.stamp, feed_forward, command.force - feed_forward + disturbance, -disturbance)

    def _engaged_step(
        self, measurement: Measurement, reference: Reference | None, estimate: DisturbanceEstimate | None
    ) -> tuple[Array, float | None]:
        """Return force and pressure of the control stack; its failure disengages the ATO, which brakes to standstill.

        Parameters
        ----------
        measurement, reference, estimate
            Newest valid messages; without a reference the last command is held, without an estimate it is 0.

        Raises
        ------
        RunFailed
            Without a valid measurement or reference for longer than ``hold_limit``, in a run without supervision.
        """
        stack, answer, self.answer = self.stack, self.answer, None
        assert stack is not None
        if self.ato.returned_at == measurement.stamp:
            stack.swap(self.controller, self._parameters.get(self.controller, {}))
        try:
            if answer is None:
                force, pressure = stack.step(measurement, reference, estimate)
            else:
                force, pressure = unless_raised(answer.output)
        except RunFailed as error:
            if not (self.setup.layout.supervised or isinstance(error, ComponentFailed)):
                raise
            self._brake(measurement.stamp, error)
            return self.ato.command(measurement)
        if self.ato.assured:
            assert self.ato.assurance is not None
            force = stack.brake(self.ato.braking_force(measurement), self.ato.assurance.least_jerk)
        return force, pressure

    def _reference_problem(self, reference: Reference) -> str:
        """Return the difference of a reference from the profile at its stamp as text, "" for a reference of it."""
        if self.profile is None:
            return ""
        position, _, _, _ = self.profile.at(reference.stamp * 1e-9)
        if abs(reference.position - position) > MAX_REFERENCE_SHIFT:
            return f"not of the profile: {reference.position:.0f} m, {reference.velocity * 3.6:.1f} km/h"
        return ""

    def diagnostic(self, stamp: int) -> Diagnostic | None:
        """Return the state of the controller once a second, and at every step with a change or a held command."""
        due = self.inputs.report_due(stamp) or bool(self.changed) or self.ato.changed_at == stamp
        if self.stack is None or not (due or self.stack.hold.in_a_row):
            return None
        values = {
            "controller": self.controller,
            **self._fit,
            **self._constants,
            **self.stack.diagnostics(),
            **self.inputs.diagnostics(),
        }
        if self.changed:
            values[scenario_changes.KEY] = scenario_changes.changes_to_json(self.changed)
        if self._given:
            values[scenario_changes.GIVEN] = scenario_changes.changes_to_json(self._given)
            self._given = {}
        if self.setup.layout.supervised:
            values |= self.ato.diagnostics(stamp)
        if not self.ato.drives:
            state = self.ato.machine.state
            return Diagnostic(stamp, "controller", 1 + (state is AtoState.FAILURE), state.text, values)
        if self.ato.assured:
            return Diagnostic(stamp, "controller", 1, BRAKING_LAW, values)
        if self.stack.hold.in_a_row:
            return Diagnostic(stamp, "controller", 1, "holding the last command", values)
        return Diagnostic(stamp, "controller", 0, "engaged", values)
