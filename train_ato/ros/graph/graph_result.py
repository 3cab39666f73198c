"""How a graph is run, and what is known of a run when its nodes have ended."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from train_ato.topics import Role

ANSWERING = (Role.PROFILE, Role.OBSERVER, Role.CONTROLLER)
"""Nodes that send exactly one message for every measurement."""
STOPPING_S = 2.0
"""Longest wall time for answers that are still under way when a run stops."""
LOCKSTEP_TIMEOUT_S = 10.0
PACED_TIMEOUT_S = 1.0

Report = Callable[[int], None]
"""Takes the number of ticks that are over; called about ten times a second."""


@dataclass(frozen=True)
class GraphOptions:
    """Options of both ways to run the graph.

    Attributes
    ----------
    realtime : float or None
        Simulated seconds per second of wall time; None is lockstep.
    pace : float
        In lockstep, simulated seconds per second of wall time at most; 0 is as fast as it goes.
    timeout : float or None
        Wall time after which a node that does not answer fails the run [s]; None: 10 s in lockstep, 1 s when paced.
    meeting : float
        Longest wall time for the nodes to find each other [s].
    draining : float
        Longest wall time for the recorder to take what is under way at the end [s].
    """

    realtime: float | None = None
    pace: float = 0.0
    timeout: float | None = None
    meeting: float = 10.0
    draining: float = 10.0

    @property
    def patience(self) -> float:
        """Time-out in force [s]."""
        if self.timeout is not None:
            return self.timeout
        return LOCKSTEP_TIMEOUT_S if self.realtime is None else PACED_TIMEOUT_S


@dataclass
class RunEnd:
    """What a runner reports when its nodes have ended."""

    wall_s: float = 0.0
    ticks: int = 0
    published: dict[str, int] = field(default_factory=dict)
    recorded: dict[str, int] = field(default_factory=dict)
    step_ns: list[int] = field(default_factory=list)
    late: int = 0
    held: int = 0
    interrupted: bool = False
    failure: str | None = None
