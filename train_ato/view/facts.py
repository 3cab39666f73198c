"""Constant data of a run: layout of the train, speed limits, grades, force envelopes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from plant_sim.track import Track
from plant_sim.units import KMH
from train_ato.control.contract import LawPlan
from train_ato.control.plan_text import ARRAYS, STATUS, plan_from_text
from train_ato.judge.series import DiagnosticSeries
from train_ato.messages.topic import TrainLayout
from train_ato.messages.types import Array
from train_ato.scenario.setup import RunSetup

SCALES = (40, 60, 80, 100, 120, 160, 200, 250, 300, 350, 400, 500)
"""Ends of the speed dial [km/h]."""
BRAKING = 0.02
"""Deceleration of the plan from which it brakes [m/s²]."""
MIN_BRAKING_S = 3.0
"""Duration below which a deceleration of the plan is no brake application [s]."""
REST = 1e-3
"""Speed below which the plan is at rest [m/s]."""
STOP_WINDOW = 0.5
"""Half width of the stop window of a scenario without this criterion [m]."""
ROOM = 1.12
"""Ratio of the end of the dial to the highest profile speed, at least."""


@dataclass(frozen=True)
class ProfileCurve:
    """Knots of the profile in force: time [s], position of vehicle 0's centre [m], speed [m/s]."""

    time: Array
    position: Array
    velocity: Array

    @property
    def end(self) -> float:
        """Last position of vehicle 0's centre [m]."""
        return float(self.position[-1])

    @cached_property
    def acceleration(self) -> Array:
        """Mean acceleration between the knots [m/s²], shape (knots - 1,)."""
        span = np.diff(self.time)
        return np.asarray(np.diff(self.velocity) / np.where(span > 0.0, span, np.inf))

    @cached_property
    def reached(self) -> Array:
        """Largest position of vehicle 0's centre up to every knot [m]."""
        return np.asarray(np.maximum.accumulate(self.position))

    @cached_property
    def deceleration(self) -> float:
        """Largest deceleration of the plan [m/s²], without the short peaks of the last percent."""
        braking = -self.acceleration[self.acceleration < -BRAKING]
        return max(float(np.percentile(braking, 99.0)), BRAKING) if braking.size else BRAKING

    @cached_property
    def stops(self) -> Array:
        """Positions of vehicle 0's centre at the stops after the departure [m], by rising position."""
        rest = np.abs(self.velocity) < REST
        begins = np.flatnonzero(rest[1:] & ~rest[:-1]) + 1
        return np.asarray(self.position[begins])

    @cached_property
    def _ways(self) -> list[tuple[float, float, ProfileCurve]]:
        """Begin [s], direction (1 or -1) and knots of every way from one turn to the next, a way back mirrored."""
        moving = np.flatnonzero(np.abs(self.velocity) >= REST)
        signs = np.sign(self.velocity[moving])
        turns = np.flatnonzero(np.diff(signs))
        if not turns.size and signs.sum() >= 0.0:
            return [(-np.inf, 1.0, self)]
        begins, ends = np.append(0, moving[turns] + 1), np.append(moving[turns + 1], self.time.size)
        found: list[tuple[float, float, ProfileCurve]] = []
        for begin, end, sign in zip(begins, ends, signs[np.append(turns, -1)], strict=True):
            knots = ProfileCurve(self.time[begin:end], sign * self.position[begin:end], sign * self.velocity[begin:end])
            found.append((float(self.time[ends[len(found) - 1]]) if found else -np.inf, float(sign), knots))
        return found

    def way(self, time: float) -> tuple[float, ProfileCurve]:
        """Return the direction of running at a time [s], 1 or -1, and the knots of this way, times the direction."""
        return next((sign, knots) for begin, sign, knots in reversed(self._ways) if time >= begin)

    @cached_property
    def brakings(self) -> Array:
        """Positions of vehicle 0's centre at begin and end of the planned decelerations [m], shape (n, 2)."""
        braking = np.concatenate(([False], self.acceleration < -BRAKING, [False]))
        begins, ends = (np.flatnonzero(braking[1:] & ~braking[:-1]), np.flatnonzero(~braking[1:] & braking[:-1]))
        long = self.time[ends] - self.time[begins] > MIN_BRAKING_S
        return np.column_stack((self.position[begins[long]], self.position[ends[long]]))


@dataclass(frozen=True)
class Facts:
    """Constant data of a run.

    Attributes
    ----------
    title
        Name of the scenario or of the run.
    shape
        Layout of the train.
    duration
        Simulated time of the whole run [s]; 0 if unknown.
    rear
        Distance of every vehicle's centre behind vehicle 0's [m], shape (n,).
    nose
        Front of the train before vehicle 0's centre [m].
    length
        Length of the train [m].
    limit_places, limit_speeds
        Steps of the speed limit [m, m/s].
    grade_places, grades
        Steps of the grade [m, ‰], > 0 uphill.
    speeds, most, least
        Table of the nominal envelope of all units: speed [m/s], largest traction and (negative) brake force [N].
    stop_window
        Half width of the stop window [m].
    subtitle
        Train, line, observer and compensation in words.
    setup
        Scenario with train and line; None for a run without a scenario.
    """

    title: str
    layout: TrainLayout
    duration: float = 0.0
    rear: Array = field(default_factory=lambda: np.zeros(0))
    nose: float = 0.0
    length: float = 0.0
    limit_places: Array = field(default_factory=lambda: np.zeros(0))
    limit_speeds: Array = field(default_factory=lambda: np.zeros(0))
    grade_places: Array = field(default_factory=lambda: np.zeros(0))
    grades: Array = field(default_factory=lambda: np.zeros(0))
    speeds: Array = field(default_factory=lambda: np.zeros(0))
    most: Array = field(default_factory=lambda: np.zeros(0))
    least: Array = field(default_factory=lambda: np.zeros(0))
    stop_window: float = STOP_WINDOW
    subtitle: str = ""
    setup: RunSetup | None = None

    @cached_property
    def mirrored(self) -> Facts:
        """The line for a train that runs back, with all places times -1; its rear leads."""
        places = np.append(-np.inf, -self.limit_places[:0:-1])[: self.limit_places.size]
        return replace(self, limit_places=places, limit_speeds=self.limit_speeds[::-1], nose=self.length - self.nose)

    def limit_now(self, front: float) -> float:
        """Return the lowest limit between the rear and the front of the train [m/s]; infinite without limits."""
        if not self.limit_places.size:
            return float("inf")
        first = max(0, int(np.searchsorted(self.limit_places, front - self.length, side="right")) - 1)
        last = int(np.searchsorted(self.limit_places, front, side="right"))
        return float(self.limit_speeds[first:last].min(initial=np.inf))

    def next_lower_limit(self, front: float) -> tuple[float, float] | None:
        """Return place [m] and speed [m/s] of the next limit ahead below the present one."""
        now = self.limit_now(front)
        ahead = np.flatnonzero((self.limit_places > front) & (self.limit_speeds < now))
        return (float(self.limit_places[ahead[0]]), float(self.limit_speeds[ahead[0]])) if ahead.size else None

    def envelope(self, speed: float) -> tuple[float, float]:
        """Return the largest brake force (negative) and traction force of all units at a speed [N]; NaN if unknown."""
        if not self.speeds.size:
            return float("nan"), float("nan")
        return float(np.interp(speed, self.speeds, self.least)), float(np.interp(speed, self.speeds, self.most))

    def scale(self, profile: ProfileCurve | None) -> int:
        """Return the end of the speed dial [km/h], above the limits and the profile."""
        fastest = KMH * float(self.limit_speeds.max(initial=0.0))
        if profile is not None:
            fastest = max(fastest, ROOM * KMH * float(np.abs(profile.velocity).max(initial=0.0)))
        return next((end for end in SCALES if end > fastest), SCALES[-1])


def facts_of(setup: RunSetup) -> Facts:
    """Return the constant data of a scenario."""
    consist, line, scenario = setup.consist, setup.line, setup.scenario
    track = Track(line)
    places = np.concatenate(([line.begin], track.breaks[(track.breaks > line.begin) & (track.breaks < line.end)]))
    grades = 1e3 * track.grade[np.searchsorted(track.breaks, places, side="right")]
    kept = np.concatenate(([True], np.diff(grades) != 0.0))
    fastest = 1.3 * max(float(np.abs(setup.profile.velocity).max()), 10.0)
    speeds: Array = np.linspace(0.0, fastest, 200)
    least, most = (
        np.array([side.sum() for side in sides])
        for sides in zip(*(setup.model.force_limits(np.full(setup.layout.n_units, v)) for v in speeds), strict=True)
    )
    names = f"observer {scenario.observer}, compensation {scenario.compensation}, seed {scenario.seed}"
    return Facts(
        title=scenario.name,
        layout=setup.layout,
        duration=setup.ticks * setup.tick,
        rear=np.array(consist.offsets, dtype=np.float64),
        nose=consist.vehicles[0].length / 2,
        length=consist.length,
        limit_places=np.array([limit.at for limit in line.restricted_limits], dtype=np.float64),
        limit_speeds=np.array([limit.speed for limit in line.restricted_limits], dtype=np.float64),
        grade_places=places[kept],
        grades=grades[kept],
        speeds=speeds,
        most=most,
        least=least,
        stop_window=scenario.criteria.stop_window or STOP_WINDOW,
        subtitle=f"{consist.name}, {consist.mass / 1e3:.0f} t, {consist.length:.0f} m, on {line.name}; {names}",
        setup=setup,
    )


PLAN_LASTS = 2.0
"""Time from the first point of a plan on after which it is not drawn [s]: twice the time between two plans."""
MIN_SLACK = 0.05
"""Smallest excess of the permitted speed that is shown [km/h]: half of the last digit."""


def reported_plan(values: Mapping[str, str | None]) -> LawPlan | None:
    """Return the plan in the diagnostics of the controller, with simulation times; None without one."""
    found = plan_from_text(values)
    return None if found is None else found.plan


def plan_of_row(series: DiagnosticSeries, row: int) -> LawPlan | None:
    """Return the plan in a row of the diagnostics of the controller; None without one."""
    if STATUS not in series.values:
        return None
    return reported_plan({key: series.texts(key)[row] for key in (STATUS, *ARRAYS)})


def is_current(plan: LawPlan, time: float) -> bool:
    """Return True if a plan holds at a simulated time [s]."""
    return bool(plan.times.size) and plan.times[0] + PLAN_LASTS > time


def plan_columns(plan: LawPlan | None, time: float, facts: Facts) -> dict[str, Array]:
    """Return place of the front of the train [km] and planned speed [km/h]; empty without a plan at this time [s]."""
    if plan is None or not is_current(plan, time):
        return {"place": np.zeros(0), "speed": np.zeros(0)}
    return {"place": (plan.position + facts.nose) / 1e3, "speed": KMH * plan.speed}


def plan_words(plan: LawPlan | None, time: float) -> str:
    """Return status of the solver and largest excess of the permitted speed as text; "" without a plan."""
    if plan is None or not is_current(plan, time):
        return ""
    excess = KMH * float(plan.slack.max())
    return f"plan {plan.status}" + (f", {excess:.1f} km/h above the limit" if excess > MIN_SLACK else "")
