"""Planner of the speed profile: minimum time, or a timetable with the least traction work.

Places in settings and lines refer to the front of the train; the profile refers to the centre of vehicle 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from plant_sim.consist import Consist
from plant_sim.line import Line
from plant_sim.summation import plain_sum
from train_ato.messages.types import Array
from train_ato.profile.knots import knot_count
from train_ato.profile.planner.driving_strategy import MINIMUM_TIME, DrivingStrategy, SectionInputs, SectionKnots
from train_ato.profile.planner.line_tables import LineForce, SpeedLimits
from train_ato.profile.planner.place_limits import place_limits
from train_ato.profile.planner.section import PlanSection
from train_ato.profile.planner.settings import PlanSettings
from train_ato.profile.planner.stops import stops_of
from train_ato.profile.planner.time_reserve import TIME_TOLERANCE, spread_time_reserve
from train_ato.profile.planner.train_tables import AvailableForce, TrainTables
from train_ato.profile.profile import Profile

MAX_TIMETABLE_ROUNDS = 5
"""Searches for the strategies of a timetable, each with the windows and reserves of the previous plan."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Planned speed profile with its forces and stops.

    Attributes
    ----------
    profile : Profile
        Speed profile of vehicle 0's centre.
    force : Array, shape (n,)
        Own force of the train at every knot [N], > 0 traction, < 0 braking (air brake included).
    limit : Array, shape (n,)
        Speed limit of the whole train at every knot [m/s].
    arrivals : tuple of (place, arrival, departure)
        Place of the front and times of every stop [m, s, s], first and last included.
    settings : PlanSettings
        Settings of the plan.
    train : TrainTables
        Force tables of the plan.
    line : Line
        Line of the plan.
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
        """Time from the first departure to the last arrival [s]."""
        return self.arrivals[-1][1] - self.arrivals[0][2]

    @property
    def front(self) -> Array:
        """Place of the front at every knot [m]."""
        return np.asarray(self.profile.position + self.train.half)

    def summary(self) -> dict[str, Any]:
        """Return the figures of the plan, units in the keys: running_time_s, distance_m, energy_kwh, ..."""
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
    """Plan a speed profile.

    Parameters
    ----------
    line, consist
        Line and train.
    settings
        Stops, service limits, margin, timetable.
    period
        Time between the knots of the profile [s].
    available
        Available force; None: the nominal envelopes.
    reduction
        Deepest brake-pipe reduction that the plan may use [Pa]; None: that of the largest braking factor.

    Raises
    ------
    ValueError
        If there is no solution; one line: place, reason; fix.
    """
    settings = settings or PlanSettings()
    train = TrainTables(consist, settings.speed_max, settings.air_brake, settings.point_mass, available, reduction)
    force = LineForce(line, train, settings.grade_over_length)
    inputs = SectionInputs(
        train, force, SpeedLimits(line, train.speed_max), settings, place_limits(line, consist, train)
    )
    stops = stops_of(line, settings)
    sections = [
        PlanSection(inputs, begin, end, begin_speed=v0, end_speed=v1) for begin, end, v0, v1 in stops.sections(settings)
    ]
    for section in sections:
        section.energy_profile()  # reports a place without a solution before any window is fitted

    def departure(number: int, arrival: float) -> float:
        return arrival if number == 0 else arrival + stops.dwells[number - 1]

    def assemble(strategies: list[DrivingStrategy]) -> Plan:
        since = settings.departure if settings.begin_speed > 0 else 0.0
        return assemble_plan(sections, strategies, settings, line, period, departure, since)

    fastest = assemble([MINIMUM_TIME] * len(sections))
    return fastest if settings.time is None else _plan_to_timetable(sections, fastest, settings.time, assemble)


def traction_work_bound(result: Plan) -> float:
    """Return a lower bound of the traction work of every plan with the running time of a plan [J].

    Raises
    ------
    ValueError
        If the bound has no solution.
    """
    from train_ato.profile.planner.energy_bound import energy_lower_bound

    settings = result.settings
    force = LineForce(result.line, result.train, settings.grade_over_length)
    inputs = SectionInputs(result.train, force, SpeedLimits(result.line, result.train.speed_max), settings)
    stops = stops_of(result.line, settings)
    sections = [
        PlanSection(inputs, begin, end, begin_speed=v0, end_speed=v1) for begin, end, v0, v1 in stops.sections(settings)
    ]
    dwell = plain_sum(departure - arrival for _, arrival, departure in result.arrivals[1:-1])
    return energy_lower_bound(sections, result.running_time - dwell)


def _plan_to_timetable(
    sections: list[PlanSection], fastest: Plan, time: float, assemble: Callable[[list[DrivingStrategy]], Plan]
) -> Plan:
    """Return the plan that keeps a timetable [s].

    Jerk and force limits may need a part of the time reserve; the search is then repeated.

    Raises
    ------
    ValueError
        If the time is too short, or needs a speed below the minimum cruise speed.
    """
    if time < fastest.running_time - TIME_TOLERANCE:
        raise ValueError(
            f"timetable too tight: {time:.1f} s between km {sections[0].begin / 1000:.3f} and km "
            f"{sections[-1].end / 1000:.3f}, at least {fastest.running_time:.1f} s are needed; add "
            f"{fastest.running_time - time:.1f} s"
        )
    dwell = plain_sum(departure - arrival for _, arrival, departure in fastest.arrivals[1:-1])
    target = time - dwell
    for _ in range(MAX_TIMETABLE_ROUNDS):
        plan = assemble(spread_time_reserve(sections, target))
        late = plan.running_time - time
        if late <= TIME_TOLERANCE:
            return plan
        target = max(target - 0.5 * late, fastest.running_time - dwell)
    return fastest


def assemble_plan(
    sections: list[PlanSection],
    strategies: list[DrivingStrategy],
    settings: PlanSettings,
    line: Line,
    period: float,
    departures: Callable[[int, float], float],
    since: float = 0.0,
) -> Plan:
    """Return the plan of consecutive sections.

    Parameters
    ----------
    sections, strategies
        Sections and the driving strategy of each.
    departures
        Function of section number and previous arrival [s] that returns the departure [s].
    since
        Time of the first knot [s].
    """
    inputs = sections[0].inputs
    start = departures(0, settings.departure)
    knots_of: list[tuple[Array, SectionKnots]] = []
    arrivals = [(float(sections[0].begin), start, start)]
    for number, (section, strategy) in enumerate(zip(sections, strategies, strict=True)):
        if number:
            start = departures(number, arrivals[-1][1])
            arrivals[-1] = (*arrivals[-1][:2], start)
        section.fit_jerk_limit(start, period, strategy)
        history = section.history(strategy)
        times, end = section.times(start, period, history)
        knots_of.append((times, section.knots(times, start, history)))
        arrivals.append((float(section.end), float(end), float(end)))
    profile, force = _join_knots(knots_of, arrivals, inputs, period, since)
    limit = inputs.limits.at(profile.position + inputs.train.half, inputs.train.length)
    return Plan(profile, force, limit, tuple(arrivals), settings, inputs.train, line)


def _join_knots(
    knots_of: list[tuple[Array, SectionKnots]],
    arrivals: list[tuple[float, float, float]],
    inputs: SectionInputs,
    period: float,
    since: float,
) -> tuple[Profile, Array]:
    """Return profile and force [N] of all sections on one time grid, at rest between them."""
    origin = int(np.ceil(since / period - 1e-9))
    count = max(2, knot_count(int(np.ceil(arrivals[-1][1] / period - 1e-9)) + 1 - origin))
    columns = np.zeros((4, count))
    time = period * (origin + np.arange(count))
    passed = np.searchsorted(np.array([arrival for _, arrival, _ in arrivals[1:]]), time + 1e-9, side="right")
    columns[0] = np.array([place for place, _, _ in arrivals])[passed]
    for times, knots in knots_of:
        if times.size:
            first = round(float(times[0]) / period) - origin
            for row, column in zip(columns, (knots.place, knots.speed, knots.acceleration, knots.force), strict=True):
                row[first : first + times.size] = column
    profile = Profile.uniform(period * origin, period, columns[0] - inputs.train.half, columns[1], columns[2])
    return profile, columns[3]
