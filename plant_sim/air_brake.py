"""Friction brakes: events for the kernel, shoe forces in closed form, and the pressure of the brake pipe.

The kernel integrates the waves of :class:`PipeEvents` and the cylinders step by step; :class:`BrakeForecast` computes
the shoe forces of any later time in closed form, for laws and planners.

:class:`PipePressure` is the pressure at some vehicles, for display. A change of the pressure runs along the pipe with
the speed of the brake waves.  From its arrival at a vehicle the pressure there approaches the new value as a
first-order lag, because the valve limits the flow.

The emergency brake has a path of its own on every train. It uses neither a drive nor a command: it vents the brake
pipe, or on a train without air brake opens a loop that applies the friction emergency brake of every vehicle.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from plant_sim import kernel as k
from plant_sim.brake_data import AirBrake, EmergencyBrake
from plant_sim.compiled import compiled
from plant_sim.consist import Consist
from plant_sim.elementary import libm_exp
from plant_sim.packing import pipe_distances
from plant_sim.railway import shoe_force
from plant_sim.states import Array

Flags = NDArray[np.bool_]
MIN_PRESSURE_CHANGE = 1.0
"""Smallest change of the demanded pressure that makes an event [Pa]."""


def braking_factor(brake: AirBrake, pressure: float) -> float:
    """Return the braking factor beta_c for a brake-pipe pressure [Pa, absolute]; constant beyond the table."""
    return float(np.interp(brake.charged - pressure, brake.reduction, brake.braking_factor))


@compiled
def _approached(value, goal, duration, apply_time, release_time):  # type: ignore[no-untyped-def]
    """Return a braking factor after an exponential approach of some duration [s]."""
    constant = apply_time if goal > value else release_time
    return goal + (value - goal) * libm_exp(-max(duration, 0.0) / constant)


@compiled
def _recharged(filling, goal, duration, recharge_time):  # type: ignore[no-untyped-def]
    """Return the filling of a reservoir after a duration [s]; it recharges while the demanded factor is 0."""
    if goal > 0.0 or filling == 1.0:
        return filling
    return 1.0 - (1.0 - filling) * libm_exp(-max(duration, 0.0) / recharge_time)


@compiled
def _braking_factors(  # type: ignore[no-untyped-def]
    times, since, cylinder, target, filling, supply, arrivals, done, levels, apply_time, release_time, use,
    recharge_time,
):  # fmt: skip
    """Return present and final braking factor of every vehicle at times [s], shape (times, n) each.

    Every event acts from its arrival until the arrival of a newer one; ``arrivals`` has the shape (events, n). The
    other two results are filling and supply of the reservoirs at the last time, shape (n,) each. They follow the
    equations of the kernel; an event that is ``done`` for a vehicle has acted on them before. ``use`` is the part of a
    reservoir over the factor that it fills; for 0 the reservoirs stay full, and ``done`` is not read.
    """
    n, events = len(cylinder), len(levels)
    present, final = np.empty((len(times), n)), np.empty((len(times), n))
    left = np.empty((len(times), 3))  # of vehicles that no event has reached: equal for all, so one exponential a time
    for row in range(len(times)):
        duration = max(times[row] - since, 0.0)
        left[row, 0], left[row, 1] = libm_exp(-duration / apply_time), libm_exp(-duration / release_time)
        left[row, 2] = libm_exp(-duration / recharge_time)
    last_filling, last_supply = np.ones(n), np.ones(n)
    newest = np.empty(events + 1)
    for i in range(n):
        newest[events] = np.inf
        for event in range(events - 1, -1, -1):
            newest[event] = min(newest[event + 1], arrivals[event, i])
        for row in range(len(times)):
            time, value, goal, full, begun = times[row], cylinder[i], target[i], filling[i], supply[i]
            if newest[0] > time:
                present[row, i] = goal + (value - goal) * (left[row, 0] if goal > value else left[row, 1])
                final[row, i], last_supply[i] = goal, begun
                last_filling[i] = full if goal > 0.0 or full == 1.0 else 1.0 - (1.0 - full) * left[row, 2]
                continue
            value = _approached(value, goal, min(newest[0], time) - since, apply_time, release_time)
            full = _recharged(full, goal, min(newest[0], time) - since, recharge_time)
            for event in range(events):
                arrival, newer = arrivals[event, i], newest[event + 1]
                if arrival <= time and arrival < newer:
                    duration = min(newer, time) - max(arrival, since)
                    if use == 0.0:
                        goal = levels[event]
                    elif not done[event, i]:
                        begun = full if goal == 0.0 else begun
                        rise = min(levels[event] * begun - goal, full / use)
                        goal += rise
                        full = max(full - use * max(rise, 0.0), 0.0)
                    value = _approached(value, goal, duration, apply_time, release_time)
                    full = _recharged(full, goal, duration, recharge_time)
            present[row, i], final[row, i] = value, goal
            last_filling[i], last_supply[i] = full, begun
    return present, final, last_filling, last_supply


class BrakeForecast:
    """Shoe forces at any later time from the pressures demanded, in closed form.

    Every event acts on a vehicle from its arrival until the arrival of a newer one, and the cylinder approaches its
    level exponentially. The reservoirs are used up and recharge as in the kernel.

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
        self._filling: Array = np.ones_like(self._distance)
        self._supply: Array = np.ones_like(self._distance)
        self._released = True
        self._events: list[tuple[Array, float, Flags]] = []
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
        self._events = [(np.where(old < arrival, old, np.inf), reached, done) for old, reached, done in self._events]
        self._events.append((arrival, level, np.zeros(arrival.size, dtype=np.bool_)))

    def _at(self, times: Array) -> tuple[Array, Array, Array, Array]:
        """Return the present and the final braking factor of every vehicle at times [s], shape (times, n) each.

        The other two are filling and supply of the reservoirs at the last time, shape (n,) each.
        """
        brake, n = self._brake, self._distance.size
        arrivals = np.array([arrival for arrival, _, _ in self._events]).reshape(-1, n)
        levels = np.array([level for _, level, _ in self._events])
        limited = [done for _, _, done in self._events] if brake.reservoir_use > 0.0 else []
        done = np.array(limited, dtype=np.bool_).reshape(-1, n)
        found: tuple[Array, Array, Array, Array] = _braking_factors(
            times, self._since, self._cylinder, self._target, self._filling, self._supply, arrivals, done, levels,
            float(brake.apply_time), float(brake.release_time),
            brake.reservoir_use / brake.braking_factor[-1], float(brake.recharge_time),
        )  # fmt: skip
        return found

    def commit(self, time: float) -> None:
        """Make the state at a time [s] the initial state; later calls must not be for an earlier time."""
        cylinder, target, self._filling, self._supply = self._at(np.array([time]))
        self._cylinder, self._target = cylinder[0], target[0]
        self._since = time
        self._events = [
            (arrival, level, arrival <= time)
            for arrival, level, _ in self._events
            if ((arrival > time) & (arrival < np.inf)).any()
        ]
        if not self._events and not self._target.any() and self._cylinder.max() < k.IDLE_CYLINDER:
            self._cylinder[:] = 0.0
        self._released = not self._target.any() and not self._cylinder.any()

    def factors(self, time: float) -> Array:
        """Return the braking factor of every vehicle at a time [s], shape (n,)."""
        return np.asarray(self._at(np.array([time]))[0][0])

    def forces(self, time: float, velocity: float | Array) -> Array:
        """Return the shoe force of every vehicle [N] at a time [s] and speed [m/s], shape (n,)."""
        return np.asarray(self.forces_at(np.array([time]), velocity)[0])

    def forces_at(self, times: Array, velocity: float | Array) -> Array:
        """Return the shoe forces [N], shape (times, n), at times [s] and a speed, or one in every row [m/s]."""
        return np.asarray(shoe_force(self.slow_forces_at(times), velocity))

    def slow_forces_at(self, times: Array) -> Array:
        """Return the shoe forces at standstill [N], shape (times, n), at times [s]."""
        return np.asarray(self._full * self._at(times)[0])


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
    new
        Changes, whose times must not decrease; they are taken out of the list.
    """

    def __init__(
        self, brake: AirBrake, vehicle_data: Array, vehicles: Sequence[int], new: list[PressureChange]
    ) -> None:
        self._brake, self._new = brake, new
        self._ways = vehicle_data
        self._places = [_Place(vehicle, brake.charged) for vehicle in vehicles]
        self._changes: dict[int, PressureChange] = {}
        self._number = 0

    @property
    def is_settled(self) -> bool:
        """True if the pressures remain as they are until the next change."""
        return not self._changes and all(place.is_settled for place in self._places)

    def at(self, time: float) -> tuple[float, ...]:
        """Return the pressure at every place [Pa] at a time [s]; times must not decrease."""
        if self._new:
            self._changes |= enumerate(self._new, self._number)
            self._number += len(self._new)
            self._new.clear()
        if self._changes:
            self._take_arrived(time)
        return tuple([place.follow_each((time,))[0] for place in self._places])

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
                    place.follow_each((arrival,))
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


ATMOSPHERE = 101_325.0
"""Absolute pressure of a vented brake pipe [Pa]."""
FULL_LEVEL = 1.0
"""Braking factor of a vented pipe and of an open loop; the forces of the data files are those at full application."""
AT_ONCE = 1e30
"""Wave speed of an electric loop [m/s]: without delay between the vehicles."""
AT_UNITS, AT_PARTED = range(2)
"""Origins of an event: the power units, and parted couplers."""


class BrakeEvents:
    """Changes of the braking factor that propagate along the train, as arrays of the kernel.

    Parameters
    ----------
    vehicles
        Number of vehicles.
    apply_wave
        Speed of an application along the train [m/s].

    Attributes
    ----------
    array : Array, shape (6, capacity)
        Events by row (see the kernel), oldest first.
    count : int
        Number of columns in use.
    apply_wave : float
        Speed of an application along the train [m/s].
    """

    def __init__(self, vehicles: int, apply_wave: float) -> None:
        self.array: Array = np.zeros((k.EVENT_ROWS, 16))
        self.count = 0
        self.apply_wave = apply_wave
        self._vehicles = vehicles
        self._level = 0.0
        self._number = 0
        self._parted = False

    def part(self, time: float) -> None:
        """Open the pipe or the loop at parted couplers from a time [s] on; a release then has no effect."""
        if not self._parted:
            self._parted = True
            self._start(time, self.apply_wave, FULL_LEVEL, AT_PARTED)

    def _change(self, time: float, wave: float, level: float) -> None:
        """Start a wave at the power units if the level there changes."""
        if level != self._level:
            self._level = level
            self._start(time, wave, level, AT_UNITS)

    def _start(self, time: float, wave: float, level: float, origin: int) -> None:
        """Start a wave at a time [s] with a speed [m/s] that sets the braking factor of the vehicles it reaches."""
        self._number += 1
        self.drop_finished()
        if self.count == self.array.shape[1]:
            self.array = np.concatenate((self.array, np.zeros_like(self.array)), axis=1)
        self.array[:, self.count] = (time, wave, level, 0.0, float(self._number), float(origin))
        self.count += 1

    def drop_finished(self) -> None:
        """Remove the events that have reached every vehicle."""
        if not any(reached >= self._vehicles for reached in self.array[k.REACHED, : self.count].tolist()):
            return
        propagating = self.array[k.REACHED, : self.count] < self._vehicles
        left = self.array[:, : self.count][:, propagating]
        self.array[:, : left.shape[1]] = left
        self.count = left.shape[1]


class PipeEvents(BrakeEvents):
    """Brake-pipe events of a train with an air brake.

    While the emergency brake is applied, the pipe stays vented; after its release the pressure follows the demand. From
    the parting of a coupler on, demands and releases have no effect.

    Attributes
    ----------
    pressure : float
        Pressure set at the power units [Pa, absolute].
    changes : list of PressureChange
        Changes since :class:`PipePressure` has taken them out of the list.
    vented : bool
        True while the emergency brake is applied.
    """

    def __init__(self, brake: AirBrake, vehicles: int) -> None:
        super().__init__(vehicles, brake.apply_wave)
        self.pressure = brake.charged
        self.changes: list[PressureChange] = []
        self._brake = brake
        self._demanded = brake.charged
        self.vented = False

    def demand(self, time: float, pressure: float) -> None:
        """Set the demanded pressure [Pa] from a time [s] on; a change starts an application or a release wave."""
        self._demanded = pressure
        if not self.vented and not self._parted and abs(pressure - self.pressure) >= MIN_PRESSURE_CHANGE:
            self._set(time, pressure, braking_factor(self._brake, pressure))

    def apply_emergency(self, time: float) -> None:
        """Vent the pipe at the power units from a time [s] on: an application with the speed of its wave."""
        self.vented = True
        self._set(time, ATMOSPHERE, FULL_LEVEL)

    def release_emergency(self, time: float) -> None:
        """Close the vent at a time [s]; the pressure becomes the one demanded last."""
        self.vented = False
        self.demand(time, self._demanded)

    def part(self, time: float) -> None:
        """Open the pipe at parted couplers from a time [s] on; a release then has no effect."""
        if not self._parted:
            self.changes.append(PressureChange(time, ATMOSPHERE, self.apply_wave, AT_PARTED, vents=True))
        super().part(time)

    def _set(self, time: float, pressure: float, level: float) -> None:
        falls = pressure < self.pressure
        wave = self.apply_wave if falls else self._brake.release_wave
        self.changes.append(PressureChange(time, pressure, wave, AT_UNITS, vents=self.vented))
        self.pressure = pressure
        self._change(time, self.apply_wave if level > self._level else self._brake.release_wave, level)


class EmergencyLoop(BrakeEvents):
    """Loop of the friction emergency brake of a train without air brake."""

    def __init__(self, brake: EmergencyBrake, vehicles: int) -> None:
        super().__init__(vehicles, AT_ONCE)
        self._delay = brake.delay

    def part(self, time: float) -> None:
        """Open the loop for the rest of the run, with the delay of an application."""
        super().part(time + self._delay)

    def apply_emergency(self, time: float) -> None:
        """Open the loop at a time [s]; after the delay the brake force of every vehicle builds up."""
        self._change(time + self._delay, AT_ONCE, FULL_LEVEL)

    def release_emergency(self, time: float) -> None:
        """Close the loop at a time [s]; the brakes release, except on a parted train."""
        if not self._parted:
            self._change(time, AT_ONCE, 0.0)


def friction_brake_events(consist: Consist) -> PipeEvents | EmergencyLoop:
    """Return the events of the friction brakes of a train: those of its brake pipe, or of its emergency loop."""
    vehicles, loop = len(consist.vehicles), consist.friction_emergency_brake
    if loop is not None:
        return EmergencyLoop(loop, vehicles)
    assert consist.air_brake is not None
    return PipeEvents(consist.air_brake, vehicles)
