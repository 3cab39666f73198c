"""Export of the tables of a run to Parquet and CSV, one file per topic.

Table of one topic in parts, in a temporary file until the columns of all parts are known.
"""

import csv
import io
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute
import pyarrow.csv
import pyarrow.parquet

from train_ato.log.bag_layout import table_name
from train_ato.log.table_columns import FIXED, TIME, numbers_or_texts, unit_of
from train_ato.log.table_loading import TableReader
from train_ato.log.whole_file import writing
from train_ato.messages.topics import BY_NAME
from train_ato.messages.types import Trajectory
from train_ato.program.display_units import display_unit, shown_name, symbol_in
from train_ato.program.version import VERSION

LZ4 = pa.ipc.IpcWriteOptions(compression="lz4")


class TableParts:
    """Parts of a table in the order of the log; rows of a part are in the order of time.

    Parameters
    ----------
    path
        New temporary file.
    sorted_
        Sort rows that are not in order: by time, and for diagnostics by node and stamp. They are then all in memory.
    """

    def __init__(self, path: Path, *, sorted_: bool = True) -> None:
        self._path, self._sorted = path, sorted_
        self._places: list[int] = []
        self._columns: dict[str, set[pa.DataType]] = {}
        self._filled: Counter[str] = Counter()
        self._numbers: dict[str, bool] = {}
        self._last: tuple[float, str] | None = None
        self._in_order = True

    def add(self, part: pd.DataFrame) -> None:
        """Add a part with at least one row; OSError if the disk is full or gone."""
        if _is_diagnostic(part):
            for name in part.columns[len(FIXED) :]:
                texts = part[name].tolist()
                self._numbers[name] = self._numbers.get(name, True) and numbers_or_texts(texts) is not texts
        self._in_order &= self._last is None or self._last <= _key(part, 0)
        self._last = _key(part, -1)
        table = pa.Table.from_pandas(part, preserve_index=True)
        for field in table.schema:
            self._columns.setdefault(field.name, set()).add(field.type)
            self._filled[field.name] += 1
        with writing(self._path), self._path.open("ab") as file:
            self._places.append(file.tell())
            with pa.ipc.new_stream(file, table.schema, options=LZ4) as stream:
                stream.write_table(table)

    def schema(self) -> pa.Schema:
        """Return the columns of all parts, time first, with the metadata of pandas."""
        names = [TIME, *(name for name in self._columns if name != TIME)]
        kinds = {name: self._kind(name) for name in names}
        empty = pa.table({name: pa.array([], kinds[name]) for name in names}).to_pandas().set_index(TIME)
        about = pa.Table.from_pandas(empty, preserve_index=True).schema.metadata
        return pa.schema(list(kinds.items()), metadata=about)

    def _kind(self, name: str) -> pa.DataType:
        """Return the type of a column; one of integers that is missing in a part has numbers with NaN."""
        if name == TIME or self._numbers.get(name):
            return pa.float64()
        kinds = self._columns[name]
        known = kinds - {pa.null()}
        if len(known) != 1:
            return pa.string() if known else pa.null()
        (kind,) = known
        numbers = pa.types.is_integer(kind) or pa.types.is_boolean(kind)
        return pa.float64() if numbers and self._filled[name] < len(self._places) else kind

    def parts(self, schema: pa.Schema, since_begin: Callable[[pd.DataFrame], pd.DataFrame]) -> Iterator[pa.Table]:
        """Yield the parts with all columns, in the order of time.

        Parameters
        ----------
        schema
            From :meth:`schema`, with any metadata.
        since_begin
            Converts an index in publish time [ns] to time since the begin of the log [s].
        """
        frames: Iterator[pd.DataFrame] = map(self._read, self._places)
        if self._sorted and not self._in_order:
            whole = pd.concat(list(frames))
            order = (
                np.lexsort((whole["node"], whole.index))
                if _is_diagnostic(whole)
                else np.argsort(whole.index, kind="stable")
            )
            frames = iter((whole.iloc[order],))
        for frame in frames:
            table = frame.assign(**{name: self._column(frame, name) for name in schema.names if name != TIME})
            table = since_begin(table) if table.index.dtype == np.int64 else table
            yield pa.Table.from_pandas(table, schema=schema, preserve_index=True)

    def _read(self, place: int) -> pd.DataFrame:
        with self._path.open("rb") as file:
            file.seek(place)
            return pa.ipc.open_stream(file).read_pandas()

    def _column(self, frame: pd.DataFrame, name: str) -> Any:
        if name not in frame:
            return None
        return numbers_or_texts(frame[name].tolist()) if self._numbers.get(name) else frame[name]


def _is_diagnostic(part: pd.DataFrame) -> bool:
    return tuple(part.columns[: len(FIXED)]) == FIXED


def _key(part: pd.DataFrame, row: int) -> tuple[float, str]:
    """Return the place of a row in the order of a table."""
    return float(part.index[row]), str(part["node"].iloc[row]) if _is_diagnostic(part) else ""


MAX_NAME = 200
"""Maximum length of the name of a topic in a file name [bytes]; file systems permit 255 with number and ending."""
ROWS = 32_768


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

    Parquet keeps the index, and the metadata of its fields has the unit of every column. CSV has a row of names and the
    shortest exact text of numbers. Missing values are empty. The memory is that of a few parts of the tables. The other
    parts are in a temporary file until the columns of all parts are known. A topic that is not in the order of time
    (diagnostics: of their stamps) is in memory as a whole.

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
        As :func:`~train_ato.log.table_loading.load`, or if no table has a row.
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
            reasons = "; ".join(f"{topic}: {reason}" for topic, reason in left_out.items())
            raise ValueError(f"{run}: the log has no message for a table{reasons and f' ({reasons})'}")
        names, written = file_names(found), []
        for done, (topic, table) in enumerate(found.items()):
            progress(0.5 + done / len(found) / 2, topic)
            schema = schema_with_units(topic, table.schema())
            for ending in formats:
                path = folder / f"{names[topic]}.{ending}"
                parts = table.parts(schema, reader.since_begin)
                if topic in BY_NAME:
                    rows = sum(FORMATS[ending](shown_schema(schema), map(_shown_part, parts), path))
                else:
                    rows = sum(FORMATS[ending](schema, parts, path))
                written.append(Written(path.name, topic, rows, len(schema.names) - 1, path.stat().st_size))
    return written, left_out


def file_names(topics: Iterable[str]) -> dict[str, str]:
    """Return a file name without its ending for every topic: ``train/vehicles`` becomes ``train_vehicles``."""
    names: dict[str, str] = {}
    for topic in topics:
        whole = topic.strip("/").replace("/", "_").replace("\0", "_") or "topic"
        stem = name = whole.encode(errors="replace")[:MAX_NAME].decode(errors="ignore")
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


def shown_schema(schema: pa.Schema) -> pa.Schema:
    """Return a schema with the names and units of display; without ``--units`` the schema itself."""
    number = [pa.types.is_floating(field.type) or pa.types.is_integer(field.type) for field in schema]
    names = [shown_name(name) if plain else name for name, plain in zip(schema.names, number, strict=True)]
    if names == schema.names:
        return schema
    units = [display_unit(symbol_in(name))[0] for name in schema.names]
    fields = [
        field if name == field.name else field.with_name(name).with_metadata({"unit": unit})
        for field, name, unit in zip(schema, names, units, strict=True)
    ]
    frame = pa.schema(fields).empty_table().to_pandas().set_index(TIME)
    about = pa.Table.from_pandas(frame, preserve_index=True).schema.metadata
    return pa.schema(fields, metadata={**schema.metadata, **about})


def _shown_part(part: pa.Table) -> pa.Table:
    """Return a part of a table in the units of display."""
    schema = shown_schema(part.schema)
    if schema is part.schema:
        return part
    columns = [
        column if new.name == old.name else pa.compute.multiply(column, display_unit(symbol_in(old.name))[1])
        for column, old, new in zip(part.columns, part.schema, schema, strict=True)
    ]
    return pa.Table.from_arrays(columns, schema=schema)


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
