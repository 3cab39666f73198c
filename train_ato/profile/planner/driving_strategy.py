"""Inputs, driving strategy and resulting knots of one section between two stops."""

from dataclasses import dataclass

import numpy as np

from plant_sim.consist import Consist
from plant_sim.line import Line
from train_ato.messages.types import Array
from train_ato.profile.planner.line_tables import LineForce, PlaceLimits, SpeedLimits, place_limits
from train_ato.profile.planner.settings import PlanSettings
from train_ato.profile.planner.train_tables import AvailableForce, TrainTables

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
    coasting : Array, optional
        Fall of v²/2 over the distance of a train that coasts to the curve, before each of its places [m/s²].
    electric : Array, optional
        v²/2 above which the electric brake is used, at the places of the curve.
    floor : pair of arrays, optional
        Places and v²/2 below which there is traction in any case.
    """

    cut_off: float = np.inf
    coast_above: float = np.inf
    cap: float = np.inf
    curve: tuple[Array, Array] | None = None
    coasting: Array | None = None
    electric: Array | None = None
    floor: tuple[Array, Array] | None = None

    def cut_off_energy(self, places: Array) -> Array:
        """Return v²/2 above which there is no traction [m²/s²], at places of the front [m]."""
        energy = np.full(places.size, self.cut_off**2 / 2)
        if self.curve is not None:
            energy = np.minimum(energy, np.maximum(self._between(places, self.curve[1]), MIN_CRUISE**2 / 2))
        return energy if self.floor is None else np.maximum(energy, np.interp(places, *self.floor))

    def brake_onset_energy(self, places: Array) -> Array:
        """Return v²/2 above which the electric brake is used [m²/s²], at places of the front [m]."""
        if self.curve is None or self.electric is None:
            return np.full(places.size, np.inf)
        onset = self._between(places, self.electric)
        return np.asarray(np.maximum(onset, self.cut_off_energy(places)))

    def _between(self, places: Array, energies: Array) -> Array:
        """Return a curve at places [m²/s²]: a chord, or coasting to the next point where the curve falls faster.

        A train above that point cannot reach it within the cell: on a chord it would switch up to a cell too late.
        """
        assert self.curve is not None
        chord = np.interp(places, self.curve[0], energies)
        if self.coasting is None:
            return chord
        following = np.minimum(np.searchsorted(self.curve[0], places), energies.size - 1)
        coasted = energies[following] + self.coasting[following] * (self.curve[0][following] - places)
        return np.asarray(np.minimum(chord, np.maximum(coasted, energies[following])))


MINIMUM_TIME = DrivingStrategy()
"""Strategy of the minimum-time run: no threshold."""


@dataclass(frozen=True, slots=True)
class SectionInputs:
    """Train, line forces, speed limits, settings and limits by place of a section.

    Attributes
    ----------
    ceiling : pair of arrays, optional
        Increasing places of the front [m] and speeds [m/s] of a speed limit in addition to that of the line.
    """

    train: TrainTables
    force: LineForce
    limits: SpeedLimits
    settings: PlanSettings
    places: PlaceLimits | None = None
    ceiling: tuple[Array, Array] | None = None

    @classmethod
    def of_line(
        cls,
        line: Line,
        consist: Consist,
        settings: PlanSettings,
        *,
        available: AvailableForce | None = None,
        reduction: float | None = None,
        ceiling: tuple[Array, Array] | None = None,
    ) -> "SectionInputs":
        """Return the inputs of all sections of a train on a line; available force and reduction as in its tables."""
        settings = settings.for_train(consist)
        train = TrainTables(
            consist, settings.speed_max, air_brake=settings.air_brake, point_mass=settings.point_mass,
            available=available, reduction=reduction,
        )  # fmt: skip
        force = LineForce(line, train, over_length=settings.grade_over_length)
        limits = SpeedLimits(line, train.speed_max)
        return cls(train, force, limits, settings, place_limits(line, consist, train), ceiling)
