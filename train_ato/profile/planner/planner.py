"""The planner: the fastest run, or the one that keeps a timetable with little energy.

Places of settings and lines are those of the train's front; the profile is that of vehicle 0's centre.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from plant_sim.consist import Consist
from plant_sim.line import Line
from train_ato.plan.allowance import EXACT, spread_allowance
from train_ato.plan.journey import journey_of
from train_ato.plan.line_tables import LineForce, SpeedLimits
from train_ato.plan.run import Run
from train_ato.plan.settings import PlanSettings
from train_ato.plan.style import FASTEST, Knots, Style, Track
from train_ato.plan.train_tables import AvailableForce, TrainTables
from train_ato.profile.knots import knot_count
from train_ato.profile.profile import Profile
from train_ato.types import Array

__all__ = ["Plan", "assemble", "plan"]

TIMETABLE_ROUNDS = 5
"""Searches for the styles of a timetable, each with the windows and reserves that the one before needed."""


@dataclass(frozen=True, slots=True)
class Plan:
    """A planned journey.

    Attributes
    ----------
    profile : Profile
        Of vehicle 0's centre.
    force : Array, shape (n,)
        Own force of the train at every knot [N], > 0 traction, < 0 braking (air included).
    limit : Array, shape (n,)
        Speed limit of the whole train at every knot [m/s].
    arrivals : tuple of (place, arrival, departure)
        Front and times of every stop [m, s, s], first and last included.
    settings : PlanSettings
        What was asked for.
    train : TrainTables
        Forces it was planned with.
    line : Line
        Where.
    """

    profile: Profile
    force: Array
    limit: Array
    arrivals: tuple[tuple[float, float, float], ...]
    settings: PlanSettings
    train: TrainTables
    line: Line

    @property
    def running_time(self) -> float:
        """From the first departure to the last arrival [s]."""
        return self.arrivals[-1][1] - self.arrivals[0][2]

    @property
    def front(self) -> Array:
        """Place of the front at every knot [m]."""
        return np.asarray(self.profile.position + self.train.half)

    def summary(self) -> dict[str, Any]:
        """Return the figures of the plan: running_time_s, distance_m, energy_kwh, speed_max_kmh and others."""
        profile, force = self.profile, self.force
        power = force * profile.velocity
        step = profile.period / 3.6e6
        _, electric, _ = self.train.forces_at(profile.velocity)
        recovered = np.minimum(np.maximum(-force, 0.0), electric) * profile.velocity
        moving = profile.velocity > 1e-3
        running = force[moving]
        return {
            "train": self.train.name,
            "line": self.line.name,
            "running_time_s": round(self.running_time, 3),
            "distance_m": round(self.arrivals[-1][0] - self.arrivals[0][0], 3),
            "energy_kwh": round(float(np.maximum(power, 0.0).sum() * step), 4),
            "energy_electric_brake_kwh": round(float(recovered.sum() * step), 4),
            "energy_brake_kwh": round(float(np.maximum(-power, 0.0).sum() * step), 4),
            "speed_max_kmh": round(3.6 * float(profile.velocity.max()), 3),
            "speed_mean_kmh": round(3.6 * (self.arrivals[-1][0] - self.arrivals[0][0]) / self.running_time, 3),
            "acceleration_max": round(float(profile.acceleration.max()), 4),
            "deceleration_max": round(float(-profile.acceleration.min()), 4),
            "jerk_max": round(float(np.abs(profile.jerk()).max()), 4),
            "traction_max_kn": round(float(max(running.max(initial=0.0), 0.0)) / 1e3, 3),
            "brake_max_kn": round(float(max(-running.min(initial=0.0), 0.0)) / 1e3, 3),
            "force_margin": self.settings.force_margin,
            "stops": [
                {"place_m": round(place, 3), "arrival_s": round(arrival, 3), "departure_s": round(departure, 3)}
                for place, arrival, departure in self.arrivals
            ],
        }


def plan(
    line: Line,
    consist: Consist,
    settings: PlanSettings | None = None,
    period: float = 0.1,
    available: AvailableForce | None = None,
    reduction: float | None = None,
) -> Plan:
    """Plan a journey.

    Parameters
    ----------
    line, consist
        Where and with what.
    settings
        Journey, service limits, margin, timetable.
    period
        Of the profile's knots [s].
    available
        What is left of the train's forces.
    reduction
        Deepest reduction of the brake pipe that is made on the way [Pa]; None: the deepest that the train knows.

    Raises
    ------
    ValueError
        If no such journey exists: one line with the place and the reason.
    """
    settings = settings or PlanSettings()
    train = TrainTables(consist, settings.speed_max, settings.air_brake, settings.point_mass, available, reduction)
    force = LineForce(line, train, settings.grade_over_length)
    track = Track(train, force, SpeedLimits(line, train.speed_max), settings)
    journey = journey_of(line, settings)
    runs = [Run(track, begin, end, begin_speed=v0, end_speed=v1) for begin, end, v0, v1 in journey.stretches(settings)]
    for run in runs:
        run.raw()  # a place that no run passes is named before any of them is tuned

    def departure(number: int, arrival: float) -> float:
        return arrival if number == 0 else arrival + journey.dwells[number - 1]

    def drive(styles: list[Style]) -> Plan:
        since = settings.departure if settings.begin_speed > 0 else 0.0
        return assemble(runs, styles, settings, line, period, departure, since)

    fastest = drive([FASTEST] * len(runs))
    return fastest if settings.time is None else _timetabled(runs, fastest, settings.time, drive)


def _timetabled(runs: list[Run], fastest: Plan, time: float, drive: Callable[[list[Style]], Plan]) -> Plan:
    """Return the plan that keeps a timetable [s]; comfort and forces may need some of the time that its styles spend.

    Raises
    ------
    ValueError
        If the time is too short, or so long that the train would have to crawl.
    """
    if time < fastest.running_time - EXACT:
        raise ValueError(
            f"timetable too tight: {time:.1f} s between km {runs[0].begin / 1000:.3f} and km "
            f"{runs[-1].end / 1000:.3f}, at least {fastest.running_time:.1f} s are needed; allow "
            f"{fastest.running_time - time:.1f} s more"
        )
    standing = sum(departure - arrival for _, arrival, departure in fastest.arrivals[1:-1])
    for _ in range(TIMETABLE_ROUNDS):
        plan = drive(spread_allowance(runs, time - standing))
        if plan.running_time <= time + EXACT:
            return plan
    return fastest


def assemble(
    runs: list[Run],
    styles: list[Style],
    settings: PlanSettings,
    line: Line,
    period: float,
    departures: Callable[[int, float], float],
    since: float = 0.0,
) -> Plan:
    """Drive the runs one after the other and put their knots together.

    Parameters
    ----------
    runs, styles
        What is driven and how.
    departures
        Time of departure [s] of a run, from its number and the arrival before it.
    since
        Time of the first knot [s].
    """
    track = runs[0].track
    start = departures(0, settings.departure)
    parts: list[tuple[Array, Knots]] = []
    arrivals = [(float(runs[0].begin), start, start)]
    for number, (run, style) in enumerate(zip(runs, styles, strict=True)):
        if number:
            start = departures(number, arrivals[-1][1])
            arrivals[-1] = (*arrivals[-1][:2], start)
        run.tune(start, period, style)
        raw = run.raw_run(style)
        times, end = run.times(start, period, raw)
        parts.append((times, run.knots(times, start, raw)))
        arrivals.append((float(run.end), float(end), float(end)))
    profile, force = _joined(parts, arrivals, track, period, since)
    limit = track.limits.at(profile.position + track.train.half, track.train.length)
    return Plan(profile, force, limit, tuple(arrivals), settings, track.train, line)


def _joined(
    parts: list[tuple[Array, Knots]],
    arrivals: list[tuple[float, float, float]],
    track: Track,
    period: float,
    since: float,
) -> tuple[Profile, Array]:
    """Put knots of runs, and rest between them, on one grid of time."""
    origin = int(np.ceil(since / period - 1e-9))
    count = max(2, knot_count(int(np.ceil(arrivals[-1][1] / period - 1e-9)) + 1 - origin))
    columns = np.zeros((4, count))
    time = period * (origin + np.arange(count))
    passed = np.searchsorted(np.array([arrival for _, arrival, _ in arrivals[1:]]), time + 1e-9, side="right")
    columns[0] = np.array([place for place, _, _ in arrivals])[passed]
    for times, knots in parts:
        if times.size:
            first = round(float(times[0]) / period) - origin
            for row, column in zip(columns, (knots.place, knots.speed, knots.rate, knots.force), strict=True):
                row[first : first + times.size] = column
    profile = Profile.uniform(period * origin, period, columns[0] - track.train.half, columns[1], columns[2])
    return profile, columns[3]
