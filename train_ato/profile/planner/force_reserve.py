"""Reserve of traction and brakes for the jerk limit, place by place.

The moving average that limits the jerk mixes the forces of one window.  Where the mean exceeds the envelope at the mean
speed, the force before the averaging is reduced, at this place only: one reserve for the whole run would take the
traction that a long train needs on its steepest climb because of an excess at its start.
"""

from __future__ import annotations

import numpy as np

from train_ato.messages.types import Array
from train_ato.profile.planner.line_tables import PlaceGrid
from train_ato.profile.planner.passes import sliding_extreme

MAX_RESERVE = 1.0
"""Largest fraction of a force that is reserved; all of it above the end of an envelope."""
STEP_FACTOR, MIN_STEP = 1.1, 1e-4
"""Increase of a reserve: factor on the relative excess, and constant part."""


class ForceReserve:
    """Reserved fractions of traction and brakes in the cells of a section.

    Parameters
    ----------
    grid
        Cells of the whole section.

    Attributes
    ----------
    changes : int
        Number of increases.
    """

    def __init__(self, grid: PlaceGrid) -> None:
        self._grid = grid
        self._fractions: Array = np.zeros((2, grid.cells))
        self.changes = 0

    def raise_at(self, places: Array, widths: Array, excess: Array) -> None:
        """Increase the reserve around the places of an excess.

        Parameters
        ----------
        places, widths : Array, shape (n,)
            Places of the front, and distance on either side over which the forces are mixed [m].
        excess : Array, shape (2, n)
            Relative excess of the traction and of the brake force, 0 without.
        """
        grid = self._grid
        cell = np.clip(np.searchsorted(grid.places, places, side="right") - 1, 0, grid.cells - 1)
        for fraction, over in zip(self._fractions, excess, strict=True):
            if not over.any():
                continue
            most, width = np.zeros(grid.cells), np.zeros(grid.cells)
            np.maximum.at(most, cell, over)
            np.maximum.at(width, cell[over > 0.0], widths[over > 0.0])
            reach = np.full(grid.cells, float(width.max()))
            near = sliding_extreme(width, reach, grid.places, True)
            spread = sliding_extreme(most, near, grid.places, True)
            fraction += np.where(spread > 0.0, STEP_FACTOR * spread + MIN_STEP, 0.0)
            np.minimum(fraction, MAX_RESERVE, out=fraction)
        self.changes += 1

    def over(self, grid: PlaceGrid) -> tuple[Array, Array]:
        """Return the reserves of traction and brakes in the cells of a grid, shape (cells,) each."""
        middle = 0.5 * (grid.places[:-1] + grid.places[1:])
        cell = np.clip(np.searchsorted(self._grid.places, middle, side="right") - 1, 0, self._grid.cells - 1)
        return self._fractions[0, cell], self._fractions[1, cell]
