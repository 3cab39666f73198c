"""Release speed near an end of authority: SUBSET-026, 3.13.9.4."""

from __future__ import annotations

from math import isnan
from typing import Any

from plant_sim.compiled import compiled
from plant_sim.record import Records
from train_ato.supervision.deceleration_curve import Arc
from train_ato.supervision.limits import Target, TargetLimits, service_location
from train_ato.supervision.odometry import EXACT_MOTION, MotionEstimate, speed_measurement_error

TRIP_OFFSET, TRIP_SHARE = 10.0, 0.10
"""Confidence interval predicted for the end of authority: offset [m], and part of its distance to the reference."""
ITERATIONS = 60
"""Halvings of the speed interval; beyond the resolution of a float."""


@compiled
def release_location(target: Target, arcs: Records[Arc], speed: float, error: float, under_reading: float) -> Any:
    """Return the estimated front position at which the supervision of a release speed begins [m]: 3.13.9.4.6."""
    return service_location(target, arcs, speed, error, 0.0, 0.0, under_reading) - under_reading


def trip_location(
    eoa: float,
    reference: float,
    motion: MotionEstimate = EXACT_MOTION,
    balise_accuracy: float = 0.0,
) -> float:
    """Return the largest front position at the trip of an end of authority, ``d_tripEOA`` [m]: 3.13.9.4.8.2, level 2.

    Parameters
    ----------
    eoa
        Location of the end of authority [m].
    reference
        On-board reference location [m]: the last balise, not the front (3.13.1.4). The odometer error grows from there.
    motion
        Confidence of the position now.
    balise_accuracy
        Accuracy of the location of the last balise [m].
    """
    predicted = 2.0 * balise_accuracy + TRIP_OFFSET + TRIP_SHARE * max(eoa - reference, 0.0)
    return eoa + max(predicted, motion.under_reading + motion.over_reading)


def release_speed(
    limits: TargetLimits, trip: float, speed_error: float = 0.0, inhibit_compensation: bool = False
) -> float:
    """Return the release speed [m/s] that stops the train before the target after a trip: 3.13.9.4.8-9, level 2.

    Parameters
    ----------
    limits
        Limits of the supervised location, or of a lower speed limit between the trip location and it.
    trip
        Trip location [m].
    speed_error
        Speed under-reading amount ``V_ura`` [m/s].
    inhibit_compensation
        True if the national value inhibits the compensation of the speed error.

    Returns
    -------
    float
        Largest speed with EBD(trip + D_bec) at least as high as the compensated speed, not above the speed limit of
        the limits; the target speed if there is none above it.
    """
    train = limits.train
    build_up = train.brake.emergency_time.for_target(limits.target.speed)
    time = max(train.t_traction_cut_off, build_up)  # T_traction + T_berem, without traction cut-off command

    def stops(speed: float) -> bool:
        error = 0.0 if inhibit_compensation else max(speed_measurement_error(speed), speed_error)
        return limits.ebd.speed(trip + (speed + error) * time) >= speed + error

    low, high = limits.target.speed, max(limits.speed_limit, limits.target.speed)
    if not stops(low):
        return low
    if stops(high):
        return high
    for _ in range(ITERATIONS):
        middle = (low + high) / 2.0
        low, high = (middle, high) if stops(middle) else (low, middle)
    return low


def release_start(
    limits: TargetLimits, speed: float, motion: MotionEstimate = EXACT_MOTION, inhibit_compensation: bool = False
) -> float:
    """Return the estimated front position at which the supervision of the release speed begins [m]: 3.13.9.4.6.

    Parameters
    ----------
    limits
        Limits of the end of authority.
    speed
        Release speed [m/s].
    motion
        Confidence of the position; its acceleration and speed error are replaced by 0 and f41 of the release speed.
    inhibit_compensation
        As in :func:`release_speed`.
    """
    error = 0.0 if inhibit_compensation else speed_measurement_error(speed)
    found = release_location(limits.record[0], limits.arcs, speed, error, motion.under_reading)
    if isnan(found):
        limits.service(speed, MotionEstimate(0.0, error, motion.under_reading, motion.over_reading))
    return float(found)
