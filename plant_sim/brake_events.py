"""Events of the friction brakes for the kernel: waves of the brake pipe, or the loop of the emergency brake.

The emergency brake has a path of its own on every train. It uses neither a drive nor a command: it vents the brake
pipe, or on a train without air brake opens a loop that applies the friction emergency brake of every vehicle.
"""

import numpy as np

from plant_sim import kernel as k
from plant_sim.air_brake import MIN_PRESSURE_CHANGE, PressureChange, braking_factor
from plant_sim.brake_data import AirBrake, EmergencyBrake
from plant_sim.consist import Consist
from plant_sim.states import Array

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
        self._drop_finished()
        if self.count == self.array.shape[1]:
            self.array = np.concatenate((self.array, np.zeros_like(self.array)), axis=1)
        self.array[:, self.count] = (time, wave, level, 0.0, float(self._number), float(origin))
        self.count += 1

    def _drop_finished(self) -> None:
        if not any(reached >= self._vehicles for reached in self.array[k.REACHED, : self.count].tolist()):
            return
        propagating = self.array[k.REACHED, : self.count] < self._vehicles
        left = self.array[:, : self.count][:, propagating]
        self.array[:, : left.shape[1]] = left
        self.count = left.shape[1]

    def propagating(self) -> int:
        """Return the number of events that have not reached every vehicle, after removal of the others."""
        if self.count:
            self._drop_finished()
        return self.count


class PipeEvents(BrakeEvents):
    """Brake-pipe events of a train with an air brake.

    While the emergency brake is applied, the pipe stays vented; after its release the pressure follows the demand. From
    the parting of a coupler on, demands and releases have no effect.

    Attributes
    ----------
    pressure : float
        Pressure set at the power units [Pa, absolute].
    changes : list of PressureChange
        Changes since the reader of the pressure has cleared the list.
    """

    def __init__(self, brake: AirBrake, vehicles: int) -> None:
        super().__init__(vehicles, brake.apply_wave)
        self.pressure = brake.charged
        self.changes: list[PressureChange] = []
        self._brake = brake
        self._demanded = brake.charged
        self._vented = False

    def demand(self, time: float, pressure: float) -> None:
        """Set the demanded pressure [Pa] from a time [s] on; a change starts an application or a release wave."""
        self._demanded = pressure
        if not self._vented and not self._parted and abs(pressure - self.pressure) >= MIN_PRESSURE_CHANGE:
            self._set(time, pressure, braking_factor(self._brake, pressure))

    def apply_emergency(self, time: float) -> None:
        """Vent the pipe at the power units from a time [s] on: an application with the speed of its wave."""
        self._vented = True
        self._set(time, ATMOSPHERE, FULL_LEVEL)

    def release_emergency(self, time: float) -> None:
        """Close the vent at a time [s]; the pressure becomes the one demanded last."""
        self._vented = False
        self.demand(time, self._demanded)

    def part(self, time: float) -> None:
        """Open the pipe at parted couplers from a time [s] on; a release then has no effect."""
        if not self._parted:
            self.changes.append(PressureChange(time, ATMOSPHERE, self.apply_wave, AT_PARTED, vents=True))
        super().part(time)

    def _set(self, time: float, pressure: float, level: float) -> None:
        falls = pressure < self.pressure
        wave = self.apply_wave if falls else self._brake.release_wave
        self.changes.append(PressureChange(time, pressure, wave, AT_UNITS, vents=self._vented))
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
