"""Events that the scenario of a run defines: disturbances, jumps, faults, end of the evaluation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from plant_sim.disturbances import Gust, Paper001, TravellingLoad, UnmodelledGrade
from plant_sim.plant_setup import TrainSeparation
from train_ato.apps.report.event import Event
from train_ato.apps.report.quantities import KINDS
from train_ato.apps.report.words import longer
from train_ato.loop.recording import REFERENCE, Recording
from train_ato.messages.faults import SlowFault, message_faults, node_faults

__all__ = ["scenario_events"]


def scenario_events(recording: Recording) -> Iterator[Event]:
    """Yield the events that the scenario of a recording defines."""
    for source in (_disturbances, _jumps, _sensors, _faults, _scored):
        yield from source(recording)


def _disturbances(recording: Recording) -> Iterator[Event]:
    assert recording.setup is not None
    begin, end = recording.span
    for source in recording.setup.plant.disturbances:
        if isinstance(source, Gust):
            text = f"gust of {source.acceleration:+g} m/s²" if source.acceleration else f"gust of {source.force:+g} N"
            yield from _within(Event("disturbance", source.begin, text, source.end), begin, end)
        elif isinstance(source, UnmodelledGrade):
            for piece in source.pieces:
                text = f"{1e3 * piece.grade:+g} ‰ grade, not in the nominal model"
                yield from _over_places(recording, "disturbance", piece.begin, piece.end, text)
        elif isinstance(source, TravellingLoad):
            first = Event("disturbance", source.begin, "travelling load", source.begin + source.duration)
            yield from _within(first, begin, end)
        elif isinstance(source, Paper001):
            for at, until, size in ((60.0, 80.0, -0.10), (300.0, 312.0, 0.12)):
                text = f"disturbance of {source.scale * size:+.2f} m/s²"
                yield from _within(Event("disturbance", at, text, until), begin, end)
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
    link = recording.setup.links.command.jump
    if link is not None:
        yield from _within(Event("fault", link.at, longer(link.factor, link.add)), begin, end)
    for jump in recording.setup.plant.jumps:
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
    sensors = recording.setup.plant.sensors
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
