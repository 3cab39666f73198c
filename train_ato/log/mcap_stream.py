"""Messages of an MCAP file in the order of writing, with a check of every chunk and of the whole file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from mcap.opcode import Opcode

from train_ato.log.mcap_chunk import chunk_content
from train_ato.log.mcap_records import HEAD, Damage, Definitions, RawMessage, records

Progress = Callable[[float], None]
"""Receiver of the completed fraction of a task, 0 to 1."""


@contextmanager
def readable(path: Path, *, broken: bool = False) -> Iterator[None]:
    """Convert damage of a file and disk errors into a one-line ValueError; with ``broken``, stop at the damage.

    Raises
    ------
    ValueError
        If the file is not a log, damaged or unreadable.
    """
    try:
        yield
    except Damage as damage:
        if not broken:
            text = f"{path}: damaged or no log: {damage}; `train-ato recover {path}` saves the undamaged part"
            raise ValueError(text) from None
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from None


def blocks(path: Path, progress: Progress | None = None) -> Iterator[bytes]:
    """Read a log in blocks of records: the content of a chunk, or one record outside of chunks.

    Every chunk is verified before it is returned, the whole file at its end.

    Raises
    ------
    Damage
        If the file is not a log or damaged.
    """
    with path.open("rb") as file:
        size, done = max(1, path.stat().st_size), 0
        for record in records(file, size):
            done += len(record.content)
            if record.code == Opcode.CHUNK:
                yield chunk_content(record.content)
                if progress is not None:
                    progress(done / size)
            elif record.code in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                yield HEAD.pack(record.code, len(record.content)) + record.content


def stream(path: Path, *, broken: bool = False, progress: Progress | None = None) -> Iterator[RawMessage]:
    """Read the messages of a log in the order of writing.

    Parameters
    ----------
    path
        MCAP file.
    broken
        Stop at the first damage without an error, for example at the end of a partial file.
    progress
        Receiver of the fraction of the file that is read.

    Raises
    ------
    ValueError
        If the file is not a log or damaged.
    """
    known = Definitions()
    with readable(path, broken=broken):
        for block in blocks(path, progress):
            yield from known.messages(block)
