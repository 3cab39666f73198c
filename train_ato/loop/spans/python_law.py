"""Law without a compiled step in a compiled span: it is called between the compiled parts of a tick."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from plant_sim.record import zeros
from train_ato.control.compensation.base import NO_PREVIEW, CompensationBase
from train_ato.control.compiled.law_call import LEFT, LawCall
from train_ato.control.component_fault import step_limit
from train_ato.control.contract import Law, LawInput, Preview
from train_ato.control.law import GIVEN, LawUnit
from train_ato.control.plan_text import TimedPlan
from train_ato.control.stack import StepAnswer
from train_ato.loop.controller import ControllerStage
from train_ato.loop.spans.forecast import SpanForecast
from train_ato.loop.spans.kernel import AT_LIMIT
from train_ato.loop.stage_messages import diagnostics_due
from train_ato.messages.types import Array, Diagnostic, DisturbanceEstimate, Measurement, Reference

LONGEST_CALLS_NS = 200_000_000
"""Wall time after which a span ends, for Ctrl-C and the progress [ns]."""


class PythonLaw:
    """Law in Python with the attributes of :class:`train_ato.control.compiled.law_call.RecordStep`.

    The law receives the same inputs as in a tick in Python; a compensation without a compiled form makes them in
    Python, too. An exception, and an output with another effect than a force (a pressure, a repeated force, an invalid
    force), are kept: the tick is left to Python, where the control stack uses them in place of a second call.

    Parameters
    ----------
    controller
        Controller stage of the law.
    law
        The law.
    compensates
        The compensation is called before the law.

    Attributes
    ----------
    reports : dict
        Diagnostics of the controller by the number of the tick in the span, of a law with diagnostics of its own.
    """

    couplers = None
    uses_shoes = uses_effect = True

    def __init__(self, controller: ControllerStage, law: Law, *, compensates: bool) -> None:
        assert controller._stack is not None
        self.compensates = compensates
        self._controller, self._stack, self._law = controller, controller._stack, law
        self.constant = self.state = np.zeros(0)  # the state stays in the law
        self.units = zeros(LawUnit, self._stack.model.n_units)
        self.units["share"] = self._stack.model.share  # for the prediction
        self.call = LawCall(self._called)
        self.reports: dict[int, Diagnostic] = {}
        self._reported = hasattr(law, "diagnostics")
        self._last: tuple[int, StepAnswer] | None = None
        self._decided: int | None = None
        self._begin = 0

    @property
    def is_usable(self) -> bool:
        """True if the diagnostics of the law are those of its last step."""
        return not ((self._reported or self._stack.plan is not None) and self._stack._every > 1)

    def begin_span(
        self, stamp: int, forecast: SpanForecast, inputs: Any, now: Any, couplers: Array, sent: Array, counts: Any
    ) -> None:
        """Set the arrays of a span from a stamp [ns] on."""
        self._stamp, self._forecast, self._inputs, self._now = stamp, forecast, inputs, now
        self._couplers, self._sent, self._counts = couplers, sent, counts
        self.reports, self._last, self._decided, self._begin = {}, None, None, 0

    def end_span(self, done: int) -> None:
        """Give the last command to the compensation, and the output of a tick that was not run to the control stack."""
        if self._last is not None and self._last[0] == done:
            self._stack.answer = self._last[1]
        if self._decided != done:
            self._report_command()

    def _report_command(self) -> None:
        """Give the command of the last step to the compensation."""
        if self._decided is not None:
            self._stack.report_command(self._sent[self._decided + 1])
        self._decided = None

    def _called(self, tick: int, *_: Any) -> int:
        """Run the step of a tick; return 0, or ``LEFT`` for a tick that is left to Python."""
        begin = time.perf_counter_ns()
        self._begin = self._begin or begin
        if begin - self._begin > LONGEST_CALLS_NS:
            return LEFT
        try:
            usable = self._step(tick)
        except KeyboardInterrupt as error:
            self._last = tick, StepAnswer(None, error)
            return LEFT
        except Exception:  # an output without the form of the contract; the tick in Python names the fault
            return LEFT
        self._controller.step_times.nanoseconds.append(time.perf_counter_ns() - begin)
        return 0 if usable else LEFT

    def _step(self, tick: int) -> bool:
        """Call the law; return True for an output that is only a force, whose value the compiled code checks."""
        law: Any = self._law
        if not self.compensates and getattr(law, "lookahead_times", None) is not None:
            return False
        given: LawInput | BaseException | None = None
        with self._controller._call:
            try:
                if self.compensates:
                    self._report_command()
                    with step_limit(self._stack._compensation):
                        inputs = given = self._compensated(tick)
                else:
                    inputs = self._law_input(tick)
                with step_limit(law):
                    output = law.step(inputs)
            except BaseException as error:  # raised again by the tick in Python
                raised = self.compensates and given is None
                self._last = tick, StepAnswer(error if raised else given, None if raised else error)
                return False
        self._last = tick, StepAnswer(given, output)
        force = output.force
        if output.brake_pipe is not None or output.held:
            return False
        if force.dtype != np.float64 or force.shape != self._inputs.shape:
            return False
        if output.plan is not None:
            if self._stack._every > 1 or (self._stack.plan is None and not self._reported):
                return False  # from the first plan on, every report of a span is that of its tick
            self._stack.plan = TimedPlan(inputs.t, output.plan)
        self._inputs["wanted"] = force
        self._decided = tick if self.compensates else None
        if self._reported or self._stack.plan is not None:
            self._report(tick)
        return True

    def _report(self, tick: int) -> None:
        """Keep the diagnostics of a tick, once a second."""
        tick_ns = self._controller.setup.tick_ns
        stamp = self._stamp + tick * tick_ns
        if diagnostics_due(stamp, tick_ns) and (report := self._controller.diagnostic(stamp)) is not None:
            self.reports[tick] = report

    def _compensated(self, tick: int) -> LawInput:
        """Return the input of the law from the compensation, for arrays of its own."""
        stack, units = self._stack, {name: self._inputs[name].copy() for name in GIVEN}
        stamp = self._stamp + tick * self._controller.setup.tick_ns
        stack._saturated = bool(self._counts.item(AT_LIMIT))
        return stack.law_input(
            Measurement(stamp, units["position"], units["velocity"], units["applied"], *self._couplers[tick]),
            Reference(stamp, *self._forecast.reference[:, tick].tolist()),
            DisturbanceEstimate(stamp, units["disturbance"]),
            units["force_min"],
            units["force_max"],
        )

    def _law_input(self, tick: int) -> LawInput:
        """Return the input of the law, in arrays of its own."""
        forecast, compensation = self._forecast, self._stack._compensation
        assert isinstance(compensation, CompensationBase)
        t, effect = forecast.times[tick], forecast.effects[tick]
        units, now = {name: self._inputs[name].copy() for name in GIVEN}, self._now[0]
        deflection, rate, coupler_force = self._couplers[tick]
        horizon = getattr(self._law, "horizon", 0)
        return LawInput(
            t,
            units["position"],
            units["velocity"],
            units["applied"],
            units["reference_position"],
            units["reference_velocity"],
            units["reference_acceleration"],
            0.0 if forecast.predicts else effect - t,
            float(now["acceleration_at_effect"]),
            float(now["jerk_at_effect"]),
            units["feedforward"],
            Preview(*compensation.rigid.profile.window(effect, horizon, compensation.period))
            if horizon
            else NO_PREVIEW,
            units["disturbance"],
            deflection,
            rate,
            coupler_force,
            forecast.shoes[tick, 1:],
            float(now["train_shoe_force"]),
            self._stack._history.in_flight(),
            units["force_min"],
            units["force_max"],
            bool(self._counts.item(AT_LIMIT)),
        )
