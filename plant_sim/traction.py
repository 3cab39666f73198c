"""Largest traction and electric-brake force over speed."""

import numpy as np
from numpy.typing import NDArray

from plant_sim.consist import Consist, EnvelopeSegment
from plant_sim.plant_setup import PlantSetup
from plant_sim.railway import each_envelope_force, envelope_force
from plant_sim.states import Array


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

    def forces(self, speed: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return :meth:`force` at every speed of an array [N]."""
        return np.asarray(each_envelope_force(self.rows, speed))

    def largest(self) -> float:
        """Return the largest force over all speeds [N]."""
        ends = [0.0, *(row[0] for row in self._rows)]
        return max((self.force(speed) for speed in ends), default=0.0) if self._rows else 0.0


FADE = 1.0
"""Time constant of the stop of a unit with a reversing drive [s]."""


class FullServiceBrake:
    """Demand of every power unit for the full electric brake.

    The demand is the largest force of the brake envelope. The plant limits it by the envelope, the adhesion and the
    force limit at the present speed. The drives follow it with their lag and rate, and without a drive there is no
    brake. The emergency brake has a path of its own (:mod:`plant_sim.air_brake`). With ``reversing`` a negative
    force also drives backwards. Then the demand decreases with the speed and is 0 below the holding speed, where the
    holding brake acts.
    """

    def __init__(self, consist: Consist, setup: PlantSetup) -> None:
        units = [consist.vehicles[i] for i in consist.power_units]
        scale = setup.mismatch.electric_brake_scale
        self._full: Array = np.array([scale * Envelope(unit.brake).largest() for unit in units])
        self._fading: Array = np.array([unit.inertia for unit in units]) / FADE
        self._reversing = setup.reversing
        self._rest = setup.holding_speed

    def demand(self, velocity: Array) -> Array:
        """Return the force demand of every unit [N] against its motion, for speeds [m/s] of shape (units,)."""
        if not self._reversing:
            return -self._full
        braked = -np.sign(velocity) * np.minimum(self._full, self._fading * np.abs(velocity))
        return np.where(np.abs(velocity) < self._rest, 0.0, braked)
