"""Predicted cost of schedules of the air brake for one train: closed form of the shoe forces, then a rigid train."""

from itertools import pairwise
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field, field_validator, model_validator

from plant_sim.elementary import total_of_units
from plant_sim.si_model import SiModel
from plant_sim.units import Force, Number, Pressure, Ratio, Speed, Time, Usual
from train_ato.control.air_brake import schedule_cost as s
from train_ato.control.air_brake.shoes import ShoeForecast
from train_ato.control.train_model import GRID, TrainModel
from train_ato.messages.types import Array
from train_ato.supervision.track_supervision import limits_under_train


class PredictiveRules(SiModel):
    """Schedules and cost of the predictive policy."""

    reductions: Annotated[tuple[Pressure, ...], Usual(10e3, 1e6)] = Field(
        (50e3,), min_length=1, description="reductions of the brake pipe, rising"
    )
    period: Time = Field(2.0, ge=1, le=5, description="time between two decisions")
    horizon: Time = Field(120.0, ge=30, le=600, description="time ahead in which schedules are compared")
    pause: Time = Field(
        60.0, ge=0, description="least time from a release to the next application, in which the reservoirs recharge"
    )
    min_application: Time = Field(25.0, ge=0, description="least time from an application to its release")
    never_below: Annotated[Speed, Usual(0.3, 40)] = Field(
        35 / 3.6, ge=0, description="speed below which no application or release occurs, except for a departure"
    )
    electric_use: Ratio = Field(0.9, gt=0, le=1, description="part of the electric brake in the prediction")
    speed_error: Speed = Field(1 / 3.6, gt=0, description="speed error with the cost 1")
    application_cost: Number = Field(
        0.3, ge=0, description="cost of an application: mean squared speed error over the horizon, per speed_error²"
    )
    coupler_max: Annotated[Force, Usual(2e3, 20e6)] = Field(
        600e3, gt=0, description="coupler force above which a schedule has a cost"
    )

    @field_validator("reductions")
    @classmethod
    def _rise(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if value[0] <= 0 or any(b <= a for a, b in pairwise(value)):
            raise ValueError("reductions must rise from above 0; sort them and remove 0")
        return value

    @model_validator(mode="after")
    def _sees_an_application(self) -> "PredictiveRules":
        if self.horizon < self.min_application + 2 * self.period:
            raise ValueError(
                f"horizon {self.horizon:g} s is shorter than an application of {self.min_application:g} s and two "
                "periods; lengthen horizon"
            )
        return self


STEP = 2.0
"""Step of the prediction [s]."""
GAIN = 0.1
"""Gain of the predicted train on the speed error [1/s], about that of the laws of a long train."""
SPEED_STEP = 0.1
"""Spacing of the tables of the largest forces [m/s]."""
MAX_SPEED = 140.0
"""Last speed of these tables [m/s]."""


class PipeAction(NamedTuple):
    """Reduction of the brake pipe [Pa] from a time after the decision on [s]; 0 releases."""

    after: float
    reduction: float


Schedule = tuple[PipeAction, ...]


class ScheduleForecast:
    """Predicted cost of schedules of one train."""

    def __init__(self, rules: PredictiveRules, model: TrainModel) -> None:
        self._rules = rules
        self._charged = 0.0 if model.consist.air_brake is None else model.consist.air_brake.charged
        self._times: Array = STEP * np.arange(1.0, round(rules.horizon / STEP) + 1.0)
        self._track, begin = _track(model)
        self._forces = _largest_forces(model)
        vehicles = model.consist.vehicles
        self._vehicles = np.zeros((2, len(vehicles)))
        self._vehicles[s.INERTIA_SHARE] = [each.mass * each.rotating_mass_factor / model.inertia for each in vehicles]
        self._vehicles[s.FORCE_SHARE, list(model.units)] = model.share
        self._constant = np.array((
            model.inertia, *model.running, begin, STEP, GAIN, rules.electric_use,
            rules.never_below, rules.speed_error, rules.coupler_max, SPEED_STEP,
        ), dtype=np.float64)  # fmt: skip

    def least_cost(self, schedule: Schedule, reduction: float) -> float:
        """Return a lower bound of the cost: that of the applications alone."""
        before = (reduction, *(action.reduction for action in schedule))
        begun = [a == 0.0 < b for a, b in pairwise(before)]
        return self._rules.application_cost * begun.count(True)

    def cost(
        self, t: float, now: Array, reference: Array, shoes: ShoeForecast, *, reduction: float, schedule: Schedule
    ) -> float:
        """Return the mean cost of a schedule.

        Parameters
        ----------
        t
            Time of the decision [s].
        now
            Place, speed and unknown force by the names of :mod:`train_ato.control.air_brake.schedule_cost`.
        reference
            Speeds of the profile at the steps [m/s].
        shoes
            Forecast of the shoe forces without the schedule.
        reduction
            Present reduction [Pa].
        schedule
            Actions by rising time.
        """
        copy, begin = shoes.copy(), self._times - STEP
        applied = np.full(begin.size, reduction > 0.0)
        released = np.zeros(begin.size, dtype=np.bool_)
        for after, to in schedule:
            copy.demand(t + after, self._charged - to)
            first = int(np.searchsorted(begin, after))
            applied[first:] = to > 0.0
            released[first : first + 1] |= to == 0.0
        slow = copy.slow_forces_at(t + self._times - 0.5 * STEP)
        cost: float = s.schedule_cost(
            self._constant, now, reference, self._track, self._forces, self._vehicles, slow, applied, released
        )
        return cost + self.least_cost(schedule, reduction)


def _track(model: TrainModel) -> tuple[Array, float]:
    """Return line force [N] and speed limit [m/s] by the place of vehicle 0's centre, and the first place [m]."""
    _, begin = model.specific_line_force()
    places = begin + GRID * np.arange(model.tables[1].size)
    track = np.full((2, places.size), np.inf)
    track[s.LINE_FORCE] = model.tables[1]
    front = 0.5 * model.consist.vehicles[0].length
    limits = [(entry.at, entry.speed) for entry in model.line.restricted_limits]
    for at, speed in limits_under_train(limits, model.consist.length):
        track[s.LIMIT, places + front >= at] = speed
    return track, begin


def _largest_forces(model: TrainModel) -> Array:
    """Return the largest electric brake and traction of the train over the speed [N], shape (2, speeds)."""
    speeds = (SPEED_STEP * np.arange(round(MAX_SPEED / SPEED_STEP))).tolist()
    return np.array([
        [total_of_units(np.array([each.force(speed) for each in envelopes])) for speed in speeds]
        for envelopes in (model.brake, model.traction)
    ])  # fmt: skip
