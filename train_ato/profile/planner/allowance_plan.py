"""Plan with running-time supplements: every section between two stops keeps its own scheduled time.

It is the least running time of the section plus the supplements that lie in it. The planner spreads them over the
section at the least net energy; a time at a place without a stop is a timing point of a journey.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from plant_sim.elementary import plain_sum
from train_ato.messages.types import Array
from train_ato.profile.planner.allowance import MIN_DISTANCE, Allowance
from train_ato.profile.planner.assembly import Plan
from train_ato.profile.planner.driving_strategy import DrivingStrategy
from train_ato.profile.planner.section import PlanSection
from train_ato.profile.planner.time_windows import TIME_TOLERANCE, predicted_time, spread_time_reserve

MAX_ROUNDS = 5
"""Searches for the strategies, each with the times corrected by those of the previous plan."""
UNUSED_TIME = 0.1
"""Part of a scheduled time that may remain unused without another search [s]."""


def supplements(rules: tuple[Allowance, ...], fastest: Plan) -> list[float]:
    """Return the supplement of every section between two stops [s] from the plan of minimum time.

    Raises
    ------
    ValueError
        If a supplement lies outside the plan: key, value; fix.
    """
    first, last = fastest.arrivals[0][0], fastest.arrivals[-1][0]
    borders = {place for rule in rules for place in rule.extent(first, last)}
    for number, rule in enumerate(rules):
        begin, end = rule.extent(first, last)
        if begin >= last or end <= first:
            raise ValueError(
                f"allowance.{number}: km {begin / 1e3:.3f} ... {end / 1e3:.3f} lies outside the plan (km "
                f"{first / 1e3:.3f} ... {last / 1e3:.3f}); move begin or end of the allowance"
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
