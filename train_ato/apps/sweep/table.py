"""Table of a sweep: one row for each run, as a data frame and as Parquet."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.apps.sweep.row import Row

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["METADATA", "read_results", "sweep_table", "write_results"]

METADATA = b"train_ato.sweep"
"""Key of the Parquet metadata with specification, hashes and versions as JSON."""
FIRST = ("law", "observer", "compensation", "seed", "status", "reason", "verdict", "tracking")
LAST = ("sha256", "wall_s", "evaluation_s", "overhead_s", "point")


def sweep_table(rows: Sequence[Row], keys: Sequence[str]) -> pd.DataFrame:
    """Return one row for each run.

    Parameters
    ----------
    rows
        Rows of the finished runs.
    keys
        Varied keys.

    Returns
    -------
    pandas.DataFrame
        ``run``; the varied keys; law, observer, compensation, seed; ``status``, ``reason``, ``verdict``, ``tracking``;
        the numeric metrics of ``summary.json``, NaN without a value; ``sha256`` of the resolved scenario; wall times
        ``wall_s``, ``evaluation_s``, ``overhead_s``; ``point``, the values of the varied keys as JSON.  A key whose
        values are not of one type, or not scalar, is a column of JSON texts.
    """
    import pandas as pd

    metrics = list(dict.fromkeys(key for row in rows for key in row.get("metrics", {})))
    columns: dict[str, list[Any]] = {"run": [row["run"] for row in rows]}
    for key in keys:
        columns[key] = _column([row["point"].get(key) for row in rows])
    for key in FIRST:
        columns.setdefault(key, _column([row.get(key) for row in rows]))
    for key in metrics:
        columns[key] = [float("nan") if (value := row.get("metrics", {}).get(key)) is None else value for row in rows]
    for key in LAST[:-1]:
        columns[key] = [row.get(key) for row in rows]
    columns["point"] = [json.dumps(row["point"], ensure_ascii=False) for row in rows]
    frame = pd.DataFrame(columns)
    if "seed" not in keys:
        frame["seed"] = frame["seed"].astype("UInt64")
    return frame


def _column(values: list[Any]) -> list[Any]:
    """Return values of one scalar type unchanged, others as JSON texts."""
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {int, float} or kinds in ({str}, {bool}, set()):
        return values
    return [None if value is None else json.dumps(value, ensure_ascii=False) for value in values]


def write_results(path: Path, frame: pd.DataFrame, identity: Mapping[str, Any]) -> None:
    """Write the table as one Parquet file, whole or not at all.

    Raises
    ------
    OSError
        With the name of the file; an earlier file is unchanged.
    """
    import pyarrow as pa
    import pyarrow.parquet

    table = pa.Table.from_pandas(frame, preserve_index=False)
    metadata = {**(table.schema.metadata or {}), METADATA: json.dumps(identity, default=str).encode()}
    temporary = path.with_name(f".{path.name}.new")
    try:
        pyarrow.parquet.write_table(table.replace_schema_metadata(metadata), temporary, compression="zstd")
        temporary.replace(path)
    except OSError as error:
        with suppress(OSError):
            temporary.unlink()
        raise OSError(error.errno, error.strerror or str(error), str(path)) from None


def read_results(path: Path) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Return table and metadata of a Parquet file of a sweep.

    Raises
    ------
    ValueError
        If the file is none.
    """
    import pyarrow as pa
    import pyarrow.parquet

    try:
        table = pyarrow.parquet.read_table(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise ValueError(f"{path}: is no Parquet file ({' '.join(str(error).split())[:80]}); name another") from None
    text = (table.schema.metadata or {}).get(METADATA)
    if text is None:
        raise ValueError(f"{path}: has no metadata of a sweep; name a file that `sweep` wrote")
    return table.to_pandas(), json.loads(text)
