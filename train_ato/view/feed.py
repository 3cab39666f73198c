"""Common data source of the pages for a live graph and a recorded run."""

import json
import math
import secrets
import threading
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from train_ato.control.assurance import BRAKING_LAW
from train_ato.judge.protection_record import INTERVENTIONS, REACTIONS
from train_ato.judge.verdict import verdict_line
from train_ato.log.versions import SUMMARY
from train_ato.loop.train_protection import REQUESTED, SUPERVISOR
from train_ato.messages.types import Array, AtoState, Diagnostic, Protection
from train_ato.report.events import EXCEEDED
from train_ato.view.facts import Facts, ProfileCurve
from train_ato.view.snapshot import STRIP, ProtectionStates, Snapshot, along, delay_text, now, strip_row, where

MAX_POINTS = 800
"""Largest number of points of the speed; a page is rarely wider in pixels."""


class WholeRun:
    """Speed, limit, law and state of the ATO from the start of a run; at most :data:`MAX_POINTS` times.

    Parameters
    ----------
    span
        First and last time of the run [s].

    Attributes
    ----------
    number : int
        Number of changes so far.
    """

    def __init__(self, span: tuple[float, float]) -> None:
        self._span = span
        self._step = max(span[1] - span[0], 0.0) / MAX_POINTS
        self._points: list[tuple[float, float, float]] = []
        self._bands: dict[str, list[tuple[float, str]]] = {"law": [], "ato": []}
        self.number = 0

    def add(self, time: float, speed: float, limit: float, *, law: str, ato: str) -> None:
        """Add a moment [s, km/h, km/h]; one too near to the last moment for a point of its own adds only bands."""
        for name, text in (("law", law), ("ato", ato)):
            band = self._bands[name]
            if text and (not band or band[-1][1] != text):
                band.append((time, text))
                self.number += 1
        if self._points and time < self._points[-1][0] + self._step:
            return
        self._points.append((time, speed, limit))
        self.number += 1
        if len(self._points) > MAX_POINTS:  # a run of unknown duration
            del self._points[1::2]
            self._step = (self._points[-1][0] - self._points[0][0]) / (len(self._points) - 1)

    def columns(self) -> dict[str, list[Any]]:
        """Return the lists of the picture."""
        end = max([self._span[1], *(time for time, _, _ in self._points[-1:])])
        return {
            "span": [self._span[0], end],
            "points": [
                [round(time, 2), round(speed, 2), None if math.isnan(limit) else round(limit, 2)]
                for time, speed, limit in self._points
            ],
            **{name: [list(part) for part in band] for name, band in self._bands.items()},
        }


REPORT_PAGE = "/report"
FINISHED, RUN_ENDED = "finished", "run ended"
"""States of a run after its regular end, and after any other one."""


@dataclass(frozen=True)
class Ending:
    """End of a run.

    Attributes
    ----------
    state
        :data:`FINISHED` or :data:`RUN_ENDED`; "" for a recorded run.
    verdict
        One line; "" before the metrics are written.
    report
        Address of the report on the server; "" without a log.
    """

    state: str
    verdict: str = ""
    report: str = ""


def ending_of(state: str, folder: Path | None) -> Ending:
    """Return the end of a run in a folder; without ``summary.json`` it has no verdict and no report."""
    summary = _read_summary(folder)
    return Ending(state, verdict_line(summary), REPORT_PAGE) if summary else Ending(state)


def _read_summary(folder: Path | None) -> dict[str, Any]:
    """Return the summary of a run folder; {} before it is written."""
    if folder is None:
        return {}
    try:
        return dict(json.loads((folder / SUMMARY).read_text(encoding="utf-8")))
    except (OSError, ValueError):
        return {}


MAX_ROWS = 6000
"""Number of kept rows: five minutes of wall time at 20 frames a second."""


class Strip:
    """Rows of :data:`train_ato.view.snapshot.STRIP` with constant row numbers, newest last.

    Attributes
    ----------
    added : int
        Number of rows added so far.
    """

    def __init__(self, rows: int = MAX_ROWS) -> None:
        self.rows, self.added = rows, 0
        self._kept: deque[Sequence[float]] = deque(maxlen=rows)

    def add(self, row: Sequence[float]) -> None:
        """Add the newest row."""
        self._kept.append(row)
        self.added += 1

    def since(self, number: int) -> dict[str, Array]:
        """Return the columns of the kept rows from a row number on."""
        first = max(0, len(self._kept) - max(0, self.added - number))
        rows = np.array([*islice(self._kept, first, None)]).reshape(-1, len(STRIP))
        return {name: rows[:, column].astype(np.float32 if column else np.float64) for column, name in enumerate(STRIP)}


FRAMES_PER_SECOND = 20
MIN_REACH, MIN_SHOE = 100.0, 10.0
"""Least ends of the force axes along the train [kN]: couplers, shoes."""
ROOM = 1.25
KEPT_S = 60.0
"""Simulated time for which a force axis keeps a peak [s]."""
TIGHT = 0.6
"""Part of a force axis below which the peaks of that time let it shrink."""


@dataclass(frozen=True)
class Frame:
    """Data of one snapshot for the page; built once for all browsers.

    Attributes
    ----------
    number
        Number of the frame, increasing.
    now, where, along
        Columns of the driver's display and of place and time (one row each), and of the forces along the train.
    """

    number: int
    moment: Snapshot
    now: dict[str, list[Any]]
    where: dict[str, list[float]]
    along: dict[str, Array]


@dataclass(frozen=True)
class Mark:
    """Event of a run: time [s], label of the strip charts, description; the driver acknowledges an intervention."""

    time: float
    label: str
    text: str
    acknowledge: bool = False


class ForceAxis:
    """End of a force axis: above every force at once, lower again after the peaks are old.

    Parameters
    ----------
    least
        Smallest end [kN].
    """

    def __init__(self, least: float) -> None:
        self.end = self._least = least
        self._peaks: deque[tuple[float, float]] = deque()

    def fitted(self, time: float, force: float) -> float:
        """Return the end of the axis [kN] for the force [kN] at a simulated time [s]."""
        peaks = self._peaks
        if peaks and time < peaks[-1][0]:
            peaks.clear()
        while peaks and peaks[-1][1] <= force:
            peaks.pop()
        peaks.append((time, force))
        while peaks[0][0] < time - KEPT_S:
            peaks.popleft()
        largest = peaks[0][1]
        if largest > self.end or (largest < TIGHT * self.end and self.end > self._least):
            self.end = max(self._least, ROOM * largest)
        return self.end


class Feed:
    """Data of one run for any number of pages.

    Parameters
    ----------
    facts
        Constant data of the run.

    Attributes
    ----------
    live : bool
        The train runs now and accepts requests.
    facts : Facts
    profile : ProfileCurve or None
        Profile in force; ``profile_number`` increases with every new one.
    frame : Frame or None
        Newest frame.
    strip : Strip
        Rows of the strip charts; :attr:`lock` protects them and the overview.
    overview : WholeRun
        Overview of the run so far, or of a whole recorded run.
    marks : list of Mark
        Events so far, or all events of a recorded run.
    mark : str
        Mark of this feed, different for every served run.
    folder : Path or None
        Folder of the run, if it is on this machine.
    ending : Ending or None
        End of the run; None before it.
    timetable : ProfileCurve or None
        First profile of the run.
    acknowledged : frozenset of int
        Numbers of the acknowledged events.
    repeatable : bool
        The run can be started again from the page.
    """

    live = False

    def __init__(self, facts: Facts) -> None:
        self.facts = facts
        self.profile: ProfileCurve | None = None
        self.profile_number = 0
        self.frame: Frame | None = None
        self.strip = Strip()
        self.overview = WholeRun((0.0, facts.duration))
        self.marks: list[Mark] = []
        self.lock = threading.Lock()
        self.scale = facts.scale(None)
        self.mark = secrets.token_hex(8)
        self.folder: Path | None = None
        self.ending: Ending | None = None
        self.timetable: ProfileCurve | None = None
        self.acknowledged: frozenset[int] = frozenset()
        self.repeatable = self.again = False
        self._axes = {"coupler": ForceAxis(MIN_REACH), "shoe": ForceAxis(MIN_SHOE)}

    def take_profile(self, profile: ProfileCurve) -> None:
        """Replace the profile in force."""
        self.profile = profile
        self.timetable = self.timetable or profile
        self.scale = self.facts.scale(profile)
        self.profile_number += 1

    def show(self, moment: Snapshot, *, kept: bool = True) -> None:
        """Build the frame of a snapshot; ``kept`` adds its row to the strip charts."""
        number = 1 if self.frame is None else self.frame.number + 1
        if kept:
            values = strip_row(moment, self.facts)
            at, speed, limit = (values[STRIP.index(name)] for name in ("time", "speed", "limit"))
            with self.lock:
                self.strip.add(values)
                self.overview.add(at, speed, limit, law=moment.law, ato=moment.states.ato)
        forces = along(moment)
        row = now(moment, self.facts, self.profile, self.scale)
        row["delay_text"] = [delay_text(self.timetable, moment, self.facts.stop_window)]
        for name, axis in self._axes.items():
            row[f"{name}_reach"] = [axis.fitted(moment.time, float(abs(forces[name]).max(initial=0.0)))]
        self.frame = Frame(number, moment, row, where(moment, self.facts, self.profile), forces)

    def whole(self) -> dict[str, list[Any]]:
        """Return the lists of the overview, with the events that have a label."""
        with self.lock:
            found = self.overview.columns()
        shown = [mark for mark in self.marks if mark.label]
        return {**found, "marks": [[mark.time, mark.text or mark.label, int(mark.acknowledge)] for mark in shown]}

    def page_opened(self) -> None:
        """Note an open page; a run that waits for the first one begins."""

    def acknowledge(self, number: int) -> None:
        """Acknowledge an event by its number; it is common to all browsers."""
        self.acknowledged |= {number}

    def request_again(self) -> None:
        """Request another run of the same scenario; the pages of this one are loaded again."""
        self.again = self.repeatable

    def advance(self) -> None:
        """Advance the time of a recorded run."""

    def close(self) -> None:
        """Release the source of the data."""


WAITING = frozenset(state.text for state in (AtoState.NOT_AVAILABLE, AtoState.AVAILABLE, AtoState.READY))
"""States of the ATO between two engagements, without a label in the strip charts."""


@dataclass
class ProtectionTracker:
    """States after the diagnostics so far.

    Attributes
    ----------
    states : ProtectionStates
    advice : str
        Remedy for gains or a delay that do not fit, as the controller reported it last.
    """

    states: ProtectionStates = field(default_factory=ProtectionStates)
    advice: str = ""

    def take(self, message: Diagnostic) -> list[Mark]:
        """Take one message of the diagnostics; return the changes that it reports as marks of the strip charts."""
        before, now = self.states, states_after(self.states, message)
        self.states = now
        time, marks = message.stamp * 1e-9, []
        if now.supervision != before.supervision and now.supervision in EXCEEDED:
            label = now.supervision if now.supervision in INTERVENTIONS else ""
            text = _text(now.supervision, now.supervision_reason)
            marks.append(Mark(time, label, text, acknowledge=now.supervision in INTERVENTIONS))
        if now.protection != before.protection and now.protection_reason not in ("", SUPERVISOR, REQUESTED):
            text = _text(f"train: {now.protection}", now.protection_reason)
            marks.append(Mark(time, now.protection, text, acknowledge=True))
        if before.ato and now.ato != before.ato:
            label = "" if now.ato in WAITING else now.ato.removeprefix(f"{AtoState.ENGAGED.text}, ")
            failed = now.ato == AtoState.FAILURE.text
            marks.append(Mark(time, label, _text(f"ATO {now.ato}", now.ato_reason), acknowledge=failed))
        if message.node == "controller":
            advice, self.advice = self.advice, message.values.get("advice", "")
            if self.advice not in ("", advice):
                marks.append(Mark(time, "", self.advice))
        return marks


def _text(state: str, reason: str) -> str:
    return f"{state}: {reason}" if reason else state


def states_after(states: ProtectionStates, message: Diagnostic) -> ProtectionStates:
    """Return the states after one message of the diagnostics."""
    values = message.values
    if message.node == "supervisor":
        return replace(states, supervision=message.message, supervision_reason=values.get("reason", ""))
    if message.node == "plant":
        reacting = REACTIONS.get(message.message, Protection.NONE) is not Protection.NONE
        reason = values.get("protection", "")
        return replace(states, protection=message.message if reacting else "", protection_reason=reason)
    if message.node == "controller" and "ato_state" in values:
        ato = values["ato_state"]
        shown = f"{ato}, {BRAKING_LAW}" if message.message == BRAKING_LAW else ato
        reason = "" if ato == AtoState.ENGAGED.text else values.get("ato_reason", "")
        return replace(states, ato=shown, ato_reason=reason)
    return states


def protection_history(reports: Iterable[Diagnostic]) -> tuple[list[float], list[ProtectionStates], list[Mark]]:
    """Return times [s] and states of all changes in a recorded run, and their marks."""
    tracker = ProtectionTracker()
    times, states, marks = [0.0], [tracker.states], []
    for report in reports:
        marks += tracker.take(report)
        if tracker.states != states[-1]:
            times.append(report.stamp * 1e-9)
            states.append(tracker.states)
    return times, states, marks
