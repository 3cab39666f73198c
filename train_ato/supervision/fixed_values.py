"""Fixed values of the speed and distance monitoring: SUBSET-026, A.3.1, and its gravity (3.13.4.3)."""

from __future__ import annotations

from dataclasses import dataclass

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
