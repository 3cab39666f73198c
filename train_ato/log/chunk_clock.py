"""Closes the open chunk of a log in time, also when no further message comes.

A recorder that is killed loses what is in the open chunk.  Messages alone cannot bound that: a paused or stalled run
sends none, and its last messages would wait for ever.
"""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable


class ChunkClock:
    """A thread that asks a log again and again to close what is due.

    Parameters
    ----------
    look
        Method that closes what is due and returns after how long to ask again [s]. It is held weakly: a log that
        nobody holds any more ends its clock.
    first
        Time until it is asked first [s].
    """

    def __init__(self, look: Callable[[], float], first: float) -> None:
        self._look = weakref.WeakMethod(look)
        self._wait = first
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="chunk clock", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stopped.wait(self._wait):
            look = self._look()
            if look is None:
                return
            self._wait = look()
            del look

    def stop(self) -> None:
        """End the thread; not while holding a lock that ``look`` takes."""
        self._stopped.set()
        self._thread.join()
