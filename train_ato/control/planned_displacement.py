"""Planned motion of the power units against the profile: the laws correct only the deviation from it.

The couplings of a long train stretch and close by some metres on every change of grade and force. The profile is the
motion of one point; feedback on the speed and position of a power unit converts the motion of the couplings to traction
and braking. With the displacement d_i(x) that a plan expects for unit i at the place x of the train, the law receives::

    x_i - d_i(x),    v_i - d_i'(x) v_0

so that a train which moves as planned, couplings included, needs no correction. d_i is a cubic between the places, so
that the speed is the derivative of the place: an observer of both would estimate their difference as a disturbance.
"""

from __future__ import annotations

import dataclasses
from bisect import bisect_right
from collections.abc import Sequence

import numpy as np
from pydantic import Field

from plant_sim.si_model import SiModel
from plant_sim.units import Length
from train_ato.control.rows_by_place import check_rows
from train_ato.messages.types import Measurement


class DisplacementAt(SiModel):
    """Displacement of the power units against the profile at a place of vehicle 0's centre; cubic between places."""

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
        self._places = [entry.at for entry in entries]
        self._rows = [entry.displacement for entry in entries]
        check_rows("unit_displacements", "displacements", self._places, self._rows, units)
        neighbours = [(max(k - 1, 0), min(k + 1, len(entries) - 1)) for k in range(len(entries))]
        self._slopes = [
            [
                (b - a) / max(self._places[high] - self._places[low], 1.0)
                for a, b in zip(self._rows[low], self._rows[high], strict=True)
            ]
            for low, high in neighbours
        ]

    def at(self, position: float) -> tuple[list[float], list[float]]:
        """Return displacements [m] and their derivatives [m/m] at a position of vehicle 0's centre [m]."""
        after = bisect_right(self._places, position)
        if after in (0, len(self._places)):
            row = self._rows[max(after - 1, 0)]
            return list(row), [0.0] * len(row)
        before = after - 1
        width = self._places[after] - self._places[before]
        w = (position - self._places[before]) / width
        displacements, slopes = [], []
        for a, b, slope_a, slope_b in zip(
            self._rows[before], self._rows[after], self._slopes[before], self._slopes[after], strict=True
        ):
            # cubic with the values and slopes of both places
            first, last = width * slope_a - (b - a), (b - a) - width * slope_b
            bow = w * (1.0 - w)
            displacements.append(a + w * (b - a) + bow * (first * (1.0 - w) + last * w))
            change = (1.0 - 2.0 * w) * (first * (1.0 - w) + last * w) + bow * (last - first)
            slopes.append((b - a + change) / width)
        return displacements, slopes

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
