"""Values of the ticks of a span that do not depend on the state of the train: reference, feed-forward, shoe forces."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from plant_sim.elementary import mean_over_units
from train_ato.control.air_brake.shoes import ShoeForecast
from train_ato.control.command_hold import profile_at_standstill
from train_ato.control.compensation.base import CompensationBase
from train_ato.control.compensation.predictor import Predictor
from train_ato.control.compensation.preview import PreviewFeedforward
from train_ato.control.compensation.twin import Twin
from train_ato.control.stack import ControlStack
from train_ato.messages.types import Array
from train_ato.profile.profile import Profile
from train_ato.scenario.setup import RunSetup

WINDOW = 1 << 14
"""Number of ticks of a forecast."""


class Forecast:
    """Reference, feed-forward and shoe forces of the ticks of a window.

    Parameters
    ----------
    setup
        Prepared run.
    profile
        Profile of the whole run.
    stack
        Control stack with its compensation.
    first
        First tick of the window.
    """

    def __init__(self, setup: RunSetup, profile: Profile, stack: ControlStack, first: int) -> None:
        compensation: Any = stack.compensation
        self._setup, self._profile, self._compensation = setup, profile, compensation
        self._first, self._end = first, min(first + WINDOW, setup.ticks)
        stamps = effects = setup.tick_ns * np.arange(first, self._end, dtype=np.int64)
        self._times: Array = np.asarray(stamps * 1e-9, dtype=np.float64)
        now = effect = profile.at_stamps(stamps)
        if isinstance(compensation, PreviewFeedforward):
            mean = mean_over_units(setup.model.share.tolist(), compensation.actuators["forward"].tolist())
            effects = np.rint((self._times + mean) * 1e9).astype(np.int64)
            effect = profile.at_stamps(effects)
            self._effects = self._times + mean
        else:
            self._effects = self._times
        self._reference: Array = np.array(now[:3])
        self._predicts = isinstance(compensation, Predictor)
        state = effect if self._predicts else now
        to_effect = np.zeros(len(stamps)) if self._predicts else self._effects - self._times
        self._expected: Array = np.array([*state[:3], *effect[2:], to_effect])
        later = profile.at_times(self._times + stack.delay_to_effect)
        self._standstill = profile_at_standstill(now[1], now[2], later, setup.model)
        shown = slice(0, 1 if self._predicts else 2)  # a predictor needs the shoe forces at the effect only
        self._shoe_times = np.array((self._effects, self._times))[shown]
        self._shoe_speeds = np.array((effect[1], now[1]))[shown]

    def is_of(self, profile: Profile, stack: ControlStack, first: int, count: int) -> bool:
        """Return True if this forecast has ``count`` ticks from ``first`` on of a profile and a compensation."""
        inside = self._first <= first and first + count <= self._end
        return inside and self._profile is profile and self._compensation is stack.compensation

    def of(self, first: int, count: int, stack: ControlStack, *, used: bool, shoes_used: bool) -> "SpanForecast":
        """Return the values of some ticks from a tick on, with the events of the brake so far.

        Parameters
        ----------
        first, count
            Number of the first tick, and number of ticks.
        stack
            Control stack.
        used
            False if the compensation is called in every tick: then feed-forward and shoe forces are 0.
        shoes_used
            False if shoe forces are not used.
        """
        first -= self._first
        part, units = slice(first, first + count), self._setup.model.n_units
        forecast = SpanForecast(self._compensation if used else None, self._times[part], stack.pressure)
        forecast.reference = np.ascontiguousarray(self._reference[:, part])
        forecast.expected = np.ascontiguousarray(self._expected[:, part])
        forecast.standstill = self._standstill[:, part] & (not getattr(stack.law, "open_loop", False))
        forecast.effects, forecast.predicts = self._effects[part].tolist(), self._predicts
        forecast.shoes, totals = np.zeros((count, 1 + units)), np.zeros(count)
        if not used:
            forecast.feedforward = np.zeros((count, units))
            return forecast
        if shoes_used and not self._compensation.shoes.idle:
            known = self._compensation.shoes
            for rows in forecast.shoe_use.runs():
                run, ticks = rows.stop - rows.start, slice(first + rows.start, first + rows.stop)
                found = known.at_each(self._shoe_times[:, ticks].ravel(), self._shoe_speeds[:, ticks].ravel())
                forecast.shoes[rows], totals[rows] = found[-run:], found[:run, 0]
        forecast.feedforward = self._compensation.feedforwards(self._times[part], totals)
        return forecast


class SpanShoes:
    """Use of a forecast of shoe forces in the ticks of one span; ticks that were not run can be taken back.

    Parameters
    ----------
    owner
        Compensation or observer with the forecast ``shoes``, in the state before the span.
    times, pressure
        Times of the ticks [s]; pressure of the brake pipe demanded in the span [Pa], None without an air brake.
    """

    def __init__(self, owner: Any, times: list[float], pressure: float | None) -> None:
        self._owner, self._times, self._pressure = owner, times, pressure
        self._kept: ShoeForecast | None = None

    def runs(self) -> Iterator[slice]:
        """Yield the ticks between two restarts of the forecast, which then has the state of the last of them."""
        known: ShoeForecast = self._owner.shoes
        self._kept, index = known.copy(), 0
        while index < len(self._times):
            known.demand(self._times[index], self._pressure)
            run = min(len(self._times) - index, known.calls_to_restart())
            known.skip(run - 1)
            yield slice(index, index + run)
            index += run

    def take_back(self, done: int) -> None:
        """Set the forecast to its state after the first ``done`` ticks."""
        if self._kept is None:
            self._owner.shoes.skip(done)
        elif done < len(self._times):
            self._owner.shoes = self._kept
            for t in self._times[:done]:
                self._kept.demand(t, self._pressure)


class SpanForecast:
    """Feed-forward and shoe forces of the ticks of one span; those of ticks that were not run can be taken back.

    Attributes
    ----------
    reference : Array, shape (3, ticks)
        Position [m], speed [m/s] and acceleration [m/s²] at the time of the tick.
    expected : Array, shape (6, ticks)
        The same for the law, of the time of the state that it receives, then acceleration [m/s²] and jerk [m/s³] at the
        effect of the command, and the time from the state to the effect [s].
    feedforward : Array, shape (ticks, units)
        Feed-forward of every unit [N].
    shoes : Array, shape (ticks, 1 + units)
        Shoe force of the train and of every unit's vehicle [N].
    standstill : Array of bool, shape (2, ticks)
        See :func:`train_ato.control.command_hold.profile_at_standstill`.
    effects : list of float
        Times at which the commands take effect [s].
    predicts : bool
        The state of the law is that of the effect.
    """

    reference: Array
    expected: Array
    feedforward: Array
    shoes: Array
    standstill: Any
    effects: list[float]
    predicts: bool

    def __init__(self, compensation: CompensationBase | None, times: Array, pressure: float | None) -> None:
        self._compensation, self.times = compensation, times.tolist()
        self.shoe_use = SpanShoes(compensation, self.times, pressure)

    def take_back(self, done: int) -> None:
        """Set shoe forecast and twin to their states after the first ``done`` ticks."""
        if self._compensation is not None:
            self.shoe_use.take_back(done)
        if isinstance(self._compensation, Twin):
            self._compensation.rewind(done)
