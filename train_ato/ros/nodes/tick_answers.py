"""Answers of the other nodes to the ticks of the plant: force command, brake pipe pressure and brake release.

Outage: a node gives no answer while its process is started again.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from train_ato.messages.topics import EPOCH_NS, Role
from train_ato.messages.types import BrakeRelease, Command, Pipe

if TYPE_CHECKING:
    from train_ato.scenario.setup import RunSetup

BY_ROLE: dict[Role, tuple[type, ...]] = {Role.CONTROLLER: (Command, Pipe), Role.SUPERVISOR: (BrakeRelease,)}
"""Types of the answers by node."""
TOPICS: dict[type, str] = {
    Command: "ato/command", Pipe: "ato/brake_pipe_command", BrakeRelease: "atp/brake_release",
}  # fmt: skip
NAMES: dict[type, str] = {Command: "a command", Pipe: "a pressure", BrakeRelease: "a brake release"}
ECHOED = {Role.CONTROLLER: "train/measurement", Role.SUPERVISOR: "train/odometry"}
"""Topic with the stamp of an answer, by node."""
OUTAGE_RATE = 1.0
"""Maximum simulated seconds per wall second during an outage: the train goes on while a process starts."""


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
    piped : bool
        True if a pressure belongs to every tick. A program in place of the controller may leave it out. The brake pipe
        of a train with an air brake then stays charged.
    ignored : int
        Number of duplicate or unexpected answers.
    stamps : dict
        Stamp of the newest answer of every type [ns]; -1 before the first.
    """

    def __init__(self, setup: RunSetup) -> None:
        self._setup = setup
        self.command: Command | None = None
        self.pipe: Pipe | None = None
        self.release: BrakeRelease | None = None
        self.ignored = 0
        self.piped = setup.layout.air_brake
        self.stamps: dict[type, int] = {Command: -1, Pipe: -1, BrakeRelease: -1}
        self._unused: dict[type, int] = {}
        self._named: set[tuple[type, bool]] = set()
        self._lost: tuple[type, ...] = ()

    def all_commanded(self, stamp: int) -> bool:
        """Return True if command and pressure for a stamp [ns] have arrived."""
        return all(self.stamps[kind] >= stamp for kind in [Command] + [Pipe] * self.piped)

    def lose(self, role: Role) -> None:
        """Use no answers of a lost node any more."""
        self._lost = BY_ROLE.get(role, ())

    def stamps_wrongly(self, role: Role) -> bool:
        """Return True if a node has sent an answer that echoes no measurement: it does not lack a message."""
        return any((kind, False) in self._named for kind in BY_ROLE.get(role, ()))

    def unused_of(self, role: Role) -> str:
        """Return the newest answer of a node with a stamp that was not due, and the remedy, as text; "" without one."""
        found = [(kind, self._unused[kind]) for kind in BY_ROLE.get(role, ()) if kind in self._unused]
        if not found:
            return ""
        kind, stamp = found[0]
        return f"; {NAMES[kind]} stamped {_shown(stamp)} came; echo the stamp of {ECHOED[role]}"

    def refusal(self, answer: Command | Pipe | BrakeRelease, sent: int) -> str:
        """Return an answer that is not used with the remedy, as text, measurements being sent up to ``sent`` [ns].

        It is "" after the first one of a kind, and for a lost node.
        """
        kind, stamp = type(answer), answer.stamp
        echoes = 0 <= stamp <= sent and stamp % self._setup.tick_ns == 0
        if (kind, echoes) in self._named or kind in self._lost:
            return ""
        self._named.add((kind, echoes))
        role = next(role for role, kinds in BY_ROLE.items() if kind in kinds)
        if echoes:
            said = f"{TOPICS[kind]} stamped {_shown(stamp)} came twice, or after its tick"
            return f"node {role.value}: {said}; answer each {ECHOED[role]} once"
        tick = f"; the tick of the scenario is {self._setup.tick:g} s" if stamp >= 0 else ""
        return f"node {role.value}: {NAMES[kind]} stamped {_shown(stamp)} came; echo the stamp of {ECHOED[role]}{tick}"

    def take(self, answer: Command | Pipe | BrakeRelease, *, expected: bool, again: bool = False) -> bool:
        """Take an answer to an expected stamp that is newer than the last one; count others and return False.

        ``again`` takes one of the same stamp too.
        """
        kind = type(answer)
        newer = answer.stamp > self.stamps[kind] or (again and answer.stamp == self.stamps[kind])
        if kind in self._lost:  # the failure names its node
            return False
        if not expected or not newer:
            self.ignored += 1
            self._unused[kind] = answer.stamp
            return False
        self.stamps[kind] = answer.stamp
        if isinstance(answer, Command):
            self.command = answer
        elif isinstance(answer, Pipe):
            self.pipe = answer
        else:
            self.release = answer
        return True

    def all_arrived(self, stamp: int) -> bool:
        """Return True if every answer to a stamp [ns] has arrived."""
        due = [Command] + [Pipe] * self.piped + [BrakeRelease] * self._setup.supervised_at(stamp)
        return all(self.stamps[kind] == stamp for kind in due)

    def use(self, stamp: int) -> tuple[Command, Pipe | None, BrakeRelease | None] | None:
        """Return the answers to a stamp [ns] and forget them; None if one is missing."""
        command, pipe, release = self.command, self.pipe, self.release
        if command is None or (pipe is None and self.piped):
            return None
        if release is None and self._setup.supervised_at(stamp):
            return None
        self.command = self.pipe = self.release = None
        return command, pipe if self.piped else self._charged(stamp) or pipe, release

    def use_newest(self) -> tuple[Command | None, Pipe | None, BrakeRelease | None]:
        """Return the answers without a wait for missing ones, and forget them except the pressure."""
        command, release = self.command, self.release
        self.command = self.release = None
        return command, self.pipe or self._charged(0), release

    def _charged(self, stamp: int) -> Pipe | None:
        """Return the pressure of the released brake in a run without pressure commands, else None."""
        brake = self._setup.consist.air_brake
        return None if brake is None or self.piped else Pipe(stamp, brake.charged)


def _shown(stamp: int) -> str:
    return "0" if stamp == -EPOCH_NS else f"{stamp * 1e-9:.3f} s"


class Outage:
    """Nodes that are away, from the notice of their restart until every answer is in order again.

    Parameters
    ----------
    ticks
        Number of consecutive ticks with all answers that end the outage.

    Attributes
    ----------
    away : dict
        Reason of the restart, by node.
    returned : Counter
        Number of restarts after which the node has answered again, by node.
    """

    def __init__(self, ticks: int) -> None:
        self.away: dict[Role, str] = {}
        self.returned: Counter[Role] = Counter()
        self._begun: Counter[Role] = Counter()
        self._ticks = ticks
        self._in_order = 0

    @property
    def text(self) -> str:
        """Nodes that are away, with the reasons; "" without one."""
        return "; ".join(f"node {role.value}: {reason}" for role, reason in self.away.items())

    def begin(self, role: Role, reason: str) -> None:
        """Add a node that is away."""
        self.away[role] = reason
        self._begun[role] += 1
        self._in_order = 0

    def step(self, in_order: bool) -> bool:
        """Count a tick with all answers in time, or begin to count again; return True at the end of the outage."""
        self._in_order = self._in_order + 1 if in_order else 0
        if self._in_order < self._ticks:
            return False
        for role in self.away:
            self.returned[role] = self._begun[role]
        self.away.clear()
        return True
