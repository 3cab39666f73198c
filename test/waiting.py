"""Waits for conditions without bounds on wall time, for tests of threads and processes under load."""

import threading
import time
from collections.abc import Callable
from typing import Any

LIMIT_S = 300.0
"""Wall time after which a wait fails [s], much longer than needed under load."""
LOOK_S = 0.02
"""Wall time between two checks [s]."""
STILL = 50
"""Number of equal values in a row for a constant value."""
_NEVER = threading.Event()


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
