"""Automatic air brake: braking factor of a pressure, and a closed form of the shoe forces.

The kernel integrates waves and cylinders step by step (:mod:`plant_sim.brake_events`); :class:`BrakeForecast` computes
the shoe forces of any later time in closed form, for laws and planners.
"""

from __future__ import annotations

import numpy as np

from plant_sim import kernel as k
from plant_sim.brake_data import AirBrake
from plant_sim.consist import Consist
from plant_sim.elementary import exp_each
from plant_sim.packing import pipe_distances
from plant_sim.states import Array

MIN_PRESSURE_CHANGE = 1.0
"""Smallest change of the demanded pressure that makes an event [Pa]."""


def braking_factor(brake: AirBrake, pressure: float) -> float:
    """Return the braking factor beta_c for a brake-pipe pressure [Pa, absolute]; constant beyond the table."""
    return float(np.interp(brake.charged - pressure, brake.reduction, brake.braking_factor))


class BrakeForecast:
    """Shoe forces at any later time from the pressures demanded, in closed form.

    Every event acts on a vehicle from its arrival until the arrival of a newer one, and the cylinder approaches its
    level exponentially. Reservoirs count as full.

    Parameters
    ----------
    consist : Consist
        Train with an air brake.

    Raises
    ------
    ValueError
        If the train has no air brake.
    """

    def __init__(self, consist: Consist) -> None:
        if consist.air_brake is None:
            raise ValueError(f"train '{consist.name}' has no air brake; add air_brake to the consist")
        self._brake = consist.air_brake
        self._distance = pipe_distances(consist)
        self._full: Array = np.array(consist.friction_forces)
        self.reset()

    def reset(self) -> None:
        """Clear all events: brake released, pipe charged."""
        self._since = 0.0
        self._cylinder: Array = np.zeros_like(self._distance)
        self._target: Array = np.zeros_like(self._distance)
        self._released = True
        self._events: list[tuple[Array, float]] = []
        self._pressure = self._brake.charged
        self._level = 0.0

    @property
    def idle(self) -> bool:
        """True if no event acts or propagates."""
        return self._released and not self._events

    def demand(self, time: float, pressure: float) -> None:
        """Add a pressure demanded at the head [Pa] from a time [s] on; times must not decrease."""
        if abs(pressure - self._pressure) < MIN_PRESSURE_CHANGE:
            return
        level = braking_factor(self._brake, pressure)
        self._pressure = pressure
        if level == self._level:
            return
        wave = self._brake.apply_wave if level > self._level else self._brake.release_wave
        self._level = level
        arrival = time + self._distance / wave
        # A newer event that arrives first cancels the older ones on that vehicle.
        self._events = [(np.where(old < arrival, old, np.inf), reached) for old, reached in self._events]
        self._events.append((arrival, level))

    def _at(self, time: float) -> tuple[Array, Array]:
        """Return the present and the final braking factor of every vehicle at a time [s]."""
        following = [np.full_like(self._distance, np.inf)]
        for arrival, _ in reversed(self._events):
            following.append(np.minimum(following[-1], arrival))
        following.reverse()
        cylinder = self._approach(self._cylinder, self._target, np.minimum(following[0], time) - self._since)
        target = self._target.copy()
        for (arrival, level), newer in zip(self._events, following[1:], strict=True):
            duration = np.minimum(newer, time) - np.maximum(arrival, self._since)
            acts = (arrival <= time) & (arrival < newer)
            cylinder = np.where(acts, self._approach(cylinder, level, duration), cylinder)
            target = np.where(acts, level, target)
        return cylinder, target

    def _approach(self, cylinder: Array, target: Array | float, duration: Array) -> Array:
        constant = np.where(target > cylinder, self._brake.apply_time, self._brake.release_time)
        return np.asarray(target + (cylinder - target) * exp_each(-np.maximum(duration, 0.0) / constant))

    def commit(self, time: float) -> None:
        """Make the state at a time [s] the initial state; later calls must not be for an earlier time."""
        self._cylinder, self._target = self._at(time)
        self._since = time
        self._events = [
            (arrival, level) for arrival, level in self._events if ((arrival > time) & (arrival < np.inf)).any()
        ]
        if not self._events and not self._target.any() and self._cylinder.max() < k.IDLE_CYLINDER:
            self._cylinder[:] = 0.0
        self._released = not self._target.any() and not self._cylinder.any()

    def factors(self, time: float) -> Array:
        """Return the braking factor of every vehicle at a time [s], shape (n,)."""
        return self._at(time)[0]

    def forces(self, time: float, velocity: float | Array) -> Array:
        """Return the shoe force of every vehicle [N] at a time [s] and speed [m/s], shape (n,)."""
        speed = k.KMH * np.abs(velocity)
        full = self._full * self.factors(time)
        return np.asarray(full * (k.SHOE_A * speed + k.SHOE_SPEED) / (k.SHOE_B * speed + k.SHOE_SPEED))

    def force(self, time: float, velocity: float | Array) -> float:
        """Return the shoe force of the train [N] at a time [s] and speed [m/s]."""
        return 0.0 if self.idle else float(self.forces(time, velocity).sum())
