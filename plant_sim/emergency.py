"""The emergency brake of the power units: full electric (or blended friction) brake, whatever is commanded."""

from __future__ import annotations

import numpy as np

from plant_sim.consist import Consist
from plant_sim.plant_setup import PlantSetup
from plant_sim.states import Array
from plant_sim.traction import Envelope

FADE = 1.0
"""Time constant with which a drive that can also push backwards brings its unit to rest [s]."""


class EmergencyBrake:
    """Demand of every power unit while the emergency brake is applied.

    It is the largest force of the unit's brake envelope; the plant cuts it to what the envelope, the adhesion and the
    force limit give at the present speed.  Where a negative force also drives backwards (``reversing``), it fades out
    with the speed and is 0 below the holding speed, so that the holding brake takes over.

    Parameters
    ----------
    consist, setup
        The train and its actuators.
    """

    def __init__(self, consist: Consist, setup: PlantSetup) -> None:
        units = [consist.vehicles[i] for i in consist.power_units]
        scale = setup.mismatch.electric_brake_scale
        self._full: Array = np.array([scale * Envelope(unit.brake).largest() for unit in units])
        self._fading: Array = np.array([unit.mass * unit.rotating_mass_factor for unit in units]) / FADE
        self._reversing = setup.reversing
        self._rest = setup.holding_speed

    def demand(self, velocity: Array) -> Array:
        """Return the force demanded of every unit [N], <= 0 against the motion, at its speed [m/s], shape (units,)."""
        if not self._reversing:
            return -self._full
        braked = -np.sign(velocity) * np.minimum(self._full, self._fading * np.abs(velocity))
        return np.where(np.abs(velocity) < self._rest, 0.0, braked)
