"""Settings of the predictive brake policy: block ``predictive`` of the scenario's ``brake:``."""

from __future__ import annotations

from itertools import pairwise

from pydantic import Field, field_validator, model_validator

from plant_sim.si_model import SiModel
from plant_sim.units import Force, Pressure, Ratio, Speed, Time


class PredictiveRules(SiModel):
    """Schedules and cost of the predictive policy."""

    reductions: tuple[Pressure, ...] = Field((50e3,), min_length=1, description="reductions of the pipe, rising")
    period: Time = Field(2.0, ge=1, le=5, description="time between two decisions")
    horizon: Time = Field(120.0, ge=30, le=600, description="time ahead that a decision compares")
    pause: Time = Field(60.0, ge=0, description="minimum time from a release to the next application (recharge)")
    min_application: Time = Field(25.0, ge=0, description="minimum time from an application to its release")
    never_below: Speed = Field(
        35 / 3.6, ge=0, description="no release or application below this speed, except for a departure"
    )
    electric_use: Ratio = Field(0.9, gt=0, le=1, description="part of the electric brake that the prediction uses")
    speed_error: Speed = Field(1 / 3.6, gt=0, description="speed error of cost 1")
    application_cost: float = Field(
        0.3, ge=0, description="cost of an application: mean squared speed error over the horizon, per speed_error²"
    )
    coupler_max: Force = Field(600e3, gt=0, description="coupler force above which a schedule has a cost")

    @field_validator("reductions")
    @classmethod
    def _rise(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if value[0] <= 0 or any(b <= a for a, b in pairwise(value)):
            raise ValueError("reductions must rise from above 0; sort them and remove 0")
        return value

    @model_validator(mode="after")
    def _sees_an_application(self) -> PredictiveRules:
        if self.horizon < self.min_application + 2 * self.period:
            raise ValueError(
                f"horizon {self.horizon:g} s is shorter than an application of {self.min_application:g} s and two "
                "periods; lengthen horizon"
            )
        return self
