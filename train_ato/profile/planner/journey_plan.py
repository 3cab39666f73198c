"""Plan of a journey with timing points: every window kept at the least net energy, or the first lost one is named.

The search for the times works with the runs before the jerk limit; the difference to the planned times then shifts the
windows of the next round.
"""

from dataclasses import dataclass, replace

import numpy as np

from plant_sim.line import Line
from train_ato.messages.types import Array
from train_ato.profile.planner import time_windows
from train_ato.profile.planner.assembly import Plan, assemble_plan
from train_ato.profile.planner.driving_strategy import MINIMUM_TIME, DrivingStrategy, SectionInputs
from train_ato.profile.planner.passes import traction_floor
from train_ato.profile.planner.section import PlanSection
from train_ato.profile.planner.timing_points import SpeedWindow, TimeWindow, TimingPoint
from train_ato.profile.planner.train_tables import SPEED_STEP

MAX_ROUNDS = 6
"""Searches for the strategies, each with the windows and reserves of the previous plan."""
SPEED_TOLERANCE = 0.03
"""Speed by which a speed window may be missed because of rounding [m/s]."""
NOTCH_SLOPE, NOTCH_MARGIN = 1.0, 6.0
"""Length of the slope beside a place with a largest speed, and least distance over which it is kept [m]."""
FLOOR_FACTOR = 1.01
"""Factor on a least speed for the rounding of the grids."""


@dataclass(frozen=True, slots=True)
class JourneyStart:
    """Begin of a journey.

    Attributes
    ----------
    time, place : float
        Departure [s] and place of the front [m].
    speed, acceleration : float
        State there [m/s, m/s²]; 0: a departure from rest.
    first_knot : float
        Time of the first knot of the profile [s], at rest until the departure.
    """

    time: float
    place: float
    speed: float = 0.0
    acceleration: float = 0.0
    first_knot: float = 0.0


def plan_journey(inputs: SectionInputs, line: Line, points: tuple[TimingPoint, ...], period: float) -> Plan:
    """Plan a journey from rest at its first point.

    Parameters
    ----------
    inputs
        Train, line forces, speed limits and settings.
    line
        The line.
    points
        Timing points, checked by :func:`.timing_points.check_points`.
    period
        Time between the knots of the profile [s].
    """
    for point in points:
        line.check_place(point.at, f"timing point {point.label}", "move it")
    window = points[0].departure or TimeWindow()
    time = max(window.earliest or 0.0, inputs.settings.departure or 0.0)
    if window.latest is not None and time > window.latest + time_windows.WINDOW_TOLERANCE:
        raise ValueError(str(time_windows.Lateness(points[0].label, "departure", window.latest, time)))
    start = JourneyStart(time, points[0].at)
    result, late = JourneyPlanner(inputs, line, points[1:], start, period).plan()
    if late is not None:
        raise ValueError(str(late))
    return result


class JourneyPlanner:
    """Planner of a journey from a state."""

    def __init__(
        self, inputs: SectionInputs, line: Line, points: tuple[TimingPoint, ...], start: JourneyStart, period: float
    ) -> None:
        self._inputs, self._line, self._points, self._start, self._period = inputs, line, points, start, period
        self._places = [
            time_windows.TimedPlace(start.place, 0.0, np.inf),
            *(time_windows.timed_place(point, points[-1]) for point in points),
        ]
        self._legs = self._sections()

    def plan(self, *, fastest_if_late: bool = False) -> tuple[Plan, time_windows.Lateness | None]:
        """Return the plan of least net energy, and the first window that it does not keep.

        Parameters
        ----------
        fastest_if_late
            True: a window that cannot be kept is moved to the earliest possible time; False: the fastest plan is
            returned with it.

        Raises
        ------
        ValueError
            If there is no solution, or a window is too late or a speed too high for this train.
        """
        fastest = self._assembled([MINIMUM_TIME] * len(self._legs))
        possible = time_windows.fastest_times(self._legs, self._places, self._start.time)
        late = self._first_late(possible)
        if late is not None and not fastest_if_late:
            return fastest, late
        floors = [self._floor(leg) for leg in self._legs]
        moved = np.zeros(len(self._places))
        problem: str | None = None
        for _ in range(MAX_ROUNDS):
            places = [
                replace(
                    place,
                    earliest=place.earliest - move,
                    latest=max(place.latest - move, earliest if fastest_if_late else 0.0),
                )
                for place, move, earliest in zip(self._places, moved, possible, strict=True)
            ]
            search = time_windows.WindowSearch(self._legs, places, self._start.time, floors)
            strategies, _ = search.solve()
            result = self._assembled(strategies)
            reached = self._reached(result)
            problem = self._missed(result, reached, late_accepted=late is not None)
            if problem is None:
                return result, late
            moved = reached - search.predicted(strategies)
        if self._missed(fastest, self._reached(fastest), late_accepted=late is not None) is None or fastest_if_late:
            return fastest, late
        raise ValueError(problem)

    def _sections(self) -> list[time_windows.Leg]:
        """Return the sections between the stops with their largest speeds at timing points."""
        start, legs, first = self._start, [], 0
        for number, point in enumerate(self._points, start=1):
            if not point.stops and number < len(self._points):
                continue
            passed = self._points[first : number - 1]
            section = PlanSection(
                self._inputs, self._places[first].place, point.at,
                begin_speed=start.speed if first == 0 else 0.0,
                begin_acceleration=start.acceleration if first == 0 and start.speed > 0 else 0.0,
                ceiling=self._ceiling(passed, self._places[first].place, point.at),
                accept_overspeed=first == 0 and start.speed > 0,
            )  # fmt: skip
            legs.append(time_windows.Leg(section, first, number))
            first = number
        return legs

    def _ceiling(self, passed: tuple[TimingPoint, ...], begin: float, end: float) -> tuple[Array, Array] | None:
        """Return places [m] and speeds [m/s] of the largest speeds at points; None without one."""
        settings, top = self._inputs.settings, self._inputs.train.speed_max
        limits = [(point.at, point.speed.most) for point in passed if point.speed and point.speed.most is not None]
        if not limits:
            return None
        places = np.linspace(begin, end, max(2, int((end - begin) / NOTCH_SLOPE) + 1))
        speeds = np.full(places.size, top)
        for at, most in limits:
            reach = NOTCH_MARGIN + (most * settings.service_rate / settings.jerk if settings.jerk else 0.0)
            speeds[np.abs(places - at) <= reach] = np.minimum(speeds[np.abs(places - at) <= reach], most)
        return places, speeds

    def _floor(self, leg: time_windows.Leg) -> tuple[Array, Array] | None:
        """Return places [m] and least v²/2 [m²/s²] for the least speeds within a leg; None without one."""
        section = leg.section
        grid, tables, settings = section.grid, section.tables, self._inputs.settings
        floor = np.zeros(grid.places.size)
        for point in self._points[leg.first : leg.last - 1]:
            if point.speed is None or not point.speed.least:
                continue
            speed = FLOOR_FACTOR * point.speed.least
            reach = speed * section.window / 2
            last = int(np.searchsorted(grid.places, point.at - reach))
            needed = traction_floor(
                speed**2 / 2, last, tables.rates, SPEED_STEP, tables.line_max, tables.air, grid.steps,
                tables.reserves, settings.acceleration or np.inf,
            )  # fmt: skip
            needed[(grid.places >= point.at - reach) & (grid.places <= point.at + reach)] = speed**2 / 2
            floor = np.maximum(floor, needed)
        if not floor.any():
            return None
        return grid.places, np.minimum(floor, section.energy_profile())

    def _assembled(self, strategies: list[DrivingStrategy]) -> Plan:
        start, legs = self._start, self._legs

        def departure(number: int, arrival: float) -> float:
            if number == 0:
                return start.time
            place = self._places[legs[number].first]
            return max(arrival + place.dwell, place.depart_after)

        sections = [leg.section for leg in legs]
        settings = self._inputs.settings
        return assemble_plan(
            sections, strategies, settings, self._line, self._period, departures=departure, since=start.first_knot
        )

    def _reached(self, result: Plan) -> Array:
        """Return the times of all timed places in a plan [s]: departure, passing, or the last arrival."""
        times = np.interp([place.place for place in self._places], result.front, result.profile.time)
        for (_, arrival, departure), k in zip(result.arrivals, [0, *(leg.last for leg in self._legs)], strict=True):
            times[k] = departure if k < len(self._places) - 1 else arrival
        return np.asarray(times)

    def _first_late(self, times: Array) -> time_windows.Lateness | None:
        """Return the first window whose latest time is before the earliest possible one."""
        for point, place, time in zip(self._points, self._places[1:], times[1:].tolist(), strict=True):
            if time > place.latest + time_windows.WINDOW_TOLERANCE:
                return time_windows.lateness_at(point, place, time, is_last=point is self._points[-1])
        return None

    def _missed(self, result: Plan, times: Array, *, late_accepted: bool) -> str | None:
        """Return the first missed window of a plan in one line; None if it keeps all."""
        for point, place, time in zip(self._points, self._places[1:], times[1:].tolist(), strict=True):
            if time > place.latest + time_windows.WINDOW_TOLERANCE and not late_accepted:
                return str(time_windows.lateness_at(point, place, time, is_last=point is self._points[-1]))
            if time < place.earliest - time_windows.WINDOW_TOLERANCE:
                return (
                    f"timing point {point.label}: earliest time {place.earliest:.1f} s cannot be kept, the train is "
                    f"there at {time:.1f} s; reduce it or add a stop before"
                )
            window = point.speed or SpeedWindow()
            speed = float(np.interp(time, result.profile.time, result.profile.velocity))
            if window.least is not None and speed < window.least - SPEED_TOLERANCE:
                return (
                    f"timing point {point.label}: least speed {3.6 * window.least:.1f} km/h cannot be kept, "
                    f"{3.6 * speed:.1f} km/h is possible; reduce it"
                )
            if window.most is not None and speed > window.most + SPEED_TOLERANCE:
                return (
                    f"timing point {point.label}: largest speed {3.6 * window.most:.1f} km/h cannot be kept, the train "
                    f"has {3.6 * speed:.1f} km/h; increase it"
                )
        return None
