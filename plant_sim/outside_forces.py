"""Sum of the disturbances of a run, as arrays for the kernel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from plant_sim.disturbances import (
    DisturbanceSource,
    Equation40,
    Gust,
    OutsideForce,
    Paper002,
    Turbulence,
    UnmodelledGrade,
)
from plant_sim.states import Array

BLOCK = 16
"""Number of ticks for which the disturbances are computed at once: 7 instead of 21 us per tick for equation (40)."""


Columns = slice | list[int]
"""Columns of an array: a slice if their distances are equal, which numpy adds in place without a copy."""


def _columns(numbers: Sequence[int]) -> Columns:
    """Return the columns of these numbers."""
    if not numbers:
        return []
    step = numbers[1] - numbers[0] if len(numbers) > 1 else 1
    even = range(numbers[0], numbers[-1] + 1, step) if step > 0 else ()
    return slice(numbers[0], numbers[-1] + 1, step) if list(even) == list(numbers) else list(numbers)


class _Wind:
    """Ornstein-Uhlenbeck sequence of one :class:`Turbulence`, sampled at the tick."""

    def __init__(self, source: Turbulence, vehicles: int, tick: float, random: np.random.Generator) -> None:
        self._decay = math.exp(-tick / source.correlation)
        self._gain = source.acceleration_rms * float(np.sqrt(1.0 - self._decay**2))
        self._value = np.zeros(vehicles)
        self._random = random

    def tick(self, t: Array, mass: Array) -> OutsideForce:
        """Return the forces of the next :data:`BLOCK` ticks, shape (ticks, vehicles)."""
        values = self._gain * self._random.standard_normal((BLOCK, self._value.size))
        for value in values:
            value += self._decay * self._value
            self._value = value
        self._value = values[-1].copy()
        return OutsideForce(values * mass)


class OutsideForces:
    """Sum of all disturbances of a run on the vehicles that they list.

    Parameters
    ----------
    disturbances
        Disturbances of the scenario; grades belong to the line.
    mass : Array, shape (n,)
        Inertial masses [kg].
    step_ns, tick_ns : int
        Plant step and tick [ns].
    streams
        One generator per disturbance, in the same order.

    Attributes
    ----------
    vehicles : Array, shape (listed vehicles,)
        Numbers of the vehicles with a disturbance.
    listed : slice or list of int
        The same numbers.
    mean : Array, shape (2, listed vehicles)
        Means of force [N] and force per speed [N s/m] over the last tick.
    """

    def __init__(
        self,
        disturbances: Sequence[DisturbanceSource],
        mass: Array,
        step_ns: int,
        tick_ns: int,
        streams: Sequence[np.random.Generator],
    ) -> None:
        self._mass = mass.copy()  # initial masses: a later jump of mass does not change the disturbances
        self._tick_ns, self._steps = tick_ns, tick_ns // step_ns
        self._offsets: Array = np.arange(self._steps) * np.float64(step_ns * 1e-9)
        acting = [
            (source, random)
            for source, random in zip(disturbances, streams, strict=True)
            if not isinstance(source, UnmodelledGrade)
        ]
        self.has_drift = any(isinstance(source, Paper002) for source, _ in acting)
        self.has_cubes = any(isinstance(source, Equation40) and source.speed_power == 3 for source, _ in acting)
        self._planned = sorted({i for source, _ in acting for i in source.listed(len(mass))})
        self._sources: list[tuple[Any, Columns, Array]] = []
        for source, random in acting:
            listed = list(source.listed(len(mass)))
            kind = _Wind(source, len(listed), tick_ns * 1e-9, random) if isinstance(source, Turbulence) else source
            self._sources.append((kind, _columns([self._planned.index(i) for i in listed]), self._mass[listed]))
        self._buffer: Array = np.zeros((BLOCK, 3, self._steps, len(self._planned)))
        self._block: Array = np.zeros(0)
        self._cubes: Array = np.zeros(0)
        self._means: Array = np.zeros(0)
        self._block_begin = -BLOCK * tick_ns
        self._added_gusts: list[Gust] = []
        self._arrange()

    def _arrange(self) -> None:
        """Assign a column to every listed vehicle."""
        added = [gust.listed(len(self._mass)) for gust in self._added_gusts]
        listed = sorted({*self._planned, *(i for vehicles in added for i in vehicles)})
        self.vehicles = np.array(listed, dtype=np.int64)
        self.listed = _columns(listed)
        self._planned_columns = [listed.index(i) for i in self._planned]
        self._gusts = [
            (gust, [listed.index(i) for i in vehicles], self._mass[list(vehicles)])
            for gust, vehicles in zip(self._added_gusts, added, strict=True)
        ]
        self.acts = bool(listed)
        self._sum = np.zeros((3, self._steps, len(listed)))
        self.mean = np.zeros((2, len(listed)))

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
        remaining = [gust for gust in self._added_gusts if now < gust.end + (gust.shift or 0.0)]
        if len(remaining) == len(self._added_gusts):
            return False
        self._added_gusts = remaining
        self._arrange()
        return True

    def tick(self, stamp: int, speed: Array) -> Array:
        """Return force [N], force per speed [N s/m] and drift speed [m/s] of the tick from a stamp on.

        Parameters
        ----------
        stamp : int
            Begin of the tick [ns]; every tick follows the one before.
        speed : Array, shape (n,)
            Speed of every vehicle at that time [m/s].

        Returns
        -------
        Array, shape (3, steps, listed vehicles)
            Valid until the next call.
        """
        if not self.acts:
            return self._sum
        index = (stamp - self._block_begin) // self._tick_ns
        if self._planned and not 0 <= index < len(self._block):
            index = 0
            self._buffer[:] = 0.0
            self._keep(stamp, *self._block_from(stamp, self._buffer))
        if not (self._gusts or self._cubes.size):
            self.mean = self._means[index]
            block: Array = self._block[index]
            return block
        self._sum[:] = 0.0
        if self._planned:
            self._sum[:, :, self._planned_columns] = self._block[index]
        if self._cubes.size:
            self._sum[1][:, self._planned_columns] += self._cubes[index] * speed[self._planned] ** 2
        t = stamp * 1e-9 + self._offsets
        for gust, columns, mass in self._gusts:
            self._sum[0][:, columns] += gust.tick(gust.local(t), mass).force
        self.mean = np.add.reduce(self._sum[:2], axis=1) / self._steps
        return self._sum

    def rest_of_block(self, stamp: int, count: int) -> Array:
        """Return the forces of at most ``count`` ticks from a stamp [ns] on, without added gusts and cubes.

        Shape (ticks, 3, steps, listed vehicles) as in :meth:`ahead`, without a copy; valid until the next call. The
        attribute ``mean`` becomes that of the last of these ticks.
        """
        if not self.acts:
            return np.broadcast_to(self._sum, (count, *self._sum.shape))
        index = (stamp - self._block_begin) // self._tick_ns
        if not 0 <= index < len(self._block):
            index = 0
            self._buffer[:] = 0.0
            self._keep(stamp, *self._block_from(stamp, self._buffer))
        block: Array = self._block[index : index + count]
        self.mean = self._means[index + len(block) - 1]
        return block

    def ahead(self, stamp: int, count: int) -> tuple[Array, Array, Array]:
        """Return the forces of the ticks from a stamp on, without added gusts.

        Parameters
        ----------
        stamp : int
            Begin of the first tick [ns]; the tick before has been taken.
        count : int
            Number of ticks.

        Returns
        -------
        forces : Array, shape (ticks, 3, steps, listed vehicles)
            A copy of force [N], force per speed [N s/m] and drift speed [m/s].
        cubes : Array, shape (ticks, steps, listed vehicles)
            Force per third power of the speed [N s³/m³]; its part is not in ``forces``.
        means : Array, shape (ticks, 2, listed vehicles)
            Means over the ticks, without the cubes.
        """
        if not self.acts:
            none = np.zeros((count, self._steps, 0))
            return np.zeros((count, *self._sum.shape)), none, np.zeros((count, 2, 0))
        index = (stamp - self._block_begin) // self._tick_ns
        if not 0 <= index < len(self._block):
            index = 0
            self._keep(stamp, *self._block_from(stamp, self._empty_block()))
        while index + count > len(self._block):
            kept = (self._block[index:], self._means[index:], self._cubes[index:])
            more = self._block_from(stamp + len(kept[0]) * self._tick_ns, self._empty_block())
            self._keep(stamp, *(np.concatenate(parts) for parts in zip(kept, more, strict=True)))
            index = 0
        part = slice(index, index + count)
        cubes = self._cubes[part] if self._cubes.size else np.zeros((count, self._steps, 0))
        return self._block[part].copy(), cubes, self._means[part]

    def _keep(self, begin: int, block: Array, means: Array, cubes: Array) -> None:
        self._block_begin, self._block, self._means, self._cubes = begin, block, means, cubes

    def _empty_block(self) -> Array:
        return np.zeros(self._buffer.shape)

    def _block_from(self, begin: int, block: Array) -> tuple[Array, Array, Array]:
        """Return forces, their means, and cubes of the scenario for :data:`BLOCK` ticks from a stamp [ns] on.

        ``block`` has zeros, shape (ticks, 3, steps, listed vehicles); the forces are written into it. One block for
        the whole run saves the memory pages of a new one: 25 us per tick for 106 vehicles.
        """
        starts = (begin + self._tick_ns * np.arange(BLOCK)) * 1e-9
        t = np.add.outer(starts, self._offsets).ravel()
        cubes: Array = np.zeros(0)
        for source, columns, mass in self._sources:
            outside = source.tick(t if isinstance(source, _Wind) else source.local(t), mass)
            for row, part in enumerate(outside[:3]):
                if part is not None:
                    block[:, row][:, :, columns] += part.reshape(BLOCK, -1, len(mass))
            if outside.per_cube is not None:
                cubes = cubes if cubes.size else np.zeros((BLOCK, self._steps, len(self._planned)))
                cubes[:, :, columns] += outside.per_cube.reshape(BLOCK, -1, len(mass))
        means = np.add.reduce(block[:, :2], axis=2) / self._steps
        return block, means, cubes
