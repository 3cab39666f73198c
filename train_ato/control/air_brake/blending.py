"""Blending: the air brake is applied near the limit of the electric brake and released well below it.

The policy uses the measured force of the power units, so it works with any law and needs no plan. The rule is not from
a paper; paper 000 uses position and speed.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from pydantic import Field, model_validator

from plant_sim.compiled import compiled
from plant_sim.record import Records, quantity
from plant_sim.si_model import SiModel
from plant_sim.units import Pressure, Ratio, Speed, Time
from train_ato.control.air_brake.record_policy import BrakeNow, BrakePolicy, NoRules, PolicyForm, lasts, used_share
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


@dataclass
class BlendState:
    """State of :func:`blend_reduction`."""

    applied: bool = quantity("", "the brake is applied")
    stood: bool = quantity("", "the train has stood since the application")
    since: float = quantity("s", "begin of the condition of the next change")
    released_at: float = quantity("s", "time of the last release")


@compiled
def blend_reduction(p: BlendRules, state: BlendState, rows: Records[NoRules], now: BrakeNow) -> float:
    """Return the reduction by the used part of the electric brake [Pa]."""
    share = used_share(now)
    if state.applied:
        state.stood = state.stood or abs(now.velocity) < STANDSTILL_SPEED
        eased = share <= p.ease and now.velocity >= p.never_below
        wanted, after = eased or (state.stood and now.applied > 0.0), p.ease_after
    else:
        rested = now.t - state.released_at >= p.pause
        wanted, after = share >= p.call and rested and now.velocity >= p.never_below, p.call_after
    if lasts(state, wanted, now.t, after):
        state.applied = not state.applied
        state.stood, state.since = False, inf
        state.released_at = state.released_at if state.applied else now.t
    return p.reduction if state.applied else 0.0


class BlendedBrake(BrakePolicy):
    """Policy that applies and releases by the used part of the electric brake."""

    form = PolicyForm(blend_reduction, BlendRules, BlendState, NoRules)

    def __init__(self, charged: float, rules: BlendRules, model: TrainModel) -> None:
        super().__init__(charged, rules, model=model)
        self.state["since"], self.state["released_at"] = inf, -inf
