"""Where a page gets its figures from: the same for a live graph and for a recorded run."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any

from train_ato.types import Array
from train_ato.view.facts import Facts, Profile
from train_ato.view.moment import Moment, along, now, strip_row, where
from train_ato.view.strip import Strip

FRAMES_PER_SECOND = 20
LEAST_REACH, LEAST_SHOE = 100.0, 10.0
"""The axes of the forces along the train reach at least so far [kN]."""
ROOM = 1.25


@dataclass(frozen=True)
class Frame:
    """What a page shows at one moment; made once, sent to every browser.

    Attributes
    ----------
    number
        Rises with every new frame.
    now, where, along
        Columns of the driver's display and of place and time (one row each), and of the force strip along the train.
    """

    number: int
    moment: Moment
    now: dict[str, list[Any]]
    where: dict[str, list[float]]
    along: dict[str, Array]


@dataclass(frozen=True)
class Mark:
    """Something that happened: when [s], in a word or two for the strip, and in a sentence."""

    time: float
    label: str
    text: str


class Feed:
    """Figures of one run for any number of pages.

    Parameters
    ----------
    facts
        What is known before the first message.

    Attributes
    ----------
    live : bool
        The train runs now and can be acted on.
    facts : Facts
    profile : Profile or None
        The one in force; ``profile_number`` rises when it is another one.
    frame : Frame or None
        The newest one.
    strip : Strip
        Take its lock, :attr:`lock`, to read it.
    marks : list of Mark
        What happened so far, or in a recorded run all of it.
    """

    live = False

    def __init__(self, facts: Facts) -> None:
        self.facts = facts
        self.profile: Profile | None = None
        self.profile_number = 0
        self.frame: Frame | None = None
        self.strip = Strip()
        self.marks: list[Mark] = []
        self.lock = threading.Lock()
        self.scale = facts.scale(None)
        self._reach = (LEAST_REACH, LEAST_SHOE)

    def take_profile(self, profile: Profile) -> None:
        """Take the profile that is in force from now on."""
        self.profile = profile
        self.scale = self.facts.scale(profile)
        self.profile_number += 1

    def show(self, moment: Moment, *, kept: bool = True) -> None:
        """Make the frame of a moment, and keep its row for the strip charts."""
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
        """Let the axes of the force strip reach as far as the largest force so far, with some room."""
        coupler, shoe = (float(abs(forces[name]).max(initial=0.0)) for name in ("coupler", "shoe"))
        reach = (
            ROOM * coupler if coupler > self._reach[0] else self._reach[0],
            ROOM * shoe if shoe > self._reach[1] else self._reach[1],
        )
        self._reach = reach

    def advance(self) -> None:
        """Let time go on, where it does not by itself."""

    def close(self) -> None:
        """Let go of what feeds it."""
