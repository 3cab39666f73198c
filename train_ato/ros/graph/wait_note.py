"""Notes on a long wait, so that a slow machine differs from a silent one."""

import sys
import time

NOTE_AFTER_S = 3.0
"""Wall time of a wait before the first note [s]."""


class WaitNote:
    """Prints the awaited part on stderr after 3 s, and again whenever the duration of the wait has doubled."""

    def __init__(self) -> None:
        self._awaited = ""
        self._begin = self._next = 0.0

    def __call__(self, awaited: str) -> None:
        """Continue the wait for a part; another part begins a new wait."""
        now = time.monotonic()
        if awaited != self._awaited:
            self._awaited, self._begin, self._next = awaited, now, now + NOTE_AFTER_S
        if now > self._next:
            elapsed = now - self._begin
            self._next = self._begin + 2.0 * elapsed
            sys.stderr.write(f"waiting for {awaited} ({elapsed:.0f} s)\n")
            sys.stderr.flush()
