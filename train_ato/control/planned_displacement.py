"""Planned motion of the power units against the profile: the laws correct only the deviation from it.

The couplings of a long train stretch and close by some metres on every change of grade and force. The profile is the
motion of one point; feedback on the speed and position of a power unit converts the motion of the couplings to traction
and braking. With the displacement d_i(x) that a plan expects for unit i at the place x of the train, the law receives::

    x_i - d_i(x),    v_i - d_i'(x) v_0

so that a train which moves as planned, couplings included, needs no correction.
"""

from __future__ import annotations

import dataclasses
from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from pydantic import Field

from plant_sim.units import Length, SiModel
from train_ato.messages.types import Measurement


class DisplacementAt(SiModel):
    """Displacement of the power units against the profile at a place of vehicle 0's centre; linear between places."""

    at: Length = Field(description="place of vehicle 0's centre")
    displacement: tuple[Length, ...] = Field(
        description="distance of every power unit ahead of its nominal place behind the profile, front first"
    )


class PlannedDisplacement:
    """Displacements and their slopes over the place.

    Parameters
    ----------
    entries
        Displacements at increasing places; the first and the last ones hold beyond them.
    units
        Number of power units.

    Raises
    ------
    ValueError
        One line, if the places do not increase or the number of displacements is not that of the units.
    """

    def __init__(self, entries: Sequence[DisplacementAt], units: int) -> None:
        if any(after.at <= before.at for before, after in pairwise(entries)):
            raise ValueError("unit_displacements: places do not increase; sort the entries by 'at'")
        for entry in entries:
            if len(entry.displacement) != units:
                raise ValueError(
                    f"unit_displacements: {len(entry.displacement)} displacements at {entry.at:g} m, but the train has "
                    f"{units} power units; give one for each"
                )
        self._places = [entry.at for entry in entries]
        rows = [entry.displacement for entry in entries]
        neighbours = [(max(k - 1, 0), min(k + 1, len(rows) - 1)) for k in range(len(rows))]
        slopes = [
            [
                (b - a) / max(self._places[high] - self._places[low], 1.0)
                for a, b in zip(rows[low], rows[high], strict=True)
            ]
            for low, high in neighbours
        ]
        self._rows = [(*row, *slope) for row, slope in zip(rows, slopes, strict=True)]
        self._units = units

    def at(self, position: float) -> tuple[list[float], list[float]]:
        """Return displacements [m] and their slopes [m/m] at a position of vehicle 0's centre [m]."""
        n, after = self._units, bisect_right(self._places, position)
        if after in (0, len(self._places)):
            return list(self._rows[max(after - 1, 0)][:n]), [0.0] * n
        begin, end = self._places[after - 1], self._places[after]
        weight = (position - begin) / (end - begin)
        row = [a + weight * (b - a) for a, b in zip(self._rows[after - 1], self._rows[after], strict=True)]
        return row[:n], row[n:]

    def without(self, measurement: Measurement, position: float) -> Measurement:
        """Return a measurement without the planned displacements.

        Parameters
        ----------
        measurement
            State of the power units.
        position
            Position of vehicle 0's centre [m].
        """
        displacement, slope = self.at(position)
        speed = float(measurement.velocity[0])
        return dataclasses.replace(
            measurement,
            position=measurement.position - np.array(displacement),
            velocity=measurement.velocity - speed * np.array(slope),
        )
