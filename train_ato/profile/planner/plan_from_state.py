"""Plan of the remaining run from the present state of the train with the available force.

If the available force is too small (saturation, fault, low adhesion), the train lags behind its profile.  The rest is
then planned again: at no place faster than the old profile, within the available force, with the same stops.

Plan of the rest of a journey from the present state: late or early trains return to their timing points.

Lost time is caught up as far as the limits permit, at the least net energy for what remains; no earlier profile is a
ceiling.  A window that is lost is moved to the earliest possible time and reported.
"""

from dataclasses import dataclass

import numpy as np

from plant_sim.consist import Consist
from plant_sim.line import Line
from train_ato.messages.types import Array
from train_ato.profile.planner.assembly import Plan, assemble_plan
from train_ato.profile.planner.driving_strategy import MINIMUM_TIME, SectionInputs
from train_ato.profile.planner.journey_plan import JourneyPlanner, JourneyStart
from train_ato.profile.planner.section import PlanSection
from train_ato.profile.planner.settings import PlanSettings, stops_of
from train_ato.profile.planner.time_windows import Lateness
from train_ato.profile.planner.timing_points import TimeWindow, TimingPoint
from train_ato.profile.planner.train_tables import AvailableForce
from train_ato.profile.profile import Profile

REST_SPEED = 1e-6
"""Speed of a knot at rest [m/s]."""
STOP_TOLERANCE = 0.01
"""Distance at which a train at rest has reached a stop [m]."""


@dataclass(frozen=True, slots=True)
class TrainState:
    """State of the train: time [s], position of vehicle 0's centre [m], speed [m/s], acceleration [m/s²].

    A train at rest does not depart before its brakes are released [s].
    """

    time: float
    position: float
    velocity: float
    acceleration: float = 0.0
    released: float = 0.0


@dataclass(frozen=True, slots=True)
class _Leg:
    """Part of the old profile between two stops: places [m], speeds [m/s], times [s], dwell time before it [s]."""

    front: Array
    speed: Array
    departure: float
    arrival: float
    dwell: float


def replan(
    state: TrainState,
    profile: Profile,
    line: Line,
    consist: Consist,
    settings: PlanSettings | None = None,
    *,
    available: AvailableForce | None = None,
) -> Plan:
    """Plan the rest of a profile again.

    Limits are relaxed step by step if the stop cannot be reached otherwise: first the service deceleration together
    with 0.5, 0.2 and 0 of the margin, then the jerk limit.

    Parameters
    ----------
    state
        Present state of the train; the new profile continues it without a jump.
    profile
        The old profile; its stops are kept.
    line, consist
        Nominal line and train.
    settings
        Service limits and margin; begin, end and timetable are ignored.
    available
        Available force; None: the nominal envelopes.

    Returns
    -------
    Plan
        Its knots coincide with those of the old profile from ``state.time`` on: ``profile.followed_by(plan.profile)``.

    Raises
    ------
    ValueError
        If there is no solution with every limit relaxed: place, remaining speed; fix.
    """
    for attempt in relaxed_settings(settings or PlanSettings(), state.time):
        try:
            return _replan(state, profile, line, consist, attempt, available=available)
        except ValueError as error:
            failure = error
    raise failure


def relaxed_settings(settings: PlanSettings, departure: float) -> list[PlanSettings]:
    """Return the settings of the rest of a plan from a time on [s], with more and more limits relaxed.

    First service deceleration and margin are relaxed, then the jerk limit.
    """
    ended = {"time": None, "points": None, "allowance": (), "begin": None, "end": None}
    kept = settings.model_copy(update=ended | {"departure": departure})
    margins = [part * kept.force_margin for part in (0.5, 0.2)] if kept.force_margin > 0 else []
    relaxations = [kept]
    relaxations += [
        kept.model_copy(update={"deceleration": None, "force_margin": margin}) for margin in (*margins, 0.0)
    ]
    return [*relaxations, relaxations[-1].model_copy(update={"jerk": None})]


def _replan(
    state: TrainState,
    profile: Profile,
    line: Line,
    consist: Consist,
    settings: PlanSettings,
    *,
    available: AvailableForce | None,
) -> Plan:
    inputs = SectionInputs.of_line(line, consist, settings, available=available)
    half = inputs.train.half
    front = state.position + half
    legs = _remaining_legs(profile, half, front)
    if not legs:
        raise ValueError(f"nothing left to plan: the front at km {front / 1000:.3f} is at the end of the profile")
    speed = max(state.velocity, 0.0)
    sections = []
    for number, leg in enumerate(legs):
        first = number == 0
        begin = front if first else float(legs[number - 1].front[-1])
        section = PlanSection(
            inputs, begin, float(leg.front[-1]),
            begin_speed=speed if first else 0.0,
            begin_acceleration=state.acceleration if first and speed > 0 else 0.0,
            ceiling=(leg.front, leg.speed),
            accept_overspeed=first and speed > 0,
        )  # fmt: skip
        sections.append(section)

    def departure(number: int, arrival: float) -> float:
        if number == 0:
            return state.time if speed > 0 else max(state.time, state.released, legs[0].departure)
        return max(arrival + legs[number].dwell, legs[number].departure)

    return assemble_plan(
        sections, [MINIMUM_TIME] * len(sections), settings, line, profile.period, departures=departure, since=state.time
    )


def _remaining_legs(profile: Profile, half: float, front: float) -> list[_Leg]:
    """Return the parts of a profile between two stops that end beyond a place of the front [m]."""
    moving = np.abs(profile.velocity) > REST_SPEED
    edges = np.flatnonzero(np.diff(np.concatenate(([0], moving.astype(int), [0]))))
    legs: list[_Leg] = []
    last_end = -np.inf
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        low, high = max(first - 1, 0), min(last, len(profile) - 1)
        leg_front = profile.position[low : high + 1] + half
        departure = float(profile.time[low])
        dwell = departure - last_end if np.isfinite(last_end) else 0.0
        last_end = float(profile.time[high])
        passed = leg_front[-1] <= front + STOP_TOLERANCE
        if not passed and np.all(np.diff(leg_front) >= 0):
            legs.append(_Leg(leg_front, profile.velocity[low : high + 1], departure, last_end, dwell))
    return [leg for leg in legs if leg.front[-1] > front]


def timetable_points(line: Line, settings: PlanSettings) -> tuple[TimingPoint, ...]:
    """Return the timing points of a plan: its own, or its stops with the arrival of its timetable; empty without."""
    if settings.points is not None:
        return settings.points
    if settings.time is None:
        return ()
    stops = stops_of(line, settings)
    departure = settings.departure or 0.0
    begin = TimingPoint(at=stops.places[0], departure=TimeWindow(earliest=departure))
    between = [TimingPoint(at=at, dwell=dwell) for at, dwell in zip(stops.places[1:-1], stops.dwells, strict=True)]
    arrival = TimeWindow(latest=departure + settings.time)
    return begin, *between, TimingPoint(at=stops.places[-1], arrival=arrival)


def scheduled_points(profile: Profile, half: float) -> tuple[TimingPoint, ...]:
    """Return the stops of a profile with its own arrivals and departures, as allowances schedule them.

    ``half`` is half the length of vehicle 0 [m].
    """
    legs = _remaining_legs(profile, half, -np.inf)
    points = [TimingPoint(at=float(legs[0].front[0]), departure=TimeWindow(earliest=legs[0].departure))]
    for leg, following in zip(legs, [*legs[1:], None], strict=True):
        arrival = TimeWindow(latest=leg.arrival)
        departure = None if following is None else TimeWindow(earliest=following.departure)
        dwell = None if following is None else following.dwell
        points.append(TimingPoint(at=float(leg.front[-1]), arrival=arrival, departure=departure, dwell=dwell))
    return tuple(points)


def catch_up(
    state: TrainState,
    points: tuple[TimingPoint, ...],
    line: Line,
    consist: Consist,
    settings: PlanSettings,
    *,
    period: float,
    available: AvailableForce | None = None,
) -> tuple[Plan, Lateness | None]:
    """Plan the rest of a journey from a state.

    Parameters
    ----------
    state
        Present state of the train; at a stop the dwell time begins now.
    points
        Timing points of the whole journey; those behind the train are left out.
    line, consist
        Nominal line and train.
    settings
        Service limits, margin and net energy; the service limits are relaxed if a stop cannot be reached otherwise.
    period
        Time between the knots of the profile [s]; ``state.time`` is a multiple of it after the first knot.
    available
        Available force; None: the nominal envelopes.

    Returns
    -------
    plan, lateness : Plan, Lateness or None
        The first window that is lost, with the earliest possible time; None if all are kept.

    Raises
    ------
    ValueError
        If there is no solution: place, reason; fix.
    """
    failure = ValueError("nothing left to plan: the train is at its last timing point")
    for attempt in relaxed_settings(settings, state.time):
        inputs = SectionInputs.of_line(line, consist, attempt, available=available)
        front, speed = state.position + inputs.train.half, max(state.velocity, 0.0)
        ahead = tuple(point for point in points if point.at > front + STOP_TOLERANCE)
        if not ahead:
            raise failure
        start = state.time
        for point in points:
            if speed == 0.0 and abs(point.at - front) <= STOP_TOLERANCE:
                after = point.departure.earliest if point.departure else None
                start = max(start + (point.dwell or 0.0), after or 0.0)
        begin = JourneyStart(start, front, speed, state.acceleration if speed > 0 else 0.0, state.time)
        try:
            return JourneyPlanner(inputs, line, ahead, begin, period).plan(fastest_if_late=True)
        except ValueError as error:
            failure = error
    raise failure
