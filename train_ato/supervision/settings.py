"""Block ``supervision:`` of a scenario: supervisor, and reactions of the train to missing messages."""

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from plant_sim.si_model import SiModel
from plant_sim.units import Length, Place, Ratio, Speed, Time, Usual


class FailsafeSpec(SiModel):
    """Reactions of the train to missing commands.

    The age of the newest command beyond the largest delay of its link decides: the last command is held up to
    ``hold``, the drives are off up to ``coast``, the service brake acts up to ``service``, then the emergency brake.
    The emergency brake is applied too if the brake release of the supervisor is older than ``release``.
    """

    hold: Time = Field(0.5, ge=0, description="largest age of the last command that is held")
    coast: Time = Field(1.0, ge=0, description="largest age of the last command up to which the drives are off")
    service: Time = Field(
        5.0, ge=0, description="largest age of the last command for the service brake; then the emergency brake acts"
    )
    release: Time | None = Field(
        None,
        gt=0,
        description="largest age of the brake release; default: supervision period and one tick",
        examples=[0.6],
    )


class SupervisionSpec(SiModel):
    """Supervision of the speed limits and of the stop at the end of the profile."""

    enabled: bool | None = Field(None, description="supervision of the speed; default: on a line with speed limits")
    period: Time = Field(0.4, ge=1e-3, le=2.0, description="period of the supervisor, rounded up to ticks")
    overlap: Annotated[Place, Usual(1, 5e3)] = Field(
        100.0, ge=0, le=1e5, description="distance from the stop to the end of authority, the supervised location"
    )
    kdry: Ratio = Field(0.8, gt=0, le=1, description="factor Kdry_rst on the emergency deceleration")
    service_brake: bool = Field(True, description="intervention by the service brake before the emergency brake")
    service_curve: bool = Field(
        False, description="supervision of the stop by the SBD too, for a law without full service braking"
    )
    roll_away: Annotated[Length, Usual(0.05, 20)] = Field(2.0, gt=0, description="largest movement backwards")
    speed_difference: Speed = Field(
        2.0, gt=0, description="largest difference of the ATO's speed, beyond the errors of both"
    )
    position_difference: Annotated[Place, Usual(0.5, 1e3)] = Field(
        20.0, gt=0, description="largest difference of the ATO's position, beyond the error of the odometry"
    )
    confirmation: Time = Field(1.0, ge=0, description="duration of a difference before it counts")
    assurance: bool = Field(True, description="braking law that takes over from the law before the warning limit")
    assurance_limit: Literal["warning", "service_brake"] = Field(
        "warning", description="limit before which the braking law takes over"
    )
    assurance_margin: Speed = Field(
        0.5, ge=0, description="distance from the permitted speed at which the law takes over again"
    )
    plan_margin: Speed | None = Field(
        0.5, ge=0, description="least distance of a plan from the warning speed; null: the plan does not use the limits"
    )
    failsafe: FailsafeSpec = FailsafeSpec()


STANDARD_GRAVITY = 9.81
"""Acceleration of gravity of 3.13.4.3 [m/s²]."""
MIN_INDICATION_TIME = 5.0
"""Smallest time between the indication and the permitted speed [s]: 3.13.9.3.6."""
INDICATION_SHARE = 0.8
"""Part of the service-brake build-up time in the indication time: 3.13.9.3.6."""
LOCKED_SERVICE_TIME = 2.0
"""Smallest time from the SBI2 to the EBI with service-brake feedback, ``T_bs2_locked`` [s]: A.3.10."""
MAX_LATER_ACCELERATION = 0.4
"""Largest estimated acceleration after the traction time [m/s²]: 3.13.9.3.2.9."""


@dataclass(frozen=True, slots=True)
class FixedValues:
    """Times and rotating masses that a case may replace.

    Attributes
    ----------
    t_warning : float
        Time between the warning and the service-brake intervention [s].
    t_driver : float
        Time between the permitted speed and the service-brake intervention [s].
    m_rotating_max, m_rotating_min : float
        Rotating mass uphill and downhill, without a nominal value [% of the mass].
    driver_time_twice : bool
        True: the indication time contains ``t_driver`` once more, as in the text of issue 4.0.0; False: as in the
        published cases of baselines 3.3 and 3.4.
    """

    t_warning: float = 2.0
    t_driver: float = 4.0
    m_rotating_max: float = 15.0
    m_rotating_min: float = 2.0
    driver_time_twice: bool = False
