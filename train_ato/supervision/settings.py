"""Block ``supervision:`` of a scenario: supervisor, and reactions of the train to missing messages."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from plant_sim.si_model import SiModel
from plant_sim.units import Length, Ratio, Speed, Time


class FailsafeSpec(SiModel):
    """Reactions of the train to missing commands.

    The age of the newest command beyond the largest delay of its link decides: the last command is held up to
    ``hold``, the drives are off up to ``coast``, the service brake acts up to ``service``, then the emergency brake.
    The emergency brake is applied too if the brake release of the supervisor is older than ``release``.
    """

    hold: Time = Field(0.5, ge=0, description="the last command is held up to this age")
    coast: Time = Field(1.0, ge=0, description="the drives are off up to this age")
    service: Time = Field(5.0, ge=0, description="the service brake acts up to this age; then the emergency brake")
    release: Time | None = Field(
        None, gt=0, description="largest age of the brake release; default: supervision period and one tick"
    )


class SupervisionSpec(SiModel):
    """Supervision of the speed limits and of the stop at the end of the profile."""

    enabled: bool | None = Field(None, description="default: true where the line has speed limits")
    period: Time = Field(0.4, ge=1e-3, le=2.0, description="period of the supervisor, rounded up to ticks")
    overlap: Length = Field(
        100.0, ge=0, le=1e5, description="distance from the stop to the end of authority, the supervised location"
    )
    kdry: Ratio = Field(0.8, gt=0, le=1, description="factor on the emergency deceleration, Kdry_rst")
    service_brake: bool = Field(True, description="intervene with the service brake before the emergency brake")
    service_curve: bool = Field(
        False, description="supervise the stop with the SBD too, for a law that does not use the full service brake"
    )
    roll_away: Length = Field(2.0, gt=0, description="largest movement backwards")
    speed_difference: Speed = Field(
        2.0, gt=0, description="largest difference of the ATO's speed, beyond the errors of both"
    )
    position_difference: Length = Field(
        20.0, gt=0, description="largest difference of the ATO's position, beyond the error of the odometry"
    )
    confirmation: Time = Field(1.0, ge=0, description="duration of a difference before it counts")
    assurance: bool = Field(True, description="a braking law takes over from the law before the warning limit")
    assurance_limit: Literal["warning", "service_brake"] = Field(
        "warning", description="limit before which the braking law takes over"
    )
    assurance_margin: Speed = Field(
        0.5, ge=0, description="distance from the permitted speed at which the law drives again"
    )
    plan_margin: Speed | None = Field(
        0.5,
        ge=0,
        description="least distance of a planned profile from the warning speed, with the errors of the odometry; "
        "null: the plan does not use the limits of the supervisor",
    )
    failsafe: FailsafeSpec = FailsafeSpec()
