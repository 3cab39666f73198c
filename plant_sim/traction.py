"""Largest traction and electric-brake force over speed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plant_sim.consist import EnvelopeSegment

SLOWEST = 0.1
"""Constant power is not continued below this speed [m/s]."""


class Envelope:
    """Largest force over speed, packed as rows ``[v_end, f0, f1, p]`` with F = f0 + f1 v + p / v in SI.

    Attributes
    ----------
    rows : ndarray, shape (segments, 4)
        m/s, N, N s/m, W; beyond the last row the force is 0.
    """

    def __init__(self, segments: tuple[EnvelopeSegment, ...]) -> None:
        rows = [[part.to, part.force, part.slope_kn_per_kmh * 3600.0, part.power] for part in segments]
        self.rows: NDArray[np.float64] = np.array(rows, dtype=np.float64).reshape(-1, 4)
        self._rows = [tuple(row) for row in rows]

    def force(self, speed: float) -> float:
        """Return the largest force at a speed >= 0 [N]."""
        for end, constant, slope, power in self._rows:
            if speed <= end:
                return max(0.0, constant + slope * speed + power / max(speed, SLOWEST))
        return 0.0

    def largest(self) -> float:
        """Return the largest force over all speeds [N]."""
        ends = [0.0, *(row[0] for row in self._rows)]
        return max((self.force(speed) for speed in ends), default=0.0) if self._rows else 0.0
