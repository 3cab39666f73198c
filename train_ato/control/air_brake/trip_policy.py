"""Policy of a planned trip: applications at planned places, moved by the measured use of the electric brake.

A plan is for the nominal train. On the real train the use of the electric brake differs, because the controller keeps
the planned speed with it: a heavier train or weaker shoes need more of it than planned, more resistance less. The
share of the electric brake in use therefore moves an application by up to ``shift``:

* apply earlier if the electric brake is nearly used up; later while it is used clearly less than planned;
* release earlier if the drives pull against the shoes, or before the speed falls below the minimum release speed; later
  while the electric brake is used clearly more than planned;
* apply without a plan if the electric brake is used up and the recharge pause has passed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field, model_validator

from plant_sim.units import Length, Pressure, Ratio, SiModel, Speed, Time
from train_ato.control.algorithms.force_shares import total_of_units
from train_ato.control.train_model import STANDSTILL_SPEED

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel


class PlannedApplication(SiModel):
    """Application of the air brake in a plan; places are those of vehicle 0's centre."""

    apply: Length = Field(description="place of the application")
    release: Length = Field(description="place of the release")
    reduction: Pressure = Field(50e3, gt=0, description="reduction of the brake pipe")
    electric_at_apply: Ratio = Field(0.0, ge=-1, le=1, description="planned use of the electric brake there")
    electric_at_release: Ratio = Field(0.0, ge=-1, le=1, description="planned use of the electric brake there")

    @model_validator(mode="after")
    def _in_order(self) -> PlannedApplication:
        if self.release <= self.apply:
            raise ValueError(f"release {self.release:g} m must lie beyond apply {self.apply:g} m; exchange them")
        return self


class TripRules(SiModel):
    """Rules that move the planned applications."""

    shift: Length = Field(300.0, ge=0, description="largest distance by which an application or release moves")
    call: Ratio = Field(0.92, gt=0, le=1, description="use of the electric brake that applies the air brake ...")
    ease: Ratio = Field(0.35, ge=0, lt=1, description="... and up to which an unplanned application is released ...")
    after: Time = Field(4.0, ge=0, description="... after this time")
    tolerance: Ratio = Field(0.15, ge=0, le=1, description="difference to the planned use that moves a place")
    pause: Time = Field(60.0, ge=0, description="minimum time from a release to an unplanned application")
    never_below: Speed = Field(35 / 3.6, ge=0, description="no release below this speed, except for a departure")
    release_margin: Speed = Field(0.5 / 3.6, ge=0, description="a planned release is earlier at this distance from it")


@dataclass(frozen=True, slots=True)
class _Sample:
    """Measured values of one step: time [s], place [m], speed [m/s], used share of the electric brake."""

    t: float
    position: float
    velocity: float
    share: float


class TripBrake:
    """Policy with the applications of a plan, moved by the measured use of the electric brake.

    Parameters
    ----------
    charged
        Pressure of the charged brake pipe [Pa].
    applications
        Planned applications, in the order of the line.
    rules
        Rules that move them.
    model
        The nominal train; its limits give the available electric brake.
    """

    def __init__(
        self, charged: float, applications: tuple[PlannedApplication, ...], rules: TripRules, model: TrainModel
    ) -> None:
        self._charged, self._rules, self._model = charged, rules, model
        self._applications = applications
        self._next = 0
        self._reduction = 0.0
        self._planned = False
        self._stood = False
        self._since: float | None = None
        self._released_at = -np.inf

    def step(self, t: float, position: float, velocity: float, applied: float = 0.0) -> float:
        """Return the pressure demanded [Pa]; ``applied`` is the measured force of all units [N], < 0 braking."""
        available = total_of_units(np.array([brake.force(abs(velocity)) for brake in self._model.brake]))
        sample = _Sample(t, position, velocity, -applied / available if available > 0 else 0.0)
        if self._reduction == 0.0:
            self._decide_application(sample)
        else:
            self._stood = self._stood or abs(velocity) < STANDSTILL_SPEED
            if self._release_due(sample) or (self._stood and applied > 0.0):
                self._release(t)
        return self._charged - self._reduction

    def _decide_application(self, sample: _Sample) -> None:
        rules, position = self._rules, sample.position
        full = self._lasts(sample.share >= rules.call, sample.t)
        while self._next < len(self._applications) and position >= self._applications[self._next].release:
            self._next += 1  # passed without need, or within an unplanned application
        following = self._applications[self._next] if self._next < len(self._applications) else None
        if following is not None and position >= following.apply - rules.shift:
            spared = sample.share < following.electric_at_apply - rules.tolerance
            late = position >= following.apply + (rules.shift if spared else 0.0)
            if full or late:
                self._apply(following.reduction, planned=True)
        elif full and sample.t - self._released_at >= rules.pause and sample.velocity >= rules.never_below:
            deepest = max((entry.reduction for entry in self._applications), default=0.0)
            self._apply(deepest, planned=False)

    def _release_due(self, sample: _Sample) -> bool:
        """Return True if the present application ends at this sample."""
        rules = self._rules
        if sample.velocity < rules.never_below:
            return False
        if not self._planned:
            return self._lasts(sample.share <= rules.ease, sample.t)
        now = self._applications[self._next]
        pulling = self._lasts(sample.share < 0.0, sample.t)
        if sample.position < now.release - rules.shift:
            return False
        slow = sample.velocity <= rules.never_below + rules.release_margin
        strained = sample.share > now.electric_at_release + rules.tolerance
        return pulling or slow or sample.position >= now.release + (rules.shift if strained else 0.0)

    def _lasts(self, condition: bool, t: float) -> bool:
        """Return True if a condition has lasted for the time of the rules."""
        if not condition:
            self._since = None
        elif self._since is None:
            self._since = t
        return self._since is not None and t - self._since >= self._rules.after

    def _apply(self, reduction: float, *, planned: bool) -> None:
        self._reduction, self._planned, self._stood, self._since = reduction, planned, False, None

    def _release(self, t: float) -> None:
        self._next += self._planned
        self._reduction, self._since, self._released_at = 0.0, None, t
