"""Measurement from the true state: noise, bias, resolution, frozen channels, wheel slip."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant_sim.compiled import compiled
from plant_sim.elementary import random_stream
from plant_sim.input_error import one_of
from plant_sim.plant_setup import Freeze, Sensors, WheelSlip
from plant_sim.record import Records, quantity, records_of, zeros
from plant_sim.states import Array, Measurement, VehicleStates

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


@dataclass
class SensorConstants:
    """Errors of the sensors of all units."""

    position_bias: float = quantity("m", "bias of the positions")
    velocity_bias: float = quantity("m/s", "bias of the speeds")
    position_quantum: float = quantity("m", "resolution of the positions, 0: exact")
    velocity_quantum: float = quantity("m/s", "resolution of the speeds, 0: exact")
    tick: float = quantity("s", "time between measurements")


@dataclass
class UnitSensor:
    """Sensors of one power unit, with the last measurement."""

    vehicle: int = quantity("", "number of the vehicle")
    slipped: float = quantity("m", "distance counted by slips")
    position: float = quantity("m", "measured position")
    velocity: float = quantity("m/s", "measured speed")
    known: bool = quantity("", "there is a measurement")


@dataclass
class FreezeRecord:
    """Time in which channels of a unit keep their last values."""

    unit: int = quantity("", "number of the unit")
    begin: float = quantity("s", "begin")
    end: float = quantity("s", "end")
    keeps_position: bool = quantity("", "the position is frozen")
    keeps_velocity: bool = quantity("", "the speed is frozen")


class SensorRecords(NamedTuple):
    """Sensors of a train: errors, units, faults, and the vehicles before the couplers with their gaps [m]."""

    constants: Records[SensorConstants]
    units: Records[UnitSensor]
    slips: Records[WheelSlip]
    freezes: Records[FreezeRecord]
    couplers: NDArray[np.int64]
    gaps: Array


@compiled
def rounded(value: float, quantum: float) -> float:
    """Return a value at a resolution; 0 is exact."""
    return quantum * float(np.rint(value / quantum)) if quantum > 0.0 else value


@compiled
def measure_unit(
    p: SensorConstants, own: UnitSensor, u: int, slips: Records[WheelSlip], freezes: Records[FreezeRecord],
    time: float, x: float, v: float, noise: float, speed_noise: float,
) -> None:  # fmt: skip
    """Measure true position [m] and speed [m/s] of a unit at a time [s], with the noise of both."""
    for slip in slips:
        if slip.unit == u and slip.begin <= time < slip.end:
            own.slipped += slip.slip * v * p.tick
            v *= 1.0 + slip.slip
    x, v = x + own.slipped, v + p.velocity_bias
    if p.position_bias != 0.0:
        x += p.position_bias
    x, v = rounded(x + noise, p.position_quantum), rounded(v + speed_noise, p.velocity_quantum)
    for freeze in freezes:
        if own.known and freeze.unit == u and freeze.begin <= time < freeze.end:
            x = own.position if freeze.keeps_position else x
            v = own.velocity if freeze.keeps_velocity else v
    own.position, own.velocity, own.known = x, v, True


@compiled
def measure_train(
    sensors: SensorRecords, time: float, x: Array, v: Array, force: Array, noise: Array, speed_noise: Array,
    coupler_noise: Array, couplers: Array,
) -> None:  # fmt: skip
    """Measure all units and couplers at a time [s].

    Parameters
    ----------
    sensors
        The sensors.
    time
        Time [s].
    x, v, force : Array, shape (vehicles,)
        Positions [m], speeds [m/s] and forces of the couplers behind the vehicles [N].
    noise, speed_noise : Array, shape (units,)
        Noise of positions [m] and speeds [m/s].
    coupler_noise : Array, shape (2, couplers)
        Noise of deflections [m] and forces [N].
    couplers : Array, shape (3, couplers)
        Measured deflections [m], rates [m/s] and forces [N], written here.
    """
    for u in range(sensors.units.size):
        own, p = sensors.units[u], sensors.constants[0]
        i = own.vehicle
        measure_unit(p, own, u, sensors.slips, sensors.freezes, time, x[i], v[i], noise[u], speed_noise[u])
    deflections, rates, forces = couplers
    for j in range(sensors.couplers.size):
        i = sensors.couplers[j]
        deflections[j] = x[i] - x[i + 1] - sensors.gaps[j] + coupler_noise[0, j]
        rates[j] = v[i] - v[i + 1]
        forces[j] = force[i] + coupler_noise[1, j]


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
        front: NDArray[np.int64] = np.array(sensors.couplers, dtype=np.int64)
        constants, own = zeros(SensorConstants, 1), zeros(UnitSensor, len(units))
        for name in constants.dtype.names[:-1]:
            constants[name] = getattr(sensors, name)
        constants["tick"], own["vehicle"] = tick, units
        slips, freezes = records_of(WheelSlip, sensors.wheel_slip), zeros(FreezeRecord, 0)
        self.records = SensorRecords(constants, own, slips, freezes, front, gaps[front])
        self._freezes: tuple[Freeze, ...] = ()
        self._add_freezes(sensors.freeze)
        self._none = np.zeros(len(units))
        self._position_noise, self._velocity_noise = (
            _Noise(random_stream(seed, f"sensor/{name}"), np.full(len(units), deviation)) if deviation else None
            for name, deviation in (("position", sensors.position_noise), ("velocity", sensors.velocity_noise))
        )
        deviations = np.array(((sensors.deflection_noise,), (sensors.force_noise,)))
        self._coupler_noise = _Noise(
            random_stream(seed, "sensor/coupler"), deviations.repeat(len(sensors.couplers), axis=1)
        )

    def _add_freezes(self, added: Sequence[Freeze]) -> None:
        """Add frozen channels."""
        self._freezes = (*self._freezes, *added)
        freezes = zeros(FreezeRecord, len(self._freezes))
        for record, freeze in zip(freezes, self._freezes, strict=True):
            record["unit"], record["begin"], record["end"] = freeze.unit, freeze.begin, freeze.end
            record["keeps_position"] = freeze.quantity != "velocity"
            record["keeps_velocity"] = freeze.quantity != "position"
        self.records = self.records._replace(freezes=freezes)

    def freeze(self, begin: float, end: float) -> None:
        """Freeze the measurement of all units from a time to another one [s]."""
        self._add_freezes([Freeze(unit=unit, begin=begin, end=end) for unit in range(self._none.size)])

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
        noises = (self._position_noise, self._velocity_noise)
        noise, speed_noise = (self._none if one is None else one.of_tick() for one in noises)
        couplers = np.empty((3, self.records.couplers.size))
        measure_train(
            self.records, vehicles.stamp * 1e-9, vehicles.position, vehicles.velocity, vehicles.coupler_force, noise,
            speed_noise, self._coupler_noise.of_tick() if couplers.size else couplers, couplers,
        )  # fmt: skip
        units: Any = self.records.units
        return Measurement(vehicles.stamp, units["position"].copy(), units["velocity"].copy(), applied, *couplers)

    def noise_ahead(self, count: int) -> tuple[Array, Array, Array]:
        """Return the noise of positions, speeds and couplers of the next ticks without use of them."""
        none = np.zeros((count, self._none.size))
        noises = (self._position_noise, self._velocity_noise)
        position, velocity = (none if one is None else one.ahead(count) for one in noises)
        couplers = self._coupler_noise.ahead(count) if self.records.couplers.size else np.zeros((count, 2, 0))
        return position, velocity, couplers

    def skip_noise(self, count: int) -> None:
        """Use the noise of some ticks."""
        for noise in (self._position_noise, self._velocity_noise):
            if noise is not None:
                noise.skip(count)
        if self.records.couplers.size:
            self._coupler_noise.skip(count)
