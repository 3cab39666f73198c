"""Predicted cost of schedules of the air brake for one train: closed form of the shoe forces, then a rigid train."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from train_ato.control.air_brake import schedule_cost as s
from train_ato.control.air_brake.predictive_rules import PredictiveRules
from train_ato.control.air_brake.shoes import ShoeForecast
from train_ato.control.algorithms.force_shares import total_of_units
from train_ato.control.train_model import GRID, TrainModel
from train_ato.messages.types import Array
from train_ato.supervision.track_supervision import limits_under_train

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
    """Predicted cost of schedules of one train.

    Parameters
    ----------
    rules
        Weights and horizon.
    model
        The nominal train.
    """

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
        self, t: float, now: Array, reference: Array, shoes: ShoeForecast, reduction: float, schedule: Schedule
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
