"""Predictive policy: the air brake follows the schedule with the smallest predicted cost.

Every ``period`` the policy compares schedules over ``horizon``. With released brakes a schedule has no application, or
an application now or after a wait, which lasts to the end or is released after some time. With applied brakes it has a
release now or after a wait, with or without the next application after the recharge pause, a deeper reduction, or no
change. A schedule is a list of pressures by time. The closed form of the shoe forces (wave, cylinders, reservoirs)
gives its forces, and a rigid train gives its speed (:mod:`train_ato.control.air_brake.schedule_cost`). If the first
action of the best schedule is due now, the policy takes it. The next decision compares again. The rule is not from a
paper. It is a model predictive control with a finite set of schedules, as in move blocking.

The difference between measured and predicted acceleration is an unknown force, which holds over the horizon: a heavier
train, another resistance or weaker shoes move the decisions without a plan.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.record import Records, quantity
from train_ato.control.air_brake import schedule_cost as s
from train_ato.control.air_brake.record_policy import BrakeNow, BrakePolicy, NoRules, PolicyForm
from train_ato.control.air_brake.schedule_forecast import STEP, PipeAction, PredictiveRules, Schedule, ScheduleForecast
from train_ato.control.air_brake.shoes import ShoeForecast
from train_ato.control.algorithms.luenberger import LuenbergerObserver
from train_ato.control.train_model import STANDSTILL_SPEED, TrainModel
from train_ato.messages.types import Array

WAITS = (0, 1, 2, 4, 8, 16, 32)
"""Waits of the schedules before the next action, in periods."""
HOLDS = (1.0, 2.0, 4.0)
"""Durations of a scheduled application, in minimum durations; the present one can be of any duration."""
BANDWIDTH = 0.05
"""Bandwidth of the unknown force [1/s]: below the longitudinal oscillations of a long train."""
MAX_UNKNOWN = 0.02
"""Largest unknown force per inertia [m/s²]: twice the difference of 15 % of the shoes and 5 % of the mass."""
TOLERANCE = 1e-6
"""Tolerance of the time of a decision, for the rounding of times [s]."""


class SpeedProfile(Protocol):
    """Speed profile by time and place."""

    @property
    def time(self) -> Array:
        """Times of the knots [s]."""

    @property
    def position(self) -> Array:
        """Positions of vehicle 0's centre at the knots [m]."""

    def at_times(self, t: Array) -> tuple[Array, Array, Array]:
        """Return position, speed and acceleration at many times [s], each of the shape of ``t``."""


@dataclass
class DecisionState:
    """State of :class:`PredictiveBrake` that holds between its decisions."""

    reduction: float = quantity("Pa", "present reduction")
    due: float = quantity("s", "time of the next decision")


@compiled
def decided_reduction(p: NoRules, state: DecisionState, rows: Records[NoRules], now: BrakeNow) -> float:
    """Return the present reduction [Pa]; a negative number from the next decision on, which is made in Python."""
    return -1.0 if now.t >= state.due else state.reduction


class PredictiveBrake(BrakePolicy):
    """Policy that takes the schedule with the smallest predicted cost.

    Parameters
    ----------
    charged
        Pressure of the charged brake pipe [Pa].
    rules
        Schedules and cost.
    model
        The nominal train.
    profile
        Speed profile that the train follows; the place on it is the measured one, so that a late train has the speeds
        of its place.
    """

    form = PolicyForm(decided_reduction, NoRules, DecisionState, NoRules)

    def __init__(self, charged: float, rules: PredictiveRules, model: TrainModel, profile: SpeedProfile) -> None:
        super().__init__(charged, NoRules())
        self._rules, self._model, self._profile = rules, model, profile
        self._forecast = ScheduleForecast(rules, model)
        self._shoes = ShoeForecast(model)
        self._unknown = LuenbergerObserver(BANDWIDTH, rules.period)
        self.state["due"] = -np.inf
        self._changed_at = -np.inf
        self._stood = False
        self._before: tuple[float, float] | None = None

    @property
    def due(self) -> float:
        """Time of the next decision [s]."""
        return float(self.state["due"][0])

    @property
    def _reduction(self) -> float:
        return float(self.state["reduction"][0])

    def step(self, t: float, position: float, velocity: float, applied: float = 0.0) -> float:
        """Return the pressure demanded [Pa]; ``applied`` is the measured force of all units [N], < 0 braking."""
        if t >= self.due:
            unknown = self._unknown_force(t, position, velocity, applied)
            self.state["due"] = t + self._rules.period - TOLERANCE
            if self._released_for_departure(velocity, applied):
                self._set(t, 0.0)
            elif abs(velocity) >= STANDSTILL_SPEED:
                self._decide(t, np.array((position, velocity, unknown)))
            self._shoes.demand(t, self.charged - self._reduction)
        return self.charged - self._reduction

    def _released_for_departure(self, velocity: float, applied: float) -> bool:
        self._stood = self._reduction > 0.0 and (self._stood or abs(velocity) < STANDSTILL_SPEED)
        return self._stood and applied > 0.0

    def _unknown_force(self, t: float, position: float, velocity: float, applied: float) -> float:
        """Return the force that the model lacks [N], > 0 forward, from the acceleration since the last decision."""
        model = self._model
        shoes = self._shoes.at(t, velocity).total
        known = (applied - model.resisting_force(position, velocity, shoes)) / model.inertia
        if self._before is None or abs(t - self._before[0] - self._rules.period) > 0.5 * self._rules.period:
            self._unknown.restart()
            mean = known
        else:
            mean = 0.5 * (self._before[1] + known)
        self._before = (t, known)
        rate = self._unknown.step(velocity, mean)
        return model.inertia * min(max(rate, -MAX_UNKNOWN), MAX_UNKNOWN)

    def _decide(self, t: float, now: Array) -> None:
        """Compare the schedules and take the first action of the best one if it is due."""
        reference = self._reference(now)
        best: Schedule = ()
        lowest = self._forecast.cost(t, now, reference, self._shoes, reduction=self._reduction, schedule=())
        for schedule in self._schedules(t, self._latest_release(reference)):
            if lowest <= self._forecast.least_cost(schedule, self._reduction):
                continue
            cost = self._forecast.cost(t, now, reference, self._shoes, reduction=self._reduction, schedule=schedule)
            if cost < lowest:
                best, lowest = schedule, cost
        if best and best[0].after == 0.0:
            self._set(t, best[0].reduction)

    def _set(self, t: float, reduction: float) -> None:
        self.state["reduction"], self._changed_at, self._stood = reduction, t, False
        self._shoes.demand(t, self.charged - reduction)

    def _reference(self, now: Array) -> Array:
        """Return the speeds of the profile at the steps from the present place on [m/s]."""
        profile, count = self._profile, round(self._rules.horizon / STEP) + 1
        begin = float(np.interp(now[s.AT], profile.position, profile.time))
        times = np.minimum(begin + STEP * np.arange(count), profile.time[-1])
        return np.ascontiguousarray(profile.at_times(times)[1])

    def _latest_release(self, reference: Array) -> float:
        """Return the time after which the profile is too slow for a release [s]; the horizon if it never is."""
        slow = reference < self._rules.never_below + self._rules.speed_error
        return STEP * max(int(slow.argmax()) - 1, 0) if slow.any() else self._rules.horizon

    def _schedules(self, t: float, latest: float) -> list[Schedule]:
        """Return the schedules that obey the pause and the minimum application, the later ones first."""
        rules = self._rules
        rest = rules.min_application if self._reduction > 0.0 else rules.pause
        earliest = max(self._changed_at + rest - t, 0.0)
        waits = sorted({max(wait * rules.period, earliest) for wait in WAITS}, reverse=True)
        if self._reduction > 0.0:
            return [*self._releases(waits), *self._deeper(latest)]
        return [
            schedule
            for wait in waits
            for reduction in rules.reductions
            for schedule in self._applications(wait, reduction, latest)
        ]

    def _applications(self, wait: float, reduction: float, latest: float) -> list[Schedule]:
        """Return an application after a wait [s]: held, and released after some times or at the latest time."""
        apply, rest = PipeAction(wait, reduction), self._rules.min_application
        ends = {wait + hold * rest for hold in HOLDS} | {max(latest, wait + rest)}
        return [(apply,), *((apply, PipeAction(end, 0.0)) for end in sorted(ends) if wait < end < self._rules.horizon)]

    def _releases(self, waits: list[float]) -> list[Schedule]:
        """Return releases after waits [s]: the last one, and one before another application."""
        again = self._rules.reductions[0]
        releases = [PipeAction(wait, 0.0) for wait in waits]
        return [
            schedule
            for release in releases
            for schedule in ((release,), (release, PipeAction(release.after + self._rules.pause, again)))
        ]

    def _deeper(self, latest: float) -> list[Schedule]:
        """Return deeper reductions from now on: held, and released after some times."""
        deeper = [reduction for reduction in self._rules.reductions if reduction > self._reduction]
        return [schedule for reduction in deeper for schedule in self._applications(0.0, reduction, latest)]
