"""Parts of a tick in Python that compiled ticks call: a law, or the control stack as a whole."""

import time
from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from plant_sim.record import zeros
from train_ato.control.compensation.base import NO_PREVIEW
from train_ato.control.component_fault import step_limit
from train_ato.control.contract import Law, LawInput, Preview
from train_ato.control.guard import GIVEN
from train_ato.control.law import LawUnit
from train_ato.control.law_call import LEFT, LawCall
from train_ato.control.plan_text import TimedPlan
from train_ato.loop.forecast import SpanForecast
from train_ato.loop.span_messages import SpanArrays
from train_ato.loop.stage_messages import SECOND_NS
from train_ato.loop.stages import Stages
from train_ato.messages.types import Diagnostic, DisturbanceEstimate, Measurement, Reference

MAX_CALLS_NS = 200_000_000
"""Wall time after which a span ends, for Ctrl-C and the progress [ns]."""


class PythonCall(ABC):
    """Call of a part of a tick in Python, with the attributes of a step over records.

    A call can end with an exception, or with an output that is not only a force: a pressure, a repeated force or an
    invalid force. Its result is kept, and the tick is left to Python. There the stages use the result and make no
    second call.

    Parameters
    ----------
    stages
        Setup and stages of the loop.
    law
        The law.

    Attributes
    ----------
    whole : bool
        The control stack is called as a whole.
    has_answer : bool
        The stages have results for the tick that ended the span.
    reports : dict
        Diagnostics of the controller by the number of the tick in the span, if they are made in the tick.
    """

    whole = False
    couplers = None
    uses_shoes = uses_effect = True

    def __init__(self, stages: Stages, law: Law) -> None:
        assert stages.controller.stack is not None
        self._stages, self._controller, self._law = stages, stages.controller, law
        self._stack = stages.controller.stack
        self.constant = self.state = np.zeros(0)  # the state stays in the law
        self.units = zeros(LawUnit, self._stack.model.n_units)
        self.units["share"] = self._stack.model.share  # for the prediction
        self.call = LawCall(self._called)
        self.reports: dict[int, Diagnostic] = {}
        self.has_answer = False
        self._last: tuple[int, Any] | None = None
        self._begin = 0

    def begin_span(self, stamp: int, forecast: SpanForecast, arrays: SpanArrays, now: Any, counts: Any) -> None:
        """Set the arrays of a span from a stamp [ns] on."""
        self._stamp, self._forecast, self._arrays, self._now, self._counts = stamp, forecast, arrays, now, counts
        self.reports, self.has_answer, self._last, self._begin = {}, False, None, 0

    def end_span(self, done: int) -> None:
        """Give the output of a tick that was not run to the control stack."""
        if self._last is not None and self._last[0] == done:
            self._stack.answer, self.has_answer = self._last[1], True

    def _called(self, tick: int, *_: Any) -> int:
        """Run the step of a tick; return 0, or ``LEFT`` for a tick that is left to Python."""
        begin = time.perf_counter_ns()
        self._begin = self._begin or begin
        if begin - self._begin > MAX_CALLS_NS:
            return LEFT
        try:
            usable = self._step(tick)
        except KeyboardInterrupt as error:
            self._last = tick, error
            return LEFT
        except Exception:  # an output without the form of the contract; the tick in Python names the fault
            return LEFT
        if usable:
            self._controller.step_times.append(time.perf_counter_ns() - begin)
        return 0 if usable else LEFT

    @abstractmethod
    def _step(self, tick: int) -> bool:
        """Call the part; return False for a tick that is left to Python."""

    def _report(self, tick: int, *, due: bool) -> None:
        """Keep the diagnostics of a tick, if there are some."""
        stamp = self._stamp + tick * self._controller.setup.tick_ns
        if due and (report := self._controller.diagnostic(stamp)) is not None:
            self.reports[tick] = report


class PythonLaw(PythonCall):
    """Law in Python; it receives the same inputs as in a tick in Python."""

    def __init__(self, stages: Stages, law: Law) -> None:
        super().__init__(stages, law)
        self._reported, self._limit = hasattr(law, "diagnostics"), step_limit(law)
        self._given = self.units.view(np.float64).reshape(len(self.units), -1)[:, : len(GIVEN)].T

    def _step(self, tick: int) -> bool:
        """Call the law; return True for an output that is only a force, whose value the compiled code checks."""
        law: Any = self._law
        if self._stack.has_fault:
            return False
        with self._controller.call:
            try:
                inputs = self._law_input(tick)
                with self._limit:
                    output = law.step(inputs)
            except BaseException as error:  # raised again by the tick in Python
                self._last = tick, error
                return False
        self._last = tick, output
        force = output.force
        if output.brake_pipe is not None or output.held:
            return False
        if force.dtype != np.float64 or force.shape != self.units.shape:
            return False
        if output.plan is not None:
            if self._stack.plan is None and not self._reported:
                return False  # from the first plan on, every report of a span is that of its tick
            self._stack.plan = TimedPlan(inputs.t, output.plan)
        self.units["wanted"] = force
        if self._reported or self._stack.plan is not None:
            tick_ns = self._controller.setup.tick_ns
            self._report(tick, due=(self._stamp + tick * tick_ns) % SECOND_NS < tick_ns)
        return True

    def _law_input(self, tick: int) -> LawInput:
        """Return the input of the law, the records of the tick in arrays of its own."""
        t, acceleration, jerk, delay_to_effect, _, train_shoe_force, _ = self._now[0].item()
        (
            position, velocity, applied, reference_position, reference_velocity, reference_acceleration, feedforward,
            disturbance, force_min, force_max, shoe_force,
        ) = self._given.copy()  # fmt: skip
        deflection, rate, coupler_force = self._arrays.couplers[tick].copy()
        horizon, preview, stack = getattr(self._law, "horizon", 0), NO_PREVIEW, self._stack
        if horizon:
            preview = Preview(*stack.profile.window(self._forecast.effects[tick], horizon, stack.period))
        return LawInput(
            t, position, velocity, applied, reference_position, reference_velocity, reference_acceleration,
            delay_to_effect, acceleration, jerk, feedforward, preview, disturbance, deflection, rate,
            coupler_force, shoe_force, train_shoe_force, stack.in_flight.copy(), force_min, force_max,
            bool(self._counts["at_limit"][0]),
        )  # fmt: skip


class PythonStack(PythonCall):
    """Control stack as a whole, after re-planning and an observer that is called, too: the stages of the nodes.

    Attributes
    ----------
    observes : bool
        The observer is called.
    policy_state : Array
        State of the policy of the air brake after the ticks that were run.
    """

    whole = True
    uses_shoes = False

    def __init__(self, stages: Stages, law: Law) -> None:
        super().__init__(stages, law)
        self.observes = False
        self.policy_state = self._stack.policy.state.copy()

    def begin_span(self, stamp: int, forecast: SpanForecast, arrays: SpanArrays, now: Any, counts: Any) -> None:
        """Set the arrays of a span from a stamp [ns] on."""
        super().begin_span(stamp, forecast, arrays, now, counts)
        self.policy_state[:] = self._stack.policy.state

    def _step(self, tick: int) -> bool:
        """Call the stages in their order; a decision, a pressure and an exception are for the tick in Python."""
        stages, arrays, stack, controller = self._stages, self._arrays, self._stack, self._controller
        stamp = self._stamp + tick * stages.setup.tick_ns
        seen = Measurement(stamp, *arrays.measured[tick].copy(), *arrays.couplers[tick].copy())
        self.has_answer = True
        stages.profile.answer = stages.profile.decided(stamp, seen)
        if stages.profile.answer[0] is not None:
            return False
        if self.observes:
            try:
                stages.observer.answer = estimate = stages.observer.step(stamp, seen)
            except BaseException as error:  # raised again by the tick in Python
                stages.observer.answer = error
                return False
            if controller.failed:
                return False
            arrays.estimates[tick] = estimate.force
        else:
            estimate = DisturbanceEstimate(stamp, arrays.estimates[tick].copy())
        self.policy_state[:], pressure = stack.policy.state, stack.pressure
        place, speed, acceleration = self._forecast.reference[:, tick].tolist()
        reference = Reference(stamp, place, speed, acceleration, stages.profile.planned)
        controller.answer = controller.answered(seen, reference, estimate)
        output = controller.answer.output
        if isinstance(output, BaseException) or output[1] != pressure:
            return False
        self.policy_state[:] = stack.policy.state
        self.has_answer, controller.answer, stages.observer.answer, stages.profile.answer = False, None, None, None
        arrays.sent[tick + 1], arrays.at_limit[tick + 1] = output[0], stack.saturated_steps
        self._report(tick, due=True)
        return True
