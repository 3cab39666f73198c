"""Tables of the topics whose messages vary in length: profiles, speed limits, diagnostics."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from train_ato.cdr import SECOND
from train_ato.frames.columns import TIME, column, diagnostic_column
from train_ato.frames.tables import in_order, seconds
from train_ato.topics import EPOCH_NS
from train_ato.types import Diagnostic, Trajectory
from train_ato.wire_variable import decode_diagnostic, decode_trajectory

__all__ = ["diagnostic_table", "trajectory_table"]


def trajectory_table(topic: str, payloads: Sequence[bytes]) -> pd.DataFrame:
    """Return the knots of the profiles, or the steps of the limits: one row each, over the time of the knot.

    Raises
    ------
    ValueError
        For bytes that are no trajectory.
    """
    tables = [_knots(topic, decode_trajectory(payload)) for payload in payloads]
    return tables[0] if len(tables) == 1 else pd.concat(tables)


def _knots(topic: str, trajectory: Trajectory) -> pd.DataFrame:
    values = {
        "points[].positions": trajectory.position,
        "points[].velocities": trajectory.velocity,
        "points[].accelerations": trajectory.acceleration,
        "header.stamp": np.full(trajectory.time.size, trajectory.stamp * 1e-9),
    }
    columns = {name: entry for field, entry in values.items() if entry.size and (name := column(topic, field))}
    return pd.DataFrame(columns, index=pd.Index(seconds(trajectory.time), name=TIME))


def diagnostic_table(payloads: Sequence[bytes]) -> pd.DataFrame:
    """Return one row for each message: ``node``, ``level``, ``message`` and a column for each key.

    A key whose values are all numbers is a column of numbers, NaN where a node does not say it; else of texts.

    Raises
    ------
    ValueError
        For bytes that are no diagnostics.
    """
    rows = sorted((_diagnostic(payload) for payload in payloads), key=lambda row: (row.stamp, row.node))
    keys: dict[str, None] = {key: None for row in rows for key in row.values}
    columns: dict[str, Any] = {
        "node": [row.node for row in rows],
        "level": np.array([row.level for row in rows], dtype=np.int64),
        "message": [row.message for row in rows],
    }
    for key in keys:
        columns[diagnostic_column(key)] = _column([row.values.get(key) for row in rows])
    index = pd.Index(seconds(np.array([row.stamp for row in rows], dtype=np.int64)), name=TIME)
    return in_order(pd.DataFrame(columns, index=index))


def _column(texts: list[str | None]) -> Any:
    try:
        return np.array([np.nan if text is None else float(text) for text in texts])
    except ValueError:
        return texts


def _diagnostic(data: bytes) -> Diagnostic:
    """Read diagnostics of one node as they are written here; whatever differs goes the long way."""
    if data[:2] != b"\x00\x01" or data[12:17] != b"\x01\x00\x00\x00\x00" or data[20:24] != b"\x01\x00\x00\x00":
        return decode_diagnostic(data)
    try:
        (node, message, _), place = _texts(data, 25, 3)
        place += -place % 4
        (count,) = _LENGTH.unpack_from(data, place)
        pairs, _ = _texts(data, place + 4, 2 * count)
    except (struct.error, UnicodeDecodeError):
        return decode_diagnostic(data)
    whole, rest = _STAMP.unpack_from(data, 4)
    stamp = whole * SECOND + rest - EPOCH_NS
    return Diagnostic(stamp, node, data[24], message, dict(zip(pairs[::2], pairs[1::2], strict=True)))


_LENGTH = struct.Struct("<I")
_STAMP = struct.Struct("<iI")


def _texts(data: bytes, place: int, count: int) -> tuple[list[str], int]:
    """Read so many texts; return them and where they end."""
    texts, last = [], len(data)
    for _ in range(count):
        place += -place % 4
        (size,) = _LENGTH.unpack_from(data, place)
        end = place + 4 + size
        if not size or end > last:
            raise struct.error("text beyond the end")
        texts.append(data[place + 4 : end - 1].decode())
        place = end
    return texts, place
