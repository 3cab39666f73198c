"""Times of a journey's timing points at the least net energy, every window kept.

With one price of time for the whole journey the time reserve is shared out at the least energy. If windows are not
kept, the most exceeded window fixes the time of its point. The journey before this point and the journey after it then
have their own prices. For convex costs this recursion gives the optimum (Norstad, Fagerholt and Laporte, "Tramp ship
routing and scheduling with speed optimization", 2011). A stop has one time, its departure. A passing point within a
section couples both prices by the speed there, which the switching curve of both contains.

Distribution of the time reserve of a timetable: less net energy by coasting and a lower cruise.

Traction and electric brake are used below and above the switching curves of
:mod:`train_ato.profile.planner.dynamic_programming`. One price of time gives the curves of all sections. A lower price
uses more of the reserve. The price is searched on a coarse grid and then on a fine grid, both without a jerk limit,
until two near prices have the wanted time between them. A mean of their curves then keeps the time. The curves of one
price at other speeds would not keep it: where the optimal run just reaches a limit downhill, a little more speed is
braked away. At last :mod:`train_ato.profile.planner.switching_places` moves the begins of coasting to their best
places.

The classical rule is evaluated too. Its traction ends at one speed V, and its coasting changes to braking at U =
psi(V)/phi'(V) with phi = v r(v), psi = v² r'(v), and r the running resistance (Howlett and Pudney, "Energy-Efficient
Train Control", 1995). Variants have less coasting, or only a reduced cruise. The strategies with the least net energy
are used.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from plant_sim.elementary import plain_sum
from train_ato.messages.types import Array
from train_ato.profile.planner.driving_strategy import MIN_CRUISE, MINIMUM_TIME, DrivingStrategy
from train_ato.profile.planner.dynamic_programming import CoarseGrid, EnergyWeights, Resolution, switching_curve
from train_ato.profile.planner.passes import durations
from train_ato.profile.planner.section import PlanSection, energy_weights, section_energy
from train_ato.profile.planner.switching_places import best_distances, moved, switches_to_coasting
from train_ato.profile.planner.timing_points import TimeWindow, TimingPoint
from train_ato.profile.planner.train_tables import SPEED_STEP

COASTING_FACTORS = (0.0, 1.0)
"""Factors on the speed range of coasting below V that are evaluated; 0 is a reduced cruise alone."""
TIME_TOLERANCE = 0.02
"""Permitted deviation from a timetable [s]."""
PRICE_TOLERANCE = 0.002
"""Relative accuracy of the running time in the search for the price of time on the first grid."""
FIRST_GRID, LAST_GRID = Resolution(400, 250), Resolution(6000, 700)
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

    curves = cache(lambda price: strategies(fine, price))  # the pair is among the prices of its search
    price = _price_of_time(sections, time, lambda price: strategies(coarse, price))
    pair = near_prices(lambda price: predicted_time(sections, curves(price)), time, price)
    fast, slow = (curves(price) for price in pair)

    def mixed(share: float) -> Strategies:
        return [mean_curves(one, other, share) for one, other in zip(fast, slow, strict=True)]

    found = _with_cap(sections, time, mixed(_bisect(sections, time, mixed, *SHARE_RANGE)))
    better = _with_best_switches(sections, time, found, pair[0])
    kept = predicted_time(sections, better) <= time
    return better if kept and _total_energy(sections, better) < _total_energy(sections, found) else found


def _with_best_switches(sections: list[PlanSection], time: float, strategies: Strategies, price: float) -> Strategies:
    """Return the strategies with the best places of their switches to coasting for the running time [s].

    The best places of two near prices of time have the time between them; a mean of both keeps it.
    """
    switches = [switches_to_coasting(*entry) for entry in zip(sections, strategies, strict=True)]
    found: dict[float, list[Array]] = {}

    def best(power: float) -> list[Array]:
        if power not in found:
            runs = zip(sections, strategies, switches, strict=True)
            found[power] = [best_distances(section, entry, at, power) for section, entry, at in runs]
        return found[power]

    def mean(distances: list[Array]) -> Strategies:
        return [moved(*entry) for entry in zip(strategies, switches, distances, strict=True)]

    fast, slow = (
        best(power) for power in near_prices(lambda power: predicted_time(sections, mean(best(power))), time, price)
    )

    def mixed(share: float) -> Strategies:
        return mean([share * one + (1.0 - share) * other for one, other in zip(fast, slow, strict=True)])

    return mixed(_bisect(sections, time, mixed, *SHARE_RANGE))


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
    coasting = grid.coasting_rate(np.minimum(traction, grid.top), SPEED_STEP)
    return DrivingStrategy(
        curve=(places, traction), coasting=coasting, electric=electric if weights.recovered > 0 else None
    )


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
        runs = zip(sections, strategies, strict=True)
        return plain_sum(section_energy(section, section.energy_profile(strategy)) for section, strategy in runs)
    except ValueError:
        return np.inf


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
                    self._set_price(begin, end, fixed[end], is_latest=fixed[end] == self._places[end].latest)
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

    def _set_price(self, begin: int, end: int, time: float, *, is_latest: bool) -> None:
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


WINDOW_TOLERANCE = 0.05
"""Time by which a window may be missed because of rounding [s]."""


@dataclass(frozen=True, slots=True)
class Lateness:
    """A window that cannot be kept: label of the point, name of the window, its time and the earliest possible [s]."""

    label: str
    window: str
    latest: float
    possible: float

    def __str__(self) -> str:
        return (
            f"timing point {self.label}: latest {self.window} {self.latest:.1f} s cannot be kept, the earliest is "
            f"{self.possible:.1f} s; add {self.possible - self.latest:.1f} s"
        )


def timed_place(point: TimingPoint, final: TimingPoint) -> TimedPlace:
    """Return the single window of a timing point, that of its departure, of passing, or of the last arrival.

    Raises
    ------
    ValueError
        If dwell time and windows of a stop contradict each other.
    """
    if not point.stops and point is not final:
        window = point.passing or TimeWindow()
        return TimedPlace(point.at, window.earliest or 0.0, _or_never(window.latest))
    arrival, departure = point.arrival or TimeWindow(), point.departure or TimeWindow()
    if point is final:
        return TimedPlace(point.at, arrival.earliest or 0.0, _or_never(arrival.latest))
    dwell = point.dwell or 0.0
    after = departure.earliest or 0.0
    dwell = max(dwell, after - _or_never(arrival.latest))
    earliest = max(after, (arrival.earliest or 0.0) + dwell)
    latest = min(_or_never(departure.latest), _or_never(arrival.latest) + dwell)
    if earliest > latest + WINDOW_TOLERANCE:
        raise ValueError(
            f"timing point {point.label}: with a dwell time of {dwell:.1f} s the earliest departure is {earliest:.1f} "
            f"s, the latest {latest:.1f} s; widen its windows or reduce the dwell time"
        )
    return TimedPlace(point.at, earliest, latest, dwell, after)


def lateness_at(point: TimingPoint, place: TimedPlace, time: float, *, is_last: bool) -> Lateness:
    """Return the exceeded window of a point; of a stop its arrival, if that is the narrower one."""
    if not point.stops and not is_last:
        return Lateness(point.label, "passing", place.latest, time)
    departure = point.departure or TimeWindow()
    if not is_last and departure.latest is not None and departure.latest <= place.latest:
        return Lateness(point.label, "departure", place.latest, time)
    return Lateness(point.label, "arrival", place.latest - place.dwell, time - place.dwell)


def _or_never(time: float | None) -> float:
    return np.inf if time is None else time
