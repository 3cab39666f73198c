"""Watch of the date: a step backward does not extend the waits of the executor.

The ROS wheels are built for a C library without ``pthread_cond_clockwait``.  Their waits with a time-out then end at a
date, also those for a steady clock, and a date that is set back by an hour extends them by an hour.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

LOOK_S = 0.1
"""Period of the looks at the date [s]."""
STEP_S = 0.02
"""Smallest step of the date between two looks that is repaired [s]; a slewed clock changes less."""


class DateWatch:
    """Thread that calls a function after a step of the date backward.

    Parameters
    ----------
    repair
        Ends the extended waits; called again at the next look, for a wait that began during the step.
    """

    def __init__(self, repair: Callable[[], None]) -> None:
        self._repair = repair
        self._stopped = False
        self._thread = threading.Thread(target=self._run, name="date watch", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        last, again = _date(), False
        while not self._stopped:
            time.sleep(LOOK_S)  # the wait of a lock may end at a date too
            date = _date()
            stepped = date < last - STEP_S
            if (stepped or again) and not self._stopped:
                self._repair()
            last, again = date, stepped

    def stop(self) -> None:
        """End the thread."""
        self._stopped = True
        self._thread.join()


def _date() -> float:
    """Return the date at the zero of the steady clock [s]."""
    return time.time() - time.monotonic()
