"""Compiled spans: ticks without events run in compiled code, with the same messages, bit for bit.

Between the diagnostics of two seconds most ticks of a run consist of sensors, law, delay line and train only.
:class:`CompiledSpans` runs them in one compiled call (:mod:`train_ato.loop.span_kernel`) and makes their messages from
its arrays. Every tick with an event (a change of the brake pipe, a jump, a change of the law, standstill, an impossible
value) is left to the stages in Python.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from plant_sim.brake_events import PipeEvents
from plant_sim.plant_setup import Jump
from train_ato.control.air_brake.policy import PlannedBrake, ReleasedBrake
from train_ato.control.compensation.none import NoCompensation
from train_ato.control.compensation.preview import PreviewFeedforward
from train_ato.control.compensation.twin import Twin
from train_ato.control.compiled import laws as c
from train_ato.control.compiled.packing import CompiledLaw, has_compiled_step
from train_ato.control.observers.none import NoObserver
from train_ato.control.registry import COMPENSATIONS, OBSERVERS
from train_ato.control.stack import ControlStack
from train_ato.control.train_model import DRY_FRICTION_SPEED, GRID, STANDSTILL_SPEED
from train_ato.loop import span_kernel as kernel
from train_ato.loop.controller import ControllerStage
from train_ato.loop.observer import ObserverStage
from train_ato.loop.plant import PlantStage
from train_ato.loop.profile import ProfileStage
from train_ato.loop.recording import (
    BRAKE_PIPE,
    BRAKE_PIPE_COMMAND,
    BRAKE_PIPE_TAIL,
    BRAKE_SHOES,
    COMMAND,
    DISTURBANCE,
    ESTIMATE,
    MEASUREMENT,
    REFERENCE,
    TRUTH,
)
from train_ato.loop.recording_builder import RecordingBuilder
from train_ato.loop.setup import RunSetup
from train_ato.loop.stage_messages import SECOND_NS, Published, diagnostics_due
from train_ato.messages.links import LinkSpec, PackedQueues
from train_ato.messages.types import (
    Array,
    BrakeShoes,
    Command,
    Diagnostic,
    Disturbance,
    DisturbanceEstimate,
    Measurement,
    Pipe,
    Reference,
    Tick,
    VehicleStates,
)
from train_ato.scenario.changes import requested_stamp

SHORTEST, LONGEST, BRAKED = 4, 256, 32
"""Shortest span that is worth its preparation, longest span, and longest one with forecasts of shoe forces [ticks]."""
FAR = 1e300
"""Place or time that is never reached [m, s]."""
LIMITS = (1e6, 100.0, 1e7)
"""Position [m], speed [m/s] and force [N] beyond which a tick is left to Python, far inside the limits of validity."""

Publish = Callable[[int, Published], None]


def spans_possible(setup: RunSetup) -> bool:
    """Return True for a run whose ticks can be compiled: kinds of compensation, observer, links, sensors and events."""
    scenario, links = setup.scenario, setup.links
    undelayed = all(link == LinkSpec() for link in (links.measurement, links.reference, links.estimate))
    plain = not (setup.layout.supervised or scenario.faults or scenario.replan or scenario.interventions)
    steady = undelayed and links.brake_pipe == LinkSpec() and not (links.command.jitter or links.command.loss)
    sensors = setup.plant.sensors
    compensation = COMPENSATIONS.get(setup.compensation)
    known = OBSERVERS.get(setup.observer) is NoObserver and compensation in (NoCompensation, PreviewFeedforward, Twin)
    if compensation is PreviewFeedforward and setup.layout.air_brake:  # its shoe forces are those of one time
        known = known and np.array_equal(setup.model.delay, setup.model.delay_brake)
    return bool(
        plain and steady and known and not sensors.freeze and not sensors.wheel_slip and setup.model.n_units > 0
    )


@dataclass
class _Known:
    """Values of all ticks that do not depend on the state of the train."""

    reference: Array
    """Position, speed, acceleration, and acceleration at the effect of the command, shape (4, ticks)."""
    force: Array
    """Force of the rigid train of which the feed-forward is a share, in traction and in braking, (2, ticks, units)."""
    effect: Array
    """Speed of the profile for which the shoe force of the feed-forward is computed [m/s], shape (ticks,)."""


class CompiledSpans:
    """Runs the ticks between two events in compiled code.

    Parameters
    ----------
    setup
        Prepared run, of which :func:`spans_possible` is True.
    plant, profile, observer, controller
        Stages of the loop.
    recording
        Recording of the run in memory.
    publish
        Called with stamp and messages of every stage of every tick, in the order of the loop; None if only the
        recording needs them.
    """

    def __init__(
        self,
        setup: RunSetup,
        plant: PlantStage,
        profile: ProfileStage,
        observer: ObserverStage,
        controller: ControllerStage,
        recording: RecordingBuilder,
        publish: Publish | None,
    ) -> None:
        self._setup, self._plant, self._profile, self._controller = setup, plant, profile, controller
        self._observer = observer
        self._recording, self._publish = recording, publish
        self._zero = np.zeros(setup.model.n_units)
        self._known: _Known | None = None
        self._law: CompiledLaw | None = None
        self._compiled: Any = None
        self._retry = 0
        self._own, self._table = _own_constants(setup)
        self._limits, self._segments = _envelopes(setup)
        sensors = plant.train._sensors
        values = setup.plant.sensors
        self._sensor = np.array(
            (values.position_bias, values.velocity_bias, values.position_quantum, values.velocity_quantum)
        )
        self._units, self._front, self._gaps = sensors._units, sensors._front, np.array(sensors._gaps)

    def run(self) -> int:
        """Run the ticks up to the next event; return their number, 0 if the next tick is left to Python."""
        plant, stack = self._plant, self._controller._stack
        assert stack is not None
        if plant.stamp < self._retry:
            return 0
        count = self._ticks_to_event(stack)
        if count < SHORTEST or not self._ready(stack):
            return 0
        done = _Span(self, stack, plant.stamp, count).run()
        if not done:  # standstill: the next ticks are probably left to Python, too
            self._retry = plant.stamp + SECOND_NS
        return done

    def _ticks_to_event(self, stack: ControlStack) -> int:
        """Return the number of ticks before the next change, jump, or end of the run; 0 at the start."""
        plant, tick = self._plant, self._setup.tick_ns
        stamp = plant.stamp
        if stamp == 0:
            return 0
        longest = LONGEST if stack._compensation.shoes.idle else BRAKED
        ends = [stamp + longest * tick, self._setup.ticks * tick, plant._link.next_jump(stamp)]
        ends += [requested_stamp(change) for change in self._controller._planned]
        ends += [round(jump.at * 1e9) // tick * tick for jump in plant.train._jumps._waiting if jump.at is not None]
        return int(-((stamp - min(ends)) // tick))

    def _ready(self, stack: ControlStack) -> bool:
        """Return True if the present states of stack and train permit compiled ticks."""
        train, policy = self._plant.train, stack._policy
        if self._compiled is not stack._law:
            self._compiled = stack._law
            self._law = CompiledLaw(stack._law) if has_compiled_step(stack._law) else None
        known = type(policy) in (ReleasedBrake, PlannedBrake) and self._law is not None
        compensation = stack._compensation
        if self._law is not None and isinstance(compensation, PreviewFeedforward):
            known = known and not (self._law.sensors and compensation.forward != compensation.backward)
        if isinstance(compensation, Twin):
            known = known and compensation.started
        pipe = train._brake
        if isinstance(pipe, PipeEvents):
            known = known and stack._pressure == pipe.pressure and not pipe._vented
        free = train._parted._since is None and not train._has_added_gusts and not self._controller._asked
        return known and free and not stack.holding and stack._offset is None

    def known(self, stack: ControlStack) -> _Known:
        """Return the values of all ticks, computed once."""
        if self._known is None:
            setup, compensation = self._setup, stack._compensation
            profile, rigid = self._profile.profile, stack._compensation.rigid
            stamps = setup.tick_ns * np.arange(setup.ticks, dtype=np.int64)
            t = stamps * 1e-9
            now = profile._evaluate(stamps)
            share = setup.model.share
            effect, total = now, np.repeat(rigid.totals(t)[:, None], share.size, axis=1)
            force = np.array([total, total])
            if isinstance(compensation, PreviewFeedforward):
                delays = (compensation.forward, compensation.backward)
                effect = profile._evaluate(np.rint((t + _mean(share, delays[0])) * 1e9).astype(np.int64))
                parts = [[rigid.aheads(t + delay, compensation.lag) for delay in kind] for kind in delays]
                force = np.array(parts).swapaxes(1, 2)
            self._known = _Known(np.array([*now, effect[2]]), force, effect[1])
        return self._known


class _Span:
    """One span: preparation of the arrays, compiled call, messages, and the states after it."""

    def __init__(self, spans: CompiledSpans, stack: ControlStack, stamp: int, count: int) -> None:
        self.spans, self.stack, self.stamp = spans, stack, stamp
        self.plant, self.setup = spans._plant, spans._setup
        self.train = self.plant.train
        assert spans._law is not None
        self.law = spans._law
        self.outside, self.cubes, self.means = self.train._outside.ahead(stamp, count)
        self.count = len(self.outside)
        self.first = self.plant.tick

    def run(self) -> int:
        """Run the ticks; return the number of them that were run."""
        count, n, setup, train, stack = self.count, self.train.n, self.setup, self.train, self.stack
        known, part = self.spans.known(stack), slice(self.first, self.first + self.count)
        self.reference = np.ascontiguousarray(known.reference[:, part])
        shoes, feedforward = self._forecast(known, part)
        law = stack._law
        inputs = np.zeros((c.INPUT_ROWS, setup.model.n_units))
        inputs[c.SHARE], inputs[c.SATURATED], inputs[c.LAST_FORCE] = law.share, law.saturated, law._last_force
        self.inputs, self.state = inputs, self.law.state()
        self.truth = np.empty((count, 4, n))
        self.measured, self.couplers = np.empty((count, 3, len(train.units))), np.empty((count, 3, len(train.sensors)))
        self.sent = np.empty((count + 1, len(train.units)))
        self.sent[0] = stack._last
        self.counts = np.array((stack._ticks, stack._every, stack._saturated, 0), dtype=np.int64)
        self.at_limit = np.zeros(count + 1, dtype=np.int64)
        self.at_limit[0] = stack._saturated_steps
        a, events = train.arrays, train._brake.propagating()
        most = count * train.tick_ns // SECOND_NS + 2
        changing = (a.state, a.gear, a.unit, a.setting)
        self.reports = [np.empty((most, *values.shape)) for values in changing]
        link = self.plant._link
        newest = link.newest_due(self.stamp, count * train.substeps).reshape(count, train.substeps)
        queues = link.packed(count)
        cubed = np.arange(train._outside.vehicles.size if self.cubes.shape[2] else 0)
        done = kernel.run_span(
            self.stamp, train.tick_ns, train._step,
            (a.state, a.vehicle, a.vehicle_index, a.gear, a.table, a.run, a.body, a.unit, a.unit_index, a.envelope,
             a.piece),
            train._brake.array, events, (self.outside, self.cubes, cubed), train._outside.vehicles, a.setting,
            self._noise(), self.spans._sensor, self.spans._units, self.spans._front, self.spans._gaps,
            self.law.number, self.law.constant, self.state, inputs, self.reference, feedforward, shoes,
            self._beside(), self.spans._own, self.spans._table, self.spans._limits, self.spans._segments,
            self._bounds(), self.counts, link.delays(self.stamp), newest, *queues, stack._history._commands,
            self.truth, self.measured, self.couplers, self.sent, self.at_limit, (SECOND_NS, *self.reports),
        )  # fmt: skip
        if not done:
            self._forget_forecast()
        else:
            self._store(done, queues, int(newest[done - 1, -1]))
            if self.spans._publish is None:
                self._record(done)
                self.spans._recording.extend(
                    ("/diagnostics", report) for group in self._diagnostics(done).values() for report in group
                )
            else:
                self._publish(done, self.spans._publish)
        return int(done)

    def _forecast(self, known: _Known, part: slice) -> tuple[Array, Array]:
        """Return shoe forces, of the train and of the units' vehicles [N], and feed-forward of every tick and unit."""
        units, compensation = self.setup.model.n_units, self.stack._compensation
        shoes, totals = np.zeros((self.count, 1 + units)), np.zeros((self.count, 1))
        self._shoes = None
        if not compensation.shoes.idle and self._uses_shoes():
            self._shoes = compensation.shoes.copy()
            ahead = isinstance(compensation, PreviewFeedforward)
            for index, tick in enumerate(range(part.start, part.stop)):
                t, speed = self.setup.tick_ns * tick * 1e-9, float(self.reference[1, index])
                compensation.shoes.demand(t, self.stack._pressure)
                found = compensation.shoes.at(t, speed)
                shoes[index] = (found.total, *found.own)
                if ahead:
                    effect = t + compensation.mean_delay(self.stack._history._commands)
                    found = compensation.shoes.at(effect, float(known.effect[tick]))
                totals[index] = found.total
        if isinstance(compensation, Twin):
            times = (self.setup.tick_ns * np.arange(part.start, part.stop) * 1e-9).tolist()
            return shoes, compensation.feedforwards(times)
        forward, backward = known.force[0, part] + totals, known.force[1, part] + totals
        braking = np.where(backward < 0.0, backward, 0.0)
        differ = np.array(self._delays_differ())
        return shoes, np.where((forward < 0.0) & differ, braking, forward) * self.setup.model.share

    def _delays_differ(self) -> list[bool]:
        """Return True for every unit whose delay in braking is another than in traction, under `preview`."""
        compensation = self.stack._compensation
        if not isinstance(compensation, PreviewFeedforward):
            return [False] * self.setup.model.n_units
        return [a != b for a, b in zip(compensation.forward, compensation.backward, strict=True)]

    def _uses_shoes(self) -> bool:
        """Return True if this law, or one after a planned change, uses the shoe forces."""
        law, compensation = self.stack._law, self.stack._compensation
        used = self.law.sensors or (law.uses_feedforward and not isinstance(compensation, Twin))
        return bool(self.setup.law_changes or used)

    def _noise(self) -> tuple[Array, Array, Array]:
        """Return the noise of positions, speeds and couplers of the ticks; empty without noise."""
        sensors, none = self.train._sensors, np.zeros((0, self._zero.size))
        noises = (sensors._position_noise, sensors._velocity_noise)
        position, velocity = (none if noise is None else noise.ahead(self.count) for noise in noises)
        couplers = len(self.train.sensors)
        return position, velocity, sensors._coupler_noise.ahead(self.count) if couplers else np.zeros((0, 2, 0))

    @property
    def _zero(self) -> Array:
        return self.spans._zero

    def _beside(self) -> Any:
        """Return the sensors in front of and behind every unit, shape (units, 2), -1 for none."""
        return np.array(self.law.sensors, dtype=np.int64).reshape(-1, 2)

    def _bounds(self) -> Array:
        """Return the values beyond which a tick is left to Python."""
        event = self.stack._policy.next_event if self.setup.layout.air_brake else None  # type: ignore[attr-defined]
        place = FAR if event is None or event.place is None else event.place
        time = FAR if event is None or event.time is None else event.time
        places = [jump.place for jump in self.train._jumps._waiting if isinstance(jump, Jump) and jump.at is None]
        jump = min((FAR if at is None else at for at in places), default=FAR)
        return np.array((*LIMITS, STANDSTILL_SPEED, place, time, jump))

    def _forget_forecast(self, done: int = 0) -> None:
        """Set shoe forecast and twin to their states after the ticks that were run."""
        stack = self.stack
        if self._shoes is not None:
            stack._compensation.shoes = self._shoes
            for tick in range(self.first, self.first + done):
                self._shoes.demand(self.setup.tick_ns * tick * 1e-9, stack._pressure)
        if isinstance(stack._compensation, Twin):
            stack._compensation.rewind(done)

    def _store(self, done: int, queues: PackedQueues, newest_due: int) -> None:
        """Set the states of stages, stack, law, link and sensors to those after the span."""
        stack, law, train, sensors = self.stack, self.stack._law, self.train, self.train._sensors
        self.law.take_state(self.state)
        law.saturated = [bool(value) for value in self.inputs[c.SATURATED]]
        law._last_force = self.inputs[c.LAST_FORCE].tolist()
        stack._ticks += done
        stack._last = self.sent[done].tolist()
        stack._saturated_steps = int(self.at_limit[done])
        stack._saturated = bool(self.counts[kernel.AT_LIMIT])
        if done < self.count:
            self._forget_forecast(done)
        self.plant._link.take_packed(queues, newest_due)
        for noise in (sensors._position_noise, sensors._velocity_noise):
            if noise is not None:
                noise.skip(done)
        if train.sensors:
            sensors._coupler_noise.skip(done)
        sensors._last = (self.measured[done - 1, 0].copy(), self.measured[done - 1, 1].copy())
        train.stamp += done * train.tick_ns
        self.plant.tick += done

    def _diagnostics(self, done: int) -> dict[int, tuple[Diagnostic, ...]]:
        """Return the diagnostics of plant, profile, observer and controller by the tick of the span."""
        spans, stack, tick_ns = self.spans, self.stack, self.setup.tick_ns
        due = [index for index in range(done) if diagnostics_due(self.stamp + index * tick_ns, tick_ns)]
        found = {}
        for number, index in enumerate(due):
            stamp = self.stamp + index * tick_ns
            state, gear, unit, setting = (values[number] for values in self.reports)
            arrays = replace(self.train.arrays, state=state, gear=gear, unit=unit, setting=setting)
            now, stack._saturated_steps = stack._saturated_steps, int(self.at_limit[index + 1])
            controller = spans._controller.diagnostic(stamp)
            stack._saturated_steps = now
            assert controller is not None
            plant = self.plant.diagnostic_at(stamp, self.train.totals_at(arrays))
            found[index] = (plant, spans._profile.diagnostic(stamp), spans._observer.diagnostic(stamp), controller)
        return found

    def _record(self, done: int) -> None:
        """Add the messages of the ticks to the recording as arrays."""
        add, train = self.spans._recording.extend_rows, self.train
        stamps = self.stamp + self.setup.tick_ns * np.arange(done, dtype=np.int64)
        truth, measured, reference = self.truth[:done], self.measured[:done], self.reference[:, :done, None]
        add("/clock", stamps, {})
        add(TRUTH, stamps, {"position": truth[:, 0], "velocity": truth[:, 1], "coupler_force": truth[:, 2]})
        if train._pipe is not None and train._pressure is not None:
            pipe, pressure = train._pipe, train._pressure
            ends = np.array([train._pressures(pipe, pressure, t) for t in (stamps * 1e-9).tolist()])
            add(BRAKE_PIPE, stamps, {"pressure": ends[:, :1]})
            add(BRAKE_PIPE_TAIL, stamps, {"pressure": ends[:, 1:]})
            add(BRAKE_SHOES, stamps, {"shoe_force": truth[:, 3]})
            add(BRAKE_PIPE_COMMAND, stamps, {"pressure": np.full((done, 1), self.stack._pressure)})
        if self.setup.layout.disturbed:
            forces = np.empty((done, train.n))
            for index in range(done):
                forces[index] = train._outside_force
                self._keep_outside(index)
            add(DISTURBANCE, stamps, {"force": forces})
        values = {"position": measured[:, 0], "velocity": measured[:, 1], "applied": measured[:, 2]}
        add(MEASUREMENT, stamps, values)
        add(REFERENCE, stamps, dict(zip(("position", "velocity", "acceleration"), reference[:3], strict=True)))
        add(ESTIMATE, stamps, {"force": np.zeros((done, self._zero.size))})
        add(COMMAND, stamps, {"force": self.sent[1 : done + 1]})

    def _publish(self, done: int, publish: Publish) -> None:
        """Publish the messages of the ticks."""
        planned = self.spans._profile.planned
        pressure, tick_ns = self.stack._pressure, self.setup.tick_ns
        references, diagnostics = self.reference[:3, :done].T.tolist(), self._diagnostics(done)
        for index in range(done):
            stamp = self.stamp + index * tick_ns
            plant, *others = diagnostics.get(index, (None,) * 4)
            reports: list[Published] = [[] if report is None else [("/diagnostics", report)] for report in others]
            messages = self._of_plant(stamp, index, plant)
            messages += [*reports[0], ("ato/reference", Reference(stamp, *references[index], planned))]
            messages += [*reports[1], ("ato/estimate", DisturbanceEstimate(stamp, self._zero))]
            if pressure is not None:
                messages.append(("ato/brake_pipe_command", Pipe(stamp, pressure)))
            messages += [*reports[2], ("ato/command", Command(stamp, self.sent[index + 1]))]
            publish(stamp, messages)

    def _of_plant(self, stamp: int, index: int, report: Diagnostic | None) -> Published:
        """Return the messages of the plant at a tick; the disturbance is that of the tick before."""
        train, (position, velocity, coupler, shoe) = self.train, self.truth[index]
        messages: Published = [
            ("/clock", Tick(stamp)),
            ("train/vehicles", VehicleStates(stamp, position, velocity, coupler)),
        ]
        if train._pipe is not None and train._pressure is not None:
            head, tail = train._pressures(train._pipe, train._pressure, stamp * 1e-9)
            messages.append(("train/brake_pipe", Pipe(stamp, head)))
            messages.append(("train/brake_pipe_tail", Pipe(stamp, tail)))
            messages.append(("train/brake_shoes", BrakeShoes(stamp, shoe)))
        if self.setup.layout.disturbed:
            messages.append(("train/disturbance", Disturbance(stamp, train.outside_force)))
            self._keep_outside(index)
        if report is not None:
            messages.append(("/diagnostics", report))
        messages.append(("train/measurement", Measurement(stamp, *self.measured[index], *self.couplers[index])))
        return messages

    def _keep_outside(self, index: int) -> None:
        """Keep the mean disturbance of a tick, which is published at the next one."""
        train, outside = self.train, self.train._outside
        if not outside.acts:
            return
        mean = self.means[index]
        if self.cubes.shape[2]:
            mean = np.add.reduce(self.outside[index, :2], axis=1) / train.substeps
        outside.mean = mean
        last = index + 1 == len(self.truth) or self.stamp + (index + 1) * train.tick_ns == train.stamp
        speed = train.arrays.state[1] if last else self.truth[index + 1, 1]
        force, per_speed = mean
        train._outside_force[outside.vehicles] = force + per_speed * speed[outside.vehicles]


def _mean(share: Array, delays: list[float]) -> float:
    total = 0.0
    for part, delay in zip(share.tolist(), delays, strict=True):
        total += part * delay
    return total


def _own_constants(setup: RunSetup) -> tuple[Array, Array]:
    """Return constants of every unit's vehicle and of the line of the model, and the line force per mass."""
    model = setup.model
    rows = [
        (*own, DRY_FRICTION_SPEED, model._begin, GRID, offset)
        for own, offset in zip(model._own, model.offsets.tolist(), strict=True)
    ]
    return np.array(rows, dtype=np.float64), np.array(model._specific)


def _envelopes(setup: RunSetup) -> tuple[Array, Any]:
    """Return the segments of all envelopes, and first and end of brake and traction of every unit."""
    rows, bounds, end = [np.zeros((0, 4))], [], 0
    for brake, traction in zip(setup.model.brake, setup.model.traction, strict=True):
        middle, last = end + len(brake.rows), end + len(brake.rows) + len(traction.rows)
        rows += [brake.rows, traction.rows]
        bounds.append((end, middle, middle, last))
        end = last
    return np.concatenate(rows), np.array(bounds, dtype=np.int64)
