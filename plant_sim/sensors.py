"""Measurement from the true state: noise, bias, resolution, frozen channels, wheel slip."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plant_sim.plant_setup import Freeze, Sensors
from plant_sim.states import Array, Measurement
from plant_sim.streams import random_stream


def _rounded(values: Array, quantum: float) -> Array:
    return np.asarray(quantum * np.round(values / quantum)) if quantum > 0.0 else values


class SensorSet:
    """Sensors of a train.

    Parameters
    ----------
    sensors : Sensors
        Sensor errors of the scenario.
    units : int
        Number of power units.
    vehicles : int
        Number of vehicles.
    tick : float
        Time between measurements [s].
    seed : int
        Seed of the run.

    Raises
    ------
    ValueError
        If a sensor is on a vehicle or a unit outside the train.
    """

    def __init__(self, sensors: Sensors, units: int, vehicles: int, tick: float, seed: int) -> None:
        for i in sensors.couplers:
            if not 0 <= i < vehicles - 1:
                raise ValueError(
                    f"sensors.couplers lists vehicle {i}: no coupler is behind it; give 0 ... {vehicles - 2}"
                )
        for unit in (*(freeze.unit for freeze in sensors.freeze), *(slip.unit for slip in sensors.wheel_slip)):
            if unit >= units:
                raise ValueError(f"a sensor fault names unit {unit}: not in the train; give 0 ... {units - 1}")
        self.couplers: NDArray[np.int64] = np.array(sensors.couplers, dtype=np.int64)
        self._sensors = sensors
        self._units = units
        self._tick = tick
        self._streams = {name: random_stream(seed, f"sensor/{name}") for name in ("position", "velocity", "coupler")}
        self._odometer = np.zeros(units)
        self._last: tuple[Array, Array] | None = None
        self._freezes = sensors.freeze

    def freeze(self, begin: float, end: float) -> None:
        """Freeze the measurement of all units from a time to another one [s]."""
        added = tuple(Freeze(unit=unit, begin=begin, end=end) for unit in range(self._units))
        self._freezes = (*self._freezes, *added)

    def measure(
        self, stamp: int, position: Array, velocity: Array, applied: Array, coupler: tuple[Array, Array, Array]
    ) -> Measurement:
        """Return the measurement of one tick.

        Every call draws the same count of random numbers, so that a change of one error does not change another.

        Parameters
        ----------
        stamp
            Time of the state [ns].
        position, velocity, applied : Array, shape (units,)
            True state [m, m/s] and force [N].
        coupler
            True deflection [m], rate [m/s] and force [N] at the sensors.
        """
        sensors = self._sensors
        t = stamp * 1e-9
        noise_x = self._streams["position"].standard_normal(self._units)
        noise_v = self._streams["velocity"].standard_normal(self._units)
        noise_c = self._streams["coupler"].standard_normal((2, len(self.couplers)))
        velocity = velocity.copy()
        for slip in sensors.wheel_slip:
            if slip.begin <= t < slip.end:
                self._odometer[slip.unit] += slip.slip * velocity[slip.unit] * self._tick
                velocity[slip.unit] *= 1.0 + slip.slip
        x = position + self._odometer + sensors.position_bias + sensors.position_noise * noise_x
        v = velocity + sensors.velocity_bias + sensors.velocity_noise * noise_v
        x, v = _rounded(x, sensors.position_quantum), _rounded(v, sensors.velocity_quantum)
        last_x, last_v = self._last or (x, v)
        for freeze in self._freezes:
            if freeze.begin <= t < freeze.end:
                if freeze.quantity != "velocity":
                    x[freeze.unit] = last_x[freeze.unit]
                if freeze.quantity != "position":
                    v[freeze.unit] = last_v[freeze.unit]
        self._last = x, v
        deflection, rate, force = coupler
        return Measurement(
            stamp,
            x.copy(),
            v.copy(),
            applied,
            deflection + sensors.deflection_noise * noise_c[0],
            rate,
            force + sensors.force_noise * noise_c[1],
        )
