"""Disturbances of a run added up, as arrays for the kernel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from plant_sim.disturbances import Disturbance, Gust, Outside, Paper002, Turbulence, UnmodelledGrade, Vehicles
from plant_sim.states import Array


class _Wind:
    """State of one :class:`Turbulence`: an Ornstein-Uhlenbeck sequence at the tick."""

    def __init__(self, source: Turbulence, vehicles: int, tick: float) -> None:
        self._keep = float(np.exp(-tick / source.correlation))
        self._gain = source.acceleration_rms * float(np.sqrt(1.0 - self._keep**2))
        self._value = np.zeros(vehicles)

    def tick(self, t: Array, mass: Array, draws: Array) -> Outside:
        self._value = self._keep * self._value + self._gain * draws
        return Outside(np.broadcast_to(self._value * mass, (len(t), len(mass))))


class OutsideForces:
    """All disturbances of a run, added up for the vehicles that any of them lists.

    Parameters
    ----------
    disturbances
        As in the scenario; grades are left to the line.
    mass : Array, shape (n,)
        Inertial masses [kg].
    step, tick : float
        Plant step and tick [s].
    streams
        One generator per disturbance, in the order given.
    """

    def __init__(
        self,
        disturbances: Sequence[Disturbance],
        mass: Array,
        step: float,
        tick: float,
        streams: Sequence[np.random.Generator],
    ) -> None:
        self._mass = mass.copy()  # as at the start: a later jump of mass does not change what a disturbance weighs
        self._acting: list[tuple[Any, np.random.Generator | None, Vehicles]] = [
            (
                _Wind(source, len(source.listed(len(mass))), tick) if isinstance(source, Turbulence) else source,
                random,
                source.listed(len(mass)),
            )
            for source, random in zip(disturbances, streams, strict=True)
            if not isinstance(source, UnmodelledGrade)
        ]
        self._passing: list[Gust] = []
        self._no_draws = np.zeros(0)
        self.has_drift = any(isinstance(source, Paper002) for source, _, _ in self._acting)
        self._offsets: Array = np.arange(round(tick / step)) * np.float64(step)
        self._arrange()

    def _arrange(self) -> None:
        """Give every listed vehicle a column."""
        acting = [*self._acting, *((gust, None, gust.listed(len(self._mass))) for gust in self._passing)]
        self.vehicles = np.array(sorted({i for _, _, listed in acting for i in listed}), dtype=np.int64)
        column = {int(vehicle): j for j, vehicle in enumerate(self.vehicles)}
        self._sources = [
            (source, random, np.array([column[i] for i in listed], dtype=np.int64), self._mass[list(listed)])
            for source, random, listed in acting
        ]
        self._sum = np.zeros((3, len(self._offsets), len(self.vehicles)))

    def add(self, gust: Gust) -> None:
        """Let a gust blow that no scenario knows of; it is forgotten when it is over.

        Raises
        ------
        ValueError
            If it lists a vehicle that the train does not have.
        """
        gust.listed(len(self._mass))
        self._passing.append(gust)
        self._arrange()

    @property
    def gusty(self) -> bool:
        """Whether an added gust is not over yet."""
        return bool(self._passing)

    def drop_over(self, now: float) -> bool:
        """Forget the added gusts that are over; tell whether the columns changed."""
        left = [gust for gust in self._passing if now < gust.end]
        if len(left) == len(self._passing):
            return False
        self._passing = left
        self._arrange()
        return True

    def tick(self, start: float) -> Array:
        """Return force, force per speed and drift of the tick from ``start`` on, shape (3, steps, listed vehicles)."""
        if not self._sources:
            return self._sum
        t: Array = np.add(start, self._offsets)
        self._sum[:] = 0.0
        for source, random, columns, mass in self._sources:
            draws = self._no_draws if random is None else random.standard_normal(len(columns))
            outside = source.tick(t, mass, draws)
            for row, part in enumerate(outside):
                if part is not None:
                    self._sum[row][:, columns] += part
        return self._sum
