"""Odometry of the supervisor: a wheel odometer, a radar and balises as fixed points.

It is independent of the sensors of the ATO, so that a frozen or biased measurement of the ATO does not reach the
supervisor. Wheel and radar have a constant relative error each, drawn once per run from the seed; wheel slip and slide
of the first power unit act on the wheel odometer too.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import floor
from struct import Struct
from typing import Any

from plant_sim.compiled import compiled
from plant_sim.elementary import random_stream
from plant_sim.plant_setup import OdometrySpec, WheelSlip
from plant_sim.record import Records, quantity, records_of, zeros
from plant_sim.states import Array, Odometry


@dataclass
class OdometryReading:
    """Odometry at a time; the arrays have the values of wheel odometer and radar."""

    stamp: int = quantity("ns", "time")
    position: Array = quantity("m", "front position", 2)
    speed: Array = quantity("m/s", "speed", 2)
    since_balise: Array = quantity("m", "distance counted since the last balise", 2)


@dataclass
class OdometerState:
    """Errors and counted distances of the odometers."""

    wheel: float = quantity("1", "ratio of counted to true distance of the wheel without slip")
    radar: float = quantity("1", "ratio of counted to true distance of the radar")
    spacing: float = quantity("m", "distance of the balises")
    front: float = quantity("m", "true front position at the last count")
    origin: float = quantity("m", "position of the last balise, at first that of the start")
    counted: Array = quantity("m", "distance counted from there, with its sign", 2)
    since_balise: Array = quantity("m", "distance counted from there in both directions", 2)


@compiled
def wheel_ratio(own: OdometerState, slips: Records[WheelSlip], time: float) -> float:
    """Return the ratio of counted to true distance of the wheel at a time [s], with its slip."""
    total = 0.0
    for slip in slips:
        if slip.unit == 0 and slip.begin <= time < slip.end:
            total += slip.slip
    return own.wheel * (1.0 + total)


@compiled
def count_distance(states: Records[OdometerState], slips: Records[WheelSlip], stamp: int, front: float) -> None:
    """Count the distance to a true front position [m] at a time [ns]; a passed balise sets both odometers."""
    own = states[0]
    wheel, moved = wheel_ratio(own, slips, stamp * 1e-9), front - own.front
    balise = own.spacing * floor(front / own.spacing)
    passed = moved > 0.0 and balise > own.front
    if passed:
        own.origin, moved = balise, front - balise
    for index, ratio in enumerate((wheel, own.radar)):
        if passed:
            own.counted[index] = own.since_balise[index] = moved * ratio
        else:
            own.counted[index] += moved * ratio
            own.since_balise[index] += abs(moved) * ratio
    own.front = front


@compiled
def read_odometers(
    states: Records[OdometerState], slips: Records[WheelSlip], stamp: int, speed: float,
    readings: Records[OdometryReading],
) -> None:  # fmt: skip
    """Write the odometry at the counted front position for a true speed [m/s] at a time [ns]."""
    own, reading = states[0], readings[0]
    reading.stamp = stamp
    for index, ratio in enumerate((wheel_ratio(own, slips, stamp * 1e-9), own.radar)):
        reading.position[index] = own.origin + own.counted[index]
        reading.speed[index] = speed * ratio
        reading.since_balise[index] = own.since_balise[index]


_pack = Struct("q6d").pack_into


def write_reading(reading: Any, odometry: Odometry) -> None:
    """Write a message into an array of one :class:`OdometryReading`."""
    values = (*odometry.position.tolist(), *odometry.speed.tolist(), *odometry.since_balise.tolist())
    _pack(reading, 0, odometry.stamp, *values)


def odometry_of(reading: Any) -> Odometry:
    """Return one :class:`OdometryReading` as a message."""
    values = (reading[name].copy() for name in ("position", "speed", "since_balise"))
    return Odometry(int(reading["stamp"]), *values)


class Odometers:
    """Wheel odometer and radar of a train, set to the location of every balise that the front passes.

    Parameters
    ----------
    spec
        Errors and balises.
    slips
        Wheel slips of the power units, of which those of the first act.
    front
        Front position at the start [m], known exactly.
    seed
        Seed of the run.

    Attributes
    ----------
    state : Array of :class:`OdometerState`, shape (1,)
        Errors and counted distances.
    slips : Array of :class:`WheelSlip`
        Slips of all units.
    """

    def __init__(self, spec: OdometrySpec, slips: Sequence[WheelSlip], front: float, seed: int) -> None:
        wheel, radar = random_stream(seed, "odometry").uniform(-1.0, 1.0, 2).tolist()
        self.state = zeros(OdometerState, 1)
        self.state["wheel"], self.state["radar"] = 1.0 + wheel * spec.wheel_error, 1.0 + radar * spec.radar_error
        self.state["spacing"] = spec.balise_spacing
        self.state["front"] = self.state["origin"] = front
        self.slips = records_of(WheelSlip, slips)
        self._reading = zeros(OdometryReading, 1)

    def move(self, stamp: int, front: float) -> None:
        """Count the distance to a true front position [m] with the slips at a time [ns]."""
        count_distance(self.state, self.slips, stamp, front)

    def observe(self, stamp: int, speed: float) -> Odometry:
        """Return the odometry at the present front position for a true speed [m/s] at a time [ns]."""
        read_odometers(self.state, self.slips, stamp, speed, self._reading)
        return odometry_of(self._reading[0])
