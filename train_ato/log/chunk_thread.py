"""MCAP file with compression and writing of chunks in another thread, so that recording does not wait.

Compression, checksums and writing release the interpreter lock (time: ``python studies_done/recorder.py``).
"""

import functools
import threading
import time
import weakref
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import IO

import numpy as np

from train_ato.log.mcap_writer import McapWriter, OpenChunk, TickRecords

CLOSE_AFTER_S = 0.85
"""Age at which the open chunk is closed [s], so that it is written within a second."""
Entry = tuple[int, int, int, bytes]
"""Channel, publish time and log time [ns since 1970], CDR bytes."""


class Unwritten(OSError):
    """Failure to write a log. The node that it names is the recorder, whatever stage of the engine has written.

    Attributes
    ----------
    reason : str
        What the system says.
    """

    node = "recorder"

    def __init__(self, text: str, reason: str) -> None:
        super().__init__(text)
        self.reason = reason


class ChunkThread:
    """Thread-safe receiver of messages; a killed process loses the open chunk and the one in compression.

    Parameters
    ----------
    writer
        Writer of the file.
    raw
        Unbuffered file, closed after a failure.
    name
        Name of the file for the text of a failure.
    chunk_size
        Size at which a chunk is closed [bytes].
    remedy
        Remedy of a failed write.

    Attributes
    ----------
    lock : threading.Lock
        Lock of the open chunk.
    failure : str or None
        Reason of a failed write; nothing is written after it.
    """

    def __init__(self, writer: McapWriter, raw: IO[bytes], name: str, chunk_size: int, remedy: str) -> None:
        self.lock = threading.Lock()
        self.failure: str | None = None
        self._writer = writer
        self._raw = raw
        self._name = name
        self._reason, self._remedy = "", remedy
        self._limit = chunk_size
        self._full: OpenChunk | None = None
        self._written = threading.Condition(self.lock)
        self._raised = self._stopped = False
        self._due = threading.Event()

    def start(self) -> None:
        """Start the thread."""
        given = weakref.WeakMethod(self._write_due), self._due  # the thread does not keep the log
        self._thread = threading.Thread(target=_look_repeatedly, args=given, name="chunk clock", daemon=True)
        self._thread.start()

    def extend(self, entries: Iterable[Entry]) -> None:
        """Add messages; OSError if an earlier chunk could not be written."""
        with self.lock:
            self.check()
            add, limit = self._writer.add, self._limit
            for channel, publish_ns, log_ns, data in entries:
                if add(channel, publish_ns, log_ns, data) > limit:
                    self._hand_over()

    def extend_ticks(self, records: TickRecords) -> None:
        """Add the messages of a block of ticks, errors as :meth:`extend`; a chunk is closed after a whole tick."""
        ends, first = np.cumsum(records.sizes), 0
        with self.lock:
            self.check()
            while first < ends.size:
                room = max(self._limit - self._writer.size, 0) + (int(ends[first - 1]) if first else 0)
                end = min(int(np.searchsorted(ends, room, side="right")) + 1, ends.size)
                if self._writer.add_ticks(records, first, end) > self._limit:
                    self._hand_over()
                first = end

    def _hand_over(self) -> None:
        """Pass the open chunk to the thread after the previous one is written; requires the lock."""
        while self._full is not None:
            self._written.wait()
        self.check()
        self._full = self._writer.take_chunk()
        self._due.set()

    def flush(self) -> None:
        """Write the open chunk to the file; OSError if writing fails."""
        with self.lock:
            self._hand_over()
            while self._full is not None:
                self._written.wait()
            self.check()

    def stop(self) -> None:
        """End the thread and write the remaining chunks.

        Raises
        ------
        OSError
            If writing fails, or an earlier failure was not raised yet.
        """
        self._stopped = True
        self._due.set()
        self._thread.join()
        if self.failure is not None:
            if not self._raised:
                self.check()
            return
        for chunk in (self._full, self._writer.take_chunk()):
            if chunk is not None:
                self.guard(functools.partial(self._writer.write_chunk, chunk))

    def _write_due(self) -> float | None:
        """Write the full chunk, or the open one at its age; return the time to the next call [s], None at the end."""
        if self._stopped:
            return None
        with self.lock:
            if self._full is None and self._left() <= 0:
                self._full = self._writer.take_chunk()
            chunk = self._full
            if self.failure is not None or chunk is None:
                return self._left()
        try:
            self._writer.write_chunk(chunk)
        except Exception as error:  # any exception: the recording thread raises it
            self._give_up(error)
        with self.lock:
            self._full = None
            self._written.notify_all()
            return self._left()

    def _left(self) -> float:
        """Return the time until the maximum age of the open chunk [s]; the age of an empty chunk is 0."""
        opened = self._writer.opened
        if opened is None or self.failure is not None:
            return CLOSE_AFTER_S
        return max(0.0, opened + CLOSE_AFTER_S - time.monotonic())

    def guard(self, action: Callable[[], object]) -> None:
        """Run an action on the file.

        Raises
        ------
        OSError
            If the action fails, or an earlier one has failed; the action is then omitted.
        """
        self.check()
        try:
            action()
        except OSError as error:
            self._give_up(error)
            self.check()

    def check(self) -> None:
        """Raise the failure of the file, if there is one."""
        if self.failure is not None:
            self._raised = True
            raise Unwritten(self.failure, self._reason)

    def _give_up(self, error: Exception) -> None:
        """Store the failure and close the file without further writing."""
        self._reason = (isinstance(error, OSError) and error.strerror) or str(error)
        if not Path(self._name).exists():
            self.failure = f"{self._name}: was removed during the run; nothing is recorded"
        else:
            self.failure = f"{self._name}: writing failed ({self._reason}); {self._remedy}"
        self._raw.close()


def _look_repeatedly(look: "weakref.WeakMethod[Callable[[], float | None]]", due: threading.Event) -> None:
    """Call the writing method of a log when it is due, until it returns None; the thread ends with the log."""
    wait: float | None = CLOSE_AFTER_S
    while wait is not None:
        due.wait(wait)
        due.clear()
        method = look()
        wait = None if method is None else method()
        del method  # the log may end while the thread waits
