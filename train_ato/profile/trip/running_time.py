"""Price of time of a given running time: secant of the logarithms of price and time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from train_ato.profile.trip.plan import TripPlan

TIME_TOLERANCE, LARGEST_DEVIATION = 1e-3, 0.01
"""Relative deviation from the running time that ends the search, and that of a plan of the last round.

The running time is not continuous in the price: an application moves by whole cells."""
MAX_ROUNDS = 7
"""Largest number of journeys for a running time."""
PRICE_RANGE = (0.005, 20.0)
"""Lowest and highest price of time [kWh/s]."""


def plan_at_time(
    at_price: Callable[[float], TripPlan], time: float, price: float, report: Callable[[TripPlan], None]
) -> TripPlan:
    """Return the plan with a running time [s].

    Parameters
    ----------
    at_price
        Plan for a price of time [kWh/s].
    time
        Running time [s].
    price
        First price of time [kWh/s].
    report
        Called with every plan of the search.

    Raises
    ------
    ValueError
        If the time is too short, or so long that the train would stop.
    """
    found: list[tuple[float, TripPlan]] = []
    for _ in range(MAX_ROUNDS):
        plan = at_price(price)
        error = plan.running_time / time - 1.0
        report(plan)
        found.append((price, plan))
        if abs(error) <= TIME_TOLERANCE:
            return plan
        price = _next_price(found, time)
        if not PRICE_RANGE[0] <= price <= PRICE_RANGE[1]:
            break
    best = min((plan for _, plan in found), key=lambda plan: abs(plan.running_time - time))
    if abs(best.running_time / time - 1.0) <= LARGEST_DEVIATION:
        return best
    raise ValueError(
        f"time: {time:g} s: not possible with these limits, the nearest is {best.running_time:.0f} s; give a time "
        "nearer to it, or permit more traction"
    )


def _next_price(found: list[tuple[float, TripPlan]], time: float) -> float:
    """Return the next price of time [kWh/s] of the search for a running time [s]."""
    ordered = sorted(found, key=lambda row: row[0])
    long = [row for row in ordered if row[1].running_time > time]
    short = [row for row in ordered if row[1].running_time <= time]
    if not short:
        return 3.0 * ordered[-1][0] if len(found) > 1 else _typical(found[0], time)
    if not long:
        return ordered[0][0] / 3.0 if len(found) > 1 else _typical(found[0], time)
    (p0, a), (p1, b) = long[-1], short[0]
    share = np.log(a.running_time / time) / np.log(a.running_time / b.running_time)
    share = float(np.clip(share, 0.1, 0.9))
    return float(p0 * (p1 / p0) ** share)


def _typical(row: tuple[float, TripPlan], time: float) -> float:
    """Return the price for a running time [s] if the price falls with its sixth power."""
    return float(row[0] * np.clip((row[1].running_time / time) ** 6 * 1.1, 0.2, 5.0))
