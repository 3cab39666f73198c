"""Compiled ticks of a run: preparation of their arrays, the compiled call, and the states after it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant_sim.plant_setup import Jump
from plant_sim.record import zeros
from train_ato.control.air_brake.shoes import ShoeForecast
from train_ato.control.algorithms.couplers import NO_COUPLERS
from train_ato.control.compensation.base import Actuator
from train_ato.control.compensation.predictor import RIGID, PredictionConstants, Predictor
from train_ato.control.compensation.twin import Twin
from train_ato.control.compiled.law_call import LEFT, OBSERVER, POLICY, LawCall, RecordStep, is_in_loop
from train_ato.control.law import LawNow
from train_ato.control.observers.record_observer import RecordObserver
from train_ato.control.observers.stack import ObserverStack
from train_ato.control.stack import ControlStack
from train_ato.control.train_model import STANDSTILL_SPEED, TrainModel
from train_ato.loop.recording_builder import RecordingBuilder
from train_ato.loop.spans import kernel
from train_ato.loop.spans.conditions import has_compiled_form, is_regular, ticks_to_event
from train_ato.loop.spans.forecast import Forecast
from train_ato.loop.spans.messages import Publish, SpanArrays, SpanMessages
from train_ato.loop.spans.python_law import PythonLaw
from train_ato.loop.spans.stages import Stages
from train_ato.loop.spans.supervised import SupervisedTicks
from train_ato.loop.stage_messages import SECOND_NS
from train_ato.messages.tick_block import TickBlock
from train_ato.messages.types import Array, AtoReport


class ObserverShoes:
    """Forecast of the shoe forces of an observer for the ticks of one span; ticks that were not run are taken back.

    Parameters
    ----------
    stack
        Observer with its forecast, in the state before the span.
    times
        Times of the ticks [s].
    pressure
        Pressure of the brake pipe demanded in the span [Pa]; None without an air brake.
    used
        False for an observer without a balance of forces.

    Attributes
    ----------
    slow : Array, shape (ticks, vehicles)
        Forces at standstill [N]; without rows for released brakes.
    """

    def __init__(self, stack: ObserverStack, times: Array, pressure: float | None, *, used: bool) -> None:
        self._stack, self._times, self._pressure = stack, times, pressure
        self._used = used and stack._shoes.fitted
        self._kept: ShoeForecast | None = None
        self.slow: Array = np.zeros((0, 0))
        if not self._used or stack._shoes.idle:
            return
        known, self._kept = stack._shoes, stack._shoes.copy()
        rows, index = [], 0
        while index < len(times):
            known.demand(float(times[index]), pressure)
            run = min(len(times) - index, known.calls_to_restart())
            known.skip(run - 1)
            rows.append(known.slow_forces_at(times[index : index + run]))
            index += run
        self.slow = np.ascontiguousarray(np.concatenate(rows))

    def take_back(self, done: int, speed: float | None) -> None:
        """Set the forecast to its state after the first ``done`` ticks, with the last measured speed [m/s]."""
        if not self._used:
            return
        if speed is not None:
            self._stack._speed = speed
        if self._kept is None:
            self._stack._shoes.skip(done)
        elif done < len(self._times):
            self._stack._shoes = self._kept
            for t in self._times[:done].tolist():
                self._kept.demand(t, self._pressure)


def envelope_arrays(model: TrainModel) -> tuple[Array, Any]:
    """Return the segments of all envelopes, shape (segments, 4), and those of every unit, shape (units, 4).

    The latter are first segment and end of brake and of traction.
    """
    segments, bounds, end = [np.zeros((0, 4))], [], 0
    for brake, traction in zip(model.brake, model.traction, strict=True):
        middle, last = end + len(brake.rows), end + len(brake.rows) + len(traction.rows)
        segments += [brake.rows, traction.rows]
        bounds.append((end, middle, middle, last))
        end = last
    return np.concatenate(segments), np.array(bounds, dtype=np.int64)


SHORTEST = 4
"""Shortest span that is worth its preparation [ticks]."""
MAX_PAUSE = 16
"""Largest number of ticks in Python between two spans without a tick."""
RETRIED = 32
"""Longest span after one without a tick [ticks]."""
FAR = 1e300
"""Place or time that is never reached [m, s]."""
REPORTED = ("state", "gear", "unit", "setting")
"""Arrays of the kernel that the diagnostics of the plant need."""
LIMITS = (1e6, 100.0, 1e9)
"""Position [m], speed [m/s] and force [N] beyond which a tick is left to Python, far inside the limits of validity."""


class CompiledSpans:
    """Runs the ticks between two events in compiled code.

    Parameters
    ----------
    stages
        Setup, of which :func:`~train_ato.loop.spans.conditions.spans_possible` is True, and stages of the loop.
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
    untimed : bool
        A compiled law has run, without a time of its own.
    ato : AtoReport or None
        Last report of the ATO; set before :meth:`run`, which replaces it.
    """

    def __init__(
        self,
        stages: Stages,
        recording: RecordingBuilder,
        publish: Publish | None,
        publish_ticks: Callable[[TickBlock], bool] | None = None,
    ) -> None:
        self.stages, self._recording, self._publish, self._publish_ticks = stages, recording, publish, publish_ticks
        self._forecast: Forecast | None = None
        self._law: Any = None
        self._step: RecordStep | PythonLaw | None = None
        self._retry = self.ticks = 0
        self.untimed = False
        self._pause = 1
        self.ato: AtoReport | None = None
        self._memory: dict[str, Array] = {}
        self.supervised = SupervisedTicks(stages)
        model = stages.setup.model
        self.model = model.vehicles, model.tables, *envelope_arrays(model)
        self.brief = recording.summary_only and not stages.setup.layout.disturbed
        units, vehicles = stages.plant.train.units, stages.plant.train.n
        shown = (0, *units, vehicles - 1) if self.brief else range(vehicles)
        self.shown: NDArray[np.int64] = np.array(shown, dtype=np.int64)
        self.policy_call: LawCall | None = None
        self.observer: Any = stages.observer._stack._observer
        self.observing = _call_of_observer(self.observer)

    def run(self) -> int:
        """Run the ticks up to the next event; return their number, 0 if the next tick is left to Python."""
        plant, stack = self.stages.plant, self.stages.controller._stack
        assert stack is not None
        law = self._step_of(stack)
        if (isinstance(law, PythonLaw) and not law.is_usable) or plant.stamp < self._retry:
            return 0
        count = ticks_to_event(self.stages, self.supervised, stack, logged=self.logged, brief=self.brief)
        if count < SHORTEST or not is_regular(self.stages, self.supervised, stack, law):
            return 0
        stamp = plant.stamp
        if self._pause > 1:  # probably another span without a tick, whose arrays cost as much as those of a full one
            count = min(count, RETRIED)
        span = _Span(self, stack, law, count)
        done = span.run()
        if not done:  # at a start the next ticks, too, are left to Python
            self._retry = stamp + self._pause * self.stages.setup.tick_ns
            self._pause = min(2 * self._pause, MAX_PAUSE)
            return 0
        self._pause = 1
        self.ticks += done
        self.untimed |= not isinstance(law, PythonLaw)
        messages = SpanMessages(self.stages, span.arrays, stamp, done, brief=self.brief)
        if self.brief:
            messages.record_summary(self._recording)
        elif self._publish is None or (self._publish_ticks is not None and self._publish_ticks(messages.block())):
            messages.record(self._recording)
        else:
            messages.publish(self._publish)
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

    def _step_of(self, stack: ControlStack) -> RecordStep | PythonLaw:
        """Return the compiled step of the present law, or its call in Python."""
        law: Any = stack._law
        compensates = not has_compiled_form(stack._compensation, law, self.stages.setup)
        if self._step is None or self._law is not law or self._step.compensates != compensates:
            self._law = law
            if compensates or not is_in_loop(law):
                self._step = PythonLaw(self.stages.controller, law, compensates=compensates)
            else:
                self._step = RecordStep(law)
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


class _Span:
    """One span.

    Attributes
    ----------
    arrays : SpanArrays
        Results of its ticks.
    """

    def __init__(self, spans: CompiledSpans, stack: ControlStack, law: RecordStep | PythonLaw, count: int) -> None:
        self._spans, self._stack, self._law, self._count = spans, stack, law, count
        self._setup, self._plant = spans.stages.setup, spans.stages.plant
        self._train = train = self._plant.train
        self._first, self._stamp = self._plant.tick, self._plant.stamp
        forecast = spans.forecast(stack, self._first, count)
        self._forecast = forecast.of(self._first, count, stack, used=not law.compensates, shoes_used=self._uses_shoes())
        units, sensors = len(train.units), len(train.sensors)
        most, changing = count * train.tick_ns // SECOND_NS + 2, train.arrays
        self.arrays = SpanArrays(
            np.empty((count, 4, train.n)) if spans.logged else spans.empty("truth", count, 4, len(spans.shown)),
            np.empty((count, 3, units)),
            np.empty((count, 3, sensors)),
            np.empty((count + 1, units)),
            np.zeros(count + 1, dtype=np.int64),
            self._forecast.reference,
            *train._outside.ahead(self._stamp, count),
            [
                spans.empty(name, 1 if spans.brief and name != "setting" else most, *getattr(changing, name).shape)
                for name in REPORTED
            ]
            + [np.zeros(most, dtype=np.int64)],
            spans.supervised.arrays(count),
            np.zeros((count, units)),
        )
        self.arrays.sent[0], self.arrays.at_limit[0] = stack._last, stack._saturated_steps
        self._inputs, self._now = law.units, zeros(LawNow, 1)
        self._policy: Any = stack._policy
        times = np.array(self._forecast.times)
        used = isinstance(spans.observer, RecordObserver)
        self._observer_shoes = ObserverShoes(spans.stages.observer._stack, times, stack._pressure, used=used)
        self._counts = np.array((stack._ticks, stack._every, stack._saturated, 0), dtype=np.int64)

    def run(self) -> int:
        """Run the ticks; return the number of them that were run."""
        train, out, spans = self._train, self.arrays, self._spans
        link, protection, stamps = self._plant.link, self._plant.protection, self._plant.protection.stamps
        a, events = train.arrays, train._brake.propagating()
        cubed = np.arange(train._outside.vehicles.size if out.cubes.shape[2] else 0)
        law = self._law
        if isinstance(law, PythonLaw):
            arrays = (self._inputs, self._now, out.couplers, out.sent, self._counts)
            law.begin_span(self._stamp, self._forecast, *arrays)
        done = int(kernel.run_span(
            self._stamp, train.tick_ns, train._step,
            (a.state, a.vehicle, a.vehicle_index, a.gear, a.table, a.run, a.body, a.unit, a.unit_index, a.envelope,
             a.piece),
            train._brake.array, events, (out.outside, out.cubes, cubed), train._outside.vehicles, a.setting,
            train.sensor_set.noise_ahead(self._count), train.sensor_set.records,
            (law.constant.view(np.uint8), law.state.view(np.uint8), law.state.size, self._now, law.call,
             law.couplers.records if law.couplers else NO_COUPLERS),
            self._observing(), self._predicting(), self._braking(), self._inputs, self._forecast.expected,
            self._forecast.feedforward, self._forecast.shoes, *spans.model,
            self._bounds(), self._counts,
            (*link.records(self._stamp, self._count), link.draws(self._count)),
            (protection.age, *stamps.records(self._stamp, self._count), stamps.draws(self._count)),
            self._stack._history._commands, spans.shown, out.truth, out.measured, out.couplers, out.sent, out.at_limit,
            (SECOND_NS, *out.reports), out.supervision, self._forecast.at_rest,
        ))  # fmt: skip
        if isinstance(law, PythonLaw):
            law.end_span(done)
            out.law_reports = law.reports
        self._forecast.take_back(done)
        self._observer_shoes.take_back(done, float(out.measured[done - 1, 1, 0]) if done else None)
        if done:
            self._store(done)
        return done

    def _uses_shoes(self) -> bool:
        """Return True if this law, or one after a planned change, uses the forecast of the shoe forces."""
        uses_feedforward = getattr(self._stack._law, "uses_feedforward", True)
        compensation = self._stack._compensation
        used = self._law.uses_shoes or isinstance(compensation, Predictor)
        return bool(self._setup.law_changes or used or (uses_feedforward and not isinstance(compensation, Twin)))

    def _predicting(self) -> tuple[Any, ...]:
        """Return the records of the compensation `predictor`, empty ones for another."""
        known = self._stack._compensation
        if self._law.compensates or not isinstance(known, Predictor):
            return zeros(PredictionConstants, 0), RIGID, zeros(Actuator, 0), np.zeros(0)
        return known.constants, known.chain(known.known_delay or 0.0), known.actuators, known.along

    def _observing(self) -> tuple[Any, ...]:
        """Return the arrays of the observer."""
        slow = self._observer_shoes.slow
        units = self._spans.stages.observer._stack._shoes._units
        shoes = (slow, units, np.zeros(1 + len(units)), np.zeros(slow.shape[1]))
        *records, couplers = self._spans.observing
        return *records, self.arrays.estimates, shoes, couplers

    def _braking(self) -> tuple[Any, ...]:
        """Return call and arrays of the policy of the air brake."""
        policy, spans = self._policy, self._spans
        if spans.policy_call is None:
            step = policy.form.step
            spans.policy_call = LawCall(
                lambda *_: step(policy.constants, policy.state, policy.rows, policy.now), policy.form.entry, POLICY
            )
        records = (policy.constants.view(np.uint8), policy.state.view(np.uint8), policy.rows.view(np.uint8))
        pressure = policy.charged if self._stack._pressure is None else self._stack._pressure
        brake = (spans.policy_call, policy.limits, policy.segments, policy.charged, pressure)
        return *records, len(policy.rows), policy.now, *brake

    def _bounds(self) -> Array:
        """Return the values from which on a tick is left to Python."""
        jumps = [jump.place for jump in self._train._jumps._waiting if isinstance(jump, Jump) and jump.at is None]
        jumps += [jump.place for jump in self._train._jumps._waiting if not isinstance(jump, Jump) and jump.at is None]
        jump_place = min((at for at in jumps if at is not None), default=FAR)
        return np.array((*LIMITS, STANDSTILL_SPEED, jump_place))

    def _store(self, done: int) -> None:
        """Set the states of stages, stack, law, link and sensors to those after the span."""
        stack, train, out = self._stack, self._train, self.arrays
        observer = self._spans.stages.observer._stack
        if isinstance(self._spans.observer, RecordObserver):
            self._spans.observer.balance.units["disturbance"] = out.estimates[done - 1]
        observer._policy.state[:] = self._policy.state
        stack._ticks += done
        stack._last = out.sent[done].tolist()
        stack._saturated_steps = int(out.at_limit[done])
        stack._saturated = bool(self._counts[kernel.AT_LIMIT])
        self._spans.supervised.store(done)
        self._plant.link.skip_draws(done)
        train.sensor_set.skip_noise(done)
        train.stamp += done * train.tick_ns
        self._plant.tick += done
