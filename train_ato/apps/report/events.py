"""What happened during a run, worked out from its log and its scenario: marked on every figure over time."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from plant_sim.disturbances import Gust, Paper001, TravellingLoad, UnmodelledGrade
from train_ato import interventions
from train_ato.report.events import KINDS, Event
from train_ato.report.recording import Recording, Said
from train_ato.report.words import longer
from train_ato.types import Array

SAME_PIPE_S = 5.0
"""Changes of the brake-pipe demand in one direction that follow each other within this time are one event [s]."""
SMALLEST_PIPE = 1000.0
"""Changes of the brake-pipe demand below this are none [Pa]."""
MOST = 200
"""Events of one kind are joined until there are no more than these."""


def events_of(recording: Recording) -> list[Event]:
    """Return everything that happened in a run, by time."""
    found: list[Event] = []
    for source in (_law, _air_brake, _limit, _disturbances, _jumps, _sensors, _outside, _plans, _noticed, _gaps, _ends):
        found += source(recording)
    begin, end = recording.span
    order = list(KINDS)
    few = [
        event
        for kind in order
        for event in _joined(sorted((e for e in found if e.kind == kind), key=lambda e: e.begin), (end - begin) / MOST)
    ]
    return sorted(few, key=lambda event: (event.begin, order.index(event.kind)))


def _joined(events: list[Event], pause: float) -> list[Event]:
    """Return events of one kind, those joined that follow each other at once where there are too many to tell."""
    if len(events) <= MOST:
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
    """Return the changes of the command's delay made while the run went on: time [s], factor, addition [s]."""
    return [
        (time, entry.factor, entry.add)
        for time, entry in _interventions(recording)
        if isinstance(entry, interventions.DelayJumpNow)
    ]


def _law(recording: Recording) -> Iterator[Event]:
    """Return changes of the law, and of its parameters where the controller told which."""
    said = recording.said.get("controller")
    if said is None:
        return
    planned = [swap.at for swap in recording.setup.swaps] if recording.setup is not None else []
    names, swaps, told = said.texts("controller"), said.numbers("swaps"), said.texts("changed")
    for row in range(said.time.size):
        before, now, time = names[max(0, row - 1)], names[row], float(said.time[row])
        earlier = float(said.time[max(0, row - 1)])
        if told[row]:
            time = earlier = float(said.time[row])
        if now != before and now is not None and before is not None:
            at = next((swap for swap in planned if earlier < swap <= time), time)
            more = _changed(str(told[row]), without="controller") if told[row] else ""
            yield Event("law", at, f"law {before} → {now}{f', {more}' if more else ''}")
        elif told[row]:
            yield Event("law", time, _changed(str(told[row])))
        elif row and swaps is not None and swaps[row] > swaps[row - 1] and not any(told):
            yield Event("law", time, f"parameters of law {now} changed")


def _changed(text: str, without: str = "") -> str:
    """Return changes of parameters, as the controller tells them, in words; one of them may be left out."""
    try:
        values = json.loads(text)
    except ValueError:
        values = None
    if not isinstance(values, dict):
        return "parameters changed"
    named = [f"{name} = {value}" for name, value in values.items() if name != without]
    return f"set {', '.join(named)}" if named else ""


def _air_brake(recording: Recording) -> Iterator[Event]:
    found = recording.of("ato/brake_pipe", "pressure")
    if found is None:
        return
    time, pressure = found[0], found[1][:, 0]
    changes = np.flatnonzero(np.abs(np.diff(pressure)) >= SMALLEST_PIPE)
    row = 0
    while row < changes.size:
        last, sign = row, np.sign(pressure[changes[row] + 1] - pressure[changes[row]])
        while last + 1 < changes.size and _goes_on(time, pressure, changes, last, sign):
            last += 1
        before, after = pressure[changes[row]] / 1e3, pressure[changes[last] + 1] / 1e3
        what = "applied" if after < before else "released"
        end = float(time[changes[last] + 1]) if last > row else None
        text = f"air brake {what}: {before:.0f} → {after:.0f} kPa"
        yield Event("air_brake", float(time[changes[row] + 1]), text, end)
        row = last + 1


def _goes_on(time: Array, pressure: Array, changes: NDArray[np.intp], last: int, sign: float) -> bool:
    """Tell whether the next change belongs to the one before."""
    after = changes[last + 1]
    near = time[after] - time[changes[last]] < SAME_PIPE_S
    return bool(near and np.sign(pressure[after + 1] - pressure[after]) == sign)


def _limit(recording: Recording) -> Iterator[Event]:
    said = recording.said.get("plant")
    total = said.numbers("saturated") if said is not None else None
    if said is None or total is None:
        return
    for begin, end in _stretches(said, np.diff(total) > 0, recording.span):
        amount = np.interp(end, said.time, total) - np.interp(begin, said.time, total)
        yield Event("limit", begin, f"force cut at its limit for {amount:.1f} s", end)


def _stretches(said: Said, active: NDArray[np.bool_], span: tuple[float, float]) -> Iterator[tuple[float, float]]:
    """Return the stretches between messages in which something holds, joined where the pause is short."""
    rows = np.flatnonzero(active)
    if not rows.size:
        return
    pause = max(2.0, (span[1] - span[0]) / MOST)
    begins, ends = said.time[rows], said.time[rows + 1]
    breaks = np.flatnonzero(begins[1:] - ends[:-1] > pause)
    for first, last in zip(np.append(0, breaks + 1), np.append(breaks, rows.size - 1), strict=True):
        yield float(begins[first]), float(ends[last])


def _disturbances(recording: Recording) -> Iterator[Event]:
    if recording.setup is None:
        return
    begin, end = recording.span
    for source in recording.setup.plant.disturbances:
        if isinstance(source, Gust):
            text = f"gust of {source.acceleration:+g} m/s²" if source.acceleration else f"gust of {source.force:+g} N"
            yield from _within(Event("disturbance", source.begin, text, source.end), begin, end)
        elif isinstance(source, UnmodelledGrade):
            for piece in source.pieces:
                text = f"{1e3 * piece.grade:+g} ‰ that no model knows of"
                yield from _over_places(recording, "disturbance", piece.begin, piece.end, text)
        elif isinstance(source, TravellingLoad):
            first = Event("disturbance", source.begin, "travelling load", source.begin + source.duration)
            yield from _within(first, begin, end)
        elif isinstance(source, Paper001):
            for at, until, size in ((60.0, 80.0, -0.10), (300.0, 312.0, 0.12)):
                text = f"disturbance of {source.scale * size:+.2f} m/s²"
                yield from _within(Event("disturbance", at, text, until), begin, end)
        else:
            yield Event("disturbance", begin, f"disturbance '{source.kind}' acts from the start on")


def _within(event: Event, begin: float, end: float) -> Iterator[Event]:
    """Yield an event if any of it lies in the run."""
    if event.begin <= end and (event.end is None or event.end >= begin):
        yield Event(event.kind, event.begin, event.text, None if event.end is None else min(event.end, end))


def _over_places(recording: Recording, kind: str, begin: float, end: float, text: str) -> Iterator[Event]:
    """Yield an event for the time that the train is over a stretch of line."""
    motion = recording.motion
    if motion is None or "position" not in motion:
        return
    head, rear = motion["position"][:, 0], motion["position"][:, -1]
    over = np.flatnonzero((head >= begin) & (rear <= end))
    if over.size:
        yield Event(kind, float(motion.time[over[0]]), text, float(motion.time[over[-1]]))


def _jumps(recording: Recording) -> Iterator[Event]:
    if recording.setup is None:
        return
    begin, end = recording.span
    link = recording.setup.links.command.jump
    if link is not None:
        yield from _within(Event("fault", link.at, longer(link.factor, link.add)), begin, end)
    for jump in recording.setup.plant.jumps:
        text = f"{jump.what} times {jump.factor:g}"
        if jump.at is not None:
            yield from _within(Event("fault", jump.at, text), begin, end)
        elif jump.place is not None:
            for event in _over_places(recording, "fault", jump.place, np.inf, text):
                yield Event("fault", event.begin, event.text)


def _sensors(recording: Recording) -> Iterator[Event]:
    if recording.setup is None:
        return
    sensors = recording.setup.plant.sensors
    for freeze in sensors.freeze:
        what = "position and speed" if freeze.quantity == "both" else freeze.quantity
        text = f"unit {freeze.unit}: measured {what} frozen"
        yield from _within(Event("fault", freeze.begin, text, freeze.end), *recording.span)
    for slip in sensors.wheel_slip:
        text = f"wheels of unit {slip.unit} {'slip' if slip.slip > 0 else 'slide'} by {100 * abs(slip.slip):g} %"
        yield from _within(Event("fault", slip.begin, text, slip.end), *recording.span)


def _interventions(recording: Recording) -> Iterator[tuple[float, interventions.Intervention]]:
    """Return what the plant says was done to it, and when."""
    said = recording.said.get("plant")
    for time, text in zip(said.time, said.texts(interventions.KEY), strict=True) if said is not None else ():
        if text:
            with suppress(ValueError):  # of another version: it cannot be told
                yield from ((float(time), entry) for entry in interventions.from_text(text))


def _outside(recording: Recording) -> Iterator[Event]:
    for time, entry in _interventions(recording):
        if isinstance(entry, interventions.GustNow):
            text = f"gust of {entry.acceleration:+g} m/s² for {entry.duration:g} s"
            yield Event("outside", time, text, time + entry.duration)
        else:
            jump = entry if isinstance(entry, interventions.DelayJumpNow) else None
            yield Event("outside", time, longer(jump.factor, jump.add) if jump else entry.described())


def _plans(recording: Recording) -> Iterator[Event]:
    said = recording.said.get("profile")
    for plan in recording.profiles[1:]:
        reason = None
        if said is not None:
            row = int(np.searchsorted(said.time, plan.at))
            reason = next((text for text in said.texts("reason")[row : row + 3] if text), None)
        yield Event("plan", plan.at, f"profile planned anew{f': {reason}' if reason else ''}")


def _noticed(recording: Recording) -> Iterator[Event]:
    """Return what nodes warned of, when they began to, and measurements that were not used."""
    for node, said in recording.said.items():
        told = said.texts(interventions.KEY)
        for row in range(said.time.size):
            new = row == 0 or said.message[row] != said.message[row - 1] or said.level[row - 1] == 0
            if said.level[row] > 0 and new and not told[row]:
                yield Event("fault", float(said.time[row]), f"{node}: {said.message[row]}")
    controller = recording.said.get("controller")
    unsound = controller.numbers("unsound_measurements") if controller is not None else None
    if controller is None or unsound is None:
        return
    for begin, end in _stretches(controller, np.diff(unsound) > 0, recording.span):
        yield Event("fault", begin, "measurements that were not sound: the last command was held", end)


def _gaps(recording: Recording) -> Iterator[Event]:
    """Return where messages are missing in the log."""
    motion = recording.motion
    if motion is None or motion.time.size < 3:
        return
    steps = np.diff(motion.time)
    for row in np.flatnonzero(steps > 1.5 * np.median(steps))[:MOST]:
        begin, end = float(motion.time[row]), float(motion.time[row + 1])
        yield Event("fault", begin, f"no messages for {end - begin:.2f} s", end)


def _ends(recording: Recording) -> Iterator[Event]:
    status = recording.summary.get("status", "done")
    if status not in ("done", "imported"):
        text = str(recording.summary.get("failure") or f"the run was {status}")
        yield Event("end", recording.span[1], text)
    score = recording.setup.score if recording.setup is not None else None
    if score is None:
        return
    if score.until_time is not None:
        yield from _within(Event("scored", score.until_time, KINDS["scored"].words), *recording.span)
    found = recording.of("ato/reference", "position")
    if score.until is not None and found is not None:
        beyond = np.flatnonzero(found[1][:, 0] > score.until)
        if beyond.size:
            yield Event("scored", float(found[0][beyond[0]]), KINDS["scored"].words)
