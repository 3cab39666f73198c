"""Options and result of a run of the graph."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from train_ato.log.compression import DEFAULT
from train_ato.messages.topics import Role

ANSWERING = (Role.PROFILE, Role.OBSERVER, Role.CONTROLLER)
"""Nodes that send exactly one message per measurement."""
STOPPING_S = 10.0
"""Maximum wall time for answers in flight at the end of a run [s]."""
LOCKSTEP_TIMEOUT_S = 10.0
FREE_TIMEOUT_S = 3.0
"""Longer than a link that is cut for a second, with the time of the messages after it [s]."""

IGNORED = "messages ignored; a line above names the first of each topic, with its stamp and the remedy"

Report = Callable[[int], None]
"""Receiver of the number of complete ticks; called about ten times a second."""


@dataclass(frozen=True)
class GraphOptions:
    """Options of both modes of the graph.

    Attributes
    ----------
    lockstep : bool
        Every tick waits for its command.
    rate : float
        Maximum simulated seconds per second of wall time; 0 is unlimited in lockstep, 1 without it.
    timeout : float or None
        Wall time without an answer of a node after which the run fails [s]; None: 10 in lockstep, 3 without it.
    start_limit : float or None
        Maximum wall time of the start of the nodes [s]; None: :meth:`starting`.
    draining : float
        Maximum wall time for the recorder to receive the messages in flight at the end [s].
    compression : str
        Of the log: ``none``, ``fast`` or ``small``.
    restarts : int
        With one process per node: maximum number of restarts of each node; 0 restarts none.
    external : Role or None
        Node of the graph in whose place another program runs.
    namespace : str
        Namespace of all nodes, for one of several trains in a domain; "" for none.
    followed : bool
        Do not begin before a train behind reads the reports.
    resets : bool
        The caller begins the run again after a request to reset it.
    """

    lockstep: bool = True
    rate: float = 0.0
    timeout: float | None = None
    start_limit: float | None = None
    draining: float = 30.0
    compression: str = DEFAULT
    restarts: int = 0
    external: Role | None = None
    namespace: str = ""
    followed: bool = False
    resets: bool = False

    @property
    def arguments(self) -> list[str]:
        """ROS arguments of the nodes."""
        return ["--ros-args", "-r", f"__ns:={self.namespace}", "--"] if self.namespace else []

    @property
    def patience(self) -> float:
        """Effective time-out [s]."""
        if self.timeout is not None:
            return self.timeout
        return LOCKSTEP_TIMEOUT_S if self.lockstep else FREE_TIMEOUT_S

    def starting(self, default: float) -> float:
        """Return the effective limit of the start [s]: ``default`` if none is given, infinite with an external node."""
        if self.start_limit is not None:
            return self.start_limit
        return default if self.external is None else math.inf


@dataclass
class GraphResult:
    """End of a run as reported by its nodes."""

    wall_s: float = 0.0
    ticks: int = 0
    published: dict[str, int] = field(default_factory=dict)
    ignored: dict[str, int] = field(default_factory=dict)
    """Received but unused messages by the name of the node."""
    step_ns: list[int] = field(default_factory=list)
    interruption: str | None = None
    """Signal or request that ended the run before its last tick; None without one."""
    failure: str | None = None
    restarts: dict[str, int] = field(default_factory=dict)
    """Number of restarts by the name of the node."""
    outside: dict[str, str] = field(default_factory=dict)
    """Names of programs in place of nodes, by node."""
