"""Wall times of the plant node: time without an answer with the name of its node, and lateness of the ticks."""

import time
from collections.abc import Mapping, Sequence

import numpy as np

from train_ato.messages.topics import BY_NAME, Role

CHECK_S = 0.1
"""Period of the checks for a due answer [s]."""
SUSPENDED_S = 0.25
"""Wall time between two of these checks above which the process was suspended [s].

With the age of the last answer before it (0.4 s for the supervisor) it is shorter than the time-out without lockstep.
"""
LEASE_S = 3.0
"""Suspension after which nodes of other processes drop this one [s]: ``leaseDuration`` of fastdds.xml."""
GONE = "its process ended or stood still, or the link is cut"


class AnswerWatch:
    """Wall time since the last command and the last brake release, without the suspensions of this process.

    Attributes
    ----------
    suspended : float
        Longest suspension [s].
    heard, heard_release : float
        Wall time of the last command, or message of the recorder, and of the last brake release [s].
    """

    def __init__(self) -> None:
        self.suspended = 0.0
        self.begin()

    def begin(self) -> None:
        """Begin at the present time."""
        self._checked = time.monotonic()
        self.restart()

    def restart(self) -> None:
        """Count from the present time: before it no answer was due."""
        self.heard = self.heard_release = time.monotonic()

    def check(self) -> None:
        """Count a suspension since the last check as one period: answers sent meanwhile can still be read."""
        gap = time.monotonic() - self._checked
        self._checked += gap
        if gap > SUSPENDED_S:
            self.heard += gap - CHECK_S
            self.heard_release += gap - CHECK_S
            self.suspended = max(self.suspended, gap)

    def silent_for(self, *, released: bool) -> float:
        """Return the time since the last command, with ``released`` since the older one of command and release [s]."""
        heard = min(self.heard, self.heard_release) if released else self.heard
        return time.monotonic() - heard

    def release_silent_for(self) -> float:
        """Return the time since the last brake release [s]."""
        return time.monotonic() - self.heard_release


def silent_node(last: Mapping[Role, int], stamp: int, *, blocked: bool, supervised: int = -1) -> Role:
    """Return the node without an answer to the stamp: the first in the order of dependence.

    Parameters
    ----------
    last
        Stamp of the last answer of every node [ns].
    stamp
        Stamp of the plant [ns].
    blocked
        True if the plant waits for the recorder.
    supervised
        Stamp of the newest step of the supervisor [ns]; -1 without one.
    """
    if blocked:
        return Role.RECORDER
    if last.get(Role.SUPERVISOR, -1) < supervised:
        return Role.SUPERVISOR
    for role in (Role.PROFILE, Role.OBSERVER):
        if last.get(role, -1) < stamp:
            return role
    return Role.CONTROLLER


def awaited_node(role: Role, awaited: Mapping[Role, str]) -> tuple[Role, str]:
    """Return the node on which a silent node waits, itself without one, and the chain of both as text.

    Parameters
    ----------
    role
        Silent node.
    awaited
        Topic for which a node waits, "" for none.
    """
    chain, passed = "", {role}
    while (topic := awaited.get(role, "")) in BY_NAME:
        sender = BY_NAME[topic].publishers[0]
        if sender is Role.PLANT or sender in passed:
            break
        passed.add(sender)
        chain = f": node {role.value} waits for its {topic}"
        role = sender
    return role, chain


def departure(gone: Sequence[Role], stamp: int) -> str:
    """Return the reason of a failure by the first of the nodes that have left at a stamp [ns]."""
    others = f", as did {' and '.join(role.value for role in gone[1:])}" if gone[1:] else ""
    return f"it left the run at {stamp * 1e-9:.3f} s{others}: {GONE}"


LATE = 1.5
"""Shortest step of a late tick from the one before, in periods."""


class TickLateness:
    """Lateness of the ticks.

    Attributes
    ----------
    late : int
        Number of ticks after more than :data:`LATE` periods.
    """

    def __init__(self) -> None:
        self.late = 0
        self._lateness: list[float] = []
        self._wall = self._planned = 0.0
        self._last: int | None = None
        self._unreported: list[int] = []

    def begin(self, period: float) -> None:
        """Note the begin of a tick, due a period after the last one [s]."""
        now = time.monotonic_ns()
        if self._last is not None:
            step = (now - self._last) * 1e-9
            self._wall, self._planned = self._wall + step, self._planned + period
            self._lateness.append(step - period)
            self.late += step > LATE * period
        self._last = now
        self._unreported.append(now)

    def restart(self) -> None:
        """Begin again after a pause or a change of the rate, which is no lateness."""
        self._last = None

    def report(self) -> dict[str, str]:
        """Return the figures for the diagnostics, with the wall times of the ticks since the last report.

        ``wall_tick_begin_ns`` is the begin of the first of these ticks [ns since 1970], ``wall_tick_steps_us`` has the
        steps between them.
        """
        found = {}
        if self._unreported:
            begins, self._unreported = np.array(self._unreported), []
            found["wall_tick_begin_ns"] = str(begins[0] + time.time_ns() - time.monotonic_ns())
            found["wall_tick_steps_us"] = " ".join(str(step) for step in np.diff(begins) // 1000)
        if self._lateness:
            lateness = np.array(self._lateness)
            found["wall_ticks_late"] = str(self.late)
            found["wall_lateness_max_s"] = f"{max(0.0, lateness.max()):.6f}"
            found["wall_lateness_p99_s"] = f"{max(0.0, np.percentile(lateness, 99)):.6f}"
            found["wall_behind_share"] = f"{max(0.0, 1.0 - self._planned / self._wall):.6f}"
        return found
