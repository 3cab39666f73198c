"""Reader of the log of a run."""

from __future__ import annotations

import fcntl
import shlex
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from mcap.opcode import Opcode

from train_ato.log.bag_layout import LOG, PARTIAL, table_name
from train_ato.log.foreign_bag import as_mcap, original
from train_ato.log.mcap_records import Progress, attachment_of, metadata_of, readable, records, stream
from train_ato.messages.topics import EPOCH_NS

MERGED = "several runs, or a run and its copy, are merged in this log; name the log of one run"
"""Complaint about a log with two messages of one time, or two scenarios."""
MAX_RUN_NS = 86_400 * 10**9
"""Maximum duration of a run [ns]."""


def time_zero(first_ns: int, *, ours: bool) -> int:
    """Return time 0 of a log [ns since 1970]: the start of the simulation, of other or wall times the first message.

    Parameters
    ----------
    first_ns
        Publish time of the first message [ns since 1970].
    ours
        True for a log with topics of the topic table.
    """
    return EPOCH_NS if ours and 0 <= first_ns - EPOCH_NS <= MAX_RUN_NS else first_ns


def log_file(run: Path) -> Path:
    """Return the log of a run: the file itself, ``run.mcap`` in its folder, or a bag of another recorder.

    Raises
    ------
    ValueError
        If there is no log, or only that of a killed or running run.
    """
    path = run / LOG if (run / LOG).is_file() else run
    partial = partial_of(run)
    if partial is not None:
        raise ValueError(f"{partial}: {state_of(partial)}")
    if not path.exists():
        raise ValueError(f"{path}: no such log; name a run folder or an MCAP file")
    return as_mcap(path)


def partial_of(run: Path) -> Path | None:
    """Return the partial log of a run without a complete one, else None."""
    partial = run / PARTIAL if run.is_dir() else run
    if partial.suffix != ".partial" or not partial.is_file() or (run.is_dir() and (run / LOG).is_file()):
        return None
    return partial


def state_of(partial: Path) -> str:
    """Return the state of a run with a partial log, with the remedy."""
    if being_written(partial):
        return "the run still goes on; wait for its end, or end it with Ctrl-C"
    return f"the run was killed; `train-ato recover {shlex.quote(str(partial))}` makes its log readable"


def being_written(path: Path) -> bool:
    """Return True if a process has locked a log for writing."""
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def attachments(path: Path, *, broken: bool = False, once: str = "") -> dict[str, bytes]:
    """Return the attachments of a log by name.

    Raises
    ------
    ValueError
        If the file is not a log or damaged, or has two attachments of the name ``once``.
    """
    found = list(_parsed(path, Opcode.ATTACHMENT, attachment_of, broken=broken))
    if [entry.name for entry in found].count(once) > 1:
        raise ValueError(f"{original(path)}: two attachments {once}: {MERGED}")
    return {entry.name: entry.data for entry in found}


def _parsed(path: Path, code: Opcode, parse: Callable[[bytes], Any], *, broken: bool) -> Iterator[Any]:
    """Yield the records of one kind of a log; with ``broken``, up to the first damage without an error."""
    with readable(path, broken=broken), path.open("rb") as file:
        for found, content in records(file, path.stat().st_size):
            if found == code:
                yield parse(content)


def iter_raw(
    run: Path, topics: Collection[str] | None = None, progress: Progress | None = None
) -> Iterator[tuple[str, int, bytes]]:
    """Read the messages of a run as (topic of the table, publish stamp, CDR bytes), in the order of the log.

    Parameters
    ----------
    run
        Run folder or MCAP file.
    topics
        Names in the table; default: all.
    progress
        Receiver of the fraction of the file that is read.
    """
    known: dict[str, str | None] = {}
    for message in stream(log_file(run), progress=progress):
        name = message.channel.topic
        if name not in known:
            found = table_name(name)
            known[name] = found if topics is None or found in topics else None
        topic = known[name]
        if topic is not None:
            yield topic, message.publish_ns - EPOCH_NS, message.data


def read_log(
    run: Path, decode: Callable[[str, bytes], Any], topics: Collection[str] | None = None
) -> Iterator[tuple[str, int, Any]]:
    """Read the decoded messages of a run as (topic, stamp, dataclass), with ``decode`` of its :class:`Wire`."""
    for topic, stamp, data in iter_raw(run, topics):
        yield topic, stamp, decode(topic, data)


WALL_TIME = "wall_time"
"""Name of the metadata record."""


def clock_ns() -> int:
    """Return the wall time [ns since 1970]."""
    return time.time_ns()


def steady_ns() -> int:
    """Return the time of a clock that is never set [ns]."""
    return time.monotonic_ns()


@dataclass(frozen=True)
class WallTime:
    """Wall time of a recording.

    Attributes
    ----------
    begin_ns : int
        Opening of the log [ns since 1970].
    duration_s : float or None
        Wall time from the opening to the closing of the log [s]; None for the log of a killed run.
    since_ns : int
        Opening by a clock that is never set [ns].
    """

    begin_ns: int
    duration_s: float | None = None
    since_ns: int = field(default_factory=lambda: steady_ns(), compare=False, repr=False)

    @classmethod
    def now(cls) -> WallTime:
        """Return the wall time of a recording that begins now."""
        return cls(clock_ns())

    def ended(self) -> WallTime:
        """Return the wall time of the recording with its end now."""
        return replace(self, duration_s=(steady_ns() - self.since_ns) * 1e-9)

    @property
    def begin(self) -> str:
        """Opening of the log, ISO 8601 in UTC, to the millisecond."""
        found = datetime.fromtimestamp(self.begin_ns * 1e-9, timezone.utc)
        return found.isoformat(timespec="milliseconds").replace("+00:00", "Z")

    def record(self) -> dict[str, str]:
        """Return the content of the metadata record."""
        found = {"begin": self.begin, "begin_ns": str(self.begin_ns)}
        return found if self.duration_s is None else {**found, "duration_s": f"{self.duration_s:.3f}"}

    def listed(self) -> dict[str, Any]:
        """Return the record with numbers, for JSON."""
        return {"begin": self.begin, "begin_ns": self.begin_ns, "duration_s": self.duration_s}

    @classmethod
    def of(cls, record: Mapping[str, str]) -> WallTime | None:
        """Return the wall time of a metadata record; None if its numbers cannot be read or do not fit its text."""
        try:
            duration = record.get("duration_s")
            found = cls(int(record["begin_ns"]), None if duration is None else float(duration))
            return found if found.begin == record["begin"] else None
        except (KeyError, ValueError, OverflowError, OSError):
            return None


def read_wall_time(path: Path, *, broken: bool = False) -> WallTime | None:
    """Return the wall time of a log; None for a log without the record, as of another recorder."""
    found = None
    for record in _parsed(path, Opcode.METADATA, metadata_of, broken=broken):
        if record.name == WALL_TIME:
            found = WallTime.of(record.metadata) or found
    return found
