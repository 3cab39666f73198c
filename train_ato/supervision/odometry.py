"""Confidence of position and speed: SUBSET-041, 5.3.1, as used in SUBSET-026, 3.13.9."""

# mypy: allow-untyped-decorators

from __future__ import annotations

from math import nan
from typing import NamedTuple

from plant_sim.compiled import also_compiled
from plant_sim.units import KMH

POSITION_OFFSET, POSITION_SHARE = 5.0, 0.05
"""Position error [m], and its part of the distance since the last balise: SUBSET-041, 5.3.1.1."""
SPEED_ERROR, SPEED_KNEE, SPEED_ERROR_TOP, SPEED_TOP = 2.0, 30.0, 12.0, 500.0
"""Speed error up to the knee, and linear from there to the top speed [km/h]: SUBSET-041, 5.3.1.2."""


@also_compiled
def odometer_error(distance: float, balise_accuracy: float = 0.0) -> float:
    """Return the largest error of the position [m] at a distance since the last balise [m].

    Parameters
    ----------
    distance
        Distance since the last balise [m].
    balise_accuracy
        Accuracy of the location of the balise (Q_LOCACC) [m].
    """
    return balise_accuracy + POSITION_OFFSET + POSITION_SHARE * abs(distance)


@also_compiled
def speed_measurement_error(speed: float) -> float:
    """Return the largest error of a measured speed [m/s], function f41 of SUBSET-026."""
    slope = (SPEED_ERROR_TOP - SPEED_ERROR) / (SPEED_TOP - SPEED_KNEE)
    return (SPEED_ERROR + slope * max(abs(speed) * KMH - SPEED_KNEE, 0.0)) / KMH


class MotionEstimate(NamedTuple):
    """Estimate of the motion at one time, input of the supervision limits.

    Attributes
    ----------
    acceleration : float
        Estimated acceleration [m/s²]; the limits use it, if it is above 0, during the traction time (``A_est1``).
    speed_error : float
        Speed under-reading amount ``V_ura`` [m/s]; 0 if its compensation is inhibited.
    under_reading, over_reading : float
        Distance from the estimated front to the max safe front and to the min safe front [m].
    later_acceleration : float
        Acceleration after the traction time [m/s²] (``A_est2``), used from 0 to 0.4 m/s²; NaN: the same.
    """

    acceleration: float = 0.0
    speed_error: float = 0.0
    under_reading: float = 0.0
    over_reading: float = 0.0
    later_acceleration: float = nan


EXACT_MOTION = MotionEstimate()
"""Exact odometry and no acceleration."""


def motion_estimate(speed: float, acceleration: float, distance: float, balise_accuracy: float = 0.0) -> MotionEstimate:
    """Return the estimate with the largest errors permitted by SUBSET-041.

    Parameters
    ----------
    speed, acceleration
        Measured speed [m/s] and acceleration [m/s²].
    distance, balise_accuracy
        As in :func:`odometer_error`.
    """
    error = odometer_error(distance, balise_accuracy)
    return MotionEstimate(acceleration, speed_measurement_error(speed), error, error)
