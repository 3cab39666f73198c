"""Largest traction and electric-brake force over speed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plant_sim.consist import EnvelopeSegment
from plant_sim.railway import envelope_force


class Envelope:
    """Largest force over speed, as rows ``[v_end, f0, f1, p]`` with F = f0 + f1 v + p / v in SI.

    Parameters
    ----------
    segments
        Segments by rising speed.

    Attributes
    ----------
    rows : ndarray, shape (segments, 4)
        m/s, N, N s/m, W; beyond the last row the force is 0.
    """

    def __init__(self, segments: tuple[EnvelopeSegment, ...]) -> None:
        self._rows = [segment.row for segment in segments]
        self.rows: NDArray[np.float64] = np.array(self._rows, dtype=np.float64).reshape(-1, 4)

    def force(self, speed: float) -> float:
        """Return the largest force [N] at a speed >= 0 [m/s]."""
        return float(envelope_force(self._rows, 0, len(self._rows), speed))

    def largest(self) -> float:
        """Return the largest force over all speeds [N]."""
        ends = [0.0, *(row[0] for row in self._rows)]
        return max((self.force(speed) for speed in ends), default=0.0) if self._rows else 0.0
