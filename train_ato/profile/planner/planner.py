"""Planner of the speed profile: minimum time, or a timetable or timing points with the least net energy.

With running-time supplements every section between two stops keeps its own scheduled time. This is its least running
time plus the supplements inside it, spread at the least net energy.

Places in settings and lines refer to the front of the train; the profile refers to the centre of vehicle 0.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from plant_sim.consist import Consist
from plant_sim.elementary import plain_sum
from plant_sim.formats.fields import print_assumption
from plant_sim.line import Line
from plant_sim.units import number_text
from train_ato.messages.types import Array
from train_ato.profile.planner.allowance import MIN_DISTANCE, Allowance
from train_ato.profile.planner.assembly import Plan, assemble_plan
from train_ato.profile.planner.driving_strategy import MINIMUM_TIME, DrivingStrategy, SectionInputs
from train_ato.profile.planner.journey_plan import plan_journey
from train_ato.profile.planner.line_tables import LineForce, SpeedLimits
from train_ato.profile.planner.section import PlanSection
from train_ato.profile.planner.settings import PlanSettings, Stops, stops_of
from train_ato.profile.planner.time_windows import TIME_TOLERANCE, predicted_time, spread_time_reserve
from train_ato.profile.planner.train_tables import TrainTables

MAX_ROUNDS = 5
"""Searches for the strategies, each with the windows, reserves and times of the previous plan."""
UNUSED_TIME = 0.1
"""Part of a scheduled time, or of a timetable, that may remain unused without another search [s]."""
LESS_RESERVE = 0.75
"""Ratio of the time reserves of two searches, where the first finds no plan."""


def supplements(rules: tuple[Allowance, ...], fastest: Plan) -> list[float]:
    """Return the supplement of every section between two stops [s] from the plan of minimum time.

    Raises
    ------
    ValueError
        If a supplement lies outside the plan: key, value; fix.
    """
    first, last = fastest.arrivals[0][0], fastest.arrivals[-1][0]
    post = fastest.line.post_at
    borders = {place for rule in rules for place in rule.extent(first, last)}
    for number, rule in enumerate(rules):
        begin, end = rule.extent(first, last)
        if begin >= last or end <= first:
            raise ValueError(
                f"allowance.{number}: km {post(begin)} ... {post(end)} lies outside the plan (km "
                f"{post(first)} ... {post(last)}); move begin or end of the allowance"
            )
    found = []
    for (begin, _, departure), (end, arrival, _) in pairwise(fastest.arrivals):
        inner = [place for place in sorted(borders) if begin + MIN_DISTANCE < place < end - MIN_DISTANCE]
        times = [departure, *np.interp(inner, fastest.front, fastest.profile.time).tolist(), arrival]
        parts = zip(pairwise([begin, *inner, end]), pairwise(times), strict=True)
        found.append(
            plain_sum(
                rule.seconds(late - early, to - at, at_stop=to == end)
                for (at, to), (early, late) in parts
                for rule in rules
                if rule.covers(at, to)
            )
        )
    return found


def plan_with_allowances(
    sections: list[PlanSection],
    fastest: Plan,
    rules: tuple[Allowance, ...],
    assemble: Callable[[list[DrivingStrategy]], Plan],
) -> Plan:
    """Return the plan that keeps the scheduled time of every section at its least net energy.

    Raises
    ------
    ValueError
        If a supplement lies outside the plan, or needs a speed below the minimum cruise speed.
    """
    least = _running_times(fastest)
    times = least + np.array(supplements(rules, fastest))
    best, closest = fastest, np.inf
    wanted = times
    for _ in range(MAX_ROUNDS):
        strategies = [_strategy(section, float(time)) for section, time in zip(sections, wanted, strict=True)]
        result = assemble(strategies)
        late = _running_times(result) - times
        off = float(np.abs(late).max())
        if off < closest:
            best, closest = result, off
        if late.max() <= TIME_TOLERANCE and late.min() >= -UNUSED_TIME:
            break
        predicted = [predicted_time([section], [entry]) for section, entry in zip(sections, strategies, strict=True)]
        wanted = times - (_running_times(result) - predicted)
    return replace(best, least=tuple(least.tolist()))


def _strategy(section: PlanSection, time: float) -> DrivingStrategy:
    """Return the strategy of a section for its running time [s]."""
    try:
        return spread_time_reserve([section], time)[0]
    except ValueError as error:
        where = f"km {section.begin / 1e3:.3f} ... {section.end / 1e3:.3f}"
        raise ValueError(f"allowance on {where}: {error}") from None


def _running_times(plan: Plan) -> Array:
    """Return the running time of every section between two stops [s]."""
    return np.array([arrival - departure for (_, _, departure), (_, arrival, _) in pairwise(plan.arrivals)])


__all__ = ["Plan", "net_energy_bound", "plan_profile"]

MAX_OF_TRAIN, MAX_OF_LINE, MAX_OF_LIMITS = 1.5, 3.0, 2.2
"""Ratios of speed_max to the speeds of train and line, and of the limits to that of the train, that are noted."""
SHORT_PLAN = 20.0
"""Distance of a plan with a begin or an end below which their unit is probably another one [m]."""


def plan_profile(
    line: Line,
    consist: Consist,
    settings: PlanSettings | None = None,
    period: float = 0.1,
    *,
    reduction: float | None = None,
    ceiling: tuple[Array, Array] | None = None,
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
    reduction
        Deepest brake-pipe reduction that the plan may use [Pa]; None: that of the largest braking factor.
    ceiling : pair of arrays, optional
        Increasing places of the front [m] and speeds [m/s] of a speed limit in addition to that of the line.

    Raises
    ------
    ValueError
        If there is no solution; one line: place, reason; fix.
    """
    try:
        inputs = SectionInputs.of_line(line, consist, settings or PlanSettings(), reduction=reduction, ceiling=ceiling)
        _note_speeds(inputs.settings.speed_max, line, inputs.train)
        return _planned(line, inputs, period)
    except ValueError as error:
        raise ValueError(line.with_posts(str(error))) from error


def _planned(line: Line, inputs: SectionInputs, period: float) -> Plan:
    """Return the plan of a train on a line with the settings of the inputs."""
    settings = inputs.settings
    if settings.points is not None:
        return plan_journey(inputs, line, settings.points, period)
    stops = stops_of(line, settings)
    if (settings.begin, settings.end) != (None, None) and (way := stops.places[-1] - stops.places[0]) < SHORT_PLAN:
        print_assumption(f"begin and end of the plan are {number_text(way)} m apart; check their unit")
    sections = _sections(inputs, stops)
    for section in sections:
        section.energy_profile()  # reports a place without a solution before any window is fitted

    def departure(number: int, arrival: float) -> float:
        return arrival if number == 0 else arrival + stops.dwells[number - 1]

    def assemble(strategies: list[DrivingStrategy]) -> Plan:
        since = settings.departure or 0.0 if settings.begin_speed > 0 else 0.0
        return assemble_plan(sections, strategies, settings, line, period, departures=departure, since=since)

    fastest = assemble([MINIMUM_TIME] * len(sections))
    if settings.allowance:
        return plan_with_allowances(sections, fastest, tuple(rule.on(line) for rule in settings.allowance), assemble)
    return fastest if settings.time is None else _plan_to_timetable(sections, fastest, settings.time, assemble)


def _sections(inputs: SectionInputs, stops: Stops) -> list[PlanSection]:
    """Return the sections between the stops of a plan."""
    speeds = [inputs.settings.begin_speed, *[0.0] * len(stops.dwells), inputs.settings.end_speed]
    rows = pairwise(zip(stops.places, speeds, strict=True))
    return [PlanSection(inputs, begin, end, begin_speed=v0, end_speed=v1) for (begin, v0), (end, v1) in rows]


def _note_speeds(speed: float | None, line: Line, train: TrainTables) -> None:
    """Note speeds [m/s] that have no effect: speed_max far above train and line, limits far above the train."""
    own, limits = train.highest_speed, [limit.speed for limit in line.restricted_limits]
    name, on, speed_max = f"train '{train.name}'", f"line '{line.name}'", "speed_max" if speed else ""
    for what, high, other, known, ratio in (
        (speed_max, speed or 0.0, name, own, MAX_OF_TRAIN),
        (speed_max, speed or 0.0, on, max(limits, default=np.inf), MAX_OF_LINE),
        (f"the lowest speed limit of {on}", min(limits, default=0.0), name, own, MAX_OF_LIMITS),
    ):
        if high > ratio * known:
            print_assumption(
                f"{what} = {number_text(high)}: {number_text(3.6 * high)} km/h, {other} permits at most "
                f"{number_text(3.6 * known)} km/h; check its unit"
            )
            break


def net_energy_bound(result: Plan) -> float:
    """Return a lower bound of the net energy of every plan with the running time of a plan [J].

    The air of tunnels counts. Limits of forces by place are left out, because without them a plan needs no more work.
    The bound is the larger of two bounds. A linear program is close on long sections with much reserve, and the value
    of a price of time is close on the others.

    Raises
    ------
    ValueError
        If the bound has no solution.
    """
    from train_ato.profile.planner.energy_bound import energy_lower_bound
    from train_ato.profile.planner.value_bound import value_lower_bound

    settings = result.settings
    force = LineForce(result.line, result.train, over_length=settings.grade_over_length)
    inputs = SectionInputs(
        result.train, force, SpeedLimits(result.line, result.train.speed_max), settings, result.places
    )
    sections = _sections(inputs, stops_of(result.line, settings))
    dwell = plain_sum(departure - arrival for _, arrival, departure in result.arrivals[1:-1])
    time = result.running_time - dwell
    bound = max(energy_lower_bound(sections, time), value_lower_bound(sections, time))
    return bound + settings.auxiliary * result.running_time


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
    kept, reserve = [section.copy() for section in sections], time - fastest.running_time
    best = _within(sections, fastest, time, assemble)
    while (
        best is fastest and (reserve := LESS_RESERVE * reserve) > UNUSED_TIME
    ):  # limits of one search stay in the next
        sections[:] = [section.copy() for section in kept]
        best = _within(sections, fastest, fastest.running_time + reserve, assemble)
    return best


def _within(
    sections: list[PlanSection], fastest: Plan, time: float, assemble: Callable[[list[DrivingStrategy]], Plan]
) -> Plan:
    """Return the plan with the least energy found within a running time [s], the fastest one without another."""
    dwell = plain_sum(departure - arrival for _, arrival, departure in fastest.arrivals[1:-1])
    bias, best = 0.0, fastest
    for _ in range(MAX_ROUNDS):
        strategies = spread_time_reserve(sections, max(time - dwell - bias, fastest.running_time - dwell))
        found = assemble(strategies)
        late = found.running_time - time
        if late <= TIME_TOLERANCE and found.energy < best.energy:
            best = found
        if -UNUSED_TIME <= late <= TIME_TOLERANCE:
            break
        bias = found.running_time - dwell - predicted_time(sections, strategies)
    return best
