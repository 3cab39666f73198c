"""Range of a vertical axis: from zero for quantities >= 0, and without bounds that would squash the other lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from train_ato.apps.report.quantities import BOUNDS, FROM_ZERO, SQUASH
from train_ato.messages.types import Array


@dataclass(frozen=True)
class AxisRange:
    """Range of an axis.

    Attributes
    ----------
    low, high : float
        Extremes of the lines that set the range.
    from_zero : bool
        True if the axis begins at zero.
    far : dict of float
        Least magnitude of every bound that does not set the range, by column.
    """

    low: float
    high: float
    from_zero: bool
    far: dict[str, float]

    def remark(self, column: str) -> str:
        """Return the value of a bound that is outside of the frame as text, "" for other lines."""
        least = self.far.get(column, 0.0)
        return f" (outside: {least:.0f} or more)" if least > max(abs(self.low), abs(self.high)) else ""


def axis_range(axis: str, lines: Sequence[tuple[str, Array]]) -> AxisRange:
    """Return the range of an axis.

    Parameters
    ----------
    axis
        Key of the title of the axis.
    lines
        Column and values of every line; NaN: no value.
    """
    finite = [(column, values) for column, values in lines if np.isfinite(values).any()]
    main = [values for column, values in finite if column.partition(":")[0] not in BOUNDS]
    low = min((float(np.nanmin(values)) for values in main), default=0.0)
    high = max((float(np.nanmax(values)) for values in main), default=0.0)
    reach = max(abs(low), abs(high))
    far = {
        column: float(np.nanmin(np.abs(values)))
        for column, values in finite
        if column in BOUNDS and main and reach > 0.0 and float(np.nanmax(np.abs(values))) > SQUASH * reach
    }
    near = [values for column, values in finite if column in BOUNDS and column not in far]
    return AxisRange(
        min([low, *(float(np.nanmin(values)) for values in near)]),
        max([high, *(float(np.nanmax(values)) for values in near)]),
        axis in FROM_ZERO and low >= -0.02 * reach,
        far,
    )
