"""Distribution of a total force over independent power units: shares by place, on top of the forces of the law.

The laws control every unit with its own speed and position. On a long train the couplings between two units stretch by
some metres, and the feedback of the units then drives them against each other. With shares by place, the laws supply
the total U of the force only, and the share s_i(x) at the place x of the train gives the force of every unit::

    u_i = s_i(x) U

A unit at a limit leaves the rest to the others.
"""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import Field, model_validator

from plant_sim.si_model import SiModel
from plant_sim.summation import plain_sum
from plant_sim.units import Length, Ratio
from train_ato.control.rows_by_place import check_rows, row_at

SUM_TOLERANCE = 0.005
"""Largest deviation of a sum of shares from 1: three units with two decimals each."""


class SharesAt(SiModel):
    """Shares of the power units in the total force at a place of vehicle 0's centre; linear between the places."""

    at: Length = Field(description="place of vehicle 0's centre")
    shares: tuple[Ratio, ...] = Field(description="share of every power unit, front first; their sum is 1")

    @model_validator(mode="after")
    def _complete(self) -> SharesAt:
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
        return row_at(self._places, self._rows, position) if self._rows else self._fixed

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
