"""Times of a journey's timing points at the least net energy, every window kept.

With one price of time for the whole journey the time reserve is shared out at the least energy.  Where a window is not
kept, the most exceeded one fixes the time of its point, and the journey before and after has its own price: for convex
costs this recursion gives the optimum (Norstad, Fagerholt and Laporte, "Tramp ship routing and scheduling with speed
optimization", 2011).  A stop has one time, its departure; a passing point within a section couples both prices by the
speed there, which the switching curve of both contains.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from train_ato.messages.types import Array
from train_ato.profile.planner.driving_strategy import MINIMUM_TIME, DrivingStrategy
from train_ato.profile.planner.dynamic_programming import CoarseGrid, Resolution
from train_ato.profile.planner.net_energy import energy_weights
from train_ato.profile.planner.passes import durations
from train_ato.profile.planner.section import PlanSection
from train_ato.profile.planner.time_reserve import (
    FIRST_GRID,
    LAST_GRID,
    PRICE_RANGE,
    TIME_TOLERANCE,
    curve_strategy,
    mean_curves,
    near_prices,
)

FIRST_STEPS, SHARE_STEPS = 16, 30
"""Largest numbers of prices on the first grid, and of shares of two prices, that are tried for one fixed time."""
PRICE_ACCURACY = 2e-3
"""Relative accuracy of the time of a price on the first grid."""


@dataclass(frozen=True, slots=True)
class TimedPlace:
    """A timing point with one window: of the departure, of passing, or of the last arrival.

    Attributes
    ----------
    place : float
        Place of the front [m].
    earliest, latest : float
        Window [s]; 0 and infinity without.
    dwell : float
        Time from arrival to departure [s]; 0 for passing.
    depart_after : float
        The train waits until this time before it departs [s].
    """

    place: float
    earliest: float
    latest: float
    dwell: float = 0.0
    depart_after: float = 0.0


@dataclass(frozen=True, slots=True)
class Leg:
    """A section with the numbers of its timed places: the first and the last are the stops at its ends."""

    section: PlanSection
    first: int
    last: int

    def times(self, places: list[TimedPlace], strategy: DrivingStrategy) -> Array:
        """Return the times from the departure to every timed place behind the first [s]."""
        section = self.section
        grid, energy = section.grid, section.energy_profile(strategy)
        total = np.concatenate(([0.0], np.cumsum(durations(energy, grid.steps))))
        inner = [places[k].place for k in range(self.first + 1, self.last)]
        passed = np.interp(inner, grid.places, total) + section.window / 2
        return np.concatenate((passed, [total[-1] + section.window]))


class WindowSearch:
    """Search for the strategies of a journey.

    Parameters
    ----------
    legs
        Sections of the journey.
    places
        Timed places in order; windows of the first are not used.
    start
        Departure at the first place [s].
    floors
        Places and least v²/2 of every leg, or None.
    """

    def __init__(
        self, legs: list[Leg], places: list[TimedPlace], start: float, floors: list[tuple[Array, Array] | None]
    ) -> None:
        self._legs, self._places, self._start, self._floors = legs, places, start, floors
        settings = legs[0].section.inputs.settings
        self._weights = energy_weights(settings)
        self._least_price = max(settings.auxiliary / legs[0].section.inputs.train.inertia, PRICE_RANGE[0])
        self._grids: dict[tuple[int, Resolution], CoarseGrid] = {}
        self._found: dict[tuple[int, Resolution, tuple[float, ...]], tuple[DrivingStrategy, Array]] = {}
        self._prices: Array = np.full(len(places) - 1, PRICE_RANGE[1])
        self._late_prices = self._prices.copy()

    def solve(self) -> tuple[list[DrivingStrategy], Array]:
        """Return the strategies of all legs and the times of all places [s], shape (places,)."""
        last = len(self._places) - 1
        fixed = {last: self._places[last].latest}
        strategies: list[DrivingStrategy] = []
        times = np.zeros(last + 1)
        for _ in range(last + 1):
            ends = sorted(fixed)
            for _sweep in range(1 if len(ends) == 1 else 2):
                for begin, end in zip([0, *ends[:-1]], ends, strict=True):
                    self._set_price(begin, end, fixed[end], fixed[end] == self._places[end].latest)
            strategies, (times, ready) = self._mixed(ends, fixed)
            early = np.array([place.earliest for place in self._places]) - ready
            late = times - np.array([place.latest for place in self._places])
            excess = np.maximum(early, late)
            excess[[0, *ends]] = 0.0
            worst = int(np.argmax(excess))
            if excess[worst] <= TIME_TOLERANCE:
                break
            fixed[worst] = self._places[worst].latest if late[worst] > 0 else self._places[worst].earliest
        return strategies, times

    def chained(self, leg_times: list[Array]) -> tuple[Array, Array]:
        """Return the times of all places [s] from those within the legs, with and without waiting for a departure."""
        times, ready = [self._start], [self._start]
        for leg, inner in zip(self._legs, leg_times, strict=True):
            times += (times[leg.first] + inner).tolist()
            place = self._places[leg.last]
            times[-1] += place.dwell
            ready += times[leg.first + 1 :]
            times[-1] = max(times[-1], place.depart_after)
        return np.array(times), np.array(ready)

    def predicted(self, strategies: list[DrivingStrategy]) -> Array:
        """Return the times of all places [s] with strategies."""
        pairs = zip(self._legs, strategies, strict=True)
        return self.chained([leg.times(self._places, strategy) for leg, strategy in pairs])[0]

    def _leg_at(self, number: int, size: Resolution) -> tuple[DrivingStrategy, Array]:
        """Return the strategy of a leg at the present prices, and its times [s]."""
        leg = self._legs[number]
        prices = tuple(self._prices[leg.first : leg.last].tolist())
        key = (number, size, prices)
        if key not in self._found:
            if (number, size) not in self._grids:
                self._grids[number, size] = leg.section.coarse_grid(size, self._floors[number])
            grid = self._grids[number, size]
            borders = [self._places[k].place for k in range(leg.first + 1, leg.last)]
            cell = np.searchsorted(borders, 0.5 * (grid.places[1:] + grid.places[:-1]), side="right")
            strategy = curve_strategy(grid, np.array(prices)[cell], self._weights)
            strategy = replace(strategy, floor=self._floors[number])
            self._found[key] = strategy, leg.times(self._places, strategy)
        return self._found[key]

    def _times(self, size: Resolution) -> tuple[Array, Array]:
        """Return the times of :meth:`chained` [s] at the present prices; infinite without a solution."""
        try:
            return self.chained([self._leg_at(number, size)[1] for number in range(len(self._legs))])
        except ValueError:
            return np.full(len(self._places), np.inf), np.full(len(self._places), np.inf)

    def _set_price(self, begin: int, end: int, time: float, is_latest: bool) -> None:
        """Set the price between two places so that the second has its time [s] as closely as the last grid permits."""
        low, high = self._least_price if is_latest else PRICE_RANGE[0], PRICE_RANGE[1]
        least, price = low, min(max(float(self._prices[begin]), 2.0 * low), 1.0)

        def needed(price: float, size: Resolution) -> tuple[float, float]:
            self._prices[begin:end] = price
            times, ready = self._times(size)
            return float(ready[end] - times[begin]), float(time - times[begin])

        for step in range(FIRST_STEPS):
            found, wanted = needed(price, FIRST_GRID)
            if abs(found - wanted) <= PRICE_ACCURACY * wanted or high / low <= 1.0 + PRICE_ACCURACY:
                break
            low, high = (low, price) if found < wanted else (price, high)
            guess = price * (found / wanted) ** 3 if wanted > 0 and np.isfinite(found) else np.inf
            price = guess if step % 2 == 0 and low < guess < high else float(np.sqrt(low * high))
        pair = near_prices(lambda price: needed(max(price, least), LAST_GRID)[0], wanted, price)
        self._prices[begin:end], self._late_prices[begin:end] = (max(price, least) for price in pair)

    def _mixed(self, ends: list[int], fixed: dict[int, float]) -> tuple[list[DrivingStrategy], tuple[Array, Array]]:
        """Return strategies with means of the curves of two prices, so that every fixed place has its time."""
        numbers, prices = range(len(self._legs)), self._prices
        fast, self._prices = [self._leg_at(number, LAST_GRID) for number in numbers], self._late_prices
        slow, self._prices = [self._leg_at(number, LAST_GRID)[0] for number in numbers], prices
        strategies, spans = [leg[0] for leg in fast], [leg[1] for leg in fast]
        for begin, end in zip([0, *ends[:-1]], ends, strict=True):
            waits_for_floor = self._prices[begin] <= self._least_price * 1.001
            if waits_for_floor and self.chained(spans)[1][end] <= fixed[end]:
                continue
            low, high, best = 0.0, 1.0, (strategies, spans)
            for _ in range(SHARE_STEPS):
                share = 0.5 * (low + high)
                trial = self._with_share(strategies, slow, spans, (begin, end), share)
                gap = fixed[end] - float(self.chained(trial[1])[1][end])
                low, high, best = (low, share, trial) if gap >= 0.0 else (share, high, best)
                if 0.0 <= gap < TIME_TOLERANCE:
                    break
            strategies, spans = best
        return strategies, self.chained(spans)

    def _with_share(
        self,
        strategies: list[DrivingStrategy],
        slow: list[DrivingStrategy],
        spans: list[Array],
        between: tuple[int, int],
        share: float,
    ) -> tuple[list[DrivingStrategy], list[Array]]:
        """Return strategies and times with a share of the slower curves between two places."""
        found, times = list(strategies), list(spans)
        begin, end = between
        for number, leg in enumerate(self._legs):
            curve = strategies[number].curve
            if leg.last <= begin or leg.first >= end or curve is None:
                continue
            first, last = self._places[max(begin, leg.first)].place, self._places[min(end, leg.last)].place
            inside = (curve[0] >= first) & (curve[0] <= last)
            found[number] = mean_curves(strategies[number], slow[number], np.where(inside, share, 1.0))
            try:
                times[number] = leg.times(self._places, found[number])
            except ValueError:
                times[number] = np.full(spans[number].size, np.inf)
        return found, times


def fastest_times(legs: list[Leg], places: list[TimedPlace], start: float) -> Array:
    """Return the earliest possible times of all places [s]; the train waits for the begin of every window."""
    times = [start]
    for leg in legs:
        spans = leg.times(places, MINIMUM_TIME)
        begin = times[leg.first]
        for k, span in zip(range(leg.first + 1, leg.last + 1), np.diff(np.concatenate(([0.0], spans))), strict=True):
            begin = max(begin + float(span) + (places[k].dwell if k == leg.last else 0.0), places[k].earliest)
            times.append(begin)
        times[-1] = max(times[-1], places[leg.last].depart_after)
    return np.array(times)
