"""What a run is driven on and with, how fast it is driven, and what comes out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from train_ato.plan.line_tables import LineForce, SpeedLimits
from train_ato.plan.settings import PlanSettings
from train_ato.plan.train_tables import TrainTables
from train_ato.types import Array

__all__ = ["FASTEST", "Knots", "Style", "Track"]


@dataclass(frozen=True, slots=True)
class Style:
    """How fast a run is driven [m/s].

    Attributes
    ----------
    cut_off : float
        No traction above it; downhill the train may run faster.
    coast_above : float
        The train coasts towards a braking above it.
    cap : float
        Never faster, also downhill.
    curve : pair of arrays, optional
        Places and v²/2 above which there is no traction there, see :mod:`train_ato.plan.value`.
    scale : float
        On the speeds of the curve.
    """

    cut_off: float = np.inf
    coast_above: float = np.inf
    cap: float = np.inf
    curve: tuple[Array, Array] | None = None
    scale: float = 1.0

    def cut_off_energy(self, places: Array) -> Array:
        """Return v²/2 above which there is no traction, at places of the front."""
        flat = np.full(places.size, self.cut_off**2 / 2)
        if self.curve is None:
            return flat
        return np.asarray(np.minimum(flat, self.scale**2 * np.interp(places, *self.curve)))


FASTEST = Style()
"""Traction as long as nothing forbids it."""


@dataclass(frozen=True, slots=True)
class Track:
    """What a run is driven on and with."""

    train: TrainTables
    force: LineForce
    limits: SpeedLimits
    settings: PlanSettings


@dataclass(frozen=True, slots=True)
class Knots:
    """A driven run at some times: place of the front [m], speed, acceleration and own force [N] > 0 traction."""

    place: Array
    speed: Array
    rate: Array
    force: Array
