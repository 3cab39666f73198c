"""Measurement from the true state: noise, bias, resolution, frozen channels, wheel slip."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from plant_sim.input_error import one_of
from plant_sim.plant_setup import Freeze, Sensors
from plant_sim.states import Array, Measurement, VehicleStates
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
            self._draw()
        self._next += 1
        return np.asarray(self._drawn[self._next - 1])

    def ahead(self, count: int) -> Array:
        """Return the noise of the next ticks without use of them, shape (count, ...)."""
        while self._next + count > len(self._drawn):
            self._draw()
        return self._drawn[self._next : self._next + count]

    def _draw(self) -> None:
        more = self._scale * self._stream.standard_normal((NOISE_TICKS, *self._scale.shape))
        self._drawn = np.concatenate((self._drawn[self._next :], more))
        self._next = 0

    def skip(self, count: int) -> None:
        """Use the noise of some ticks."""
        self._next += count


def _rounded(values: Array, quantum: float) -> Array:
    return np.asarray(quantum * np.round(values / quantum)) if quantum > 0.0 else values


class SensorSet:
    """Sensors of a train.

    Parameters
    ----------
    sensors : Sensors
        Sensor errors of the scenario.
    units
        Numbers of the vehicles that are power units, front first.
    gaps : Array, shape (n,)
        Distance of the centres of every vehicle and the next one with the coupler at rest [m]; the last is without
        effect.
    tick : float
        Time between measurements [s].
    seed : int
        Seed of the run.

    Raises
    ------
    ValueError
        If a sensor is on a vehicle or a unit outside the train.
    """

    def __init__(self, sensors: Sensors, units: Sequence[int], gaps: Array, tick: float, seed: int) -> None:
        for i in sensors.couplers:
            if not 0 <= i < len(gaps) - 1:
                raise ValueError(
                    f"sensors.couplers lists vehicle {i}: no coupler is behind it; {one_of(len(gaps) - 1)}"
                )
        for unit in (*(freeze.unit for freeze in sensors.freeze), *(slip.unit for slip in sensors.wheel_slip)):
            if unit >= len(units):
                raise ValueError(f"a sensor fault names unit {unit}: not in the train; {one_of(len(units))}")
        self._front: NDArray[np.int64] = np.array(sensors.couplers, dtype=np.int64)
        self._rear = self._front + 1
        self._gaps = gaps[self._front]
        self._no_couplers = np.zeros(0)
        self._sensors = sensors
        self._units: NDArray[np.int64] = np.array(units, dtype=np.int64)
        self._tick = tick
        self._position_noise, self._velocity_noise = (
            _Noise(random_stream(seed, f"sensor/{name}"), np.full(len(units), deviation)) if deviation else None
            for name, deviation in (("position", sensors.position_noise), ("velocity", sensors.velocity_noise))
        )
        deviations = np.array(((sensors.deflection_noise,), (sensors.force_noise,)))
        self._coupler_noise = _Noise(
            random_stream(seed, "sensor/coupler"), deviations.repeat(len(sensors.couplers), axis=1)
        )
        self._odometer = np.zeros(len(units))
        self._velocity_bias = np.full(len(units), sensors.velocity_bias)
        self._last: tuple[Array, Array] | None = None
        self._freezes = sensors.freeze

    def freeze(self, begin: float, end: float) -> None:
        """Freeze the measurement of all units from a time to another one [s]."""
        added = tuple(Freeze(unit=unit, begin=begin, end=end) for unit in range(len(self._units)))
        self._freezes = (*self._freezes, *added)

    def measure(self, vehicles: VehicleStates, applied: Array) -> Measurement:
        """Return the measurement of one tick.

        Every noise has a stream of its own, so that a change of one error does not change another.

        Parameters
        ----------
        vehicles
            True state of every vehicle.
        applied : Array, shape (units,)
            True force of every unit [N].
        """
        sensors, stamp = self._sensors, vehicles.stamp
        position, velocity = vehicles.position[self._units], vehicles.velocity[self._units]
        if sensors.wheel_slip:
            self._slip(stamp * 1e-9, velocity)
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
        return Measurement(stamp, x, v, applied, *self._at_couplers(vehicles))

    def _at_couplers(self, vehicles: VehicleStates) -> tuple[Array, Array, Array]:
        """Return the measured deflection [m], rate [m/s] and force [N] of the couplers with a sensor."""
        if not self._sensors.couplers:
            return self._no_couplers, self._no_couplers, self._no_couplers
        x, v, front, rear = vehicles.position, vehicles.velocity, self._front, self._rear
        noise = self._coupler_noise.of_tick()  # also with a deviation of 0: its sign is that of a force of 0
        deflection = x[front] - x[rear] - self._gaps
        return deflection + noise[0], v[front] - v[rear], vehicles.coupler_force[front] + noise[1]

    def _slip(self, time: float, velocity: Array) -> None:
        """Make the speeds [m/s] those of the wheels at a time [s]; count the distance of slipping ones."""
        for slip in self._sensors.wheel_slip:
            if slip.begin <= time < slip.end:
                self._odometer[slip.unit] += slip.slip * velocity[slip.unit] * self._tick
                velocity[slip.unit] *= 1.0 + slip.slip

    def _keep_frozen(self, time: float, x: Array, v: Array) -> None:
        """Replace the channels that are frozen at a time [s] by their last values."""
        last_x, last_v = self._last or (x, v)
        for freeze in self._freezes:
            if freeze.begin <= time < freeze.end:
                if freeze.quantity != "velocity":
                    x[freeze.unit] = last_x[freeze.unit]
                if freeze.quantity != "position":
                    v[freeze.unit] = last_v[freeze.unit]
