"""Common data source of the pages for a live graph and a recorded run."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any

from train_ato.apps.view.facts import Facts, ProfileCurve
from train_ato.apps.view.snapshot import Snapshot, along, now, strip_row, where
from train_ato.apps.view.strip import Strip
from train_ato.messages.types import Array

FRAMES_PER_SECOND = 20
LEAST_REACH, LEAST_SHOE = 100.0, 10.0
"""Least ends of the force axes along the train [kN]: couplers, shoes."""
ROOM = 1.25


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
    """Event of a run: time [s], label of the strip charts, description."""

    time: float
    label: str
    text: str


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
        self._reach = (LEAST_REACH, LEAST_SHOE)

    def take_profile(self, profile: ProfileCurve) -> None:
        """Replace the profile in force."""
        self.profile = profile
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
        self._widen(forces)
        row["coupler_reach"], row["shoe_reach"] = [self._reach[0]], [self._reach[1]]
        self.frame = Frame(number, moment, row, where(moment, self.facts, self.profile), forces)

    def _widen(self, forces: dict[str, Array]) -> None:
        """Widen the force axes to the largest force so far, with a margin."""
        coupler, shoe = (float(abs(forces[name]).max(initial=0.0)) for name in ("coupler", "shoe"))
        reach = (
            ROOM * coupler if coupler > self._reach[0] else self._reach[0],
            ROOM * shoe if shoe > self._reach[1] else self._reach[1],
        )
        self._reach = reach

    def advance(self) -> None:
        """Advance the time of a recorded run."""

    def close(self) -> None:
        """Release the source of the data."""
