"""Waits without bounds on wall time, and ROS domains for commands, for tests of threads and processes under load."""

import random
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

LIMIT_S = 300.0
"""Wall time after which a wait fails [s], much longer than needed under load."""
LOOK_S = 0.02
"""Wall time between two checks [s]."""
STILL = 50
"""Number of equal values in a row for a constant value."""
_NEVER = threading.Event()
_reserved: deque[socket.socket] = deque(maxlen=4)
"""Locks of the last reserved domains; a test uses one or two."""


def pause(seconds: float) -> None:
    """Wait for a wall time [s]."""
    _NEVER.wait(seconds)


def wait_for(
    condition: Callable[[], Any], what: str = "the condition", turn: Callable[[], Any] = lambda: pause(LOOK_S)
) -> Any:
    """Wait until a condition is true and return its value; ``turn`` is called between two checks."""
    last = time.monotonic() + LIMIT_S
    while not (value := condition()):
        assert time.monotonic() < last, f"{what} did not come within {LIMIT_S:g} s"
        turn()
    return value


def still(value: Callable[[], Any]) -> Any:
    """Return a value after it has become constant."""
    seen, equal, last = value(), 0, time.monotonic() + LIMIT_S
    while equal < STILL:
        assert time.monotonic() < last, f"{seen} is still changing after {LIMIT_S:g} s"
        pause(LOOK_S)
        before, seen = seen, value()
        equal = equal + 1 if seen == before else 0
    return seen


def reserved_domain() -> int:
    """Return a domain for a command with ``--domain``; no run without this option takes it before the command does."""
    from train_ato.ros.graph.domain_lock import locked_runs
    from train_ato.ros.graph.environment import DOMAINS

    free = {*DOMAINS} - {locked for locked, _ in locked_runs()}
    for domain in random.SystemRandom().sample(sorted(free), len(free)):
        lock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        with suppress(OSError):
            lock.bind(f"\0train_ato-domain-{domain}/reserved by a test")
            _reserved.append(lock)
            return domain
    raise AssertionError("all domains are taken")
