"""Measurement from the true state: noise, bias, resolution, frozen channels, wheel slip."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plant_sim.plant_setup import Freeze, Sensors
from plant_sim.states import Array, Measurement
from plant_sim.streams import random_stream

NOISE_TICKS = 256
"""Number of ticks for which noise is drawn at once."""


class _Noise:
    """Noise of some sensors: the numbers of single draws, drawn for many ticks at once.

    A draw of one number costs 1 us, its part of a draw of 256 numbers 0.05 us.

    Parameters
    ----------
    stream
        Generator of the numbers.
    scale : Array
        Standard deviation of every value of a tick.
    """

    def __init__(self, stream: np.random.Generator, scale: Array) -> None:
        self._stream = stream
        self._scale = scale
        self._drawn = np.zeros((0, *scale.shape))
        self._next = 0

    def of_tick(self) -> Array:
        """Return the noise of the next tick."""
        if self._next == len(self._drawn):
            self._drawn = self._scale * self._stream.standard_normal((NOISE_TICKS, *self._scale.shape))
            self._next = 0
        self._next += 1
        return np.asarray(self._drawn[self._next - 1])


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
        self._position_noise, self._velocity_noise = (
            _Noise(random_stream(seed, f"sensor/{name}"), np.full(units, deviation)) if deviation > 0.0 else None
            for name, deviation in (("position", sensors.position_noise), ("velocity", sensors.velocity_noise))
        )
        deviations = np.array(((sensors.deflection_noise,), (sensors.force_noise,)))
        self._coupler_noise = _Noise(
            random_stream(seed, "sensor/coupler"), deviations.repeat(len(sensors.couplers), axis=1)
        )
        self._odometer = np.zeros(units)
        self._velocity_bias = np.full(units, sensors.velocity_bias)
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

        Every noise has a stream of its own, so that a change of one error does not change another.

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
        if sensors.wheel_slip:
            velocity = self._slipping(stamp * 1e-9, velocity)
        x, v = position + self._odometer, velocity + self._velocity_bias
        if sensors.position_bias != 0.0:
            x += sensors.position_bias
        if self._position_noise is not None:
            x += self._position_noise.of_tick()
        if self._velocity_noise is not None:
            v += self._velocity_noise.of_tick()
        x, v = _rounded(x, sensors.position_quantum), _rounded(v, sensors.velocity_quantum)
        if self._freezes:
            self._keep_frozen(stamp * 1e-9, x, v)
        self._last = x, v
        deflection, rate, force = coupler
        if sensors.couplers:
            noise = self._coupler_noise.of_tick()  # also with a deviation of 0: its sign is that of a force of 0
            deflection, force = deflection + noise[0], force + noise[1]
        return Measurement(stamp, x, v, applied, deflection, rate, force)

    def _slipping(self, time: float, velocity: Array) -> Array:
        """Return the speeds of the wheels [m/s] at a time [s]; count the distance of slipping ones."""
        velocity = velocity.copy()
        for slip in self._sensors.wheel_slip:
            if slip.begin <= time < slip.end:
                self._odometer[slip.unit] += slip.slip * velocity[slip.unit] * self._tick
                velocity[slip.unit] *= 1.0 + slip.slip
        return velocity

    def _keep_frozen(self, time: float, x: Array, v: Array) -> None:
        """Replace the channels that are frozen at a time [s] by their last values."""
        last_x, last_v = self._last or (x, v)
        for freeze in self._freezes:
            if freeze.begin <= time < freeze.end:
                if freeze.quantity != "velocity":
                    x[freeze.unit] = last_x[freeze.unit]
                if freeze.quantity != "position":
                    v[freeze.unit] = last_v[freeze.unit]
