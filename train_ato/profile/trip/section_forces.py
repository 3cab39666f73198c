"""Traction and electric brake of a trip in neutral sections, power limits, and sections with another adhesion.

The limits are those of the planner for shorter trains (:class:`train_ato.profile.planner.place_limits.PlaceLimits`):
the units share a force in proportion, so the most limited unit limits the train. The profile is an average of the run
over time. The limits of a section therefore hold :data:`MARGIN` before and after it, and the force changes to them with
the rate of the settings. Shoes at low adhesion are limited by the plant of :mod:`.driven_run` only.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array
from train_ato.profile.planner.place_limits import PlaceLimits
from train_ato.profile.planner.train_tables import SPEED_STEP as TABLE_STEP
from train_ato.profile.planner.train_tables import TrainTables

Integers = NDArray[np.int64]
MARGIN = 7.5
"""Time before and after a section with its limits [s]: half of the window of the average of the speed."""


class SectionForces:
    """Largest traction and electric brake of a train by the place of vehicle 0's centre.

    Parameters
    ----------
    model
        Nominal train on its line.
    top_speed
        Largest speed of the tables [m/s].

    Attributes
    ----------
    breaks : Array, shape (m,)
        Rising places at which the forces change [m]; empty for a line without such sections.
    """

    def __init__(self, model: TrainModel, top_speed: float) -> None:
        line, offsets = model.line, model.offsets
        self.breaks: Array = np.zeros(0)
        if not (line.neutral_sections or line.power_limits or line.adhesion):
            return
        limits = PlaceLimits(line, model.consist, TrainTables(model.consist, top_speed))
        self.breaks = np.unique(limits.breaks[:, None] + offsets)
        inside = np.concatenate(([self.breaks[0] - 1.0], self.breaks))
        zones = np.zeros((inside.size, len(model.consist.vehicles)), dtype=np.int64)
        zones[:, list(model.units)] = limits.zones_at(inside[:, None] - offsets)
        rows, which = np.unique(zones, axis=0, return_inverse=True)
        tables = np.stack([np.stack(limits.available(tuple(row), equal_parts=True)[:2]) for row in rows.tolist()])
        self._tables = tables[which.ravel()]

    def least(self, begin: float, end: float) -> Array:
        """Return the least forces between two places over the speed [N], shape (2, speeds): traction, electric brake.

        The speeds are multiples of ``TABLE_STEP``.
        """
        first, last = np.searchsorted(self.breaks, (begin, end), side="right")
        return np.asarray(self._tables[first : last + 1].min(axis=0))

    def over_cells(self, edges: Array, limit: Array, speed: Array) -> tuple[Array, Integers]:
        """Return the tables of the cells and the table of every cell, with the margin at the limit of the speed.

        Parameters
        ----------
        edges : Array, shape (cells + 1,)
            Limits of the cells [m].
        limit : Array, shape (cells + 1,)
            Highest speed there [m/s].
        speed : Array, shape (speeds,)
            Speeds of the tables [m/s].

        Returns
        -------
        tables : Array, shape (tables, 2, speeds)
            Traction and electric brake [N].
        which : Array, shape (cells,)
            Number of the table.
        """
        way = MARGIN * limit
        found = np.stack([self.least(*row) for row in zip(edges[:-1] - way[:-1], edges[1:] + way[1:], strict=True)])
        index = np.minimum(np.rint(speed / TABLE_STEP).astype(np.int64), found.shape[2] - 1)
        tables, which = np.unique(found[:, :, index], axis=0, return_inverse=True)
        return tables, which.ravel()

    def at(self, position: float, velocity: float, slew: float) -> tuple[float, float]:
        """Return the largest traction and electric brake at a place and speed, with the change before a section [N].

        Parameters
        ----------
        position, velocity
            Of vehicle 0 [m, m/s].
        slew
            Largest rate of the force [N/s].
        """
        way, speed = MARGIN * velocity, max(velocity, 0.1)
        first, last = np.searchsorted(self.breaks, (position - way, position + way), side="right")
        column = self._tables[first:, :, min(round(velocity / TABLE_STEP), self._tables.shape[2] - 1)]
        present, ahead = column[: last - first + 1].min(axis=0), column[last - first + 1 :]
        if len(ahead):
            time = (self.breaks[last:] - position - way) / speed
            present = np.minimum(present, (ahead + slew * time[:, None]).min(axis=0))
        return float(present[0]), float(present[1])
