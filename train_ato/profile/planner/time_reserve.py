"""Distribution of the time reserve of a timetable: less net energy by coasting and a lower cruise.

Traction and electric brake are used below and above the switching curves of
:mod:`train_ato.profile.planner.dynamic_programming`.  One price of time gives the curves of all sections; a lower price
uses more of the reserve.  The price is searched on a coarse grid and then on a fine one, both without a jerk limit,
until two near prices have the time between them; a mean of their curves keeps it.  The curves of one price at other
speeds would not: where the optimal run just reaches a limit downhill, a little more speed is braked away.

The classical rule is evaluated too: traction ends at one speed V, and coasting changes to braking at U = psi(V)/phi'(V)
with phi = v r(v), psi = v² r'(v), r the running resistance (Howlett and Pudney, "Energy-Efficient Train Control",
1995), with less coasting, or as a reduced cruise alone.  The strategies with the least net energy are used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from plant_sim.summation import plain_sum
from train_ato.messages.types import Array
from train_ato.profile.planner.driving_strategy import MIN_CRUISE, MINIMUM_TIME, DrivingStrategy
from train_ato.profile.planner.dynamic_programming import CoarseGrid, EnergyWeights, Resolution, switching_curve
from train_ato.profile.planner.net_energy import energy_weights, section_energy
from train_ato.profile.planner.section import PlanSection
from train_ato.profile.planner.train_tables import SPEED_STEP

COASTING_FACTORS = (0.0, 1.0)
"""Factors on the speed range of coasting below V that are evaluated; 0 is a reduced cruise alone."""
TIME_TOLERANCE = 0.02
"""Permitted deviation from a timetable [s]."""
PRICE_TOLERANCE = 0.002
"""Relative accuracy of the running time in the search for the price of time on the first grid."""
FIRST_GRID, LAST_GRID = Resolution(400, 250), Resolution(2000, 700)
"""Grids of the search for the price of time, and of the curves at this price."""
MAX_CORRECTIONS = 14
"""Largest number of prices on the last grid."""
PRICE_POWER, PAIR_STEP = 3.0, 1.001
"""First power of the running time with which the price grows, doubled until the time lies between two prices, and
factor on the time beyond it."""
PAIR_DISTANCE = 5e-4
"""Relative distance of two prices that are near enough."""
SHARE_RANGE = (1e-6, 1.0)
"""Range of the share of the faster one of two prices."""
PRICE_RANGE = (1e-5, 1e4)
"""Search range of the price of time [W/kg]."""
MAX_ITERATIONS = 60
MAX_UNUSED_TIME = 1.0
"""Time reserve that may remain unused if no strategy uses all of it [s]."""

Strategies = list[DrivingStrategy]


def spread_time_reserve(sections: list[PlanSection], time: float) -> Strategies:
    """Return the strategies of all sections for a total running time [s] with the least net energy.

    If the minimum time is not shorter, the strategies of the minimum time are returned.

    Raises
    ------
    ValueError
        If the time needs a speed below the minimum cruise speed.
    """
    if time <= plain_sum(section.time() for section in sections) + TIME_TOLERANCE:
        return [MINIMUM_TIME] * len(sections)
    candidates = [_by_cruise_speed(sections, time, factor) for factor in COASTING_FACTORS]
    candidates += [_by_price_of_time(sections, time), _with_cap(sections, time, [MINIMUM_TIME] * len(sections))]
    if all(time - predicted_time(sections, strategies) > MAX_UNUSED_TIME for strategies in candidates):
        raise ValueError(
            f"timetable too slack: {time:.1f} s of running needs less than {3.6 * MIN_CRUISE:.1f} km/h; reduce the "
            "time or increase a dwell time"
        )
    return min(candidates, key=lambda strategies: _total_energy(sections, strategies))


def _by_price_of_time(sections: list[PlanSection], time: float) -> Strategies:
    """Return the switching curves of the price of time that gives the running time [s]."""
    coarse, fine = ([section.coarse_grid(size) for section in sections] for size in (FIRST_GRID, LAST_GRID))
    weights = energy_weights(sections[0].inputs.settings)

    def strategies(grids: list[CoarseGrid], price: float) -> Strategies:
        return [curve_strategy(grid, price, weights) for grid in grids]

    price = _price_of_time(sections, time, lambda price: strategies(coarse, price))
    pair = near_prices(lambda price: predicted_time(sections, strategies(fine, price)), time, price)
    fast, slow = (strategies(fine, price) for price in pair)

    def mixed(share: float) -> Strategies:
        return [mean_curves(one, other, share) for one, other in zip(fast, slow, strict=True)]

    return _with_cap(sections, time, mixed(_bisect(sections, time, mixed, *SHARE_RANGE)))


def near_prices(needed: Callable[[float], float], time: float, price: float) -> tuple[float, float]:
    """Return two near prices of time [W/kg], the first with a running time within the given one, the second beyond it.

    Where no price on one side is found, both are the last one of the search.

    Parameters
    ----------
    needed
        Running time of a price [s], decreasing; infinite without a solution.
    time
        Given running time [s].
    price
        Begin of the search [W/kg].
    """
    low, high = (0.0, np.inf), (np.inf, 0.0)  # price and running time
    power = PRICE_POWER
    for step in range(MAX_CORRECTIONS):
        found = needed(price)
        last = price
        if found <= time:
            high = (price, found)
        else:
            low = (price, found)
        if 0.0 <= time - found < TIME_TOLERANCE or high[0] < low[0] * (1.0 + PAIR_DISTANCE):
            break
        if low[0] > 0.0 and np.isfinite(high[0]):
            part = (low[1] - time) / (low[1] - high[1]) if step % 2 and np.isfinite(low[1]) else 0.5
            price = low[0] * (high[0] / low[0]) ** min(max(part, 0.1), 0.9)
            continue
        beyond = PAIR_STEP if found > time else 1.0 / PAIR_STEP
        factor = 2.0 if np.isinf(found) else (found / time * beyond) ** power
        price = min(max(price * factor, PRICE_RANGE[0]), PRICE_RANGE[1])
        power *= 2.0
    return high[0] if np.isfinite(high[0]) else last, low[0] if low[0] > 0.0 else last


def mean_curves(one: DrivingStrategy, other: DrivingStrategy, share: float | Array) -> DrivingStrategy:
    """Return a strategy with the mean E of the curves of two; ``share`` is the weight of the first, or one by place."""
    if one.curve is None or other.curve is None:
        return one
    curve = one.curve[0], share * one.curve[1] + (1.0 - share) * other.curve[1]
    if one.electric is None or other.electric is None:
        return replace(one, curve=curve)
    return replace(one, curve=curve, electric=share * one.electric + (1.0 - share) * other.electric)


def _price_of_time(sections: list[PlanSection], time: float, strategies: Callable[[float], Strategies]) -> float:
    """Return the price of time [W/kg] that gives the running time [s]."""
    low, high = PRICE_RANGE
    for _ in range(MAX_ITERATIONS):
        price = float(np.sqrt(low * high))
        needed = predicted_time(sections, strategies(price))
        if abs(needed - time) < PRICE_TOLERANCE * time or high / low < 1.0001:
            return price
        low, high = (low, price) if needed <= time else (price, high)
    return high


def curve_strategy(grid: CoarseGrid, price: float | Array, weights: EnergyWeights) -> DrivingStrategy:
    """Return the strategy of the switching curves of a price of time [W/kg]."""
    places, traction, electric = switching_curve(grid, price, SPEED_STEP, weights)
    return DrivingStrategy(curve=(places, traction), electric=electric if weights.recovered > 0 else None)


def _by_cruise_speed(sections: list[PlanSection], time: float, factor: float) -> Strategies:
    """Return the cruise strategy of a coasting factor for the running time [s]; a speed cap uses the remainder."""
    train = sections[0].inputs.train

    def strategies(speed: float) -> Strategies:
        return [_cruise_strategy(sections, speed, factor)] * len(sections)

    cruise = _bisect(sections, time, strategies, MIN_CRUISE, 4 * train.speed_max)
    return _with_cap(sections, time, strategies(cruise))


def _with_cap(sections: list[PlanSection], time: float, strategies: Strategies) -> Strategies:
    """Return the strategies with a speed cap that uses the remaining time reserve."""
    if time - predicted_time(sections, strategies) < TIME_TOLERANCE:
        return strategies
    train = sections[0].inputs.train

    def capped(speed: float) -> Strategies:
        return [replace(strategy, cap=speed) for strategy in strategies]

    return capped(_bisect(sections, time, capped, MIN_CRUISE, train.speed_max))


def _bisect(
    sections: list[PlanSection], time: float, strategies: Callable[[float], Strategies], slow: float, fast: float
) -> float:
    """Return the smallest value between ``slow`` and ``fast`` that keeps the time; ``fast`` must keep it."""
    for _ in range(MAX_ITERATIONS):
        middle = float(np.sqrt(fast * slow))
        needed = predicted_time(sections, strategies(middle))
        fast, slow = (middle, slow) if needed <= time else (fast, middle)
        if 0 <= time - needed < TIME_TOLERANCE or fast - slow < 1e-9:
            break
    return fast


def _cruise_strategy(sections: list[PlanSection], cruise: float, factor: float) -> DrivingStrategy:
    """Return the strategy with a cruise speed V [m/s]."""
    train = sections[0].inputs.train
    c0, c1, c2 = train.resistance_at(np.array([0.0, 1.0, 2.0])) @ np.array([[1, -1.5, 0.5], [0, 2, -1], [0, -0.5, 0.5]])
    slope, product = c1 + 2 * c2 * cruise, c0 + 2 * c1 * cruise + 3 * c2 * cruise**2
    into_braking = cruise**2 * slope / product if product > 0 else cruise
    coast = np.inf if factor == 0 else max(cruise - factor * (cruise - into_braking), 0.5)
    return DrivingStrategy(cruise, coast)


def predicted_time(sections: list[PlanSection], strategies: Strategies) -> float:
    """Return the running time of all sections [s]; infinite if a section has no solution."""
    try:
        return plain_sum(section.time(strategy) for section, strategy in zip(sections, strategies, strict=True))
    except ValueError:
        return np.inf


def _total_energy(sections: list[PlanSection], strategies: Strategies) -> float:
    """Return the net energy of all sections [J]; infinite if a section has no solution."""
    try:
        return plain_sum(map(section_energy, sections, strategies))
    except ValueError:
        return np.inf
