"""Electric and air brake blended: air is called when the electric brake is nearly used up, and released when it is not.

The policy looks at the force that the power units really apply, so it works under any law and needs no plan.  It is
our own rule; paper 000 triggers by place and speed instead.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field, model_validator

from plant_sim.units import Pressure, Ratio, SiModel, Speed, Time

if TYPE_CHECKING:
    from train_ato.model import TrainModel


STANDSTILL = 0.05
"""Speed below which the train stands [m/s]."""


class BlendRules(SiModel):
    """When air joins the electric brake."""

    reduction: Pressure = Field(50e3, gt=0, description="of an application")
    call: Ratio = Field(0.9, gt=0, le=1, description="part of the electric brake in use that calls for air ...")
    call_after: Time = Field(5.0, ge=0, description="... after so long")
    ease: Ratio = Field(0.35, ge=0, lt=1, description="part of the electric brake in use that releases the air ...")
    ease_after: Time = Field(5.0, ge=0, description="... after so long")
    pause: Time = Field(60.0, ge=0, description="from a release to the next application: the reservoirs recharge")
    never_below: Speed = Field(
        35 / 3.6, ge=0, description="no release below this speed, but when a train that has stood departs"
    )

    @model_validator(mode="after")
    def _apart(self) -> BlendRules:
        if self.ease >= self.call:
            raise ValueError(f"ease {self.ease:g} must lie below call {self.call:g}, or the brake pumps")
        return self


class Blended:
    """Applies and releases by the share of the electric brake that is in use.

    Parameters
    ----------
    charged
        Pressure of the charged brake pipe [Pa].
    rules
        When to call and when to ease.
    model
        Gives the electric brake that is there at a speed.
    """

    def __init__(self, charged: float, rules: BlendRules, model: TrainModel) -> None:
        self._charged = charged
        self._rules = rules
        self._model = model
        self._applied = False
        self._stood = False
        self._since: float | None = None
        self._released_at = -np.inf

    def step(self, t: float, position: float, velocity: float, applied: float = 0.0) -> float:
        """Return the pressure demanded, from the force that all units apply now [N], < 0 braking."""
        rules = self._rules
        there = -float(self._model.force_limits(np.full(self._model.n_units, velocity))[0].sum())
        share = -applied / there if there > 0 else 0.0
        if self._applied:
            self._stood = self._stood or abs(velocity) < STANDSTILL
            eased = share <= rules.ease and velocity >= rules.never_below
            wanted, after = eased or (self._stood and applied > 0.0), rules.ease_after
        else:
            rested = t - self._released_at >= rules.pause
            wanted, after = share >= rules.call and rested and velocity >= rules.never_below, rules.call_after
        if not wanted:
            self._since = None
        elif self._since is None:
            self._since = t
        if self._since is not None and t - self._since >= after:
            self._applied = not self._applied
            self._stood = False
            self._since = None
            self._released_at = self._released_at if self._applied else t
        return self._charged - rules.reduction if self._applied else self._charged
