"""Export of the tables of a run to Parquet and CSV, one file per topic."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from train_ato.log.tables.columns import TIME, unit_of
from train_ato.log.tables.loading import Frames
from train_ato.log.whole_file import writing
from train_ato.messages.topics import BY_NAME
from train_ato.version import VERSION

__all__ = ["FORMATS", "Written", "file_names", "write_frames"]

LONGEST_NAME = 200
"""Maximum length of the name of a topic in a file name [bytes]; file systems permit 255 with number and ending."""
ROWS = 4096
"""Number of rows per step of writing."""


@dataclass(frozen=True)
class Written:
    """One file of an export."""

    file: str
    topic: str
    rows: int
    columns: int
    size_bytes: int


def write_frames(
    frames: Frames,
    folder: Path,
    formats: Sequence[str],
    progress: Callable[[float, str], None] = lambda share, text: None,
) -> list[Written]:
    """Write every table with rows in every format.

    Parquet keeps the index, with the unit of every column as metadata of its field; CSV has a row of names and the
    shortest exact text of numbers; missing values are empty.

    Parameters
    ----------
    frames
        Tables of a run.
    folder
        Existing folder.
    formats
        Keys of :data:`FORMATS`.
    progress
        Receiver of the completed fraction, 0 to 1, and the current topic.

    Raises
    ------
    OSError
        If the disk is full or gone.
    """
    tables = {topic: frame for topic, frame in frames.items() if len(frame)}
    names = file_names(tables)
    cells = sum(frame.size for frame in tables.values()) * len(formats)
    done, written = 0, []
    for topic, frame in tables.items():
        table = arrow_table(topic, frame)
        for ending in formats:
            path = folder / f"{names[topic]}.{ending}"
            for rows in FORMATS[ending](table, path):
                done += rows * frame.shape[1]
                progress(done / max(1, cells), topic)
            written.append(Written(path.name, topic, len(frame), frame.shape[1], path.stat().st_size))
    return written


def file_names(topics: Iterable[str]) -> dict[str, str]:
    """Return a file name without its ending for every topic: ``train/vehicles`` becomes ``train_vehicles``."""
    names: dict[str, str] = {}
    for topic in topics:
        whole = topic.strip("/").replace("/", "_").replace("\0", "_") or "topic"
        stem = name = whole.encode(errors="replace")[:LONGEST_NAME].decode(errors="ignore")
        number = 2
        while name in names.values():
            name, number = f"{stem}_{number}", number + 1
        names[topic] = name
    return names


def arrow_table(topic: str, frame: pd.DataFrame) -> pa.Table:
    """Return a table with units in the metadata of its fields, time first."""
    table = pa.Table.from_pandas(frame, preserve_index=True)
    table = table.select([TIME, *(name for name in table.column_names if name != TIME)])
    ours = topic in BY_NAME
    fields = [
        field.with_metadata({"unit": unit}) if (ours or field.name == TIME) and (unit := unit_of(field.name)) else field
        for field in table.schema
    ]
    about = {"topic": topic, "train_ato": VERSION, **({"meaning": BY_NAME[topic].meaning} if ours else {})}
    return table.cast(pa.schema(fields, metadata={**(table.schema.metadata or {}), **about}))


def _parquet(table: pa.Table, path: Path) -> Iterable[int]:
    floats = [field.name for field in table.schema if pa.types.is_floating(field.type)]
    texts = [field.name for field in table.schema if not pa.types.is_floating(field.type)]
    # numbers seldom repeat, so dictionaries are slow and large; split byte streams compress best
    settings = {"compression": "zstd", "use_dictionary": texts or False, "use_byte_stream_split": floats or False}
    with writing(path), pa.parquet.ParquetWriter(path, table.schema, **settings) as writer:
        for begin in range(0, table.num_rows, 8 * ROWS):
            part = table.slice(begin, 8 * ROWS)
            writer.write_table(part)
            yield part.num_rows


def _csv(table: pa.Table, path: Path) -> Iterable[int]:
    head = io.StringIO()
    csv.writer(head, lineterminator="\n").writerow(table.column_names)
    options = pa.csv.WriteOptions(include_header=False)
    with writing(path), path.open("wb") as file:
        file.write(head.getvalue().encode())
        with pa.csv.CSVWriter(file, table.schema, write_options=options) as writer:
            for begin in range(0, table.num_rows, ROWS):
                part = table.slice(begin, ROWS)
                writer.write_table(part)
                yield part.num_rows


FORMATS: dict[str, Callable[[pa.Table, Path], Iterable[int]]] = {"parquet": _parquet, "csv": _csv}
"""Writers by file extension; each yields the number of rows of every step."""
