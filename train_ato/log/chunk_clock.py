"""Thread for writing the chunks of a log: full ones at once, the open one after a maximum age.

A killed recorder loses the open chunk and the one in compression. The maximum age limits this loss for a paused run,
which sends no further message. Compression and checksums release the interpreter lock, so that the run continues.
"""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable


class ChunkClock:
    """Thread with repeated calls of the writing method of a log.

    Parameters
    ----------
    look
        Method that writes due chunks and returns the time until the next call [s]. The reference is weak: the thread
        ends with the log.
    first
        Time until the first call [s].
    """

    def __init__(self, look: Callable[[], float], first: float) -> None:
        self._look = weakref.WeakMethod(look)
        self._wait = first
        self._stopped = False
        self._due = threading.Event()
        self._thread = threading.Thread(target=self._run, name="chunk clock", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while True:
            self._due.wait(self._wait)
            self._due.clear()
            look = self._look()
            if self._stopped or look is None:
                return
            self._wait = look()
            del look

    def wake(self) -> None:
        """Call the method at once."""
        self._due.set()

    def stop(self) -> None:
        """End the thread; the caller must not hold a lock of ``look``."""
        self._stopped = True
        self._due.set()
        self._thread.join()
