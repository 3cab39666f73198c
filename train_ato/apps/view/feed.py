"""Common data source of the pages for a live graph and a recorded run."""

from __future__ import annotations

import secrets
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from train_ato.apps.view.ending import Ending
from train_ato.apps.view.facts import Facts, ProfileCurve
from train_ato.apps.view.snapshot import STRIP, Snapshot, along, delay_text, now, strip_row, where
from train_ato.messages.types import Array

MOST_ROWS = 6000
"""Number of kept rows: five minutes of wall time at 20 frames a second."""
GROW = 2


class Strip:
    """Rows of :data:`train_ato.apps.view.snapshot.STRIP` with constant row numbers, newest last.

    Attributes
    ----------
    added : int
        Number of rows added so far.
    """

    def __init__(self, rows: int = MOST_ROWS) -> None:
        self.rows = rows
        self._table: Array = np.zeros((GROW * rows, len(STRIP)))
        self._used = 0
        self.added = 0

    def add(self, row: Sequence[float]) -> None:
        """Add the newest row; the oldest rows are dropped when the table is full."""
        if self._used == len(self._table):
            self._table[: self.rows] = self._table[-self.rows :]
            self._used = self.rows
        self._table[self._used] = row
        self._used += 1
        self.added += 1

    def since(self, number: int) -> dict[str, Array]:
        """Return the columns of the kept rows from a row number on."""
        count = min(self.added - number, self._used, self.rows)
        rows = self._table[self._used - max(0, count) : self._used]
        return {name: rows[:, column].astype(np.float32 if column else np.float64) for column, name in enumerate(STRIP)}


FRAMES_PER_SECOND = 20
LEAST_REACH, LEAST_SHOE = 100.0, 10.0
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
        Rows of the strip charts; :attr:`lock` protects them.
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
        self.marks: list[Mark] = []
        self.lock = threading.Lock()
        self.scale = facts.scale(None)
        self.mark = secrets.token_hex(8)
        self.folder: Path | None = None
        self.ending: Ending | None = None
        self.timetable: ProfileCurve | None = None
        self.acknowledged: frozenset[int] = frozenset()
        self.repeatable = self.again = False
        self._axes = {"coupler": ForceAxis(LEAST_REACH), "shoe": ForceAxis(LEAST_SHOE)}

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
            with self.lock:
                self.strip.add(strip_row(moment, self.facts))
        forces = along(moment)
        row = now(moment, self.facts, self.profile, self.scale)
        row["delay_text"] = [delay_text(self.timetable, moment, self.facts.stop_window)]
        for name, axis in self._axes.items():
            row[f"{name}_reach"] = [axis.fitted(moment.time, float(abs(forces[name]).max(initial=0.0)))]
        self.frame = Frame(number, moment, row, where(moment, self.facts, self.profile), forces)

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
