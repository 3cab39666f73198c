"""Full service brake of the power units: full electric (or blended friction) brake in place of the command."""

from __future__ import annotations

import numpy as np

from plant_sim.consist import Consist
from plant_sim.plant_setup import PlantSetup
from plant_sim.states import Array
from plant_sim.traction import Envelope

FADE = 1.0
"""Time constant of the stop of a unit with a reversing drive [s]."""


class FullServiceBrake:
    """Demand of every power unit for the full electric brake.

    The demand is the largest force of the brake envelope; the plant limits it by the envelope, the adhesion and the
    force limit at the present speed. The drives follow it with their lag and rate, and without a drive there is no
    brake; the emergency brake has a path of its own (:mod:`plant_sim.brake_events`). If a negative force also drives
    backwards (``reversing``), the demand decreases with the speed and is 0 below the holding speed, where the holding
    brake acts.

    Parameters
    ----------
    consist, setup
        The train and its actuators.
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
