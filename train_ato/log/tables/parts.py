"""Table of one topic in parts, in a temporary file until the columns of all parts are known."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from train_ato.log.tables.columns import TIME
from train_ato.log.tables.variable_length import FIXED, numbers_or_texts
from train_ato.log.whole_file import writing

__all__ = ["TableParts"]

LZ4 = pa.ipc.IpcWriteOptions(compression="lz4")


class TableParts:
    """Parts of a table in the order of the log; rows of a part are in the order of time.

    Parameters
    ----------
    path
        New temporary file.
    sorted_
        Sort rows that are not in the order of time, of diagnostics of stamp and node; they are all in memory then.
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
        """Add a part with at least one row.

        Raises
        ------
        OSError
            If the disk is full or gone.
        """
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
