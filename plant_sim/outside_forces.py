"""Sum of the disturbances of a run, as arrays for the kernel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from plant_sim.disturbances import (
    DisturbanceSource,
    Gust,
    OutsideForce,
    Paper002,
    Turbulence,
    UnmodelledGrade,
    Vehicles,
)
from plant_sim.states import Array

ALL = slice(None)
"""Columns of a source that acts on all listed vehicles; as a slice the sum takes 1 instead of 4 us."""


class _Wind:
    """Ornstein-Uhlenbeck sequence of one :class:`Turbulence`, sampled at the tick."""

    def __init__(self, source: Turbulence, vehicles: int, tick: float) -> None:
        self._decay = float(np.exp(-tick / source.correlation))
        self._gain = source.acceleration_rms * float(np.sqrt(1.0 - self._decay**2))
        self._value = np.zeros(vehicles)

    def tick(self, t: Array, mass: Array, draws: Array) -> OutsideForce:
        self._value = self._decay * self._value + self._gain * draws
        return OutsideForce(np.broadcast_to(self._value * mass, (len(t), len(mass))))


class OutsideForces:
    """Sum of all disturbances of a run on the vehicles that they list.

    Parameters
    ----------
    disturbances
        Disturbances of the scenario; grades belong to the line.
    mass : Array, shape (n,)
        Inertial masses [kg].
    step, tick : float
        Plant step and tick [s].
    streams
        One generator per disturbance, in the same order.
    """

    def __init__(
        self,
        disturbances: Sequence[DisturbanceSource],
        mass: Array,
        step: float,
        tick: float,
        streams: Sequence[np.random.Generator],
    ) -> None:
        self._mass = mass.copy()  # initial masses: a later jump of mass does not change the disturbances
        self._acting: list[tuple[Any, np.random.Generator | None, Vehicles]] = [
            (
                _Wind(source, len(source.listed(len(mass))), tick) if isinstance(source, Turbulence) else source,
                random,
                source.listed(len(mass)),
            )
            for source, random in zip(disturbances, streams, strict=True)
            if not isinstance(source, UnmodelledGrade)
        ]
        self._added_gusts: list[Gust] = []
        self._no_draws = np.zeros(0)
        self.has_drift = any(isinstance(source, Paper002) for source, _, _ in self._acting)
        self._offsets: Array = np.arange(round(tick / step)) * np.float64(step)
        self._arrange()

    def _arrange(self) -> None:
        """Assign a column to every listed vehicle."""
        acting = [*self._acting, *((gust, None, gust.listed(len(self._mass))) for gust in self._added_gusts)]
        listed_vehicles = sorted({i for _, _, listed in acting for i in listed})
        self.vehicles = np.array(listed_vehicles, dtype=np.int64)
        column = {vehicle: j for j, vehicle in enumerate(listed_vehicles)}
        self._sources = [
            (
                source,
                random,
                ALL if list(listed) == listed_vehicles else np.array([column[i] for i in listed], dtype=np.int64),
                self._mass[list(listed)],
            )
            for source, random, listed in acting
        ]
        self.acts = bool(listed_vehicles)
        self._sum = np.zeros((3, len(self._offsets), len(self.vehicles)))

    def add(self, gust: Gust) -> None:
        """Add a gust that is not in the scenario; it is removed after its end.

        Raises
        ------
        ValueError
            If it lists a vehicle outside the train.
        """
        gust.listed(len(self._mass))
        self._added_gusts.append(gust)
        self._arrange()

    @property
    def gusty(self) -> bool:
        """True while an added gust has not ended."""
        return bool(self._added_gusts)

    def drop_over(self, now: float) -> bool:
        """Remove the added gusts that ended before a time [s]; return True if the columns changed."""
        remaining = [gust for gust in self._added_gusts if now < gust.end]
        if len(remaining) == len(self._added_gusts):
            return False
        self._added_gusts = remaining
        self._arrange()
        return True

    def tick(self, start: float, speed: Array) -> Array:
        """Return force [N], force per speed [N s/m] and drift speed [m/s] of the tick from ``start`` [s] on.

        Parameters
        ----------
        start : float
            Time of the begin of the tick [s].
        speed : Array, shape (n,)
            Speed of every vehicle at that time [m/s].

        Returns
        -------
        Array, shape (3, steps, listed vehicles)
            Valid until the next call.
        """
        if not self._sources:
            return self._sum
        t: Array = np.add(start, self._offsets)
        self._sum[:] = 0.0
        for source, random, columns, mass in self._sources:
            draws = self._no_draws if random is None else random.standard_normal(len(mass))
            outside = source.tick(t, mass, draws)
            for row, part in zip(self._sum, outside, strict=False):
                if part is not None:
                    row[:, columns] += part
            if outside.per_cube is not None:
                self._sum[1][:, columns] += outside.per_cube * speed[self.vehicles[columns]] ** 2
        return self._sum
