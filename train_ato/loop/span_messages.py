"""Messages of the ticks of a span and of the steps of the supervisor in it, from its arrays."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant_sim import kernel as k
from train_ato.judge import recording as rec
from train_ato.judge.recording_builder import RecordingBuilder
from train_ato.judge.repeated_reports import RepeatedReport
from train_ato.loop.plant import TOTALS
from train_ato.loop.stage_messages import SECOND_NS
from train_ato.loop.stages import Stages
from train_ato.loop.supervision_kernel import SupervisionArrays
from train_ato.messages import types as msg
from train_ato.messages.topics import BY_NAME, TickBlock, Values, message_at
from train_ato.supervision.step_function import SupervisionSpeeds
from train_ato.supervision.supervisor import SupervisionDecision

ODOMETRY, PROTECTION, BRAKE_RELEASE = "train/odometry", "train/protection", "atp/brake_release"

BETWEEN = (
    ("plant", rec.MEASUREMENT), (ODOMETRY, rec.MEASUREMENT), (PROTECTION, rec.MEASUREMENT),
    (rec.SUPERVISED_SPEEDS, rec.REFERENCE), ("supervisor", rec.REFERENCE), (BRAKE_RELEASE, rec.REFERENCE),
    ("profile", rec.REFERENCE), ("observer", rec.ESTIMATE), (rec.ATO_STATE, rec.COMMAND), ("controller", rec.COMMAND),
)  # fmt: skip
"""Messages that are not of every tick, diagnostics by their node, in order; topic before which each is published."""
NUMBERS = ("front", "position_error", "acceleration")
"""Numbers in the diagnostics of the supervisor."""
TEXTS = ["state", "reason", "reason_speed", "reason_front", "reason_limit"]
"""Fields of a step from which the texts of the diagnostics follow."""


class SupervisionMessages:
    """Messages of the steps of the supervisor in the ticks of one span.

    Parameters
    ----------
    stages
        Setup and stages of the loop; the supervisor is in its state before the span.
    arrays
        Results of the compiled steps.
    stamps : Array of int, shape (ticks,)
        Stamps of the ticks [ns].
    measured : Array, shape (ticks, 3, units)
        Position [m], speed [m/s] and force [N] of every tick.
    brief
        True for diagnostics with the numbers of the first one of equal texts.

    Attributes
    ----------
    ticks : Array of int, shape (steps,)
        Numbers of the ticks with a step.
    reports : list of RepeatedReport
        Diagnostics of the supervisor.
    """

    def __init__(
        self,
        stages: Stages,
        arrays: SupervisionArrays,
        stamps: NDArray[np.int64],
        measured: msg.Array,
        *,
        brief: bool = False,
    ) -> None:
        assert stages.supervisor is not None
        self._stages = stages
        records: Any = arrays
        count, self._period = (int(records.states.run[name][0]) for name in ("steps", "period"))
        self._stage, self._steps, self._readings = stages.supervisor, records.steps[:count], records.readings[:count]
        self.ticks = np.flatnonzero(stamps % self._period == 0)
        self._stamps = stamps[self.ticks]
        seen, first = measured[self.ticks, :, 0], self._stage.count
        assert first is not None
        count = len(self._stamps)
        alive: msg.Array = np.arange(first + 1, first + 1 + count, dtype=np.float64)
        front = self._steps["front"]
        foremost = front + self._steps["position_error"]
        limits = (self._steps[name] for name in SupervisionSpeeds._fields)
        self.rows: dict[str, Values] = {  # in the order of the fields
            ODOMETRY: {name: self._readings[name] for name in ("position", "speed", "since_balise")},
            PROTECTION: {"active": np.zeros((count, 3))},
            rec.SUPERVISED_SPEEDS: {
                "position": np.column_stack((front, *[foremost] * 4)),
                "speed": np.column_stack((self._steps["speed"], *limits)),
            },
            BRAKE_RELEASE: {"released": np.ones((count, 3)), "alive": np.repeat(alive[:, None], 3, 1)},
            rec.ATO_STATE: {
                "position": seen[:, :1] + stages.setup.model.offsets[0],
                "velocity": seen[:, 1:2],
                "state": np.full((count, 1), float(msg.AtoState.ENGAGED)),
            },
        }
        self.reports = self._diagnostics(() if brief else NUMBERS)

    def at(self, number: int) -> dict[str, Any]:
        """Return the messages of a step by topic."""
        stamp = int(self._stamps[number])
        return {
            topic: BY_NAME[topic].message(stamp, *[column[number] for column in values.values()])
            for topic, values in self.rows.items()
        }

    def record(self, recording: RecordingBuilder, *, brief: bool = False) -> None:
        """Add the messages without the diagnostics to a recording as arrays; ``brief``: the states of the ATO alone."""
        for topic, values in self.rows.items():
            if not brief:
                recording.extend_rows(topic, self._stamps, values)
            elif topic == rec.ATO_STATE:
                recording.extend_reduced(topic, self._stamps, {"state": values["state"]})

    def store(self, ato: msg.AtoReport | None) -> msg.AtoReport | None:
        """Set the supervisor, its stage and the receiving ends to their states after the last step.

        Parameters
        ----------
        ato
            Report of the ATO at the step before the span, which the profile receives first.

        Returns
        -------
        AtoReport or None
            Report at the last step.
        """
        stage, count = self._stage, len(self._stamps)
        if not count:
            return ato
        steps = [self.at(number) for number in range(max(count - 3, 0), count)]
        last = {topic: [step[topic] for step in steps[-2:]] for topic in self.rows}
        reports = [ato] * (count < 3) + [step[rec.ATO_STATE] for step in steps[:-1]]
        self._stages.accept(count, {**last, rec.ATO_STATE: [report for report in reports if report][-2:]})
        release = last[BRAKE_RELEASE][-1]
        self._stages.plant.protection.on_release(release)
        self._stages.plant.alive_check.problem(release)
        assert stage.count is not None
        stage.count += count
        stage.reported = int(self._steps["state"][-1])
        report: msg.AtoReport = steps[-1][rec.ATO_STATE]
        return report

    def _diagnostics(self, numbers: Sequence[str]) -> list[RepeatedReport]:
        """Return the diagnostics, once a second and after a change of state, with some numbers by key."""
        states = self._steps["state"]
        changed = np.diff(states, prepend=self._stage.reported) != 0
        steps = np.flatnonzero(changed | (self._stamps % SECOND_NS < self._period)).tolist()
        texts, found = self._steps[TEXTS].tolist(), []
        for _, group in groupby(steps, key=texts.__getitem__ if self._stage.authority is None else None):
            same = list(group)
            stamps, rows = self._stamps[same].tolist(), self._steps[same]
            first = self._stage.diagnostic(stamps[0], SupervisionDecision(rows[0]))
            found.append(RepeatedReport(first, stamps, {key: rows[key].tolist() for key in numbers}))
        return found


SATURATED = "saturated"
"""Key of the time at a force limit, the only number of the summary from all diagnostics of the plant."""


@dataclass
class SpanArrays:
    """Results of the compiled ticks, one row per tick.

    Attributes
    ----------
    truth : Array, shape (ticks, 4, vehicles)
        Position [m], speed [m/s], coupler and shoe force [N].
    measured : Array, shape (ticks, 3, units)
        Position [m], speed [m/s] and force [N].
    couplers : Array, shape (ticks, 3, sensors)
        Deflection [m], rate [m/s] and force [N].
    sent, at_limit : Array, shape (ticks + 1, units) and (ticks + 1,)
        Commands [N] and steps of the law at a force limit so far, those before the first tick first.
    reference : Array, shape (3, ticks)
        See :class:`train_ato.loop.forecast.Forecast`.
    outside, cubes, means : Array
        Disturbances, see :meth:`plant_sim.disturbances.OutsideForces.ahead`.
    reports : list of Array
        State, gear, unit and setting of the kernel, and number of commands lost, at the ticks with diagnostics.
    supervision : SupervisionArrays
        Results of the steps of the supervisor.
    estimates : Array, shape (ticks, units)
        Estimates of the observer [N].
    pressure : float or None
        Pressure of the brake pipe demanded in all ticks [Pa]; None without an air brake.
    law_reports : dict
        Diagnostics of the controller by tick, if they are made in the tick.
    """

    truth: msg.Array
    measured: msg.Array
    couplers: msg.Array
    sent: msg.Array
    at_limit: np.ndarray[tuple[int, ...], np.dtype[np.int64]]
    reference: msg.Array
    outside: msg.Array
    cubes: msg.Array
    means: msg.Array
    reports: list[msg.Array]
    supervision: SupervisionArrays
    estimates: msg.Array
    pressure: float | None
    law_reports: dict[int, msg.Diagnostic] = field(default_factory=dict)


class SpanMessages:
    """Messages of the ticks of one span that have been run.

    Parameters
    ----------
    stages
        Setup and stages of the loop, in their states after the span.
    arrays
        Results of the compiled ticks.
    first : int
        Stamp of the first tick [ns].
    done : int
        Number of ticks that were run.
    brief
        True for :meth:`record_summary` only: the totals of all diagnostics of the plant are those of the last one.
    """

    def __init__(self, stages: Stages, arrays: SpanArrays, first: int, done: int, *, brief: bool = False) -> None:
        self._stages, self._arrays, self._done, self._brief = stages, arrays, done, brief
        self._tick = stages.setup.tick_ns
        self._stamps = first + self._tick * np.arange(done, dtype=np.int64)
        self._train = stages.plant.train
        self._supervision: SupervisionMessages | None = None
        if stages.supervisor is not None:
            seen = arrays.measured[:done]
            self._supervision = SupervisionMessages(stages, arrays.supervision, self._stamps, seen, brief=brief)

    @cached_property
    def _rows(self) -> list[tuple[str, Values]]:
        """Topic and values of the messages of every tick, in the order of publication."""
        a, done, stamps, disturbed = self._arrays, self._done, self._stamps, self._stages.setup.layout.disturbed
        truth = a.truth[:done]
        rows: list[tuple[str, Values]] = [("/clock", {})]
        rows.append((rec.TRUTH, {"position": truth[:, 0], "velocity": truth[:, 1], "coupler_force": truth[:, 2]}))
        if self._train.pipe is not None:
            ends = self._train.pipe_pressures_at_each(np.asarray(stamps * 1e-9, dtype=np.float64))
            rows += [(rec.BRAKE_PIPE, {"pressure": ends[:, :1]}), (rec.BRAKE_PIPE_TAIL, {"pressure": ends[:, 1:]})]
            rows.append((rec.BRAKE_SHOES, {"shoe_force": truth[:, 3]}))
        if disturbed:
            rows.append(
                (rec.DISTURBANCE, {"force": np.array([self._next_disturbance(index) for index in range(done)])})
            )
        return [*rows, *self._exchanged.items()]

    @cached_property
    def _exchanged(self) -> dict[str, Values]:
        """Values of the messages of every tick between the stages, in the order of publication."""
        a, done = self._arrays, self._done
        measured, couplers = a.measured[:done], a.couplers[:done]
        seen = {"position": measured[:, 0], "velocity": measured[:, 1], "applied": measured[:, 2]}
        seen |= {"deflection": couplers[:, 0], "rate": couplers[:, 1], "force": couplers[:, 2]}
        reference = dict(zip(("position", "velocity", "acceleration"), a.reference[:, :done, None], strict=True))
        planned = np.full((done, 1), self._stages.profile.planned)
        found: dict[str, Values] = {rec.MEASUREMENT: seen, rec.REFERENCE: {**reference, "planned": planned}}
        found[rec.ESTIMATE] = {"force": a.estimates[:done]}
        if a.pressure is not None:
            found[rec.BRAKE_PIPE_COMMAND] = {"pressure": np.full((done, 1), a.pressure)}
        found[rec.COMMAND] = {"force": a.sent[1 : done + 1]}
        return found

    def record(self, recording: RecordingBuilder) -> None:
        """Add the messages to a recording as arrays."""
        for topic, values in self._rows:
            kept = {name: values[name] for name in rec.FIELDS.get(topic, ())}
            recording.extend_rows(topic, self._stamps, kept)
        if self._supervision is not None:
            self._supervision.record(recording)
        recording.extend_reports(self._reports)

    def record_summary(self, recording: RecordingBuilder) -> None:
        """Add the series of the summary to a recording, with the truth of the first, the power units and the last."""
        a, done, add = self._arrays, self._done, recording.extend_reduced
        position, velocity = a.truth[:done, :2].copy().swapaxes(0, 1)
        truth = {"front_position": position[:, :1], "front_velocity": velocity[:, :1]}
        truth |= {"rear_position": position[:, -1:], "unit_position": position[:, 1:-1]}
        if self._train.n > 1:  # the forces of all couplers are not kept
            truth |= dict.fromkeys(("coupler_draft_max", "coupler_buff_max"), np.full((done, 1), np.nan))
        add(rec.TRUTH, self._stamps, {**truth, "unit_velocity": velocity[:, 1:-1]})
        add(rec.MEASUREMENT, self._stamps, {})
        reference = dict(zip(("position", "velocity", "acceleration"), a.reference[:, :done, None], strict=True))
        add(rec.REFERENCE, self._stamps, reference)
        add(rec.COMMAND, self._stamps, {"force": a.sent[1 : done + 1]})
        if self._supervision is not None:
            self._supervision.record(recording, brief=True)
        recording.extend_reports(self._reports)

    def block(self) -> TickBlock:
        """Return the messages as arrays, with those that are not of every tick between them."""
        place = {topic: number for number, (topic, _) in enumerate(self._rows)}
        found: dict[int, dict[str, Any]] = {}
        for report in (report for each in self._reports for report in each.all()):
            found.setdefault((report.stamp - int(self._stamps[0])) // self._tick, {})[report.node] = report
        if self._supervision is not None:
            for number, tick in enumerate(self._supervision.ticks.tolist()):
                found.setdefault(tick, {}).update(self._supervision.at(number))
        between = {
            tick: [
                (place[topic], key if "/" in key else rec.DIAGNOSTICS, messages[key])
                for key, topic in BETWEEN
                if key in messages
            ]
            for tick, messages in sorted(found.items())
        }
        return TickBlock(self._stamps, self._rows, between)

    def store(self, ato: msg.AtoReport | None) -> msg.AtoReport | None:
        """Set the receiving ends of all stages and the supervisor to their states after the span.

        Parameters
        ----------
        ato
            Report of the ATO at the step of the supervisor before the span.

        Returns
        -------
        AtoReport or None
            Report at the last step.
        """
        stages, supervision, done = self._stages, self._supervision, self._done
        scenario = stages.setup.scenario
        if not (stages.setup.layout.supervised or scenario.faults or scenario.interventions):
            return ato
        last = range(max(done - 2, 0), done)
        messages = {
            topic: [message_at(topic, int(self._stamps[index]), values, index) for index in last]
            for topic, values in self._exchanged.items()
        }
        stages.accept(done, messages)
        return ato if supervision is None else supervision.store(ato)

    def _next_disturbance(self, index: int) -> msg.Array:
        """Return the disturbance to publish at a tick [N], and keep the mean over this tick for the next one."""
        train, outside = self._train, self._train.outside
        published = train.outside_force
        if outside.acts:
            mean = self._arrays.means[index]
            if self._arrays.cubes.shape[2]:
                mean = np.add.reduce(self._arrays.outside[index, :2], axis=1) / train.substeps
            outside.mean = mean
            train.keep_outside(train.arrays.state[k.V] if index + 1 == self._done else self._arrays.truth[index + 1, 1])
        return published

    @cached_property
    def _reports(self) -> list[RepeatedReport]:
        """Diagnostics of the nodes in their order."""
        stages, arrays, supervision = self._stages, self._arrays, self._supervision
        due = self._stamps % SECOND_NS < self._tick
        reports = [] if supervision is None else supervision.reports
        in_tick = [
            RepeatedReport(report, [report.stamp], {"saturated_steps": [int(arrays.at_limit[tick + 1])]})
            for tick, report in arrays.law_reports.items()
            if tick < self._done
        ]
        if not due.any():
            return [*reports, *in_tick]
        stamps, first = self._stamps[due].tolist(), int(self._stamps[due][0])
        *states, lost = (values[: len(stamps)] for values in arrays.reports)
        totals = self._train.totals_at_each(*states)
        numbers = {key: totals[attribute] for key, attribute in TOTALS}
        if self._brief:
            numbers = {SATURATED: numbers[SATURATED]}
        if stages.plant.link.lost:
            numbers["commands_lost"] = lost.tolist()
        plant = stages.plant.diagnostic_at(first, {attribute: column[0] for attribute, column in totals.items()})
        observer = stages.observer.diagnostic(first)
        if not in_tick:
            controller = stages.controller.diagnostic(first)
            assert controller is not None
            at_limit = arrays.at_limit[1 : self._done + 1][due].tolist()
            in_tick = [RepeatedReport(controller, stamps, {"saturated_steps": at_limit})]
        return [
            RepeatedReport(plant, stamps, numbers),
            *reports,
            *self._reports_of_profile(stamps),
            RepeatedReport(observer, stamps),
            *in_tick,
        ]

    def _reports_of_profile(self, stamps: list[int]) -> list[RepeatedReport]:
        """Return the diagnostics of the profile; behind a train ahead, the reports of that train change their texts."""
        profile = self._stages.profile
        if profile.headway is not None:
            return [RepeatedReport(profile.diagnostic(stamp), [stamp]) for stamp in stamps]
        remaining = {} if self._brief else {"remaining": [profile.remaining(stamp) for stamp in stamps]}
        return [RepeatedReport(profile.diagnostic(stamps[0]), stamps, remaining)]
