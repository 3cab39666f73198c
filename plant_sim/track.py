"""Table of the line for the kernel: pieces with grade and dry resistance.

Inside a piece the grade is linear and the dry resistance constant. For a vehicle as a point the grade is piecewise
constant; averaged over the length of a vehicle it is piecewise linear. The table represents both exactly.
"""

from collections.abc import Sequence

import numpy as np

from plant_sim.disturbances import ExtraGrade
from plant_sim.line import Line
from plant_sim.states import Array

UNBOUNDED = 1e12
"""Magnitude of the beginning of the first and the end of the last piece [m]."""


class Track:
    """Grade and dry resistance of a line over the distance, piecewise constant; level and straight outside it.

    Parameters
    ----------
    line
        The line.
    extra
        Grades in addition to those of the line.

    Attributes
    ----------
    breaks : Array, shape (m,)
        Positions of the changes [m], rising.
    grade : Array, shape (m + 1,)
        Grade before the first break, between them, and after the last; > 0 uphill.
    dry : Array, shape (m + 1,)
        Curve and tunnel resistance over the weight.
    """

    def __init__(self, line: Line, extra: Sequence[ExtraGrade] = ()) -> None:
        grades = line.rounded_grades
        places = {line.begin, line.end, *(entry.at for entry in grades)}
        for stretches in (line.curves, line.tunnels, extra):
            places |= {place for stretch in stretches for place in (stretch.begin, stretch.end)}
        self.breaks: Array = np.array(sorted(places))
        middles = np.concatenate(
            ([self.breaks[0] - 1.0], (self.breaks[1:] + self.breaks[:-1]) / 2, [self.breaks[-1] + 1.0])
        )
        self.grade: Array = np.zeros(len(middles))
        self.dry: Array = np.zeros(len(middles))
        inside = (middles > line.begin) & (middles < line.end)
        if grades:
            begins = np.array([entry.at for entry in grades])
            values = np.array([0.0, *(entry.grade for entry in grades)])
            self.grade[inside] = values[np.searchsorted(begins, middles[inside], side="right")]
        for piece in extra:
            self.grade[(middles > piece.begin) & (middles < piece.end)] += piece.grade
        for curve in line.curves:
            own = curve.resistance_n_per_kn
            dry = 0.6 / curve.radius if own is None else 1e-3 * own
            self.dry[(middles > curve.begin) & (middles < curve.end)] += dry
        for tunnel in line.tunnels:
            self.dry[(middles > tunnel.begin) & (middles < tunnel.end)] += 1e-3 * tunnel.resistance_n_per_kn

    def at_points(self) -> Array:
        """Return the pieces for a vehicle without length: begin, end, grade, slope of grade, dry; shape (5, pieces)."""
        begin = np.concatenate(([-UNBOUNDED], self.breaks))
        end = np.concatenate((self.breaks, [UNBOUNDED]))
        return np.array([begin, end, self.grade, np.zeros_like(begin), self.dry])

    def over_length(self, length: float) -> Array:
        """Return the pieces averaged over the length of a vehicle [m], by the position of its centre.

        The mean of the dry resistance is computed at the middle of pieces of at most 1/20 of the length.
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
        begin = np.concatenate(([-UNBOUNDED], edges))
        end = np.concatenate((edges, [UNBOUNDED]))
        slope = np.concatenate(([0.0], np.diff(grade) / np.diff(edges), [0.0]))
        dry = np.concatenate(([self.dry[0]], mean(dry_sum, (edges[1:] + edges[:-1]) / 2), [self.dry[-1]]))
        return np.array([begin, end, np.concatenate(([self.grade[0]], grade)), slope, dry])

    def _integral(self, values: Array) -> Array:
        """Return the integral from the first break to every break."""
        return np.concatenate(([0.0], np.cumsum(values[1:-1] * np.diff(self.breaks))))

    def _at(self, integral: Array, places: Array) -> Array:
        """Return the integral at positions [m]; constant outside the line, which continues level and straight."""
        return np.asarray(np.interp(places, self.breaks, integral))

    def elevation(self, places: Array) -> Array:
        """Return the height over the first break [m] at positions [m]."""
        return self._at(self._integral(self.grade), places)
