"""Report of a train for the train behind it: position, safe rear, speed and shortest stop.

The safe rear is behind the true rear as long as one odometer is within the limits of SUBSET-041: smaller position of
both odometers, less their largest error, less the length of the train with all couplers at the end of their stroke.
The shortest stop is the safety data of relative braking: the train cannot stop on a shorter way.
"""

import csv
import io
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from plant_sim.consist import Consist
from plant_sim.elementary import plain_sum
from plant_sim.line import Line
from plant_sim.plant_setup import PlantSetup
from plant_sim.railway import running_resistance
from plant_sim.states import Array, Odometry
from plant_sim.track import Track
from train_ato.supervision.odometry import odometer_error, speed_measurement_error
from train_ato.supervision.plant_brake import GRID, PlantBrakeForces

BRAKE_SHARE, MASS_SHARE, RESISTANCE_SHARE = 1.05, 0.97, 1.15
"""Largest brake force, smallest mass and largest running resistance over those of the train data."""
TOP_SPEED_SHARE = 1.5
"""Highest speed of the shortest stop over the highest speed of the line."""
COLUMNS = ("number", "time", "front", "rear", "speed", "stop")


class TrainReport(NamedTuple):
    """Report of a train.

    Attributes
    ----------
    number : int
        Number of the report; a later one has a larger number.
    time : float
        Time of the odometry [s].
    front, rear : float
        Estimated front and safe rear [m].
    speed : float
        Estimated speed [m/s].
    stop : float
        Shortest way to standstill from this time on [m].
    """

    number: int
    time: float
    front: float
    rear: float
    speed: float
    stop: float

    @property
    def stamp(self) -> int:
        """Time of the odometry [ns]."""
        return round(self.time * 1e9)

    @property
    def problem(self) -> str:
        """Reason of an invalid report, "" for a valid one."""
        if not all(math.isfinite(value) for value in self):
            return "a value is not finite"
        if self.rear > self.front:
            return "the rear is before the front"
        return "the shortest stop is negative" if self.stop < 0.0 else ""


def stretched_length(consist: Consist) -> float:
    """Return the length of a train [m] with the slack and the stroke of every coupler; linear gears have no stroke."""
    gears = consist.gears
    slack = plain_sum(getattr(gear, "slack", 0.0) / 2.0 for gear in gears)
    strokes = plain_sum(max((*getattr(gear, "deflection", ()), getattr(gear, "stroke", 0.0))) for gear in gears)
    return consist.length + slack + strokes


class ShortestStop:
    """Shortest way to standstill of a train on a line.

    All brakes act at once with 105 % of their force, without a limit by adhesion; the mass is 97 %, the running
    resistance 115 %, and the steepest rise with its curves on the way, if there is one, brakes all vehicles.

    Parameters
    ----------
    consist, setup, line
        Train, plant with its actuators, and line.
    max_speed
        Highest permitted speed [m/s].
    """

    def __init__(self, consist: Consist, setup: PlantSetup, line: Line, max_speed: float) -> None:
        self._speed: Array = np.arange(0.0, TOP_SPEED_SHARE * max_speed + GRID, GRID)
        forces = PlantBrakeForces(consist, setup.model_copy(update={"adhesion": None}), self._speed)
        brake = np.maximum(forces.emergency, forces.service_shoes) + forces.electric
        inertia = MASS_SHARE * plain_sum(vehicle.inertia for vehicle in consist.vehicles)
        rows = [vehicle.resistance.polynomial(vehicle.mass, consist.gravity) for vehicle in consist.vehicles]
        resistance = running_resistance(*np.sum(np.array(rows), axis=0).tolist(), self._speed)
        at_knots = (BRAKE_SHARE * brake + RESISTANCE_SHARE * resistance) / inertia
        self._deceleration = np.maximum(at_knots[1:], at_knots[:-1])
        self._half_squares = np.diff(self._speed**2) / 2.0
        track = Track(line)
        self._ends = np.concatenate((track.breaks, [math.inf]))
        self._begins = np.concatenate(([-math.inf], track.breaks))
        self._rises = consist.gravity * (track.grade + track.dry)

    def _way(self, speed: float, rise: float) -> float:
        """Return the way from a speed [m/s] to standstill [m] with a deceleration by the line [m/s²]."""
        cells = min(int(speed / GRID), self._deceleration.size - 1)
        way = float((self._half_squares[:cells] / (self._deceleration[:cells] + rise)).sum())
        rest = (speed**2 - float(self._speed[cells]) ** 2) / 2.0
        return way + rest / (float(self._deceleration[cells]) + rise)

    def way(self, speed: float, front: float, rear: float) -> float:
        """Return the shortest way to standstill [m].

        Parameters
        ----------
        speed
            Smallest speed of the train [m/s].
        front, rear
            Places of its ends [m]; the steepest rise is that from the rear up to the stop.
        """
        longest = self._way(speed, 0.0)
        passed = (self._ends > rear) & (self._begins < front + longest)
        return self._way(speed, max(float(self._rises[passed].max()), 0.0))


class TrainReporter:
    """Reports of a train from its odometry."""

    def __init__(self, consist: Consist, setup: PlantSetup, line: Line, max_speed: float) -> None:
        self._stop, self._length = ShortestStop(consist, setup, line, max_speed), stretched_length(consist)
        self._count = 0

    def report(self, odometry: Odometry) -> TrainReport:
        """Return the next report."""
        self._count += 1
        front, speed = float(odometry.position.mean()), float(odometry.speed.mean())
        error = odometer_error(float(odometry.since_balise.max()))
        rear = float(odometry.position.min()) - error - self._length
        slowest = float(np.abs(odometry.speed).min())
        slowest = max(slowest - speed_measurement_error(slowest), 0.0)
        stop = self._stop.way(slowest, front + error, rear)
        return TrainReport(self._count, odometry.stamp * 1e-9, front, rear, speed, stop)


def reports_text(reports: Sequence[TrainReport]) -> str:
    """Return reports as CSV in SI; reading it restores the same bits."""
    lines = [",".join(COLUMNS), *(",".join(map(repr, report)) for report in reports)]
    return "\n".join(lines) + "\n"


def parse_reports(text: str) -> tuple[TrainReport, ...]:
    """Return the reports of a CSV text in the order of their arrival without a delay.

    Raises
    ------
    ValueError
        With the line, for a wrong column, a value that is not a number, or a time that is not finite.
    """
    rows = list(csv.reader(io.StringIO(text)))
    if len(rows) < 2 or tuple(rows[0]) != COLUMNS:
        raise ValueError(f"the first line has to be {','.join(COLUMNS)}, followed by one line for each report")
    found: list[TrainReport] = []
    for number, row in enumerate(rows[1:], 2):
        try:
            number_text, *values = row
            found.append(TrainReport(int(number_text), *map(float, values)))
        except (TypeError, ValueError):
            raise ValueError(f"line {number}: '{','.join(row)[:40]}': give {len(COLUMNS)} numbers") from None
        if not math.isfinite(found[-1].time):
            raise ValueError(f"line {number}: time {found[-1].time}: give the finite time of the report in s")
    return tuple(found)
