"""Compiled ticks of a run: preparation of their arrays, the compiled call, and the states after it.

Conditions of compiled ticks are the next event, state of train and receiving ends, parts that are called in Python.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import typeof
from numpy.typing import NDArray

from plant_sim.air_brake import PipeEvents
from plant_sim.compiled import direct_call
from plant_sim.record import zeros
from train_ato.control.air_brake.predictive_policy import PredictiveBrake
from train_ato.control.algorithms.couplers import NO_COUPLERS
from train_ato.control.caller import Caller, CallerStep
from train_ato.control.compensation.none import NoCompensation
from train_ato.control.compensation.pade import Pade
from train_ato.control.compensation.predictor import RIGID, PredictionConstants, Predictor
from train_ato.control.compensation.preview import PreviewFeedforward
from train_ato.control.compensation.twin import Twin
from train_ato.control.law import LawNow, RecordLaw
from train_ato.control.law_call import LEFT, OBSERVER, POLICY, LawCall, RecordStep, is_in_loop
from train_ato.control.observers.none import NoObserver
from train_ato.control.observers.record_observer import RecordObserver
from train_ato.control.stack import ControlStack
from train_ato.control.train_model import Actuator
from train_ato.judge.recording_builder import RecordingBuilder
from train_ato.loop import span_kernel as kernel
from train_ato.loop.forecast import Forecast, SpanShoes
from train_ato.loop.python_law import PythonCall, PythonLaw, PythonStack
from train_ato.loop.span_messages import SpanArrays, SpanMessages
from train_ato.loop.stage_messages import SECOND_NS
from train_ato.loop.stages import Stages
from train_ato.loop.supervision_kernel import SupervisedTicks
from train_ato.messages.delay_lines import LinkSpec
from train_ato.messages.topics import TickBlock
from train_ato.messages.types import Array, AtoReport
from train_ato.scenario.changes import requested_stamp
from train_ato.scenario.setup import RunSetup

MAX_SPAN, BRAKED = 256, 128
"""Longest span, and longest one with forecasts of shoe forces, which cost more [ticks]."""
OF_CALLS = 32
"""Longest span in a state of the control stack that is called as a whole until the state ends [ticks]."""
_OBSERVER_STEP = RecordObserver.step
_COMPENSATION_STEPS: dict[type, Any] = {
    kind: kind.step for kind in (NoCompensation, Pade, PreviewFeedforward, Predictor, Twin)
}
"""Steps with a compiled form: one that a program replaces has none."""
UNRECORDED, BRIEF = 4, 16
"""Factor of both without a log and without disturbances, whose arrays are large, and with the series of the summary."""


def has_compiled_form(stack: ControlStack, law: Any, setup: RunSetup) -> bool:
    """Return True for a control stack whose compensation compiled ticks compute; another one is called as a whole.

    Computed are values that depend only on the time and, for `predictor`, on the state of the units. The diagnostics of
    a law in Python with a longer period are those of its last step.
    """
    compensation: Any = stack.compensation
    kind = type(compensation)
    if stack.every > 1 and not isinstance(law, RecordLaw) and (stack.plan or hasattr(law, "diagnostics")):
        return False
    if _COMPENSATION_STEPS.get(kind) is not getattr(kind, "step", None):
        return False
    if getattr(law, "lookahead_times", None) is not None:
        return False
    if isinstance(compensation, Predictor):
        return compensation.known_delay is not None
    if isinstance(compensation, Twin) and (compensation.parameters.identify or not compensation.started):
        return False  # its twin depends on the measurements
    actuators = compensation.actuators if isinstance(compensation, PreviewFeedforward) else None
    if actuators is not None and (actuators["forward"] != actuators["backward"]).any():
        shoes = setup.layout.air_brake and not isinstance(compensation, Twin)
        return not (shoes or getattr(law, "uses_effect", True))  # the time of the effect depends on the last command
    return True


def ticks_to_event(stages: Stages, stack: ControlStack, *, logged: bool, brief: bool) -> int:
    """Return the number of ticks before the next planned event, at most those of the longest span.

    An event is a change, a jump, an intervention, the end of an added gust, a fault, a request, a decision of the
    policy `predictive`, or the end of the run.
    """
    setup, plant, controller = stages.setup, stages.plant, stages.controller
    tick, stamp = setup.tick_ns, plant.stamp
    shoes = getattr(stack.compensation, "shoes", None)
    longest = MAX_SPAN if shoes is None or shoes.idle else BRAKED
    if not (logged or plant.train.outside.acts):
        longest *= BRIEF if brief else UNRECORDED
    longest = min(longest, plant.train.ticks_before_section, OF_CALLS if is_in_state(stages, stack) else longest)
    ends = [stamp + longest * tick, setup.ticks * tick, plant.link.next_jump(stamp)]
    ends += [requested_stamp(change) for change in controller.planned]
    ends += [at for at, _ in plant.interventions.due]
    ends += [round((gust.end + (gust.shift or 0.0)) * 1e9) for gust in plant.train.outside.added_gusts]
    ends += [inputs.next_fault(stamp) for inputs in stages.inputs]
    ends += [at for request in controller.ato.waiting if (at := round(request.at * 1e9)) > stamp]
    if stages.profile.headway is not None:
        due = stages.profile.headway.next_due(range(stamp, ends[0], tick))
        ends.append(ends[0] if due is None else due)
    if isinstance(stack.policy, PredictiveBrake):
        ends.append(round(max(stack.policy.due, 0.0) * 1e9))
    ends += [round(jump.at * 1e9) // tick * tick for jump in plant.train.jumps.planned if jump.at is not None]
    return int(-((stamp - min(ends)) // tick))


def is_regular(stages: Stages, supervised: SupervisedTicks, stack: ControlStack) -> bool:
    """Return True if train and receiving ends are in a state that the compiled ticks contain."""
    plant, stamp, pipe = stages.plant, stages.plant.stamp, stages.plant.train.brake
    if not supervised.is_quiet or not all(inputs.is_regular(stamp) for inputs in stages.inputs):
        return False
    if plant.train.parted.since is not None:
        return False
    if plant.pipe_link is not None and not plant.pipe_link.delivers_only(stack.pressure):
        return False
    return not (isinstance(pipe, PipeEvents) and (stack.pressure != pipe.pressure or pipe.vented))


def is_in_state(stages: Stages, stack: ControlStack) -> bool:
    """Return True in a state of the control stack or of the observer in which the stack is called as a whole."""
    if stack.hold.in_a_row or stack.law_brakes or stack.in_transition:
        return True
    own = stages.observer.stack
    if isinstance(own.observer, RecordObserver):
        if own.policy.state.tobytes() != stack.policy.state.tobytes():
            return True
        return own.shoes.fitted and own.shoes.pressure != stack.pressure
    return False


LawStep = RecordStep | CallerStep | PythonCall
"""Step of a law in the compiled ticks."""
MIN_SPAN = 4
"""Shortest span that is worth its preparation [ticks]."""
MAX_PAUSE = 16
"""Largest number of ticks in Python between two spans without a tick."""
RETRIED = 32
"""Longest span after one without a tick [ticks]."""
FAR = 1e300
"""Place or time that is never reached [m, s]."""
REPORTED = ("state", "gear", "unit", "setting")
"""Arrays of the kernel that the diagnostics of the plant need."""


class CompiledSpans:
    """Runs the ticks between two events in compiled code.

    Parameters
    ----------
    stages
        Setup and stages of the loop.
    recording
        Recording of the run in memory.
    publish
        Called with stamp and messages of every tick; None if only the recording needs them.
    publish_ticks
        Called with the messages of all ticks of a span in place of ``publish``; returns False if it does not take them.

    Attributes
    ----------
    brief : bool
        True if only the series of the summary are recorded.
    shown : Array of int
        Vehicles of the truth: all, or with ``brief`` the first, the power units and the last.
    ticks : int
        Number of compiled ticks so far.
    has_answer : bool
        A part in Python has been called for the next tick, which is left to the stages.
    untimed : bool
        A compiled law has run, without a time of its own.
    ato : AtoReport or None
        Last report of the ATO; set before :meth:`run`, which replaces it.
    """

    def __init__(
        self, stages: Stages, recording: RecordingBuilder, publish: Callable[[TickBlock], None] | None
    ) -> None:
        self.stages, self._recording, self._publish = stages, recording, publish
        self._forecast: Forecast | None = None
        self._of: tuple[Any, ...] = ()
        self._step: LawStep | None = None
        self._retry = self.ticks = 0
        self._entry: Any = None
        self.untimed = self.has_answer = False
        self._pause = 1
        self.ato: AtoReport | None = None
        self._memory: dict[str, Array] = {}
        self.supervised = SupervisedTicks(stages)
        model = stages.setup.model
        self.model = model.vehicles, model.tables, *model.envelopes
        self.brief = recording.summary_only and not stages.setup.layout.disturbed
        units, vehicles = stages.plant.train.units, stages.plant.train.n
        shown = (0, *units, vehicles - 1) if self.brief else range(vehicles)
        self.shown: NDArray[np.int64] = np.array(shown, dtype=np.int64)
        self.policy_call: LawCall | None = None
        self.observer: Any = stages.observer.stack.observer
        self.observing = _call_of_observer(self.observer)
        kind, setup = type(self.observer), stages.setup
        scenario, links = setup.scenario, setup.scenario.links
        compiled = kind is NoObserver or (issubclass(kind, RecordObserver) and kind.step is _OBSERVER_STEP)
        self._calls_observer = not compiled or links.measurement != LinkSpec()
        planned = scenario.replan or scenario.force_shares or scenario.unit_displacements
        late = any(link != LinkSpec() for link in (links.reference, links.estimate))
        self._calls_stack = bool(planned or late or self._calls_observer)
        if not model.n_units or stages.plant.radio or (setup.layout.supervised and links.measurement != LinkSpec()):
            self._retry = setup.ticks * setup.tick_ns  # reports of another train, or of the ATO with a delayed place

    def run(self) -> int:
        """Run the ticks up to the next event; return their number, 0 if the next tick is left to Python."""
        span = self.begin()
        return 0 if span is None else self.end(span, self.call(span.arguments))

    def call(self, arguments: tuple[Any, ...]) -> int:
        """Run the compiled ticks of a span; return their number."""
        if self._entry is None:
            self._entry = direct_call(kernel.run_span, typeof(arguments))
        return int(self._entry(arguments))

    def begin(self, *, without_python: bool = False) -> "Span | None":
        """Return the span from the present tick up to the next event; None if the tick is left to Python.

        Parameters
        ----------
        without_python
            True: None for a law or a control stack that the compiled ticks call in Python, too.
        """
        controller, stack = self.stages.controller, self.stages.controller.stack
        assert stack is not None
        self.has_answer = False
        if self.stages.plant.stamp < self._retry:
            return None
        count = ticks_to_event(self.stages, stack, logged=self.logged, brief=self.brief)
        if count < MIN_SPAN or not is_regular(self.stages, self.supervised, stack):
            return None
        law = self._step_of(stack)
        if without_python and isinstance(law, PythonCall):
            return None
        controller.changed = {}
        if self._pause > 1:  # probably another span without a tick, whose arrays cost as much as those of a full one
            count = min(count, RETRIED)
        return Span(self, stack, law, count)

    def end(self, span: "Span", done: int) -> int:
        """Record the first ticks of a span and set the states to those after them; return their number."""
        stamp, law = span.stamp, span.law
        span.end(done)
        self.has_answer = isinstance(law, PythonCall) and law.has_answer
        if not done:  # at a start the next ticks, too, are left to Python
            self._retry = stamp + self._pause * self.stages.setup.tick_ns
            self._pause = min(2 * self._pause, MAX_PAUSE)
            return 0
        self._pause = 1
        self.ticks += done
        self.untimed |= not isinstance(law, PythonCall)
        messages = SpanMessages(self.stages, span.arrays, stamp, done, brief=self.brief)
        if self.brief:
            messages.record_summary(self._recording)
        else:
            messages.record(self._recording)
            if self._publish is not None:
                self._publish(messages.block())
        self.ato = messages.store(self.ato)
        return done

    @property
    def logged(self) -> bool:
        """True if a log receives the messages."""
        return self._publish is not None

    def empty(self, name: str, *shape: int) -> Array:
        """Return an array that is not used after the next span, if possible the memory of the span before.

        New memory costs more than its values: the system clears its pages at the first use.
        """
        kept = self._memory.get(name)
        if kept is None or len(kept) < shape[0]:
            kept = self._memory[name] = np.empty(shape)
        return kept[: shape[0]]

    def _step_of(self, stack: ControlStack) -> LawStep:
        """Return the compiled step of the present law, or the call of the law or of the control stack in Python."""
        law: Any = stack.law
        in_state = is_in_state(self.stages, stack)
        whole = in_state or self._calls_stack or not has_compiled_form(stack, law, self.stages.setup)
        of = stack, law, whole
        if self._step is None or any(new is not known for new, known in zip(of, self._of, strict=True)):
            self._of = of
            if whole:
                self._step = PythonStack(self.stages, law)
            else:
                given = isinstance(law, Caller) and law.force is not None
                step: Any = CallerStep if given else RecordStep if is_in_loop(law) else None
                self._step = PythonLaw(self.stages, law) if step is None else step(law)
        if isinstance(self._step, PythonStack):
            self._step.observes = in_state or self._calls_observer
        return self._step

    def forecast(self, stack: ControlStack, first: int, count: int) -> Forecast:
        """Return reference and feed-forward of ``count`` ticks, computed for many spans of a profile at once."""
        profile = self.stages.profile.profile
        if self._forecast is None or not self._forecast.is_of(profile, stack, first, count):
            self._forecast = Forecast(self.stages.setup, profile, stack, first)
        return self._forecast


def _call_of_observer(observer: Any) -> tuple[Any, ...]:
    """Return records, number of bodies, call and couplers of an observer, of `none` without bodies."""
    if not isinstance(observer, RecordObserver):
        none = np.zeros(0, dtype=np.uint8)
        return none, none, 0, LawCall(lambda *_: LEFT, None, OBSERVER), NO_COUPLERS
    constants, state, balance = observer.constants, observer.state, observer.balance
    step = observer.form.step
    call = LawCall(lambda _p, _s, _b, now, units, _n: step(constants, state, now, units), observer.form.entry, OBSERVER)
    couplers = balance.couplers.records if balance.couplers and not balance.whole_train else NO_COUPLERS
    return constants.view(np.uint8), state.view(np.uint8), balance.count, call, couplers


class Span:
    """One span.

    Attributes
    ----------
    arrays : SpanArrays
        Results of its ticks.
    counts : Records of SpanCounts
        Its counts.
    law : RecordStep, CallerStep or PythonCall
        Step of the law.
    stamp : int
        Stamp of its first tick [ns].
    arguments : tuple
        Those of :func:`train_ato.loop.span_kernel.run_span`; they keep their arrays.
    """

    def __init__(self, spans: CompiledSpans, stack: ControlStack, law: LawStep, count: int) -> None:
        self._spans, self._stack, self.law, self._count = spans, stack, law, count
        self._setup, self._plant = spans.stages.setup, spans.stages.plant
        self._train = train = self._plant.train
        self._first, self.stamp = self._plant.tick, self._plant.stamp
        forecast = spans.forecast(stack, self._first, count)
        self._forecast = forecast.of(self._first, count, stack, used=not law.whole, shoes_used=self._uses_shoes())
        units, sensors = len(train.units), len(train.sensors)
        most, changing = count * train.tick_ns // SECOND_NS + 2, train.arrays
        self.arrays = SpanArrays(
            np.empty((count, 4, train.n)) if spans.logged else spans.empty("truth", count, 4, len(spans.shown)),
            np.empty((count, 3, units)),
            np.empty((count, 3, sensors)),
            np.empty((count + 1, units)),
            np.zeros(count + 1, dtype=np.int64),
            self._forecast.reference,
            *train.outside.ahead(self.stamp, count),
            [
                spans.empty(name, 1 if spans.brief and name != "setting" else most, *getattr(changing, name).shape)
                for name in REPORTED
            ]
            + [np.zeros(most, dtype=np.int64)],
            spans.supervised.arrays(count),
            np.zeros((count, units)),
            stack.pressure,
        )
        self.arrays.sent[0], self.arrays.at_limit[0] = stack.last, stack.saturated_steps
        self._inputs, self._now = law.units, zeros(LawNow, 1)
        self._policy: Any = stack.policy
        times, observer = self._forecast.times, spans.stages.observer.stack
        self._observes = isinstance(spans.observer, RecordObserver) and not getattr(law, "observes", False)
        self._observes_shoes, self._slow = self._observes and observer.shoes.fitted, np.zeros((0, 0))
        self._shoe_use = SpanShoes(observer, times, stack.pressure)
        if self._observes_shoes and not observer.shoes.idle:
            rows = [observer.shoes.slow_forces_at(np.array(times[part])) for part in self._shoe_use.runs()]
            self._slow = np.ascontiguousarray(np.concatenate(rows))
        self.counts = zeros(kernel.SpanCounts, 1)
        self.counts[0] = (stack.ticks, stack.every, stack.saturated, 0, law.whole, 0, count, 0)
        if isinstance(law, PythonCall):
            law.begin_span(self.stamp, self._forecast, self.arrays, self._now, self.counts)
        self.arguments = self._arguments()

    def _arguments(self) -> tuple[Any, ...]:
        train, out, spans = self._train, self.arrays, self._spans
        link, protection, stamps = self._plant.link, self._plant.protection, self._plant.protection.stamps
        train.brake.drop_finished()
        a, events = train.arrays, train.brake.count
        cubed = np.array(train.outside.planned_columns[: out.cubes.shape[2]], dtype=np.int64)
        law, sensors, observing, braking = self.law, train.sensor_set.records, self._observing(), self._braking()
        law_state = law.state.view(np.uint8)
        places = [np.empty_like(state) for state in (law_state, observing[1], self._inputs, braking[1], sensors.units)]
        window = np.empty((out.outside.shape[2], sensors.units.size))
        return (
            self.stamp, train.tick_ns, train.step,
            (a.state, a.vehicle, a.vehicle_index, a.gear, a.table, a.run, a.body, a.unit, a.unit_index, a.envelope,
             a.piece),
            train.brake.array, events, (out.outside, out.cubes, cubed), train.outside.vehicles, a.setting,
            train.sensor_set.noise_ahead(self._count), sensors,
            (law.constant.view(np.uint8), law_state, law.state.size, self._now, law.call,
             law.couplers.records if law.couplers else NO_COUPLERS),
            observing, self._predicting(), braking, self._inputs, self._forecast.expected,
            self._forecast.feedforward, self._forecast.shoes, *spans.model,
            min((jump.place for jump in train.jumps.planned if jump.place is not None), default=FAR), self.counts,
            (*link.records(self.stamp, self._count), link.draws(self._count)),
            (protection.age, *stamps.records(self.stamp, self._count), stamps.draws(self._count)),
            self._stack.in_flight[: 0 if law.whole else None],
            spans.shown, out.truth, out.measured, out.couplers, out.sent, out.at_limit,
            (SECOND_NS, *out.reports), out.supervision, self._forecast.standstill,
            (*places, window, np.empty(1), np.empty((1, 1))),
        )  # fmt: skip

    def end(self, done: int) -> None:
        """Set the states of stages, stack, law, link and sensors to those after the first ticks."""
        out, law = self.arrays, self.law
        if isinstance(law, PythonCall):
            law.end_span(done)
            out.law_reports = law.reports
        self._forecast.take_back(done)
        if self._observes_shoes:
            self._shoe_use.take_back(done)
            if done:
                self._spans.stages.observer.stack.speed = float(out.measured[done - 1, 1, 0])
        if done:
            self._store(done)

    def _uses_shoes(self) -> bool:
        """Return True if this law, or one after a planned change, uses the forecast of the shoe forces."""
        uses_feedforward = getattr(self._stack.law, "uses_feedforward", True)
        compensation = self._stack.compensation
        used = self._setup.scenario.law_changes or self.law.uses_shoes or isinstance(compensation, Predictor)
        return bool(used or (uses_feedforward and not isinstance(compensation, Twin)))

    def _predicting(self) -> tuple[Any, ...]:
        """Return the records of the compensation `predictor`, empty ones for another."""
        known = self._stack.compensation
        if self.law.whole or not isinstance(known, Predictor):
            return zeros(PredictionConstants, 0), RIGID, zeros(Actuator, 0), np.zeros(0)
        return known.constants, known.chain(known.known_delay or 0.0), known.actuators, known.along

    def _observing(self) -> tuple[Any, ...]:
        """Return the arrays of the observer."""
        slow = self._slow
        units = self._spans.stages.observer.stack.shoes.units
        shoes = (slow, units, np.zeros(1 + len(units)), np.zeros(slow.shape[1]))
        *records, couplers = self._spans.observing if self._observes else _call_of_observer(None)
        return *records, self.arrays.estimates, shoes, couplers

    def _braking(self) -> tuple[Any, ...]:
        """Return call and arrays of the policy of the air brake."""
        policy, spans = self._policy, self._spans
        if spans.policy_call is None:
            step = policy.form.step
            spans.policy_call = LawCall(
                lambda *_: step(policy.constants, policy.state, policy.rows, policy.now), policy.form.entry, POLICY
            )
        state = policy.state.copy() if self.law.whole else policy.state
        records = (policy.constants.view(np.uint8), state.view(np.uint8), policy.rows.view(np.uint8))
        pressure = policy.charged if self._stack.pressure is None else self._stack.pressure
        brake = (spans.policy_call, policy.limits, policy.segments, policy.charged, pressure)
        return *records, len(policy.rows), policy.now, *brake

    def _store(self, done: int) -> None:
        """Set the states of stages, stack, link and sensors to those after some ticks."""
        stack, train, out = self._stack, self._train, self.arrays
        observer, law = self._spans.stages.observer.stack, self.law
        if self._observes:
            self._spans.observer.balance.units["disturbance"] = out.estimates[done - 1]
        if not getattr(law, "observes", False):
            observer.policy.state[:] = law.policy_state if isinstance(law, PythonStack) else self._policy.state
        if not law.whole:
            stack.ticks += done
            stack.last = out.sent[done].tolist()
            stack.saturated_steps = int(out.at_limit[done])
            stack.saturated = bool(self.counts["at_limit"][0])
        if self._plant.pipe_link is not None and out.pressure is not None:
            self._plant.pipe_link.repeat(self.stamp, self._setup.tick_ns, done, out.pressure)
        self._spans.supervised.store(done)
        self._plant.link.skip_draws(done)
        train.sensor_set.skip_noise(done)
        train.stamp += done * train.tick_ns
        self._plant.tick, self._plant.stamp = self._first + done, self.stamp + done * train.tick_ns
