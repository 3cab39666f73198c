"""Answers of the other nodes to the ticks of the plant: force command, brake pipe pressure and brake release."""

from __future__ import annotations

from typing import TYPE_CHECKING

from train_ato.messages.topics import Role
from train_ato.messages.types import BrakeRelease, Command, Pipe

if TYPE_CHECKING:
    from train_ato.loop.setup import RunSetup

BY_ROLE: dict[Role, tuple[type, ...]] = {Role.CONTROLLER: (Command, Pipe), Role.SUPERVISOR: (BrakeRelease,)}
"""Types of the answers by node."""


class TickAnswers:
    """Newest answer of every type, each used once.

    Parameters
    ----------
    setup
        Setup of the loop: with an air brake and a supervisor more answers belong to a tick.

    Attributes
    ----------
    command, pipe, release
        Answers that are not yet used; None without one.
    ignored : int
        Number of duplicate or unexpected answers.
    """

    def __init__(self, setup: RunSetup) -> None:
        self._setup = setup
        self.command: Command | None = None
        self.pipe: Pipe | None = None
        self.release: BrakeRelease | None = None
        self.ignored = 0
        self._stamps: dict[type, int] = {Command: -1, Pipe: -1, BrakeRelease: -1}
        self._lost: tuple[type, ...] = ()

    @property
    def commanded(self) -> int:
        """Stamp of the newest command [ns]; -1 before the first."""
        return self._stamps[Command]

    def lose(self, role: Role) -> None:
        """Use no answers of a lost node any more."""
        self._lost = BY_ROLE.get(role, ())

    def take(self, answer: Command | Pipe | BrakeRelease, expected: bool) -> bool:
        """Take an answer to an expected stamp that is newer than the last one; count others and return False."""
        kind = type(answer)
        if kind in self._lost or not expected or answer.stamp <= self._stamps[kind]:
            self.ignored += 1
            return False
        self._stamps[kind] = answer.stamp
        if isinstance(answer, Command):
            self.command = answer
        elif isinstance(answer, Pipe):
            self.pipe = answer
        else:
            self.release = answer
        return True

    def all_arrived(self, stamp: int) -> bool:
        """Return True if every answer to a stamp [ns] has arrived."""
        due = [Command] + [Pipe] * self._setup.layout.air_brake + [BrakeRelease] * self._setup.supervised_at(stamp)
        return all(self._stamps[kind] == stamp for kind in due)

    def use(self, stamp: int) -> tuple[Command, Pipe | None, BrakeRelease | None] | None:
        """Return the answers to a stamp [ns] and forget them; None if one is missing."""
        command, pipe, release = self.command, self.pipe, self.release
        if command is None or (pipe is None and self._setup.layout.air_brake):
            return None
        if release is None and self._setup.supervised_at(stamp):
            return None
        self.command = self.pipe = self.release = None
        return command, pipe, release

    def use_newest(self) -> tuple[Command | None, Pipe | None, BrakeRelease | None]:
        """Return the answers without a wait for missing ones, and forget them except the pressure."""
        command, release = self.command, self.release
        self.command = self.release = None
        return command, self.pipe, release
