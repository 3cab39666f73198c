"""Tables of topics with messages of variable length: profiles, speed limits, diagnostics."""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from typing import Any

import numpy as np
import pandas as pd

from train_ato.log.tables.columns import TIME, column, diagnostic_column
from train_ato.log.tables.tables import in_order
from train_ato.loop.series import seconds
from train_ato.messages.codec.variable import decode_diagnostic, decode_trajectory
from train_ato.messages.topics import BY_NAME
from train_ato.messages.types import Trajectory

__all__ = ["diagnostic_table", "trajectory_table"]


def trajectory_table(topic: str, payloads: Sequence[bytes]) -> pd.DataFrame:
    """Return one row per knot of the profiles, or per step of the limits, over the time of the knot.

    Raises
    ------
    ValueError
        For bytes that are not a trajectory.
    """
    tables = [_knots(topic, decode_trajectory(payload)) for payload in payloads]
    return tables[0] if len(tables) == 1 else pd.concat(tables)


def _knots(topic: str, trajectory: Trajectory) -> pd.DataFrame:
    columns: dict[str, Any] = {}
    for place in BY_NAME[topic].places:
        if place.field == "stamp":
            columns[column(topic, place.path)] = np.full(trajectory.time.size, trajectory.stamp * 1e-9)
        elif place.field != "time" and (values := getattr(trajectory, place.field)).size:
            columns[column(topic, place.path)] = values
    return pd.DataFrame(columns, index=pd.Index(seconds(trajectory.time), name=TIME))


def diagnostic_table(payloads: Sequence[bytes]) -> pd.DataFrame:
    """Return one row per message: ``node``, ``level``, ``message`` and a column per key.

    A key with only numbers is a column of numbers, with NaN for missing values; else a column of texts.

    Raises
    ------
    ValueError
        For bytes that are not diagnostics.
    """
    found = filter(attrgetter("node"), map(decode_diagnostic, payloads))
    rows = sorted(found, key=lambda row: (row.stamp, row.node))
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
