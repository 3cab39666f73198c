"""Distribution of a total force over independent power units: shares by place, on top of the forces of the law.

The laws control every unit with its own speed and position. On a long train the couplings between two units stretch by
some metres, and the feedback of the units then drives them against each other. With shares by place, the laws supply
only the total force U. The share s_i(x) at the place x of the train then gives the force of every unit::

    u_i = s_i(x) U

A unit at a limit leaves the rest to the others.

Planned motion of the power units against the profile: the laws correct only the deviation from it.

The couplings of a long train stretch and close by some metres on every change of grade and force. The profile is the
motion of one point. Feedback on the speed and position of a power unit converts the motion of the couplings to traction
and braking. A plan expects the displacement d_i(x) for unit i at the place x of the train. The law then receives::

    x_i - d_i(x),    v_i - d_i'(x) v_0

so that a train which moves as planned, couplings included, needs no correction. d_i is a cubic between the places, so
that the speed is the derivative of the place: an observer of both would estimate their difference as a disturbance.
"""

import dataclasses
from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from pydantic import Field, model_validator

from plant_sim.elementary import plain_sum
from plant_sim.si_model import SiModel
from plant_sim.units import Length, Place, Ratio
from train_ato.messages.types import Measurement


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
    """
    if any(after <= before for before, after in pairwise(places)):
        raise ValueError(f"{key}: places do not increase; sort the entries by 'at'")
    for place, row in zip(places, rows, strict=True):
        if len(row) != units:
            raise ValueError(
                f"{key}: {len(row)} {noun} at {place:g} m, but the train has {units} power units; give one for each"
            )


SUM_TOLERANCE = 0.005
"""Largest deviation of a sum of shares from 1: three units with two decimals each."""


class SharesAt(SiModel):
    """Shares of the power units in the total force at a place of vehicle 0's centre; linear between the places."""

    at: Place = Field(description="place of vehicle 0's centre", examples=[1200.0])
    shares: tuple[Ratio, ...] = Field(
        description="share of every power unit, front first; their sum is 1", examples=[(0.6, 0.4)]
    )

    @model_validator(mode="after")
    def _complete(self) -> "SharesAt":
        total = plain_sum(self.shares)
        if min(self.shares, default=0.0) < 0.0 or abs(total - 1.0) > SUM_TOLERANCE:
            raise ValueError(f"shares {list(self.shares)} have the sum {total:g}; give shares from 0 on with the sum 1")
        return self


class ForceDistribution:
    """Forces of the power units with shares by place.

    Parameters
    ----------
    shares
        Shares at increasing places; the first and the last ones hold beyond them.
    fixed
        Fixed shares of the model.

    Raises
    ------
    ValueError
        One line, if the places do not increase or the number of shares is not that of the units.
    """

    def __init__(self, shares: Sequence[SharesAt], fixed: Sequence[float]) -> None:
        self._places = [entry.at for entry in shares]
        check_rows("force_shares", "shares", self._places, [entry.shares for entry in shares], len(fixed))
        self._fixed = list(fixed)
        self._rows = [[share / plain_sum(entry.shares) for share in entry.shares] for entry in shares]

    def shares_at(self, position: float) -> list[float]:
        """Return the shares at a position of vehicle 0's centre [m]."""
        places, rows, after = self._places, self._rows, bisect_right(self._places, position)
        if after in (0, len(places)):
            return list(rows[max(after - 1, 0)]) if rows else self._fixed
        weight = (position - places[after - 1]) / (places[after] - places[after - 1])
        return [a + weight * (b - a) for a, b in zip(rows[after - 1], rows[after], strict=True)]

    def forces(
        self, position: float, wanted: Sequence[float], low: Sequence[float], high: Sequence[float]
    ) -> list[float]:
        """Return the force of every unit [N], with the total of ``wanted``.

        Parameters
        ----------
        position
            Position of vehicle 0's centre [m].
        wanted
            Forces of the law inside the limits [N].
        low, high
            Smallest and largest force of every unit [N].
        """
        total, shares = plain_sum(wanted), self.shares_at(position)
        sent = [min(max(s * total, least), most) for s, least, most in zip(shares, low, high, strict=True)]
        rest = total - plain_sum(sent)
        ends = high if rest > 0.0 else low
        room = [end - force for end, force in zip(ends, sent, strict=True)]
        whole = plain_sum(room)
        if rest == 0.0 or whole == 0.0:
            return sent
        part = min(rest / whole, 1.0)
        return [force + part * free for force, free in zip(sent, room, strict=True)]


class DisplacementAt(SiModel):
    """Displacement of the power units against the profile at a place of vehicle 0's centre; cubic between places."""

    at: Place = Field(description="place of vehicle 0's centre", examples=[1200.0])
    displacement: tuple[Length, ...] = Field(
        description="distance of every power unit ahead of its nominal place behind the profile, front first",
        examples=[(0.0, 0.05)],
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
