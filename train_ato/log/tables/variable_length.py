"""Tables of topics with messages of variable length: profiles, speed limits, diagnostics."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from operator import attrgetter
from typing import Any

import numpy as np
import pandas as pd

from train_ato.log.tables.columns import TIME, column, diagnostic_column
from train_ato.loop.series import seconds
from train_ato.messages.codec.variable import decode_diagnostic, decode_trajectory
from train_ato.messages.topics import BY_NAME
from train_ato.messages.types import Diagnostic, Trajectory

__all__ = ["FIXED", "diagnostic_order", "diagnostic_table", "diagnostic_texts", "numbers_or_texts", "trajectory_table"]

FIXED = ("node", "level", "message")
"""Columns of diagnostics before those of the keys."""


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
    table = diagnostic_texts(map(decode_diagnostic, payloads))
    return table.assign(**{key: numbers_or_texts(table[key].tolist()) for key in table.columns[len(FIXED) :]})


def diagnostic_texts(messages: Iterable[Diagnostic]) -> pd.DataFrame:
    """Return one row per message in the order of stamp and node, with the values of all keys as texts."""
    rows = sorted(filter(attrgetter("node"), messages), key=diagnostic_order)
    keys: dict[str, None] = {key: None for row in rows for key in row.values}
    columns: dict[str, Any] = {
        "node": [row.node for row in rows],
        "level": np.array([row.level for row in rows], dtype=np.int64),
        "message": [row.message for row in rows],
    }
    for key in keys:
        columns[diagnostic_column(key)] = np.array([row.values.get(key) for row in rows], dtype=object)
    index = pd.Index(seconds(np.array([row.stamp for row in rows], dtype=np.int64)), name=TIME)
    return pd.DataFrame(columns, index=index)


def diagnostic_order(message: Diagnostic) -> tuple[int, str]:
    """Return stamp and node, the order of the rows."""
    return message.stamp, message.node


def numbers_or_texts(texts: Sequence[str | None]) -> Any:
    """Return texts as numbers, NaN for missing ones; unchanged if one is not a number."""
    try:
        return np.array([np.nan if text is None else float(text) for text in texts])
    except ValueError:
        return texts
