"""Export of the tables of a run to Parquet and CSV, one file per topic."""

from __future__ import annotations

import csv
import io
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from train_ato.log.bag_layout import table_name
from train_ato.log.tables.columns import TIME, unit_of
from train_ato.log.tables.loading import TableReader
from train_ato.log.tables.parts import TableParts
from train_ato.log.whole_file import writing
from train_ato.messages.topics import BY_NAME
from train_ato.messages.types import Trajectory
from train_ato.version import VERSION

__all__ = ["FORMATS", "Written", "file_names", "write_tables"]

LONGEST_NAME = 200
"""Maximum length of the name of a topic in a file name [bytes]; file systems permit 255 with number and ending."""
ROWS = 32_768
"""Maximum number of rows of a group of a Parquet file."""


@dataclass(frozen=True)
class Written:
    """One file of an export."""

    file: str
    topic: str
    rows: int
    columns: int
    size_bytes: int


def write_tables(
    run: Path,
    folder: Path,
    formats: Sequence[str],
    topics: Collection[str] | None = None,
    progress: Callable[[float, str], None] = lambda share, text: None,
) -> tuple[list[Written], dict[str, str]]:
    """Write the table of every topic with messages in every format.

    Parquet keeps the index, with the unit of every column as metadata of its field; CSV has a row of names and the
    shortest exact text of numbers; missing values are empty.  The memory is that of a few parts of the tables, which
    are in a temporary file until the columns of all are known; only a topic that is not in the order of time, or of
    diagnostics of their stamps, is in memory as a whole.

    Parameters
    ----------
    run
        Run folder or MCAP file.
    folder
        Existing folder.
    formats
        Keys of :data:`FORMATS`.
    topics
        Topics to write; None: all.
    progress
        Receiver of the completed fraction, 0 to 1, and the current topic.

    Returns
    -------
    tuple of list of Written, dict of str to str
        Files; topics that were left out, with the reason.

    Raises
    ------
    ValueError
        As :func:`~train_ato.log.tables.loading.load`, or if no table has a row.
    OSError
        If the disk is full or gone.
    """
    reader = TableReader(run, topics, lambda share: progress(share / 2, "reading"))
    tables: dict[str, TableParts] = {}
    with tempfile.TemporaryDirectory(dir=folder, prefix=".parts-", ignore_cleanup_errors=True) as scratch:
        for name, part in reader.parts():
            if len(part):
                if name not in tables:
                    knots = (known := table_name(name)) is not None and BY_NAME[known].message is Trajectory
                    tables[name] = TableParts(Path(scratch) / f"{len(tables)}.parts", sorted_=not knots)
                tables[name].add(part)
        left_out = {reader.key(name): reason for name, reason in reader.left_out.items()}
        found = {reader.key(name): table for name, table in tables.items() if name not in reader.left_out}
        if not found:
            raise ValueError(f"{run}: the log has no message for a table{_reasons(left_out)}")
        names, written = file_names(found), []
        for done, (topic, table) in enumerate(found.items()):
            progress(0.5 + done / len(found) / 2, topic)
            schema = schema_with_units(topic, table.schema())
            for ending in formats:
                path = folder / f"{names[topic]}.{ending}"
                rows = sum(FORMATS[ending](schema, table.parts(schema, reader.since_begin), path))
                written.append(Written(path.name, topic, rows, len(schema.names) - 1, path.stat().st_size))
    return written, left_out


def _reasons(left_out: dict[str, str]) -> str:
    return f" ({'; '.join(f'{topic}: {reason}' for topic, reason in left_out.items())})" if left_out else ""


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


def schema_with_units(topic: str, schema: pa.Schema) -> pa.Schema:
    """Return a schema with units in the metadata of its fields."""
    ours = topic in BY_NAME
    fields = [
        field.with_metadata({"unit": unit}) if (ours or field.name == TIME) and (unit := unit_of(field.name)) else field
        for field in schema
    ]
    about = {"topic": topic, "train_ato": VERSION, **({"meaning": BY_NAME[topic].meaning} if ours else {})}
    return pa.schema(fields, metadata={**(schema.metadata or {}), **about})


def _parquet(schema: pa.Schema, parts: Iterable[pa.Table], path: Path) -> Iterator[int]:
    floats = [field.name for field in schema if pa.types.is_floating(field.type)]
    texts = [field.name for field in schema if not pa.types.is_floating(field.type)]
    # numbers seldom repeat, so dictionaries are slow and large; split byte streams compress best
    settings = {"compression": "zstd", "use_dictionary": texts or False, "use_byte_stream_split": floats or False}
    with writing(path), pa.parquet.ParquetWriter(path, schema, **settings) as writer:
        for part in parts:
            writer.write_table(part, row_group_size=ROWS)
            yield part.num_rows


def _csv(schema: pa.Schema, parts: Iterable[pa.Table], path: Path) -> Iterator[int]:
    head = io.StringIO()
    csv.writer(head, lineterminator="\n").writerow(schema.names)
    options = pa.csv.WriteOptions(include_header=False)
    with writing(path), path.open("wb") as file:
        file.write(head.getvalue().encode())
        with pa.csv.CSVWriter(file, schema, write_options=options) as writer:
            for part in parts:
                writer.write_table(part)
                yield part.num_rows


FORMATS: dict[str, Callable[[pa.Schema, Iterable[pa.Table], Path], Iterator[int]]] = {"parquet": _parquet, "csv": _csv}
"""Writers by file extension; each yields the number of rows of every part."""
