"""Block ``supervision:`` of a scenario: supervisor, and reactions of the train to missing messages."""

from dataclasses import dataclass
from typing import Annotated, Literal

from plant_sim.si_model import SiModel, option
from plant_sim.units import Length, Place, Ratio, Speed, Time, Usual


class FailsafeSpec(SiModel):
    """Reactions of the train to missing commands.

    The age of the newest command beyond the largest delay of its link decides: the last command is held up to
    ``hold``, the drives are off up to ``coast``, the service brake acts up to ``service``, then the emergency brake.
    The emergency brake is applied too if the brake release of the supervisor is older than ``release``.
    """

    hold: Time = option(0.5, "largest age of the last command that is held", ge=0)
    coast: Time = option(1.0, "largest age of the last command up to which the drives are off", ge=0)
    service: Time = option(
        5.0, "largest age of the last command for the service brake; then the emergency brake acts", ge=0
    )
    release: Time | None = option(
        None, "largest age of the brake release; default: supervision period and one tick", example=0.6, gt=0
    )


class SupervisionSpec(SiModel):
    """Supervision of the speed limits and of the stop at the end of the profile."""

    enabled: bool | None = option(None, "supervision of the speed; default: on a line with speed limits")
    period: Time = option(0.4, "period of the supervisor, rounded up to ticks", ge=1e-3, le=2.0)
    overlap: Annotated[Place, Usual(1, 5e3)] = option(
        100.0, "distance from the stop to the end of authority, the supervised location", ge=0, le=1e5
    )
    kdry: Ratio = option(0.8, "factor Kdry_rst on the emergency deceleration", gt=0, le=1)
    service_brake: bool = option(True, "intervention by the service brake before the emergency brake")
    service_curve: bool = option(
        False, "supervision of the stop by the SBD too, for a law without full service braking"
    )
    roll_away: Annotated[Length, Usual(0.05, 20)] = option(2.0, "largest movement backwards", gt=0)
    speed_difference: Speed = option(2.0, "largest difference of the ATO's speed, beyond the errors of both", gt=0)
    position_difference: Annotated[Place, Usual(0.5, 1e3)] = option(
        20.0, "largest difference of the ATO's position, beyond the error of the odometry", gt=0
    )
    confirmation: Time = option(1.0, "duration of a difference before it counts", ge=0)
    assurance: bool = option(True, "braking law that takes over from the law before the warning limit")
    assurance_limit: Literal["warning", "service_brake"] = option(
        "warning", "limit before which the braking law takes over"
    )
    assurance_margin: Speed = option(0.5, "distance from the permitted speed at which the law takes over again", ge=0)
    plan_margin: Speed | None = option(
        0.5, "least distance of a plan from the warning speed; null: the plan does not use the limits", ge=0
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
