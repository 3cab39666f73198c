"""Watch of the answers to the plant: time without an answer, and name of the node without one."""

from __future__ import annotations

import time
from collections.abc import Mapping

from train_ato.messages.topics import BY_NAME, Role

CHECK_S = 0.1
"""Period of the checks for a due answer [s]."""
SUSPENDED_S = 0.25
"""Wall time between two of these checks above which the process was suspended [s].

With the age of the last answer before it (0.4 s for the supervisor) it is shorter than the time-out without lockstep.
"""
LEASE_S = 3.0
"""Suspension after which nodes of other processes drop this one [s]: ``leaseDuration`` of fastdds.xml."""


class AnswerWatch:
    """Wall time since the last command and the last brake release, without the suspensions of this process.

    Attributes
    ----------
    suspended : float
        Longest suspension [s].
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
        self._heard = self._heard_release = time.monotonic()

    def hear(self) -> None:
        """Note a command, or a message of the recorder."""
        self._heard = time.monotonic()

    def hear_release(self) -> None:
        """Note a brake release."""
        self._heard_release = time.monotonic()

    def check(self) -> None:
        """Count a suspension since the last check as one period: answers sent meanwhile can still be read."""
        gap = time.monotonic() - self._checked
        self._checked += gap
        if gap > SUSPENDED_S:
            self._heard += gap - CHECK_S
            self._heard_release += gap - CHECK_S
            self.suspended = max(self.suspended, gap)

    def silent_for(self, *, released: bool) -> float:
        """Return the time since the last command, with ``released`` since the older one of command and release [s]."""
        heard = min(self._heard, self._heard_release) if released else self._heard
        return time.monotonic() - heard

    def release_silent_for(self) -> float:
        """Return the time since the last brake release [s]."""
        return time.monotonic() - self._heard_release


def silent_node(last: Mapping[Role, int], stamp: int, blocked: bool, supervised: int = -1) -> Role:
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
