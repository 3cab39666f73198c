"""Solution of one section between two stops: the fastest one within limits, forces and comfort.

The passes find v²/2 over the place without a jerk limit.  A moving average over time then limits the jerk; its window
and reserves come from :mod:`train_ato.profile.planner.jerk_limit`.

Jerk limit by a moving average over time.

The unsmoothed solution has constant acceleration in every cell. Its average over a window T has the jerk (a(t + T/2) -
a(t - T/2))/T, the same distance and the same end. No speed or acceleration exceeds the largest value in the window.
Averages are differences of the integrals and therefore exact.
"""

from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np

from plant_sim.compiled import compiled
from train_ato.messages.types import Array
from train_ato.profile.planner import passes
from train_ato.profile.planner.accelerations import (
    SectionTables,
    acceleration_table,
    averaging_range,
    braking_message,
    stall_message,
)
from train_ato.profile.planner.driving_strategy import MINIMUM_TIME, DrivingStrategy, SectionInputs
from train_ato.profile.planner.dynamic_programming import CoarseGrid, EnergyWeights, Resolution
from train_ato.profile.planner.line_tables import PlaceGrid
from train_ato.profile.planner.settings import PlanSettings
from train_ato.profile.planner.train_tables import SPEED_STEP


@compiled
def time_history(
    energy: Array, places: Array, lead: float, lead_acceleration: float, tail: float, margin: float
) -> Array:
    """Return the unsmoothed solution over time: rows time, integral of place, place, speed, acceleration.

    Parameters
    ----------
    energy : Array, shape (n + 1,)
        v²/2 at every place of the front.
    places : Array, shape (n + 1,)
        m.
    lead, lead_acceleration
        Duration and acceleration of the state before the first place [s, m/s²].
    tail
        Duration of the speed at the last place [s].
    margin
        Further time before and after [s].
    """
    n, begin = energy.size - 1, places[0]
    run = np.zeros((5, n + 3))
    v0 = np.sqrt(2.0 * energy[0])
    time, v = -lead - margin, v0 - lead_acceleration * (lead + margin)
    run[0, 0], run[3, 0], run[4, 0] = time, v, lead_acceleration
    run[2, 0] = begin - v0 * (lead + margin) + 0.5 * lead_acceleration * (lead + margin) ** 2
    time, v = 0.0, v0
    run[0, 1], run[2, 1], run[3, 1] = 0.0, begin, v0
    for k in range(n):
        u = np.sqrt(2.0 * energy[k + 1])
        dt = 2.0 * (places[k + 1] - places[k]) / (v + u)
        run[4, k + 1] = (u - v) / dt
        time, v = time + dt, u
        run[0, k + 2], run[2, k + 2], run[3, k + 2] = time, places[k + 1], u
    run[0, n + 2], run[2, n + 2], run[3, n + 2] = time + tail + margin, places[n] + v * (tail + margin), v
    origin = run[2, 1]
    for k in range(n + 2):
        dt = run[0, k + 1] - run[0, k]
        run[1, k + 1] = run[1, k] + dt * (run[2, k] - origin + dt * (run[3, k] / 2.0 + dt * run[4, k] / 6.0))
    return run


@compiled
def _integrals_at(run: Array, piece: int, time: float, origin: float) -> tuple[float, float, float, float]:
    s = time - run[0, piece]
    x, v, a = run[2, piece] - origin, run[3, piece], run[4, piece]
    return (run[1, piece] + s * (x + s * (v / 2.0 + s * a / 6.0)), x + s * (v + s * a / 2.0), v + s * a, a)


@compiled
def moving_average(run: Array, times: Array, window: float) -> tuple[Array, Array, Array]:
    """Return place [m], speed [m/s] and acceleration [m/s²], averaged over a window [s] around increasing times [s]."""
    n = times.size
    place, speed, acceleration = np.empty(n), np.empty(n), np.empty(n)
    origin = run[2, 1]
    early, late, last = 0, 0, run.shape[1] - 2
    for k in range(n):
        t0, t1 = times[k] - window / 2.0, times[k] + window / 2.0
        while early < last and run[0, early + 1] <= t0:
            early += 1
        while late < last and run[0, late + 1] <= t1:
            late += 1
        y0, x0, v0, a0 = _integrals_at(run, early, t0, origin)
        if window <= 0.0:
            place[k], speed[k], acceleration[k] = origin + x0, v0, a0
        else:
            y1, x1, v1, _ = _integrals_at(run, late, t1, origin)
            place[k] = origin + (y1 - y0) / window
            speed[k] = (x1 - x0) / window
            acceleration[k] = (v1 - v0) / window
    return place, speed, acceleration


@compiled
def largest_acceleration_change(run: Array, window: float) -> float:
    """Return the largest change of acceleration within a window [m/s²]; divided by the window it is the jerk."""
    last = run.shape[1] - 2
    largest, first = 0.0, 0
    for early in range(last + 1):
        while first < last and run[0, first + 1] <= run[0, early] + window:
            first += 1
        late = first
        while late <= last and run[0, late] < run[0, early + 1] + window:
            largest = max(largest, abs(run[4, late] - run[4, early]))
            late += 1
    return largest


@compiled
def acceleration_excess(run: Array, window: float, change: float) -> Array:
    """Return by how much every piece exceeds, and falls below, those within a window by more than a change [m/s²].

    Returns
    -------
    Array, shape (2, n)
        Excess of the acceleration above the least one of the window plus ``change``, and below the largest one less it.
    """
    last = run.shape[1] - 2
    excess, first = np.zeros((2, last + 1)), 0
    for early in range(last + 1):
        while first < last and run[0, first + 1] <= run[0, early] + window:
            first += 1
        late = first
        while late <= last and run[0, late] < run[0, early + 1] + window:
            rise = run[4, late] - run[4, early]
            high, low = (late, early) if rise > 0.0 else (early, late)
            excess[0, high] = max(excess[0, high], abs(rise) - change)
            excess[1, low] = max(excess[1, low], abs(rise) - change)
            late += 1
    return excess


MAX_RESERVE = 1.0
"""Largest fraction of a force that is reserved; all of it above the end of an envelope."""
STEP_FACTOR, MIN_STEP = 1.1, 1e-4
"""Increase of a reserve: factor on the relative excess, and constant part."""


class ForceReserve:
    """Reserved fractions of traction and brakes in the cells of a section, for the jerk limit.

    The moving average that limits the jerk mixes the forces of one window. Where the mean exceeds the envelope at the
    mean speed, the force before the averaging is reduced, at this place only. One reserve for the whole run would let
    an excess at the start take the traction that a long train needs on its steepest climb.
    """

    def __init__(self, grid: PlaceGrid) -> None:
        self._grid = grid
        self._fractions: Array = np.zeros((2, grid.cells))
        self.changes = 0

    def raise_at(self, places: Array, widths: Array, excess: Array) -> None:
        """Increase the reserve around the places of an excess.

        Parameters
        ----------
        places, widths : Array, shape (n,)
            Places of the front, and distance on either side over which the forces are mixed [m].
        excess : Array, shape (2, n)
            Relative excess of the traction and of the brake force, 0 without.
        """
        grid = self._grid
        cell = np.clip(np.searchsorted(grid.places, places, side="right") - 1, 0, grid.cells - 1)
        for fraction, over in zip(self._fractions, excess, strict=True):
            if not over.any():
                continue
            most, width = np.zeros(grid.cells), np.zeros(grid.cells)
            np.maximum.at(most, cell, over)
            np.maximum.at(width, cell[over > 0.0], widths[over > 0.0])
            reach = np.full(grid.cells, float(width.max()))
            near = passes.sliding_extreme(width, reach, grid.places, True)
            spread = passes.sliding_extreme(most, near, grid.places, True)
            fraction += np.where(spread > 0.0, STEP_FACTOR * spread + MIN_STEP, 0.0)
            np.minimum(fraction, MAX_RESERVE, out=fraction)
        self.changes += 1

    def over(self, grid: PlaceGrid) -> tuple[Array, Array]:
        """Return the reserves of traction and brakes in the cells of a grid, shape (cells,) each."""
        middle = 0.5 * (grid.places[:-1] + grid.places[1:])
        cell = np.clip(np.searchsorted(self._grid.places, middle, side="right") - 1, 0, self._grid.cells - 1)
        return self._fractions[0, cell], self._fractions[1, cell]


@dataclass
class PlanSection:
    """A section of the front from ``begin`` to ``end``.

    Attributes
    ----------
    begin, end : float
        Places of the front [m].
    begin_speed, begin_acceleration, end_speed : float
        State at the begin [m/s, m/s²] and speed at the end [m/s].
    ceiling : pair of arrays, optional
        Places [m] and speeds [m/s] of an additional speed limit, for example the speed of an earlier profile.
    accept_overspeed : bool
        Accept a begin speed above limits and braking curves, and brake as hard as possible.
    window : float
        Window of the moving average [s]; 0 without a jerk limit.
    limit_extension : float
        Factor on the time by which limits start earlier and end later.
    extend_steps : bool
        Extend the lower side of a step of an envelope for the averaging, see :func:`.accelerations.acceleration_table`.
    keep_window : bool
        Reserve force at the places of too large changes of acceleration, where it is possible, and keep the window.
    first_window : float
        Window of the largest acceleration without a jerk limit [s].
    fastest_speed : pair of arrays, optional
        Places [m] and speeds [m/s] of the fastest run without a jerk limit; None before the window is known.
    """

    inputs: SectionInputs
    begin: float
    end: float
    begin_speed: float = 0.0
    begin_acceleration: float = 0.0
    end_speed: float = 0.0
    ceiling: tuple[Array, Array] | None = None
    accept_overspeed: bool = False
    window: float = 0.0
    limit_extension: float = 1.0
    extend_steps: bool = False
    keep_window: bool = False
    first_window: float = 0.0
    fastest_speed: tuple[Array, Array] | None = None
    _tables: SectionTables | None = None
    _tables_key: tuple[float, ...] = ()
    _ceiling_of: tuple[SectionTables, Array] | None = None
    _grid: PlaceGrid | None = None
    _reserve: ForceReserve | None = None

    @property
    def grid(self) -> PlaceGrid:
        """Grid of the passes; a moving begin or end leaves half a window to the averaging."""
        half = self.window / 2
        first, last = self.begin, self.end
        if self.begin_speed > 0:
            first += self.begin_speed * half + self.lead_acceleration * self.window**2 / 12
        if self.end_speed > 0:
            last -= self.end_speed * half
        if last - first < 1e-6:
            raise ValueError(
                f"the section from km {self.begin / 1000:.3f} to km {self.end / 1000:.3f} is too short for the limits "
                "of acceleration and jerk; move its end on or increase the limits"
            )
        if self._grid is None or (self._grid.begin, self._grid.end) != (first, last):
            borders = self.inputs.force.steps() if self.inputs.settings.has_timetable else None
            self._grid = PlaceGrid(first, last, borders)
        return self._grid

    @property
    def lead_acceleration(self) -> float:
        """Acceleration in the first half window [m/s²], bounded so that the speed stays positive."""
        if self.window <= 0 or self.begin_speed <= 0:
            return 0.0
        return max(self.begin_acceleration, -1.8 * self.begin_speed / self.window)

    def energy_profile(self, strategy: DrivingStrategy = MINIMUM_TIME) -> Array:
        """Return v²/2 without a jerk limit at every place of the grid [m²/s²].

        Raises
        ------
        ValueError
            If there is no solution: place, reason; fix.
        """
        grid, tables, settings = self.grid, self.tables, self.inputs.settings
        end_energy = self.end_speed**2 / 2
        if strategy.cap == np.inf and strategy.coast_above == np.inf:
            top = self._open_ceiling
        else:
            top = self._ceiling_energy(np.minimum(tables.limit, strategy.cap**2 / 2), strategy.coast_above**2 / 2)
        first = (self.begin_speed + self.lead_acceleration * self.window / 2) ** 2 / 2
        if first > top[0] * (1 + 1e-9) + 1e-9 and not self.accept_overspeed:
            raise ValueError(
                f"begin_speed {3.6 * self.begin_speed:.1f} km/h at km {self.begin / 1000:.3f} is too high: limits and "
                f"braking curves ahead allow {3.6 * np.sqrt(2 * top[0]):.1f} km/h; reduce begin_speed"
            )
        energy, stalled = passes.forward(
            top, tables.rates, SPEED_STEP, tables.line_max, tables.line_mean, tables.line_min, tables.air, grid.steps,
            tables.reserves, settings.acceleration or np.inf, settings.deceleration or np.inf, first,
            strategy.cut_off_energy(grid.places), strategy.brake_onset_energy(grid.places),
        )  # fmt: skip
        if stalled >= 0:
            speed = float(np.sqrt(2.0 * energy[stalled]))
            raise ValueError(stall_message(self.inputs, grid, tables, stalled, speed, at_rest=bool(energy[0] <= 0)))
        if energy[-1] > end_energy * (1 + 1e-6) + 1e-3:
            raise ValueError(
                f"the train cannot be brought to {3.6 * self.end_speed:.1f} km/h at km {self.end / 1000:.3f}: full "
                f"braking from {3.6 * self.begin_speed:.1f} km/h at km {self.begin / 1000:.3f} leaves "
                f"{3.6 * np.sqrt(2 * energy[-1]):.1f} km/h; brake earlier"
            )
        if self.window > 0:
            passes.flatten_peaks(energy, grid.places, self.window, float(settings.jerk or 0.0) * self.window)
        return np.asarray(energy)

    def copy(self) -> "PlanSection":
        """Return a section with the same window and reserves, which change apart."""
        return replace(self, _reserve=deepcopy(self._reserve))

    def without_places(self) -> "PlanSection":
        """Return the section without a window and without limits of forces by place."""
        inputs = replace(self.inputs, places=None)
        return PlanSection(inputs, self.begin, self.end, begin_speed=self.begin_speed, end_speed=self.end_speed)

    @property
    def _open_ceiling(self) -> Array:
        """Return the ceiling of the speed limits alone, which a search needs for thousands of strategies."""
        tables = self.tables
        if self._ceiling_of is None or self._ceiling_of[0] is not tables:
            self._ceiling_of = tables, self._ceiling_energy(tables.limit)
        return self._ceiling_of[1]

    def _ceiling_energy(self, limit: Array, coast_above: float = np.inf) -> Array:
        """Return the largest v²/2 that keeps every limit ahead [m²/s²]."""
        grid, tables = self.grid, self.tables
        top, lost = passes.backward(
            limit, tables.rates, SPEED_STEP, tables.line_min, tables.line_mean, tables.air, grid.steps,
            tables.reserves, self.inputs.settings.deceleration or np.inf, self.end_speed**2 / 2, coast_above,
        )  # fmt: skip
        if lost >= 0:
            raise ValueError(braking_message(self.inputs, grid, tables, lost, top))
        return np.asarray(top)

    def coarse_grid(self, resolution: Resolution, floor: tuple[Array, Array] | None = None) -> CoarseGrid:
        """Return the section on the coarse grid of the dynamic programming.

        Parameters
        ----------
        resolution
            Numbers of cells and of grid points.
        floor : pair of arrays, optional
            Places [m] and least v²/2 [m²/s²].
        """
        tables, places = self.tables, self.grid.places
        return CoarseGrid(
            places,
            self._open_ceiling,
            np.zeros(places.size) if floor is None else np.interp(places, *floor),
            line_mean=tables.line_mean,
            air=tables.air[1],
            table=tables.rates,
            service=self.inputs.settings.acceleration or np.inf,
            deceleration=self.inputs.settings.deceleration or np.inf,
            end=self.end_speed**2 / 2,
            resolution=resolution,
        )

    def time(self, strategy: DrivingStrategy = MINIMUM_TIME) -> float:
        """Return the running time of the section [s]."""
        return self.time_of(self.energy_profile(strategy))

    def time_of(self, energy: Array) -> float:
        """Return the running time of the section with v²/2 at the places of its grid [s]."""
        return float(passes.durations(energy, self.grid.steps).sum()) + self.window

    def times(self, start: float, period: float, history: Array) -> tuple[Array, float]:
        """Return the multiples of the period within the section, and the time of its end [s]."""
        end = start + float(history[0, -2]) + self.window
        first, last = int(np.ceil(start / period - 1e-9)), int(np.floor(end / period + 1e-9))
        return period * np.arange(first, last + 1, dtype=np.float64), end

    def knots(self, times: Array, start: float, history: Array) -> Array:
        """Return place of the front [m], speed, acceleration and own force [N], > 0 traction, at rising times [s]."""
        place, speed, acceleration = moving_average(history, times - start - self.window / 2, self.window)
        speed = np.maximum(speed, 0.0)
        train, settings = self.inputs.train, self.inputs.settings
        resistance = train.resistance_at(speed) + self.inputs.force.at(place)
        if self.inputs.places is not None:
            resistance += self.inputs.places.tunnel_coefficient(place) * speed**2
        if self.window <= 0:
            keep = 1.0 - settings.force_margin
            traction, electric, air = train.forces_at(speed)
            most = (keep * traction - resistance) / train.inertia
            least = (-keep * (electric + air) - resistance) / train.inertia
            driven = train.inertia * acceleration + resistance > 0  # full traction on a climb slows down
            upper = np.where(acceleration > 0, np.maximum(most, 0.0), np.where(driven, most, np.inf))
            acceleration = np.clip(acceleration, np.minimum(least, 0.0), upper)
        return np.stack((place, speed, acceleration, train.inertia * acceleration + resistance))

    def over_time(self, energy: Array) -> Array:
        """Return v²/2 at the places of the grid [m²/s²] over time, see :func:`time_history`."""
        places, window = self.grid.places, self.window
        return np.asarray(time_history(energy, places, window, self.lead_acceleration, window, 10.0 + window))

    @property
    def reserve(self) -> ForceReserve:
        """Reserves of traction and brakes for the averaging, by place."""
        if self._reserve is None:
            self._reserve = ForceReserve(PlaceGrid(self.begin, self.end))
        return self._reserve

    @property
    def tables(self) -> SectionTables:
        """Return the tables for the present window, reserves and limit extension."""
        key = (self.window, self.reserve.changes, self.limit_extension, self.extend_steps)
        if self._tables is not None and key == self._tables_key:
            return self._tables
        grid, train = self.grid, self.inputs.train
        low, mean, high = (force / train.inertia for force in self.inputs.force.over_cells(grid))
        rate = self.inputs.settings.service_rate
        places = self.inputs.places
        air = np.stack((np.zeros(grid.cells) if places is None else places.largest_air(grid),) * 3)
        width = np.zeros(grid.cells)
        if self.window > 0 and self.fastest_speed is not None:
            speed = np.interp(grid.places, *self.fastest_speed)
            width = np.maximum(speed[1:], speed[:-1]) * self.window / 2 + rate * self.window**2 / 8
            low = passes.sliding_extreme(low, width, grid.places, False)
            high = passes.sliding_extreme(high, width, grid.places, True)
            air[[0, 2]] = [passes.sliding_extreme(air[1], width, grid.places, largest) for largest in (False, True)]
        extension = self.limit_extension * self.window / 2
        limit = self.inputs.limits.over_grid(grid, train.length, extension, rate) ** 2 / 2
        for ceiling in (self.ceiling, self.inputs.ceiling):
            if ceiling is not None:
                limit = np.minimum(limit, np.interp(grid.places, ceiling[0], ceiling[1] ** 2 / 2))
        rates = acceleration_table(train, self.inputs.settings, self.window, extend_steps=self.extend_steps)
        placed, which = np.zeros((0, 2, train.speed.size)), np.zeros(grid.cells, dtype=np.int64)
        if places is not None:
            forces = np.stack((rates[passes.TRACTION] + rates[passes.COAST], rates[passes.BRAKE] - rates[passes.COAST]))
            forces *= train.inertia / (1.0 - self.inputs.settings.force_margin)
            ranges = averaging_range(train, self.inputs.settings, self.window)
            placed, which = places.over_cells(grid, width, ranges, forces)
        reserves = np.stack(self.reserve.over(grid)), placed, which
        self._tables_key = key
        self._tables = SectionTables(limit, low, mean, high, air, rates, reserves, width)
        return self._tables


def energy_weights(settings: PlanSettings) -> EnergyWeights:
    """Return cost of traction work and gain of electric-brake work in the net energy [1]."""
    return EnergyWeights(1.0 / settings.efficiency, settings.recovered)


def weighted_energy(traction: float, electric: float, time: float, settings: PlanSettings) -> float:
    """Return the net energy [J]: traction over its efficiency, less the recovered part, plus auxiliaries.

    Parameters
    ----------
    traction, electric
        Work of traction and of the electric brake [J], both >= 0.
    time
        Time with auxiliary power [s].
    """
    weights = energy_weights(settings)
    return weights.traction * traction - weights.recovered * electric + settings.auxiliary * time


def section_energy(section: PlanSection, energy: Array) -> float:
    """Return the net energy of a section without a jerk limit and without auxiliaries [J].

    The electric brake acts first, up to its own envelope; friction brakes do the rest and recover nothing.

    Parameters
    ----------
    energy : Array, shape (n + 1,)
        v²/2 at the places of the section's grid [m²/s²].
    """
    train, steps = section.inputs.train, section.grid.steps
    weights = energy_weights(section.inputs.settings)
    force = section_force(section, energy)
    work = weights.traction * float(np.maximum(force, 0.0) @ steps)
    if weights.recovered == 0.0:
        return work
    speed, columns = np.sqrt(energy[:-1] + energy[1:]), SPEED_STEP * np.arange(train.speed.size)
    electric, braked = np.interp(speed, columns, train.electric), np.maximum(-force, 0.0)
    if section.inputs.places is not None and (acting := braked > 0.0).any():
        middle = 0.5 * (section.grid.places[1:] + section.grid.places[:-1])
        electric[acting] *= section.inputs.places.electric_share(middle[acting], speed[acting])
    return work - weights.recovered * float(np.minimum(braked, electric) @ steps)


def section_force(section: PlanSection, energy: Array) -> Array:
    """Return the mean own force of every cell of :func:`section_energy` [N], > 0 traction."""
    train, tables = section.inputs.train, section.tables
    speed = np.sqrt(energy[:-1] + energy[1:])
    resistance = np.interp(speed, SPEED_STEP * np.arange(train.speed.size), train.resistance)
    rate = np.diff(energy) / section.grid.steps + tables.line_mean + tables.air[1] * speed**2
    return np.asarray(rate * train.inertia + resistance)
