"""Pressure of the brake pipe at some vehicles, for display: the brakes use the waves of :mod:`plant_sim.brake_events`.

A change of the pressure runs along the pipe with the speed of the brake waves.  From its arrival at a vehicle the
pressure there approaches the new value as a first-order lag, because the valve limits the flow.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

from plant_sim import kernel as k
from plant_sim.brake_data import AirBrake
from plant_sim.states import Array

SETTLED = 1.0
"""Difference from the final pressure that counts as reached [Pa]."""


@dataclass(frozen=True)
class PressureChange:
    """Change of the pressure at an origin.

    Attributes
    ----------
    time, pressure, wave : float
        Begin [s], final absolute pressure [Pa], speed along the pipe [m/s].
    origin : int
        Origin of the wave, as in the events of the kernel.
    vents : bool
        True for an open pipe, which empties faster than through the driver's brake valve.
    """

    time: float
    pressure: float
    wave: float
    origin: int
    vents: bool


class _Place:
    """Pressure at one vehicle [Pa]."""

    def __init__(self, vehicle: int, pressure: float) -> None:
        self.vehicle = vehicle
        self.pressure = self._final = pressure
        self._time = 0.0
        self._constant = 1.0
        self.newest = -1

    @property
    def is_settled(self) -> bool:
        """True at the final pressure."""
        return self.pressure == self._final

    def follow(self, time: float) -> None:
        """Approach the final pressure until a time [s]."""
        self.follow_each((time,))

    def follow_each(self, times: Sequence[float]) -> list[float]:
        """Approach the final pressure until rising times [s]; return the pressure at each [Pa]."""
        pressure, final, before, found = self.pressure, self._final, self._time, []
        for time in times:
            duration, before = time - before, time
            if pressure != final and duration > 0.0:
                left = (pressure - final) * math.exp(-duration / self._constant)
                pressure = final + (left if abs(left) >= SETTLED else 0.0)
            found.append(pressure)
        self.pressure, self._time = pressure, before
        return found

    def take(self, number: int, change: PressureChange, brake: AirBrake) -> None:
        """Begin the approach to the pressure of a change that arrives now."""
        self.newest, self._final = number, change.pressure
        falling = brake.pipe_vent_time if change.vents else brake.pipe_apply_time
        self._constant = falling if change.pressure < self.pressure else brake.pipe_release_time


class PipePressure:
    """Pressure of the brake pipe at some vehicles over time.

    As with the brakes, the newest change that has reached a vehicle is in effect; an older one that it has overtaken is
    not.

    Parameters
    ----------
    brake
        Air brake of the train: charged pressure and time constants of the pipe.
    vehicle_data
        Constants of the vehicles of the kernel, with the ways of the waves [m]; parting of couplers changes them.
    vehicles
        Numbers of the vehicles.
    """

    def __init__(self, brake: AirBrake, vehicle_data: Array, vehicles: Sequence[int]) -> None:
        self._brake = brake
        self._ways = vehicle_data
        self._places = [_Place(vehicle, brake.charged) for vehicle in vehicles]
        self._changes: dict[int, PressureChange] = {}
        self._number = 0

    def add(self, change: PressureChange) -> None:
        """Add a change; the times of changes must not decrease."""
        self._changes[self._number] = change
        self._number += 1

    @property
    def is_settled(self) -> bool:
        """True if the pressures remain as they are until the next change."""
        return not self._changes and all(place.is_settled for place in self._places)

    def at(self, time: float) -> tuple[float, ...]:
        """Return the pressure at every place [Pa] at a time [s]; times must not decrease."""
        if self._changes:
            self._take_arrived(time)
        for place in self._places:
            place.follow(time)
        return tuple([place.pressure for place in self._places])

    def at_each(self, times: Sequence[float]) -> Iterator[tuple[float, ...]]:
        """Return the pressures of :meth:`at` at rising times [s]."""
        known = 0
        found = []
        while self._changes and known < len(times):
            found.append(self.at(times[known]))
            known += 1
        columns = [place.follow_each(times[known:]) for place in self._places]
        return chain(found, zip(*columns, strict=True))

    def _take_arrived(self, time: float) -> None:
        """Begin the approach to the changes that have arrived until a time [s]; forget those that no place needs."""
        for place in self._places:
            for arrival, number, change in sorted(self._arrived(place, time)):
                if number > place.newest:
                    place.follow(arrival)
                    place.take(number, change, self._brake)
        oldest = min(place.newest for place in self._places)
        self._changes = {number: change for number, change in self._changes.items() if number > oldest}

    def _arrived(self, place: _Place, time: float) -> list[tuple[float, int, PressureChange]]:
        """Return time of arrival [s], number and change of every wave that has reached a place since the last one."""
        arrivals = (
            (change.time + float(self._ways[k.PIPE_DISTANCE + change.origin, place.vehicle]) / change.wave, number)
            for number, change in self._changes.items()
            if number > place.newest
        )
        return [(arrival, number, self._changes[number]) for arrival, number in arrivals if arrival <= time]
