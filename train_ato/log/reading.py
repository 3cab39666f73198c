"""Reader of the log of a run."""

from __future__ import annotations

import fcntl
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

from mcap.opcode import Opcode

from train_ato.log.bag_layout import LOG, PARTIAL, table_name
from train_ato.log.foreign_bag import as_mcap
from train_ato.log.mcap_records import attachment_of, records
from train_ato.log.mcap_stream import Progress, blocks, readable, stream
from train_ato.messages.topics import EPOCH_NS

__all__ = [
    "Progress",
    "attachments",
    "being_written",
    "blocks",
    "iter_raw",
    "log_file",
    "partial_of",
    "read_log",
    "readable",
    "state_of",
    "stream",
]


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
    return f"the run was killed; `train-ato recover {partial}` makes its log readable"


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


def attachments(path: Path, *, broken: bool = False) -> dict[str, bytes]:
    """Return the attachments of a log by name.

    Parameters
    ----------
    path
        MCAP file.
    broken
        Stop at the first damage without an error.

    Raises
    ------
    ValueError
        If the file is not a log or damaged.
    """
    found = {}
    with readable(path, broken=broken), path.open("rb") as file:
        for record in records(file, path.stat().st_size):
            if record.code == Opcode.ATTACHMENT:
                entry = attachment_of(record.content)
                found[entry.name] = entry.data
    return found


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
