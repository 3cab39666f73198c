"""The line as the kernel walks it: one table of pieces with grade and dry resistance.

Inside a piece the grade is linear and the dry resistance constant.  At a vehicle's own place grades are piecewise
constant; averaged over a vehicle's length they are piecewise linear, and so exact in the same table.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from plant_sim.disturbances import ExtraGrade
from plant_sim.line import Line
from plant_sim.states import Array

FAR = 1e12
"""Where the first piece begins and the last one ends [m]."""


class Track:
    """Grade and dry resistance of a line over the distance, piecewise constant; level and straight outside it.

    Attributes
    ----------
    breaks : Array, shape (m,)
        Places where anything changes [m], rising.
    grade : Array, shape (m + 1,)
        Grade before the first break, between them, and after the last; > 0 uphill.
    dry : Array, shape (m + 1,)
        Curve and tunnel resistance over the weight.
    """

    def __init__(self, line: Line, extra: Sequence[ExtraGrade] = ()) -> None:
        places = {line.begin, line.end, *(entry.at for entry in line.grades)}
        for stretches in (line.curves, line.tunnels, extra):
            places |= {place for stretch in stretches for place in (stretch.begin, stretch.end)}
        self.breaks: Array = np.array(sorted(places))
        middles = np.concatenate(
            ([self.breaks[0] - 1.0], (self.breaks[1:] + self.breaks[:-1]) / 2, [self.breaks[-1] + 1.0])
        )
        self.grade: Array = np.zeros(len(middles))
        self.dry: Array = np.zeros(len(middles))
        inside = (middles > line.begin) & (middles < line.end)
        if line.grades:
            begins = np.array([entry.at for entry in line.grades])
            values = np.array([0.0, *(entry.grade for entry in line.grades)])
            self.grade[inside] = values[np.searchsorted(begins, middles[inside], side="right")]
        for piece in extra:
            self.grade[(middles > piece.begin) & (middles < piece.end)] += piece.grade
        for curve in line.curves:
            self.dry[(middles > curve.begin) & (middles < curve.end)] += 0.6 / curve.radius
        for tunnel in line.tunnels:
            self.dry[(middles > tunnel.begin) & (middles < tunnel.end)] += 1e-3 * tunnel.resistance_n_per_kn

    def at_points(self) -> Array:
        """Return the pieces as a vehicle without length feels them: begin, end, grade, slope of grade, dry."""
        begin = np.concatenate(([-FAR], self.breaks))
        end = np.concatenate((self.breaks, [FAR]))
        return np.array([begin, end, self.grade, np.zeros_like(begin), self.dry])

    def over_length(self, length: float) -> Array:
        """Return the pieces averaged over a vehicle's length, by the place of its centre.

        The mean of the dry resistance is taken at the middle of pieces of at most 1/20 of the length.
        """
        half = length / 2
        edges = np.unique(np.concatenate((self.breaks - half, self.breaks + half)))
        counts = 1 + np.ceil(np.diff(edges) * 20 / length).astype(int)
        fine = [np.linspace(a, b, count) for a, b, count in zip(edges, edges[1:], counts, strict=False)]
        edges = np.unique(np.concatenate(fine))
        grade_sum, dry_sum = self._integral(self.grade), self._integral(self.dry)

        def mean(integral: Array, places: Array) -> Array:
            return np.asarray((self._at(integral, places + half) - self._at(integral, places - half)) / length)

        grade = mean(grade_sum, edges)
        begin = np.concatenate(([-FAR], edges))
        end = np.concatenate((edges, [FAR]))
        slope = np.concatenate(([0.0], np.diff(grade) / np.diff(edges), [0.0]))
        dry = np.concatenate(([self.dry[0]], mean(dry_sum, (edges[1:] + edges[:-1]) / 2), [self.dry[-1]]))
        return np.array([begin, end, np.concatenate(([self.grade[0]], grade)), slope, dry])

    def _integral(self, values: Array) -> Array:
        """Integral from the first break to every break."""
        return np.concatenate(([0.0], np.cumsum(values[1:-1] * np.diff(self.breaks))))

    def _at(self, integral: Array, places: Array) -> Array:
        """Integral at any place; outside the line it stays, as the line goes on level and straight."""
        return np.asarray(np.interp(places, self.breaks, integral))

    def elevation(self, places: Array) -> Array:
        """Height over the first break [m]."""
        return self._at(self._integral(self.grade), places)
