"""Sliding-mode laws as arrays of their compiled steps, and back."""

from __future__ import annotations

from typing import Any

import numpy as np

from train_ato.control.compiled import sliding as c
from train_ato.control.laws.fixed_time_smc import BRANCH_ERROR, LARGE, MIN_ERROR, SMALL, FixedTimeSmc
from train_ato.messages.types import Array


def fixed_time_smc_constants(law: FixedTimeSmc) -> Array:
    """Return the constants of `fixed_time_smc`."""
    p, place = law.parameters, law._offsets[0]._place
    head = [p.surface, p.reaching, p.unmatched, LARGE, SMALL, LARGE - 1.0, SMALL - 1.0, BRANCH_ERROR, MIN_ERROR,
            place._period, place._gain, place._rate_gain, law._measured]  # fmt: skip
    return np.array([*map(float, head), *law._mass])


def sliding_state(law: Any) -> Array:
    """Return the present state of a sliding-mode law."""
    rows = [
        (offset._speed is not None, offset._speed or 0.0, offset._place._value is not None,
         offset._place._value or 0.0, offset._place.unknown_rate)
        for offset in law._offsets
    ]  # fmt: skip
    return np.array(rows, dtype=np.float64).ravel()


def take_sliding_state(law: Any, values: list[float]) -> None:
    """Set the state of a sliding-mode law."""
    for offset, (has_speed, speed, known, value, rate) in zip(law._offsets, _rows(values, c.T_ENTRIES), strict=True):
        offset._speed = speed if has_speed else None
        offset._place._value, offset._place.unknown_rate = value if known else None, rate


def _rows(values: list[float], length: int) -> list[list[float]]:
    return [values[first : first + length] for first in range(0, len(values), length)]
