"""Line force and speed limits of a whole train, tabulated over the place of its front."""

from __future__ import annotations

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.line import Line
from plant_sim.track import Track
from train_ato.messages.types import Array
from train_ato.profile.planner.train_tables import TrainTables

MIN_CELL, MAX_CELL, CELLS = 0.05, 5.0, 8000
"""Bounds of the cell length in the middle of a section [m], and the number of cells between these bounds."""
END_CELL, CELL_GROWTH = 0.002, 1.15
"""Cell length at both ends of a section, where speeds are low [m], and growth factor from cell to cell."""


class PlaceGrid:
    """Grid of places of the front on one section, dense at both ends.

    Parameters
    ----------
    begin, end
        First and last place of the grid [m].

    Attributes
    ----------
    places : Array, shape (cells + 1,)
        Increasing places [m].
    steps : Array, shape (cells,)
        Distance between them [m].
    """

    def __init__(self, begin: float, end: float) -> None:
        length = end - begin
        coarse = float(np.clip(length / CELLS, MIN_CELL, MAX_CELL))
        count = int(np.log(coarse / END_CELL) / np.log(CELL_GROWTH))
        ramp = np.cumsum(END_CELL * CELL_GROWTH ** np.arange(count))
        ramp = np.concatenate(([0.0], ramp[ramp < 0.3 * length]))
        middle = length - 2 * ramp[-1]
        inner = ramp[-1] + np.linspace(0.0, middle, max(10, int(np.ceil(middle / coarse))) + 1)[1:-1]
        self.begin, self.end = begin, end
        self.places: Array = begin + np.concatenate((ramp, inner, length - ramp[::-1]))
        self.places[-1] = end
        self.steps: Array = np.diff(self.places)
        self.cells = self.steps.size


class LineForce:
    """Grade, curve and tunnel force on a whole train, every vehicle at its own position.

    Parameters
    ----------
    line, train
        Line and train.
    over_length
        Average over the length of each vehicle instead of the value at its centre.
    """

    def __init__(self, line: Line, train: TrainTables, over_length: bool = False) -> None:
        self._train = train
        track = Track(line)
        lengths = np.unique(train.lengths) if over_length else np.zeros(1)
        self._pieces = [track.over_length(float(length)) if over_length else track.at_points() for length in lengths]
        self._kind = np.searchsorted(lengths, train.lengths) if over_length else np.zeros(train.masses.size, dtype=int)

    def at(self, front: Array) -> Array:
        """Return the force at increasing places of the front [N], > 0 against the motion; beyond a step of it."""
        total = np.zeros(front.size)
        for mass, behind, kind in zip(self._train.masses, self._train.behind, self._kind, strict=True):
            _add_force(total, front, self._pieces[kind], behind, mass * self._train.gravity, 0.0)
        return total

    def work(self, front: Array) -> Array:
        """Return the work from the first of increasing places of the front to each of them [J]."""
        total = np.zeros(front.size)
        for mass, behind, kind in zip(self._train.masses, self._train.behind, self._kind, strict=True):
            _add_work(total, front, self._pieces[kind], behind, mass * self._train.gravity)
        return total

    def over_cells(self, grid: PlaceGrid) -> tuple[Array, Array, Array]:
        """Return minimum, mean and maximum force over every cell [N], shape (cells,) each."""
        places = grid.places
        beyond, before = np.zeros(places.size), np.zeros(places.size)
        for mass, behind, kind in zip(self._train.masses, self._train.behind, self._kind, strict=True):
            weight = mass * self._train.gravity
            _add_force(beyond, places, self._pieces[kind], behind, weight, 0.0)
            _add_force(before, places, self._pieces[kind], behind, weight, 1e-9)
        mean = np.diff(self.work(places)) / grid.steps
        ends = np.stack((beyond[:-1], before[1:], mean))
        return ends.min(axis=0), mean, ends.max(axis=0)


@compiled
def _add_force(total: Array, front: Array, pieces: Array, behind: float, weight: float, back: float) -> None:
    piece = 0
    for k in range(front.size):
        x = front[k] - behind - back
        while piece + 1 < pieces.shape[1] and pieces[1, piece] <= x:
            piece += 1
        total[k] += weight * (pieces[2, piece] + pieces[3, piece] * (x - pieces[0, piece]) + pieces[4, piece])


@compiled
def _add_work(total: Array, front: Array, pieces: Array, behind: float, weight: float) -> None:
    """Add the work of one vehicle from the first place on [J]."""
    piece, work = 0, 0.0
    x0 = front[0] - behind
    while piece + 1 < pieces.shape[1] and pieces[1, piece] <= x0:
        piece += 1
    for k in range(1, front.size):
        x1 = front[k] - behind
        while True:
            stop = min(x1, pieces[1, piece])
            middle = 0.5 * (x0 + stop) - pieces[0, piece]
            work += (stop - x0) * (pieces[2, piece] + pieces[3, piece] * middle + pieces[4, piece])
            x0 = stop
            if stop >= x1:
                break
            piece += 1
        total[k] += weight * work


class SpeedLimits:
    """Speed limits of the line, each valid for every part of the train.

    Attributes
    ----------
    begin, end, speed : Array
        m, m, m/s; the last limit ends at infinity.
    """

    def __init__(self, line: Line, speed_max: float) -> None:
        places = [limit.at for limit in line.restricted_limits]
        speeds = [min(limit.speed, speed_max) for limit in line.restricted_limits]
        self.begin: Array = np.array([-np.inf, *places])
        self.end: Array = np.array([*places, np.inf])
        self.speed: Array = np.array([speed_max, *speeds])

    def over_grid(self, grid: PlaceGrid, length: float, extension: float = 0.0, acceleration: float = 0.0) -> Array:
        """Return the limit of the whole train at every place of the grid [m/s], shape (cells + 1,).

        A limit is applied to the nearest grid places outside its range, so that it also holds between grid places.

        Parameters
        ----------
        length
            Of the train [m].
        extension
            Time by which a limit starts earlier and ends later [s].
        acceleration
            Maximum acceleration or deceleration in that time [m/s²].
        """
        limit = np.full(grid.cells + 1, np.inf)
        for begin, end, speed in zip(self.begin, self.end, self.speed, strict=True):
            distance = extension * (speed + extension * acceleration)
            first = max(0, int(np.searchsorted(grid.places, begin - distance + 1e-9, side="right")) - 1)
            last = int(np.searchsorted(grid.places, end + length + distance - 1e-9, side="left"))
            if begin - distance >= grid.end or end + length + distance <= grid.begin:
                continue
            limit[first : last + 1] = np.minimum(limit[first : last + 1], speed)
        return limit

    def at(self, front: Array, length: float) -> Array:
        """Return the limit of the whole train at places of its front [m/s]."""
        edges = np.unique(np.concatenate((self.begin[1:], self.end[:-1] + length)))
        inside = np.concatenate((edges[:1] - 1.0, edges)) if edges.size else np.zeros(1)
        first = np.searchsorted(self.end + length, inside, side="right")
        last = np.searchsorted(self.begin, inside, side="right")
        lowest = np.array([self.speed[a:b].min() for a, b in zip(first, last, strict=True)])
        return np.asarray(lowest[np.searchsorted(edges, front, side="right")])

    def highest(self, places: Array, length: float) -> Array:
        """Return the largest limit of the whole train between the neighbours of every grid place [m/s]."""
        at = np.unique(np.concatenate((places, self.begin[1:], self.end[:-1] + length)))
        at = at[(at >= places[0]) & (at <= places[-1])]
        limit = np.maximum(*[self.at(at + side, length) for side in (-1e-6, 1e-6)])
        cell: Array = np.maximum.reduceat(limit, np.searchsorted(at, places))
        return np.asarray(np.maximum(cell, np.concatenate((cell[:1], cell[:-1]))))
