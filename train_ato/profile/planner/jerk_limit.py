"""Jerk limit of a section: window and reserves of the moving average over time.

Window, reserves and the extension of the limits are increased until the averaged section keeps every limit at the
knots.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from train_ato.messages.types import Array
from train_ato.profile.planner.accelerations import acceleration_table
from train_ato.profile.planner.driving_strategy import MINIMUM_TIME, DrivingStrategy
from train_ato.profile.planner.section import STEP_FACTOR, PlanSection, acceleration_excess, largest_acceleration_change

MAX_ROUNDS = 25
"""Rounds of the search for window and reserves of the moving average."""
HOLDING_BRAKE_SPEED = 0.05
"""Speed below which the holding brake acts and the brake envelope is not checked [m/s]."""
LOWER_RATES = (0.85, 0.95)
"""Factors between two service accelerations that are tried, far and near."""
MIN_GAIN = 0.1
"""Square of the acceleration over the jerk limit times the top speed from which on a lower one is tried."""
MIN_GROWTH = 0.01
"""Relative growth of the window from which on less force at the places of the largest changes is tried."""
TOLERANCE = 1e-6
"""Relative excess of a force or limit that counts as rounding."""


def fit_jerk_limit(section: PlanSection, start: float, period: float, strategy: DrivingStrategy) -> None:
    """Increase window, reserves and limit extension until the averaged section keeps every limit at the knots.

    Parameters
    ----------
    start
        Time of the first movement [s]; knots are at the multiples of ``period``.

    Raises
    ------
    ValueError
        If there is no solution.
    """
    jerk = section.inputs.settings.jerk
    if jerk is None:
        section.energy_profile(strategy)
    elif section.window > 0:
        _fit(section, jerk, start, period, strategy)
    else:
        _fit_fastest(section, jerk, start, period)
        if strategy is not MINIMUM_TIME:
            _fit(section, jerk, start, period, strategy)


def _fit_fastest(section: PlanSection, jerk: float, start: float, period: float) -> None:
    """Fit the fastest of several ways to limit the jerk.

    At a step of an envelope, the lower side is extended or both sides are lowered.  Where a change of the force at one
    place, as after a dead section, needs a longer window, less force at this place is tried.  A lower service
    acceleration has a shorter window: it can be faster between stops that are close together, or with a low jerk limit.
    """
    best, problem = _fitted(_copy(section), jerk, start, period)
    steps = best is None or _has_steps(best)
    if steps:
        best = _faster(best, _fitted(_copy(section, extend_steps=True), jerk, start, period)[0])
    if best is None:
        assert problem is not None
        raise problem
    if best.window > best.first_window * (1 + MIN_GROWTH):
        kept = _copy(section, extend_steps=best.extend_steps, keep_window=True)
        best = _faster(best, _fitted(kept, jerk, start, period)[0]) or best
    for factor in LOWER_RATES:
        while section.begin_speed == 0.0 and (steps or _slow_window(best, jerk)):
            lower, _ = _fitted(_slower(best, factor * best.window * jerk), jerk, start, period)
            if _faster(best, lower) is best:
                break
            best = lower or best
    vars(section).update(vars(best))


def _copy(section: PlanSection, **changes: Any) -> PlanSection:
    """Return a section without window, reserves and tables."""
    fresh = {"window": 0.0, "limit_extension": 1.0, "fastest_speed": None, "_tables": None, "_reserve": None}
    return replace(section, **(fresh | changes))


def _slower(section: PlanSection, rate: float) -> PlanSection:
    """Return a section with service acceleration and deceleration of at most a rate [m/s²]."""
    settings = section.inputs.settings
    rates = {key: min(getattr(settings, key) or np.inf, rate) for key in ("acceleration", "deceleration")}
    return _copy(section, inputs=replace(section.inputs, settings=settings.model_copy(update=rates)))


def _fitted(
    section: PlanSection, jerk: float, start: float, period: float
) -> tuple[PlanSection | None, ValueError | None]:
    """Return a section with its window for the minimum time, or None and the reason."""
    try:
        energy = section.energy_profile()  # the first window is that of the largest acceleration without a limit
        section.fastest_speed = (section.grid.places, np.sqrt(2 * energy))
        largest = max(float(np.abs(section.over_time(energy)[4]).max()), abs(section.begin_acceleration))
        section.window = section.first_window = largest / jerk
        _fit(section, jerk, start, period, MINIMUM_TIME)
    except ValueError as problem:
        return None, problem
    return section, None


def _faster(one: PlanSection | None, other: PlanSection | None) -> PlanSection | None:
    """Return the section with the shorter running time, the first one of two equal ones."""
    if one is None or other is None:
        return one or other
    return other if other.time() < one.time() else one


def _has_steps(section: PlanSection) -> bool:
    """Return True if the envelopes have a step within the range of speeds of a window."""
    train, settings, window = section.inputs.train, section.inputs.settings, section.window
    lowered, extended = (acceleration_table(train, settings, window, extend_steps=extend) for extend in (False, True))
    return not np.array_equal(lowered, extended)


def _slow_window(section: PlanSection, jerk: float) -> bool:
    """Return True if a lower acceleration a can be faster: a / jerk plus v / a has its minimum at a² = v jerk."""
    assert section.fastest_speed is not None
    top = float(section.fastest_speed[1].max())
    return (section.window * jerk) ** 2 > MIN_GAIN * top * jerk


def _fit(section: PlanSection, jerk: float, start: float, period: float, strategy: DrivingStrategy) -> None:
    """Increase window, reserves and limit extension for one driving strategy."""
    shortfall = 0.0
    for _ in range(MAX_ROUNDS):
        try:
            history = section.over_time(section.energy_profile(strategy))
        except ValueError:
            if shortfall <= 0.0:
                raise
            break  # the reserves leave no solution: the place in that message is not the cause
        change = largest_acceleration_change(history, section.window)
        if change > jerk * section.window * (1 + TOLERANCE):
            if section.keep_window and _lower_changes(section, history, jerk, period):
                continue
            section.window = max(section.window * 1.01, change / jerk * (1 + TOLERANCE / 2))
            continue
        knots = section.knots(section.times(start, period, history)[0], start, history)
        excess, overspeed = _exceedance(section, knots)
        shortfall = float(excess.max(initial=0.0))
        if max(shortfall, overspeed) <= TOLERANCE:
            return
        if shortfall > TOLERANCE:
            section.reserve.raise_at(knots[0], knots[1] * (section.window / 2 + period), excess)
        if overspeed > TOLERANCE:
            section.limit_extension *= 1.25
    raise ValueError(
        f"no solution from km {section.begin / 1000:.3f} to km {section.end / 1000:.3f} within jerk {jerk:g} m/s³ and "
        f"the forces (short by {100 * shortfall:.1f} %); increase jerk or reduce force_margin"
    )


def _lower_changes(section: PlanSection, history: Array, jerk: float, period: float) -> bool:
    """Reserve force where the acceleration changes by more than a window permits; return False without such a force."""
    train, keep = section.inputs.train, 1.0 - section.inputs.settings.force_margin
    places, speed, rates = history[2, 1:-2], history[3, 1:-2], history[4, 1:-2]
    over = acceleration_excess(history, section.window, jerk * section.window)[:, 1:-1]
    resistance = train.resistance_at(speed) + section.inputs.force.at(places)
    force = train.inertia * rates + resistance
    traction, electric, air = train.forces_at(speed)
    cells = np.arange(section.grid.cells)
    excess = np.zeros((2, rates.size))
    for side, (sign, most) in enumerate(((1.0, traction), (-1.0, electric + air))):
        reserved = section.reserve.over(section.grid)[side][cells]
        wanted = np.maximum(sign * force - train.inertia * over[side], 0.0)
        needed = 1.0 - wanted / np.maximum(keep * most, 1.0)
        driven = (over[side] > 0.0) & (sign * force > 1.0)
        excess[side] = np.where(driven, np.maximum(needed - reserved, 0.0) / STEP_FACTOR, 0.0)
    if excess.any():
        section.reserve.raise_at(places, speed * (section.window / 2 + period), excess)
    return bool(excess.any())


def _exceedance(section: PlanSection, knots: Array) -> tuple[Array, float]:
    """Return the relative excess of traction and brake force at every knot, shape (2, n), and of the speed."""
    train, keep = section.inputs.train, 1.0 - section.inputs.settings.force_margin
    place, speed, _, force = knots
    traction, electric, air = train.forces_at(speed)
    driven = (force > 1.0) & (speed > 1e-6)
    braked = (force < -1.0) & (speed > HOLDING_BRAKE_SPEED)
    if section.begin_speed > 0:  # the initial acceleration cannot change at once
        settled = place > section.grid.begin + section.begin_speed * section.window
        driven, braked = driven & settled, braked & settled
    up = np.where(driven, force / (keep * traction + 1e-3) - 1.0, 0.0)
    down = np.where(braked, -force / (keep * (electric + air) + 1e-3) - 1.0, 0.0)
    limit = section.inputs.limits.at(place, train.length)
    over = 0.0 if section.accept_overspeed else float(np.max(speed / limit, initial=0.0)) - 1.0
    return np.maximum(np.stack((up, down)), 0.0), over
