"""Jerk limit of a section: window and reserves of the moving average over time.

Window, reserves and the extension of the limits are increased until the averaged section keeps every limit at the
knots.
"""

from __future__ import annotations

import numpy as np

from train_ato.messages.types import Array
from train_ato.profile.planner.driving_strategy import MINIMUM_TIME, DrivingStrategy, SectionKnots
from train_ato.profile.planner.section import PlanSection
from train_ato.profile.planner.smoothing import largest_acceleration_change

MAX_ROUNDS = 25
"""Rounds of the search for window and reserves of the moving average."""
HOLDING_BRAKE_SPEED = 0.05
"""Speed below which the holding brake acts and the brake envelope is not checked [m/s]."""
TOLERANCE = 1e-6
"""Relative excess of a force or limit that counts as rounding."""


def fit_jerk_limit(section: PlanSection, start: float, period: float, strategy: DrivingStrategy = MINIMUM_TIME) -> None:
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
        return
    if section.window <= 0:
        _set_first_window(section, jerk)
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
            section.window = max(section.window * 1.01, change / jerk * (1 + TOLERANCE / 2))
            continue
        knots = section.knots(section.times(start, period, history)[0], start, history)
        excess, overspeed = _exceedance(section, knots)
        shortfall = float(excess.max(initial=0.0))
        if max(shortfall, overspeed) <= TOLERANCE:
            return
        if shortfall > TOLERANCE:
            section.reserve.raise_at(knots.place, knots.speed * (section.window / 2 + period), excess)
        if overspeed > TOLERANCE:
            section.limit_extension *= 1.25
    raise ValueError(
        f"no solution from km {section.begin / 1000:.3f} to km {section.end / 1000:.3f} within jerk {jerk:g} m/s³ and "
        f"the forces (short by {100 * shortfall:.1f} %); increase jerk or reduce force_margin"
    )


def _set_first_window(section: PlanSection, jerk: float) -> None:
    """Set the window from the largest acceleration without a jerk limit."""
    energy = section.energy_profile()
    section.fastest_speed = (section.grid.places, np.sqrt(2 * energy))
    history = section.over_time(energy)
    section.window = max(float(np.abs(history[4]).max()), abs(section.begin_acceleration)) / jerk


def _exceedance(section: PlanSection, knots: SectionKnots) -> tuple[Array, float]:
    """Return the relative excess of traction and brake force at every knot, shape (2, n), and of the speed."""
    train, settings = section.inputs.train, section.inputs.settings
    traction, electric, air = train.forces_at(knots.speed)
    keep = 1.0 - settings.force_margin
    driven = (knots.force > 1.0) & (knots.speed > 1e-6)
    braked = (knots.force < -1.0) & (knots.speed > HOLDING_BRAKE_SPEED)
    if section.begin_speed > 0:  # the initial acceleration cannot change at once
        settled = knots.place > section.grid.begin + section.begin_speed * section.window
        driven, braked = driven & settled, braked & settled
    up = np.where(driven, knots.force / (keep * traction + 1e-3) - 1.0, 0.0)
    down = np.where(braked, -knots.force / (keep * (electric + air) + 1e-3) - 1.0, 0.0)
    limit = section.inputs.limits.at(knots.place, train.length)
    over = 0.0 if section.accept_overspeed else float(np.max(knots.speed / limit, initial=0.0)) - 1.0
    return np.maximum(np.stack((up, down)), 0.0), over
