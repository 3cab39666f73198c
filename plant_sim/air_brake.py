"""The automatic air brake as seen from the cab: pressures become events, and a closed form of what they do.

The kernel moves the waves and fills the cylinders step by step; :class:`BrakeForecast` answers the same question for
any later time at once, for laws and planners.
"""

from __future__ import annotations

import numpy as np

from plant_sim import kernel as k
from plant_sim.consist import AirBrake, Consist
from plant_sim.packing import pipe_distances
from plant_sim.states import Array

SMALLEST_CHANGE = 1.0
"""Changes of the demanded pressure below this are none [Pa]."""
ATMOSPHERE = 101_325.0
"""Absolute pressure of a vented brake pipe [Pa]."""
VENTED = 1.0
"""Braking factor of a vented pipe: the shoe forces of the data files are those at full cylinder pressure."""


def braking_factor(brake: AirBrake, pressure: float) -> float:
    """Return beta_c of a brake-pipe pressure [Pa, absolute]; held beyond the table's ends."""
    return float(np.interp(brake.charged - pressure, brake.reduction, brake.braking_factor))


class PipeEvents:
    """Brake-pipe events under way in the plant, in the kernel's form.

    Attributes
    ----------
    pressure : float
        Pressure at the head [Pa, absolute].
    array : Array, shape (5, capacity)
        Events for the kernel, oldest first.
    count : int
        How many columns of it are in use.
    """

    def __init__(self, brake: AirBrake, vehicles: int) -> None:
        self.pressure = brake.charged
        self.array: Array = np.zeros((5, 16))
        self.count = 0
        self._brake = brake
        self._vehicles = vehicles
        self._level = 0.0
        self._number = 0

    def demand(self, time: float, pressure: float) -> None:
        """Set the pressure at the head from a time on; a change starts an application or a release wave."""
        if abs(pressure - self.pressure) >= SMALLEST_CHANGE:
            self._change(time, pressure, braking_factor(self._brake, pressure))

    def vent(self, time: float) -> None:
        """Let all air out at the head from a time on: the emergency application, with the application wave's speed."""
        self._change(time, ATMOSPHERE, VENTED)

    def _change(self, time: float, pressure: float, level: float) -> None:
        wave = self._brake.apply_wave if level > self._level else self._brake.release_wave
        self.pressure = pressure
        if level == self._level:
            return
        self._level = level
        self._number += 1
        self._drop_finished()
        if self.count == self.array.shape[1]:
            self.array = np.concatenate((self.array, np.zeros_like(self.array)), axis=1)
        self.array[:, self.count] = (time, wave, level, 0.0, float(self._number))
        self.count += 1

    def _drop_finished(self) -> None:
        under_way = self.array[k.REACHED, : self.count] < self._vehicles
        left = self.array[:, : self.count][:, under_way]
        self.array[:, : left.shape[1]] = left
        self.count = left.shape[1]

    def under_way(self) -> int:
        """Return how many events have not reached every vehicle, dropping the others."""
        if self.count:
            self._drop_finished()
        return self.count


class BrakeForecast:
    """Total shoe force of the train at any later time, from the pressures demanded so far (or planned).

    Closed form per vehicle: every event acts from its arrival until a newer one arrives, and the cylinder approaches
    its level exponentially.  Reservoirs count as full.

    Parameters
    ----------
    consist : Consist
        A train with an air brake.
    scale : float
        On all shoe forces.

    Raises
    ------
    ValueError
        If the train has no air brake.
    """

    def __init__(self, consist: Consist, scale: float = 1.0) -> None:
        if consist.air_brake is None:
            raise ValueError(f"the train '{consist.name}' has no air brake to forecast")
        self._brake = consist.air_brake
        self._distance = pipe_distances(consist)
        shoes = [(i, vehicle.shoes) for i, vehicle in enumerate(consist.vehicles) if vehicle.shoes is not None]
        self._full: Array = np.zeros(len(self._distance))
        for i, shoe in shoes:
            force = shoe.force / 1e3
            friction = shoe.friction * (force + 200.0) / (4.0 * force + 200.0)
            self._full[i] = shoe.count * shoe.force * friction * scale
        self.reset()

    def reset(self) -> None:
        """Forget all events: brake released, pipe charged."""
        self._since = 0.0
        self._cylinder: Array = np.zeros_like(self._distance)
        self._target: Array = np.zeros_like(self._distance)
        self._events: list[tuple[Array, float]] = []
        self._pressure = self._brake.charged
        self._level = 0.0

    @property
    def idle(self) -> bool:
        """Whether nothing acts and nothing is under way."""
        return not self._events and not self._target.any() and not self._cylinder.any()

    def demand(self, time: float, pressure: float) -> None:
        """Tell of a pressure demanded at the head from a time [s] on; times must not fall."""
        if abs(pressure - self._pressure) < SMALLEST_CHANGE:
            return
        level = braking_factor(self._brake, pressure)
        self._pressure = pressure
        if level == self._level:
            return
        wave = self._brake.apply_wave if level > self._level else self._brake.release_wave
        self._level = level
        arrival = time + self._distance / wave
        # A newer event that comes first cancels the older ones: they never act on that vehicle.
        self._events = [(np.where(old < arrival, old, np.inf), reached) for old, reached in self._events]
        self._events.append((arrival, level))

    def _at(self, time: float) -> tuple[Array, Array]:
        """Braking factor reached and aimed at on every vehicle at a time."""
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
        return np.asarray(target + (cylinder - target) * np.exp(-np.maximum(duration, 0.0) / constant))

    def commit(self, time: float) -> None:
        """Take the state at a time as the new beginning; later questions must not be earlier."""
        self._cylinder, self._target = self._at(time)
        self._since = time
        self._events = [
            (arrival, level) for arrival, level in self._events if ((arrival > time) & (arrival < np.inf)).any()
        ]
        if not self._events and not self._target.any() and self._cylinder.max() < k.IDLE_CYLINDER:
            self._cylinder[:] = 0.0

    def factors(self, time: float) -> Array:
        """Return the braking factor reached on every vehicle at a time [s], shape (n,)."""
        return self._at(time)[0]

    def forces(self, time: float, velocity: float | Array) -> Array:
        """Return the shoe force of every vehicle [N] at a time [s] and speed [m/s], shape (n,)."""
        speed = 3.6 * np.abs(velocity)
        return np.asarray(self._full * self.factors(time) * (2.0 * speed + 150.0) / (3.0 * speed + 150.0))

    def force(self, time: float, velocity: float | Array) -> float:
        """Return the shoe force of the whole train [N]."""
        return 0.0 if self.idle else float(self.forces(time, velocity).sum())
