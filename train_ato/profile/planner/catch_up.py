"""Plan of the rest of a journey from the present state: late or early trains return to their timing points.

Lost time is caught up as far as the limits permit, at the least net energy for what remains; no earlier profile is a
ceiling.  A window that is lost is moved to the earliest possible time and reported.
"""

from __future__ import annotations

from plant_sim.consist import Consist
from plant_sim.line import Line
from train_ato.profile.planner.assembly import Plan
from train_ato.profile.planner.driving_strategy import SectionInputs
from train_ato.profile.planner.journey_plan import JourneyPlanner, JourneyStart
from train_ato.profile.planner.journey_windows import Lateness
from train_ato.profile.planner.plan_from_state import STOP_TOLERANCE, TrainState, relaxed_settings
from train_ato.profile.planner.settings import PlanSettings
from train_ato.profile.planner.stops import stops_of
from train_ato.profile.planner.timing_points import TimeWindow, TimingPoint
from train_ato.profile.planner.train_tables import AvailableForce, TrainTables


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


def catch_up(
    state: TrainState,
    points: tuple[TimingPoint, ...],
    line: Line,
    consist: Consist,
    settings: PlanSettings,
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
    plain = settings.model_copy(update={"time": None, "points": None, "departure": state.time})
    for attempt in relaxed_settings(plain):
        train = TrainTables(consist, attempt.speed_max, attempt.air_brake, attempt.point_mass, available)
        inputs = SectionInputs.of_line(line, consist, train, attempt)
        front, speed = state.position + train.half, max(state.velocity, 0.0)
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
