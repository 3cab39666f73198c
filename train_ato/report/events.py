"""Detection of the events of a run, from its recording and its scenario."""

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plant_sim.data_text import parse_json
from plant_sim.disturbances import Gust, Paper001, TravellingLoad, UnmodelledGrade
from plant_sim.plant_setup import TrainSeparation
from train_ato.control.assurance import BRAKING_LAW
from train_ato.judge.protection_record import REACTIONS, StateSpan, state_spans
from train_ato.judge.recording import BRAKE_PIPE_COMMAND, LOST_KEY, REFERENCE, Recording
from train_ato.judge.tracking import time_at_force_limit
from train_ato.loop.plant import RESTARTS_KEY
from train_ato.loop.profile import REJOINED
from train_ato.messages.faults import SlowFault, message_faults, node_faults
from train_ato.messages.types import Array, AtoState, Diagnostic, Protection
from train_ato.report.quantities import KINDS
from train_ato.report.words import longer
from train_ato.scenario import changes, interventions
from train_ato.supervision.supervisor import SupervisionState


@dataclass(frozen=True)
class Event:
    """Event of a run.

    Attributes
    ----------
    kind
        Key of :data:`train_ato.report.quantities.KINDS`.
    begin, end
        Times [s]; ``end`` is None for an event without duration.
    text
        Description.
    """

    kind: str
    begin: float
    text: str
    end: float | None = None


def scenario_events(recording: Recording) -> Iterator[Event]:
    """Yield the events that the scenario of a recording defines."""
    for source in (_disturbances, _jumps, _sensors, _faults, _scored):
        yield from source(recording)


def _disturbances(recording: Recording) -> Iterator[Event]:
    assert recording.setup is not None
    begin, end = recording.span
    for source in recording.setup.scenario.plant.disturbances:
        late = getattr(source, "shift", None) or 0.0
        if isinstance(source, Gust):
            text = f"gust of {source.acceleration:+g} m/s²" if source.acceleration else f"gust of {source.force:+g} N"
            yield from _within(Event("disturbance", source.begin + late, text, source.end + late), begin, end)
        elif isinstance(source, UnmodelledGrade):
            for piece in source.pieces:
                text = f"{1e3 * piece.grade:+g} ‰ grade, not in the nominal model"
                yield from _over_places(recording, "disturbance", piece.begin, piece.end, text)
        elif isinstance(source, TravellingLoad):
            behind = source.interval * (len(source.listed(len(recording.setup.consist.vehicles))) - 1)
            last = np.inf if source.period else source.begin + behind + source.duration + late
            yield from _within(Event("disturbance", source.begin + late, "travelling load", last), begin, end)
        elif isinstance(source, Paper001):
            for at, until, size in ((60.0, 80.0, -0.10), (300.0, 312.0, 0.12)):
                text = f"disturbance of {source.scale * size:+.2f} m/s²"
                yield from _within(Event("disturbance", at + late, text, until + late), begin, end)
        else:
            yield Event("disturbance", begin, f"disturbance '{source.kind}' from the start")


def _within(event: Event, begin: float, end: float) -> Iterator[Event]:
    """Yield an event if it overlaps the run."""
    if event.begin <= end and (event.end is None or event.end >= begin):
        yield Event(event.kind, event.begin, event.text, None if event.end is None else min(event.end, end))


def _over_places(recording: Recording, kind: str, begin: float, end: float, text: str) -> Iterator[Event]:
    """Yield an event for the time of the train on a part of the line."""
    motion = recording.motion
    if motion is None or "position" not in motion:
        return
    head, rear = motion["position"][:, 0], motion["rear_position"][:, 0]
    over = np.flatnonzero((head >= begin) & (rear <= end))
    if over.size:
        yield Event(kind, float(motion.time[over[0]]), text, float(motion.time[over[-1]]))


def _jumps(recording: Recording) -> Iterator[Event]:
    assert recording.setup is not None
    begin, end = recording.span
    link = recording.setup.scenario.links.command.jump
    if link is not None:
        yield from _within(Event("fault", link.at, longer(link.factor, link.add)), begin, end)
    for jump in recording.setup.scenario.plant.jumps:
        if isinstance(jump, TrainSeparation):
            text = f"coupler behind vehicle {', '.join(map(str, jump.vehicles))} parts"
        else:
            text = f"{jump.what} times {jump.factor:g}"
        if jump.at is not None:
            yield from _within(Event("fault", jump.at, text), begin, end)
        elif jump.place is not None:
            for event in _over_places(recording, "fault", jump.place, np.inf, text):
                yield Event("fault", event.begin, event.text)


def _sensors(recording: Recording) -> Iterator[Event]:
    assert recording.setup is not None
    sensors = recording.setup.scenario.plant.sensors
    for freeze in sensors.freeze:
        what = "position and speed" if freeze.quantity == "both" else freeze.quantity
        text = f"unit {freeze.unit}: measured {what} frozen"
        yield from _within(Event("fault", freeze.begin, text, freeze.end), *recording.span)
    for slip in sensors.wheel_slip:
        text = f"wheels of unit {slip.unit} {'slip' if slip.slip > 0 else 'slide'} by {100 * abs(slip.slip):g} %"
        yield from _within(Event("fault", slip.begin, text, slip.end), *recording.span)


def _faults(recording: Recording) -> Iterator[Event]:
    assert recording.setup is not None
    faults = recording.setup.scenario.faults
    nodes = node_faults(faults)
    for fault in nodes:
        delay = f" by {fault.delay:g} s" if isinstance(fault, SlowFault) else ""
        yield from _within(Event("fault", fault.at, f"node {fault.node}: {fault.do}{delay}"), *recording.span)
    for message in message_faults(fault for fault in faults if fault not in nodes):
        reader = f", to {message.reader}" if message.reader else ""
        yield from _within(
            Event("fault", message.begin, f"{message.described()}{reader}", message.end), *recording.span
        )


def _scored(recording: Recording) -> Iterator[Event]:
    assert recording.setup is not None
    evaluation = recording.setup.scenario.evaluation
    if evaluation.until_time is not None:
        yield from _within(Event("scored", evaluation.until_time, KINDS["scored"].words), *recording.span)
    found = recording.of(REFERENCE, "position")
    if evaluation.until is not None and found is not None:
        beyond = np.flatnonzero(found[1][:, 0] > evaluation.until)
        if beyond.size:
            yield Event("scored", float(found[0][beyond[0]]), KINDS["scored"].words)


EXCEEDED = frozenset(state.text for state in SupervisionState if state >= SupervisionState.OVERSPEED)
"""States of the supervision above the permitted speed; an indication precedes every stop."""


def protection_events(recording: Recording) -> Iterator[Event]:
    """Yield the states of a run with a supervisor: exceeded limits, reactions of the train, changes of the ATO."""
    if "supervisor" not in recording.diagnostics:
        return
    for span in state_spans(recording.changed_reports, "supervisor"):
        if span.state in EXCEEDED:
            lasting = f" for {span.end - span.begin:.1f} s" if span.end > span.begin else ""
            yield Event("supervision", span.begin, _text(f"{span.state}{lasting}", span.reason))
    for span in state_spans(recording.changed_reports, "plant"):
        if REACTIONS.get(span.state, Protection.NONE) is not Protection.NONE:
            yield Event("protection", span.begin, _text(f"train: {span.state}", span.reason), _end(span))
    before = AtoState.ENGAGED.text
    for span in state_spans(recording.changed_reports, "ato"):
        if span.state != before:
            yield Event("ato", span.begin, _text(f"ATO {before} → {span.state}", span.reason))
        before = span.state
    for span in state_spans(recording.changed_reports, "controller"):
        if span.state == BRAKING_LAW:
            yield Event("ato", span.begin, "the braking law drives in place of the law", _end(span))


def engagements(reports: Iterable[Diagnostic]) -> list[float]:
    """Return the times at which the ATO was engaged during the run [s]."""
    spans = state_spans(reports, "ato")
    return [span.begin for span in spans[1:] if span.state == AtoState.ENGAGED.text]


def _text(state: str, reason: str) -> str:
    return f"{state}: {reason}" if reason else state


def _end(span: StateSpan) -> float | None:
    """Return the end of a state; None for a single report."""
    return span.end if span.end > span.begin else None


def is_protection_report(report: Diagnostic) -> bool:
    """Return True for a report of a state that :func:`protection_events` contains, so that it is no fault."""
    if report.node == "controller":
        return report.level > 0 and report.message in (report.values.get("ato_state"), BRAKING_LAW)
    return report.node == "supervisor" or (report.node == "plant" and "protection" in report.values)


SAME_PIPE_S = 5.0
"""Maximum time between changes of the brake-pipe demand in one direction that form one event [s]."""
MIN_PIPE = 1000.0
"""Smallest change of the brake-pipe demand that is an event [Pa]."""
NOTHING = np.empty(0), np.empty(0)
MAX_EVENTS = 200
"""More events of one kind than this are merged."""
REASON_NS = 3_000_000_000
"""Time after a new profile in which the profile node reports its reason [ns]."""


def detect_events(recording: Recording) -> list[Event]:
    """Return the events of a run in order of time."""
    sources = [_law, _air_brake, _limit, _outside, _plans, _noticed, _gaps, _ends]
    sources += [refusal_events, protection_events, restart_events]
    if recording.setup is not None:
        sources.append(scenario_events)
    found = [event for source in sources for event in source(recording)]
    begin, end = recording.span
    order = list(KINDS)
    few = [
        event
        for kind in order
        for event in _joined(
            sorted((e for e in found if e.kind == kind), key=lambda e: e.begin), (end - begin) / MAX_EVENTS
        )
    ]
    return sorted(few, key=lambda event: (event.begin, order.index(event.kind)))


def _joined(events: list[Event], pause: float) -> list[Event]:
    """Return events of one kind; if there are too many, close ones are merged."""
    if len(events) <= MAX_EVENTS:
        return events
    groups = [[events[0]]]
    until = _until(events[0])
    for event in events[1:]:
        if event.begin - until <= pause:
            groups[-1].append(event)
        else:
            groups.append([event])
        until = max(until, _until(event))
    return [
        group[0]
        if len(group) == 1
        else Event(group[0].kind, group[0].begin, f"{len(group)} times: {group[0].text} …", max(map(_until, group)))
        for group in groups
    ]


def _until(event: Event) -> float:
    return event.begin if event.end is None else event.end


def delay_jumps(recording: Recording) -> list[tuple[float, float, float]]:
    """Return the interventions in the command delay: time [s], factor, addition [s]."""
    return [
        (time, entry.factor, entry.add)
        for time, entry in _interventions(recording)
        if isinstance(entry, interventions.DelayJumpNow)
    ]


def _law(recording: Recording) -> Iterator[Event]:
    """Yield changes of the law and of its parameters, from the diagnostics."""
    series = recording.diagnostics.get("controller")
    if series is None:
        return
    planned = [swap.at for swap in recording.setup.scenario.law_changes] if recording.setup is not None else []
    names, swaps, changed = series.texts("controller"), series.numbers("swaps"), series.texts(changes.KEY)
    for row, time in enumerate(series.time.tolist()):
        before, now = names[max(0, row - 1)], names[row]
        earlier = time if changed[row] else float(series.time[max(0, row - 1)])
        if now != before and now is not None and before is not None:
            at = next((swap for swap in planned if earlier < swap <= time), time)
            more = _changed(str(changed[row]), without="controller") if changed[row] else ""
            yield Event("law", at, f"law {before} → {now}{f', {more}' if more else ''}")
        elif changed[row]:
            yield Event("law", time, _changed(str(changed[row])))
        elif row and swaps is not None and swaps[row] > swaps[row - 1] and not any(changed):
            yield Event("law", time, f"parameters of law {now} changed")


def _changed(text: str, without: str = "") -> str:
    """Return the text of parameter changes; the parameter ``without`` is omitted."""
    try:
        named = [f"{name} = {value}" for name, value in changes.changes_from_json(text).items() if name != without]
    except ValueError:
        return "parameters changed"
    return f"set {', '.join(named)}" if named else ""


def _air_brake(recording: Recording) -> Iterator[Event]:
    found = recording.of(BRAKE_PIPE_COMMAND, "pressure")
    if found is None:
        return
    time, pressure = found[0], found[1][:, 0]
    steps = np.flatnonzero(np.abs(np.diff(pressure)) >= MIN_PIPE)
    row = 0
    while row < steps.size:
        last, sign = row, np.sign(pressure[steps[row] + 1] - pressure[steps[row]])
        while last + 1 < steps.size and _goes_on(time, pressure, steps, last, sign):
            last += 1
        before, after = pressure[steps[row]] / 1e3, pressure[steps[last] + 1] / 1e3
        what = "applied" if after < before else "released"
        end = float(time[steps[last] + 1]) if last > row else None
        text = f"air brake {what}: {before:.0f} → {after:.0f} kPa"
        yield Event("air_brake", float(time[steps[row] + 1]), text, end)
        row = last + 1


def _goes_on(time: Array, pressure: Array, changes: NDArray[np.intp], last: int, sign: float) -> bool:
    """Return True if the next change belongs to the same event."""
    after = changes[last + 1]
    near = time[after] - time[changes[last]] < SAME_PIPE_S
    return bool(near and np.sign(pressure[after + 1] - pressure[after]) == sign)


def _limit(recording: Recording) -> Iterator[Event]:
    time, total = time_at_force_limit(recording.setup, recording) or NOTHING
    for begin, end in _rising(recording, time, total):
        amount = np.interp(end, time, total) - np.interp(begin, time, total)
        yield Event("limit", begin, f"force at its limit for {amount:.1f} s", end)


def _rising(recording: Recording, time: Array, values: Array) -> Iterator[tuple[float, float]]:
    """Yield begin and end [s] of increases of a counter; short pauses are ignored."""
    rows = np.flatnonzero(np.diff(values) > 0)
    if not rows.size:
        return
    pause = max(2.0, (recording.span[1] - recording.span[0]) / MAX_EVENTS)
    begins, ends = time[rows], time[rows + 1]
    breaks = np.flatnonzero(begins[1:] - ends[:-1] > pause)
    for first, last in zip(np.append(0, breaks + 1), np.append(breaks, rows.size - 1), strict=True):
        yield float(begins[first]), float(ends[last])


def _interventions(recording: Recording) -> Iterator[tuple[float, interventions.Intervention]]:
    """Yield the interventions and their times [s]."""
    for report in recording.changed_reports:
        if report.node == "plant" and interventions.KEY in report.values:
            with suppress(ValueError):  # written by another version
                entries = interventions.interventions_from_json(report.values[interventions.KEY])
                yield from ((report.stamp * 1e-9, entry) for entry in entries)


def _outside(recording: Recording) -> Iterator[Event]:
    for time, entry in _interventions(recording):
        if isinstance(entry, interventions.GustNow):
            text = f"gust of {entry.acceleration:+g} m/s² for {entry.duration:g} s"
            yield Event("outside", time, text, time + entry.duration)
        else:
            jump = entry if isinstance(entry, interventions.DelayJumpNow) else None
            yield Event("outside", time, longer(jump.factor, jump.add) if jump else entry.described())


def _plans(recording: Recording) -> Iterator[Event]:
    reports = [report for report in recording.changed_reports if report.node == "profile"]
    engaged = engagements(recording.changed_reports)
    for plan in recording.profiles[1:]:
        at = plan.stamp * 1e-9
        if engaged and engaged[0] <= at:
            engaged = [time for time in engaged if time > at]
            yield Event("plan", at, "profile planned after the engagement")
            continue
        later = [report.values.get("reason") for report in reports if 0 <= report.stamp - plan.stamp < REASON_NS]
        reason = next((text for text in later if text), None)
        what = "sent again" if reason == REJOINED else "re-planned"
        yield Event("plan", at, f"profile {what}{f': {reason}' if reason else ''}")


def _noticed(recording: Recording) -> Iterator[Event]:
    """Yield the first of equal warnings of every node, and intervals of invalid measurements."""
    last: dict[str, tuple[int, str]] = {}
    for report in recording.changed_reports:
        if is_protection_report(report):
            continue
        state = (report.level, report.message)
        new = last.get(report.node, (0, ""))[0] == 0 or state[1] != last[report.node][1]
        if report.level > 0 and new and interventions.KEY not in report.values:
            yield Event("fault", report.stamp * 1e-9, f"{report.node}: {report.message}")
        last[report.node] = state
    for begin, end in _rising(recording, *(recording.reported("controller", "unsound_measurements") or NOTHING)):
        yield Event("fault", begin, "invalid measurements; the last command was held", end)


def _gaps(recording: Recording) -> Iterator[Event]:
    """Yield gaps in the messages of the log."""
    motion = recording.motion
    if motion is None or motion.time.size < 3:
        return
    steps = np.diff(motion.time)
    for row in np.flatnonzero(steps > 1.5 * np.median(steps))[:MAX_EVENTS]:
        begin, end = float(motion.time[row]), float(motion.time[row + 1])
        yield Event("fault", begin, f"no messages for {end - begin:.2f} s", end)


def _ends(recording: Recording) -> Iterator[Event]:
    status = recording.summary.get("status", "done")
    if status not in ("done", "imported"):
        text = str(recording.summary.get("failure") or f"the run was {status}")
        yield Event("end", recording.span[1], text)


REASON, MISSING = "refusal ", "missing "
"""Beginnings of the keys of the diagnostics of a receiving end."""


def refusal_events(recording: Recording) -> Iterator[Event]:
    """Yield the first refusal of each kind by each node, and its first missing message of each topic."""
    seen: set[tuple[str, str, str]] = set()
    for report in recording.changed_reports:
        for key, text in report.values.items():
            if not key.startswith((REASON, MISSING)):
                continue
            found = (report.node, key, text.split(" ")[0])
            if found not in seen:
                seen.add(found)
                topic = key.partition(" ")[2]
                what = f"refused a message: {text}" if key.startswith(REASON) else text
                yield Event("fault", report.stamp * 1e-9, f"{report.node}: {topic}: {what}")


def restart_events(recording: Recording) -> Iterator[Event]:
    """Yield the outages of restarted nodes, from the loss to the first report with all answers."""
    begin, reason = 0.0, ""
    before: dict[str, int] = {}
    for report in recording.changed_reports:
        if report.node != "plant":
            continue
        time = report.stamp * 1e-9
        lost = report.values.get(LOST_KEY, "")
        begin = begin if reason else time
        counts = _counts(report.values.get(RESTARTS_KEY, ""))
        names = [name for name, count in counts.items() if count > before.get(name, 0)]
        if names and not lost:
            listed = " and ".join(f"node {name}" for name in names)
            yield Event("fault", begin, f"{listed} restarted ({reason or 'reason unknown'})", time)
            before = counts
        reason = lost


def _counts(text: str) -> dict[str, int]:
    """Return the numbers of restarts by node; {} for a text of another version."""
    try:
        found = parse_json(text) if text else {}
    except ValueError:
        return {}
    return {str(name): int(count) for name, count in found.items()} if isinstance(found, dict) else {}
