"""Rows of numbers of the power units by place of the train, linear between the places."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise

__all__ = ["check_rows", "row_at"]


def check_rows(key: str, noun: str, places: Sequence[float], rows: Sequence[Sequence[float]], units: int) -> None:
    """Check that places increase, and that every row has one number per power unit.

    Parameters
    ----------
    key, noun
        Key of the scenario, and the plural of its numbers, for the message.
    places
        Positions of vehicle 0's centre [m].
    rows
        Numbers at every place.
    units
        Number of power units.

    Raises
    ------
    ValueError
        One line: key, value, problem; fix.
    """
    if any(after <= before for before, after in pairwise(places)):
        raise ValueError(f"{key}: places do not increase; sort the entries by 'at'")
    for place, row in zip(places, rows, strict=True):
        if len(row) != units:
            raise ValueError(
                f"{key}: {len(row)} {noun} at {place:g} m, but the train has {units} power units; give one for each"
            )


def row_at(places: Sequence[float], rows: Sequence[Sequence[float]], position: float) -> list[float]:
    """Return the row at a position [m]; the first and the last rows hold beyond their places.

    Parameters
    ----------
    places
        Increasing positions [m], one or more.
    rows
        One row per place, all of one length.
    position
        Position [m].
    """
    after = bisect_right(places, position)
    if after in (0, len(places)):
        return list(rows[max(after - 1, 0)])
    begin, end = places[after - 1], places[after]
    weight = (position - begin) / (end - begin)
    return [a + weight * (b - a) for a, b in zip(rows[after - 1], rows[after], strict=True)]
