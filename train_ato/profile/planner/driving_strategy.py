"""Inputs, driving strategy and resulting knots of one section between two stops."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from train_ato.messages.types import Array
from train_ato.profile.planner.line_tables import LineForce, SpeedLimits
from train_ato.profile.planner.place_limits import PlaceLimits
from train_ato.profile.planner.settings import PlanSettings
from train_ato.profile.planner.train_tables import TrainTables

MIN_CRUISE = 0.5
"""Speed up to which traction is always permitted, so that every train starts [m/s]."""


@dataclass(frozen=True, slots=True)
class DrivingStrategy:
    """Speed thresholds of traction, coasting and cruise [m/s].

    Attributes
    ----------
    cut_off : float
        No traction above this speed; downhill the train may run faster.
    coast_above : float
        Above this speed the train coasts before it brakes.
    cap : float
        Upper limit of the speed, also downhill.
    curve : pair of arrays, optional
        Switching curve: places and v²/2 above which there is no traction,
        see :mod:`train_ato.profile.planner.dynamic_programming`.
    scale : float
        Factor on the speeds of the curve.
    """

    cut_off: float = np.inf
    coast_above: float = np.inf
    cap: float = np.inf
    curve: tuple[Array, Array] | None = None
    scale: float = 1.0

    def cut_off_energy(self, places: Array) -> Array:
        """Return v²/2 above which there is no traction [m²/s²], at places of the front [m]."""
        flat = np.full(places.size, self.cut_off**2 / 2)
        if self.curve is None:
            return flat
        curve = self.scale**2 * np.interp(places, *self.curve)
        return np.asarray(np.minimum(flat, np.maximum(curve, MIN_CRUISE**2 / 2)))


MINIMUM_TIME = DrivingStrategy()
"""Strategy of the minimum-time run: no threshold."""


@dataclass(frozen=True, slots=True)
class SectionInputs:
    """Train, line forces, speed limits, settings and limits by place of a section."""

    train: TrainTables
    force: LineForce
    limits: SpeedLimits
    settings: PlanSettings
    places: PlaceLimits | None = None


@dataclass(frozen=True, slots=True)
class SectionKnots:
    """A section over time: place of the front [m], speed [m/s], acceleration [m/s²], own force [N] (> 0 traction)."""

    place: Array
    speed: Array
    acceleration: Array
    force: Array
