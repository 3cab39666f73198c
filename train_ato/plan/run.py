"""One run from place to place without a stop on the way: the fastest that keeps limits, forces and comfort."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from train_ato.plan.accelerations import acceleration_table, cannot_brake, stalls
from train_ato.plan.line_tables import Grid
from train_ato.plan.passes import backward, clip_peaks, durations, forward, spread
from train_ato.plan.smoothing import averaged, largest_jump, raw_run
from train_ato.plan.style import FASTEST, Knots, Style, Track
from train_ato.plan.train_tables import STEP
from train_ato.plan.value import Stretches
from train_ato.types import Array

__all__ = ["Run"]

ATTEMPTS = 25
"""Rounds of tightening until the averaged run keeps what the raw run keeps."""
STANDSTILL = 0.05
"""Speed below which the holding brake brakes, whatever the envelopes say [m/s]."""
TOLERANCE = 1e-6
"""Relative excess of a force or limit that counts as rounding."""


@dataclass
class Run:
    """A run of the front from ``begin`` to ``end``.

    Attributes
    ----------
    begin, end : float
        Places of the front [m].
    begin_speed, begin_rate, end_speed : float
        State at the begin [m/s, m/s²] and speed at the end [m/s].
    ceiling : pair of arrays, optional
        Places and speeds of a further limit on the speed, as a curve; a wish, not a limit of the line.
    late : bool
        Accept a begin that is faster than limits and brakings ahead allow, and brake as is possible.
    window : float
        Time over which the raw run is averaged [s]; 0 without a limit on the jerk.
    reserve, brake_reserve : float
        Parts of traction and brakes left aside so that the averaged run needs no more than the margin leaves.
    widen : float
        Factor on the time by which limits are kept earlier and longer.
    """

    track: Track
    begin: float
    end: float
    begin_speed: float = 0.0
    begin_rate: float = 0.0
    end_speed: float = 0.0
    ceiling: tuple[Array, Array] | None = None
    late: bool = False
    window: float = 0.0
    reserve: float = 0.0
    brake_reserve: float = 0.0
    widen: float = 1.0
    _prepared: dict[str, Array] = field(default_factory=dict, repr=False)
    _key: tuple[float, ...] = ()
    _fastest: tuple[Array, Array] | None = None
    _grid: Grid | None = None

    @property
    def grid(self) -> Grid:
        """Places the raw run is solved on; a moving begin or end gives half a window to the averaging."""
        half = self.window / 2
        first, last = self.begin, self.end
        if self.begin_speed > 0:
            first += self.begin_speed * half + self.rate_before * self.window**2 / 12
        if self.end_speed > 0:
            last -= self.end_speed * half
        if last - first < 1e-6:
            raise ValueError(
                f"from km {self.begin / 1000:.3f} to km {self.end / 1000:.3f} is too short for the limits on "
                "acceleration and jerk; move the end on or allow more"
            )
        if self._grid is None or (self._grid.begin, self._grid.end) != (first, last):
            self._grid = Grid(first, last)
        return self._grid

    @property
    def rate_before(self) -> float:
        """Acceleration that lasts for the first half window; of a train about to stop no more than lets it move on."""
        if self.window <= 0 or self.begin_speed <= 0:
            return 0.0
        return max(self.begin_rate, -1.8 * self.begin_speed / self.window)

    def raw(self, style: Style = FASTEST) -> Array:
        """Return v²/2 of the raw run at every place of the grid.

        Raises
        ------
        ValueError
            If there is none, with the place and the reason.
        """
        grid, parts, settings = self.grid, self._parts(), self.track.settings
        down_rate = settings.deceleration if settings.deceleration is not None else np.inf
        up_rate = settings.acceleration if settings.acceleration is not None else np.inf
        end_energy = self.end_speed**2 / 2
        coast = style.coast_above**2 / 2
        limit = np.minimum(parts["limit"], style.cap**2 / 2)
        top = self._ceiling(limit, coast)
        first = (self.begin_speed + self.rate_before * self.window / 2) ** 2 / 2
        if first > top[0] * (1 + 1e-9) + 1e-9 and not self.late:
            raise ValueError(
                f"a train that passes km {self.begin / 1000:.3f} at {3.6 * self.begin_speed:.1f} km/h cannot keep what "
                f"lies ahead: limits and brakes allow {3.6 * np.sqrt(2 * top[0]):.1f} km/h there; begin slower"
            )
        energy, stalled = forward(
            top, parts["table"], STEP, parts["up"], parts["flat"], parts["down"], grid.steps,
            up_rate, down_rate, first, style.cut_off_energy(grid.places),
        )  # fmt: skip
        if stalled >= 0:
            raise ValueError(stalls(self.track.train, grid, parts, stalled, bool(energy[0] <= 0)))
        if energy[-1] > end_energy * (1 + 1e-6) + 1e-3:
            raise ValueError(
                f"the train cannot be brought to {3.6 * self.end_speed:.1f} km/h at km {self.end / 1000:.3f}: braking "
                f"as it can from {3.6 * self.begin_speed:.1f} km/h at km {self.begin / 1000:.3f} it passes there at "
                f"{3.6 * np.sqrt(2 * energy[-1]):.1f} km/h"
            )
        if self.window > 0:
            clip_peaks(energy, grid.places, self.window, float(settings.jerk or 0.0) * self.window)
        return np.asarray(energy)

    def _ceiling(self, limit: Array, coast_above: float = np.inf) -> Array:
        """Return the largest v²/2 from which every limit ahead can be kept."""
        grid, parts, settings = self.grid, self._parts(), self.track.settings
        down_rate = settings.deceleration if settings.deceleration is not None else np.inf
        top, lost = backward(
            limit, parts["table"], STEP, parts["down"], parts["flat"], grid.steps, down_rate, self.end_speed**2 / 2,
            coast_above,
        )  # fmt: skip
        if lost >= 0:
            raise ValueError(cannot_brake(self.track.train, grid, parts, lost, top))
        return np.asarray(top)

    def stretches(self) -> Stretches:
        """Return the run as the search for the least work sees it."""
        parts, settings = self._parts(), self.track.settings
        service = settings.acceleration if settings.acceleration is not None else np.inf
        return Stretches(
            self.grid.places,
            self._ceiling(parts["limit"]),
            parts["flat"],
            parts["table"],
            service,
            self.end_speed**2 / 2,
        )

    def time(self, style: Style = FASTEST) -> float:
        """Return the duration of the run [s]."""
        return float(durations(self.raw(style), self.grid.steps).sum()) + self.window

    def tune(self, start: float, period: float, style: Style = FASTEST) -> None:
        """Choose window, reserve and widening so that the averaged run keeps every limit at the knots.

        Parameters
        ----------
        start
            Time of the first movement [s]; knots are at the multiples of ``period``.

        Raises
        ------
        ValueError
            If there is no such run.
        """
        jerk = self.track.settings.jerk
        if jerk is None:
            self.raw(style)
            return
        if self.window <= 0:
            energy = self.raw()
            self._fastest = (self.grid.places, np.sqrt(2 * energy))
            raw = self._raw_run(energy)
            self.window = max(float(np.abs(raw[4]).max()), abs(self.begin_rate)) / jerk
        short = 0.0
        for _ in range(ATTEMPTS):
            try:
                raw = self._raw_run(self.raw(style))
            except ValueError:
                if short <= 0.0:
                    raise
                break  # what the averaging needs left aside leaves no run: the place named then is not the reason
            jump = largest_jump(raw, self.window)
            if jump > jerk * self.window * (1 + TOLERANCE):
                self.window = max(self.window * 1.01, jump / jerk * (1 + TOLERANCE / 2))
                continue
            traction, brake, overspeed = self._excess(self.knots(self.times(start, period, raw)[0], start, raw))
            short = max(traction, brake)
            if max(short, overspeed) <= TOLERANCE:
                return
            if traction > TOLERANCE:
                self.reserve = min(0.9, self.reserve + 1.1 * traction + 1e-4)
            if brake > TOLERANCE:
                self.brake_reserve = min(0.9, self.brake_reserve + 1.1 * brake + 1e-4)
            if overspeed > TOLERANCE:
                self.widen *= 1.25
        raise ValueError(
            f"no run from km {self.begin / 1000:.3f} to km {self.end / 1000:.3f} keeps jerk {jerk:g} m/s³ and the "
            f"forces (short by {100 * short:.1f} %); allow more jerk or a smaller force_margin"
        )

    def times(self, start: float, period: float, raw: Array) -> tuple[Array, float]:
        """Return the multiples of the period within the run, and the time of its end [s]."""
        end = start + float(raw[0, -2]) + self.window
        first, last = int(np.ceil(start / period - 1e-9)), int(np.floor(end / period + 1e-9))
        return period * np.arange(first, last + 1, dtype=np.float64), end

    def knots(self, times: Array, start: float, raw: Array) -> Knots:
        """Return the run at rising times [s]."""
        place, speed, rate = averaged(raw, times - start - self.window / 2, self.window)
        speed = np.maximum(speed, 0.0)
        train, settings = self.track.train, self.track.settings
        resists = train.resistance_at(speed) + self.track.force.at(place)
        if self.window <= 0:
            keep = 1.0 - settings.force_margin
            traction, electric, air = train.forces_at(speed)
            most = (keep * traction - resists) / train.inertia
            least = (-keep * (electric + air) - resists) / train.inertia
            rate = np.clip(rate, np.minimum(least, 0.0), np.where(rate > 0, np.maximum(most, 0.0), np.inf))
        return Knots(place, speed, rate, train.inertia * rate + resists)

    def raw_run(self, style: Style = FASTEST) -> Array:
        """Return the raw run over time, see :func:`train_ato.plan.smoothing.raw_run`."""
        return self._raw_run(self.raw(style))

    def _raw_run(self, energy: Array) -> Array:
        grid = self.grid
        return np.asarray(raw_run(energy, grid.places, self.window, self.rate_before, self.window, 10.0 + self.window))

    def _excess(self, knots: Knots) -> tuple[float, float, float]:
        """Return by what part the run needs more traction and braking than there is, and exceeds a limit."""
        train, settings = self.track.train, self.track.settings
        traction, electric, air = train.forces_at(knots.speed)
        keep = 1.0 - settings.force_margin
        driven = (knots.force > 1.0) & (knots.speed > 1e-6)
        braked = (knots.force < -1.0) & (knots.speed > STANDSTILL)
        if self.begin_speed > 0:  # what the train brings along cannot be changed at once
            settled = knots.place > self.grid.begin + self.begin_speed * self.window
            driven, braked = driven & settled, braked & settled
        up = np.max((knots.force / (keep * traction + 1e-3))[driven], initial=0.0) - 1.0
        down = np.max((-knots.force / (keep * (electric + air) + 1e-3))[braked], initial=0.0) - 1.0
        limit = self.track.limits.at(knots.place, train.length)
        over = 0.0 if self.late else float(np.max(knots.speed / limit, initial=0.0)) - 1.0
        return float(up), float(down), over

    def _parts(self) -> dict[str, Array]:
        """Tables of this run for the present window, reserve and widening."""
        key = (self.window, self.reserve, self.brake_reserve, self.widen)
        if self._prepared and key == self._key:
            return self._prepared
        grid, train = self.grid, self.track.train
        low, flat, high = (force / train.inertia for force in self.track.force.on_cells(grid))
        if self.window > 0 and self._fastest is not None:
            speed = np.interp(grid.places, *self._fastest)
            reach = np.maximum(speed[1:], speed[:-1]) * self.window / 2 + self._rate * self.window**2 / 8
            low, high = spread(low, reach, grid.places, False), spread(high, reach, grid.places, True)
        limit = self.track.limits.over_train(grid, train.length, self.widen * self.window / 2, self._rate) ** 2 / 2
        if self.ceiling is not None:
            limit = np.minimum(limit, np.interp(grid.places, self.ceiling[0], self.ceiling[1] ** 2 / 2))
        self._prepared = {
            "limit": limit,
            "down": low,
            "flat": flat,
            "up": high,
            "table": acceleration_table(
                self.track.train, self.track.settings, self.window, self.reserve, self.brake_reserve
            ),
        }
        self._key = key
        return self._prepared

    @property
    def _rate(self) -> float:
        """Largest service acceleration or deceleration, as far as it is limited [m/s²]."""
        settings = self.track.settings
        return max(min(settings.acceleration or 2.0, 2.0), min(settings.deceleration or 2.0, 2.0))
