"""Blending: the air brake is applied near the limit of the electric brake and released well below it.

The policy uses the measured force of the power units, so it works with any law and needs no plan. The rule is not from
a paper; paper 000 uses position and speed.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field, model_validator

from plant_sim.units import Pressure, Ratio, SiModel, Speed, Time
from train_ato.control.algorithms.force_shares import total_of_units
from train_ato.control.train_model import STANDSTILL_SPEED, TrainModel


class BlendRules(SiModel):
    """Conditions for the air brake beside the electric brake."""

    reduction: Pressure = Field(50e3, gt=0, description="reduction of the brake pipe of an application")
    call: Ratio = Field(
        0.9, gt=0, le=1, description="used part of the electric brake from which the air brake is applied ..."
    )
    call_after: Time = Field(5.0, ge=0, description="... after this time")
    ease: Ratio = Field(
        0.35, ge=0, lt=1, description="used part of the electric brake up to which the air brake is released ..."
    )
    ease_after: Time = Field(5.0, ge=0, description="... after this time")
    pause: Time = Field(
        60.0, ge=0, description="minimum time from a release to the next application, for the reservoirs to recharge"
    )
    never_below: Speed = Field(
        35 / 3.6, ge=0, description="no release below this speed, except for a departure from standstill"
    )

    @model_validator(mode="after")
    def _apart(self) -> BlendRules:
        if self.ease >= self.call:
            raise ValueError(f"ease {self.ease:g} must be below call {self.call:g}, or the brake cycles; lower ease")
        return self


class BlendedBrake:
    """Policy that applies and releases by the used part of the electric brake.

    Parameters
    ----------
    charged
        Pressure of the charged brake pipe [Pa].
    rules
        Conditions of application and release.
    model
        The nominal train; its limits give the available electric brake.
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
        """Return the pressure demanded [Pa]; ``applied`` is the measured force of all units [N], < 0 braking."""
        rules = self._rules
        available = total_of_units(np.array([brake.force(abs(velocity)) for brake in self._model.brake]))
        share = -applied / available if available > 0 else 0.0
        if self._applied:
            self._stood = self._stood or abs(velocity) < STANDSTILL_SPEED
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
