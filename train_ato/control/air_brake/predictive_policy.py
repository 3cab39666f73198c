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
from itertools import pairwise
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import field_validator, model_validator

from plant_sim.compiled import compiled
from plant_sim.elementary import total_of_units
from plant_sim.record import Records, quantity, records_of
from plant_sim.si_model import SiModel, option
from plant_sim.units import Force, Number, Pressure, Ratio, Speed, Time, Usual
from train_ato.control.air_brake import schedule_cost as s
from train_ato.control.air_brake.record_policy import BrakeNow, BrakePolicy, NoRules, PolicyForm, departs
from train_ato.control.air_brake.shoes import ShoeForecast
from train_ato.control.algorithms.luenberger import LuenbergerObserver
from train_ato.control.contract import ProfileLike
from train_ato.control.train_model import GRID, STANDSTILL_SPEED, TrainModel
from train_ato.messages.types import Array
from train_ato.supervision.track_supervision import limits_under_train


class PredictiveRules(SiModel):
    """Schedules and cost of the predictive policy."""

    reductions: Annotated[tuple[Pressure, ...], Usual(10e3, 1e6)] = option(
        (50e3,), "reductions of the brake pipe, rising", min_length=1
    )
    period: Time = option(2.0, "time between two decisions", ge=1, le=5)
    horizon: Time = option(120.0, "time ahead in which schedules are compared", ge=30, le=600)
    pause: Time = option(
        60.0, "least time from a release to the next application, in which the reservoirs recharge", ge=0
    )
    min_application: Time = option(25.0, "least time from an application to its release", ge=0)
    never_below: Annotated[Speed, Usual(0.3, 40)] = option(
        35 / 3.6,
        "speed below which no release occurs, except for a departure, and with an electric brake no application",
        ge=0,
    )
    electric_use: Ratio = option(0.9, "part of the electric brake in the prediction", gt=0, le=1)
    speed_error: Speed = option(1 / 3.6, "speed error with the cost 1", gt=0)
    application_cost: Number = option(
        0.3, "cost of an application: mean squared speed error over the horizon, per speed_error²", ge=0
    )
    coupler_max: Annotated[Force, Usual(2e3, 20e6)] = option(
        600e3, "coupler force above which a schedule has a cost", gt=0
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


@dataclass
class DecisionState:
    """State of :class:`PredictiveBrake` that holds between its decisions."""

    reduction: float = quantity("Pa", "present reduction")
    due: float = quantity("s", "time of the next decision")
    rest: float = quantity("s", "begin of the standstill with applied brakes")


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

    def __init__(self, charged: float, rules: PredictiveRules, model: TrainModel, profile: ProfileLike) -> None:
        super().__init__(charged, NoRules())
        self._rules, self._model, self._profile = rules, model, profile
        self._shoes = ShoeForecast(model)
        self._times: Array = STEP * np.arange(1.0, round(rules.horizon / STEP) + 1.0)
        self._track, begin = _track(model)
        self._forces = _largest_forces(model)
        vehicles = model.consist.vehicles
        self._vehicles = np.zeros((2, len(vehicles)))
        self._vehicles[s.INERTIA_SHARE] = [each.mass * each.rotating_mass_factor / model.inertia for each in vehicles]
        self._vehicles[s.FORCE_SHARE, list(model.units)] = model.share
        c0, c1, c2 = model.running
        forecast = s.ForecastConstants(
            inertia=model.inertia, c0=c0, c1=c1, c2=c2, line_begin=begin, step=STEP, gain=GAIN,
            electric_use=rules.electric_use, lowest_release=rules.never_below, error=rules.speed_error,
            coupler_max=rules.coupler_max, speed_step=SPEED_STEP, has_electric=bool(self._forces[s.BRAKE].any()),
        )  # fmt: skip
        self._constants = records_of(s.ForecastConstants, [forecast])
        self._unknown = LuenbergerObserver(BANDWIDTH, rules.period)
        self.state["due"], self.state["rest"] = -np.inf, np.inf
        self._changed_at = -np.inf
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
            if self._reduction > 0.0 and departs(self.state[0], t, velocity, applied):
                self._set(t, 0.0)
            elif abs(velocity) >= STANDSTILL_SPEED:
                self._decide(t, position, velocity, unknown)
            self._shoes.demand(t, self.charged - self._reduction)
        return self.charged - self._reduction

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

    def _decide(self, t: float, position: float, velocity: float, unknown: float) -> None:
        """Compare the schedules and take the first action of the best one if it is due."""
        reference, stop = self._reference(position)
        now = records_of(s.ForecastNow, [s.ForecastNow(position, velocity, unknown, stop)])
        best: Schedule = ()
        lowest = self._cost(t, now, reference, ())
        slow = reference < self._rules.never_below + self._rules.speed_error  # too slow for a release
        latest = STEP * max(int(slow.argmax()) - 1, 0) if slow.any() else self._rules.horizon
        for schedule in self._schedules(t, latest):
            if lowest <= self._least_cost(schedule):
                continue
            cost = self._cost(t, now, reference, schedule)
            if cost < lowest:
                best, lowest = schedule, cost
        if best and best[0].after == 0.0:
            self._set(t, best[0].reduction)

    def _least_cost(self, schedule: Schedule) -> float:
        """Return a lower bound of the cost: that of the applications alone."""
        before = (self._reduction, *(action.reduction for action in schedule))
        begun = [a == 0.0 < b for a, b in pairwise(before)]
        return self._rules.application_cost * begun.count(True)

    def _cost(self, t: float, now: Records[s.ForecastNow], reference: Array, schedule: Schedule) -> float:
        """Return the mean cost of a schedule, actions by rising time, for a decision at a time [s].

        ``now`` is the present state of the train, ``reference`` are the speeds of the profile at the steps [m/s].
        """
        copy, begin = self._shoes.copy(), self._times - STEP
        applied = np.full(begin.size, self._reduction > 0.0)
        released = np.zeros(begin.size, dtype=np.bool_)
        for after, to in schedule:
            copy.demand(t + after, self.charged - to)
            first = int(np.searchsorted(begin, after))
            applied[first:] = to > 0.0
            released[first : first + 1] |= to == 0.0
        slow = copy.slow_forces_at(t + self._times - 0.5 * STEP)
        cost: float = s.schedule_cost(
            self._constants, now, reference, self._track, self._forces, self._vehicles, slow, applied, released
        )
        return cost + self._least_cost(schedule)

    def _set(self, t: float, reduction: float) -> None:
        self.state["reduction"], self.state["rest"], self._changed_at = reduction, np.inf, t
        self._shoes.demand(t, self.charged - reduction)

    def _reference(self, position: float) -> tuple[Array, int]:
        """Return the speeds of the profile at the steps from the present place on [m/s], and the step of its last stop.

        A stop that the profile reaches after the horizon without a faster part is that of the last step.
        """
        profile, count = self._profile, round(self._rules.horizon / STEP) + 1
        begin = float(np.interp(position, profile.position, profile.time))
        times = np.minimum(begin + STEP * np.arange(count), profile.time[-1])
        reference = np.ascontiguousarray(profile.at_times(times)[1])
        later = profile.velocity[profile.time >= times[-1]]
        slow = np.logical_and.accumulate(later < self._rules.never_below)
        if (later[slow] <= s.REST_SPEED).any():
            return reference, count - 1
        rests = np.flatnonzero(reference <= s.REST_SPEED)
        return reference, rests.item(-1) if rests.size else 0

    def _schedules(self, t: float, latest: float) -> list[Schedule]:
        """Return the schedules that obey the pause and the minimum application, the later ones first."""
        rules = self._rules
        rest = rules.min_application if self._reduction > 0.0 else rules.pause
        earliest = max(self._changed_at + rest - t, 0.0)
        waits = sorted({max(wait * rules.period, earliest) for wait in WAITS}, reverse=True)
        if self._reduction > 0.0:
            deeper = [reduction for reduction in rules.reductions if reduction > self._reduction]
            held = [schedule for reduction in deeper for schedule in self._applications(0.0, reduction, latest)]
            return [*self._releases(waits), *held]
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
