"""Compiled supervision limits, with the operations of :mod:`train_ato.supervision.track_supervision` in the same order.

The limits are arrays (:mod:`train_ato.loop.spans.packed_track`). A value that the functions in Python refuse is NaN.
"""

# mypy: allow-untyped-defs

from __future__ import annotations

from math import inf, nan, sqrt

from plant_sim.compiled import compiled
from plant_sim.units import KMH
from train_ato.supervision.fixed_values import MAX_LATER_ACCELERATION
from train_ato.supervision.odometry import (
    POSITION_OFFSET,
    POSITION_SHARE,
    SPEED_ERROR,
    SPEED_ERROR_TOP,
    SPEED_KNEE,
    SPEED_TOP,
)

# Columns of `targets`, one row per target; FLOOR is the first of four speeds.
# First arcs and ends of the curves EBD and SBD in `curves`; SBD_FIRST < 0: no SBD.
(
    LOCATION, TARGET_SPEED, IS_END, SPEED_LIMIT, TRACTION, REMAINING, BS1, BS2, INDICATION_TIME, PERMITTED_TIME,
    WARNING_TIME, SERVICE_TIME, EMERGENCY_TIME, SBD_PERMITTED_TIME, SBD_WARNING_TIME, EBD_FIRST, EBD_END, EBD_TOP,
    SBD_FIRST, SBD_END, SBD_TOP, BEGIN, FLOOR,
) = range(23)  # fmt: skip
TARGET_COLUMNS = FLOOR + 4
# Columns of `curves`, one row per arc.
ARC_SPEED, ARC_LOCATION, ARC_DECELERATION = range(3)
# Entries of `motion`.
FRONT, SPEED, ACCELERATION, ERROR, POSITION_ERROR = range(5)
# Entries of `speeds`.
PERMITTED, WARNING, SERVICE, EMERGENCY = range(4)
TOLERANCE = 1e-9
"""Distance from the end of a curve within which it is evaluated [m/s]."""
SPEED_ERROR_SLOPE = (SPEED_ERROR_TOP - SPEED_ERROR) / (SPEED_TOP - SPEED_KNEE)


@compiled
def _smaller(a, b):
    return b if b < a else a


@compiled
def _larger(a, b):
    return b if b > a else a


@compiled
def odometry_position_error(distance):
    """Return the error of the position [m] as :func:`train_ato.supervision.odometry.odometer_error`."""
    return 0.0 + POSITION_OFFSET + POSITION_SHARE * abs(distance)


@compiled
def odometry_speed_error(speed):
    """Return the error of a speed [m/s] as :func:`train_ato.supervision.odometry.speed_measurement_error`."""
    return (SPEED_ERROR + SPEED_ERROR_SLOPE * _larger(abs(speed) * KMH - SPEED_KNEE, 0.0)) / KMH


@compiled
def _advanced_speed(curves, first, end, place, time, gain, shift):
    """Return the speed of :meth:`train_ato.supervision.deceleration_curve.DecelerationCurve.advanced_speed` [m/s]."""
    wanted = place + shift - time * gain
    low, high = first, end
    while low < high:
        middle = (low + high) // 2
        if curves[middle, ARC_LOCATION] - time * curves[middle, ARC_SPEED] >= wanted:
            low = middle + 1
        else:
            high = middle
    i = low - 1 if low - 1 > first else first
    v, a = curves[i, ARC_SPEED], curves[i, ARC_DECELERATION]
    rest = wanted - curves[i, ARC_LOCATION] - v * v / (2.0 * a)
    discriminant = a * time * a * time - 2.0 * a * rest
    return sqrt(_larger(discriminant, 0.0)) - a * time - gain


@compiled
def _location(curves, first, end, top, speed):
    """Return the location at which a curve has a speed [m], NaN for a speed outside the curve."""
    if speed > top + TOLERANCE:
        return nan
    low, high = first, end
    while low < high:  # bisect_left
        middle = (low + high) // 2
        if curves[middle, ARC_SPEED] < speed:
            low = middle + 1
        else:
            high = middle
    i = low - 1 if low - 1 > first else first
    v = curves[i, ARC_SPEED]
    if speed < v - TOLERANCE:
        return nan
    return curves[i, ARC_LOCATION] - (speed * speed - v * v) / (2.0 * curves[i, ARC_DECELERATION])


@compiled
def _rises(target, acceleration):
    """Return the rises of the speed in the traction time and in the rest of the build-up time [m/s]."""
    raised = _larger(acceleration, 0.0)
    return raised * target[TRACTION], _smaller(raised, MAX_LATER_ACCELERATION) * target[REMAINING]


@compiled
def _indication(target, curves, speed, motion):
    """Return the location of the indication of a target at a speed [m]."""
    capped = _smaller(speed, _larger(target[SPEED_LIMIT], target[TARGET_SPEED]))
    low = target[TARGET_SPEED]
    first, later = _rises(target, motion[ACCELERATION])
    now = capped + motion[ERROR]
    compensated = _larger(now + first, low)
    distance = _larger(now + first / 2.0, low) * target[TRACTION] + (compensated + later / 2.0) * target[REMAINING]
    curve = int(target[EBD_FIRST]), int(target[EBD_END])
    found = _location(curves, curve[0], curve[1], target[EBD_TOP], compensated + later) - distance
    found = found - capped * target[BS2]
    if target[SBD_FIRST] >= 0.0:
        curve = int(target[SBD_FIRST]), int(target[SBD_END])
        other = _location(curves, curve[0], curve[1], target[SBD_TOP], capped) - capped * target[BS1]
        if other != other:
            return nan
        found = _smaller(found, other + motion[POSITION_ERROR])
    return found - capped * target[INDICATION_TIME]


@compiled
def _restrict(target, curves, motion, speeds):
    """Lower the speeds to those of a target."""
    first, later = _rises(target, motion[ACCELERATION])
    error = motion[ERROR]
    gain = error + first + later
    shift = (error + first / 2.0) * target[TRACTION] + (error + first + later / 2.0) * target[REMAINING]
    place = motion[FRONT] + motion[POSITION_ERROR]
    low, end = int(target[EBD_FIRST]), int(target[EBD_END])
    permitted = _advanced_speed(curves, low, end, place, target[PERMITTED_TIME], gain, shift)
    warning = _advanced_speed(curves, low, end, place, target[WARNING_TIME], gain, shift)
    emergency = _advanced_speed(curves, low, end, place, target[EMERGENCY_TIME], gain, shift)
    stopping = emergency
    if target[BS2] != 0.0:
        stopping = _advanced_speed(curves, low, end, place, target[SERVICE_TIME], gain, shift)
    if target[SBD_FIRST] >= 0.0:
        front, low, end = motion[FRONT], int(target[SBD_FIRST]), int(target[SBD_END])
        other = _advanced_speed(curves, low, end, front, target[SBD_PERMITTED_TIME], 0.0, 0.0)
        permitted = _smaller(permitted, other)
        other = _advanced_speed(curves, low, end, front, target[SBD_WARNING_TIME], 0.0, 0.0)
        warning = _smaller(warning, other)
        stopping = _smaller(stopping, _advanced_speed(curves, low, end, front, target[BS1], 0.0, 0.0))
    speeds[PERMITTED] = _smaller(speeds[PERMITTED], _larger(permitted, target[FLOOR + PERMITTED]))
    speeds[WARNING] = _smaller(speeds[WARNING], _larger(warning, target[FLOOR + WARNING]))
    speeds[SERVICE] = _smaller(speeds[SERVICE], _larger(stopping, target[FLOOR + SERVICE]))
    speeds[EMERGENCY] = _smaller(speeds[EMERGENCY], _larger(emergency, target[FLOOR + EMERGENCY]))


@compiled
def _ceiling(starts, ceilings, low, high, speeds):
    """Write the ceiling speeds of the lowest limit between two front positions [m]."""
    first = 0
    while first < len(starts) and starts[first] <= low:
        first += 1
    best = row = first
    while row < len(starts) and starts[row] <= high:
        row += 1
        if ceilings[row, PERMITTED] < ceilings[best, PERMITTED]:
            best = row
    for entry in range(4):
        speeds[entry] = ceilings[best, entry]


@compiled
def evaluate(track, motion, speeds):
    """Write the most restrictive speeds of the limits [m/s]; return 1 after the indication of a target, else 0.

    Parameters
    ----------
    track
        Arrays of :class:`train_ato.loop.spans.packed_track.PackedTrack`.
    motion
        Estimate by the entries above.
    speeds
        Output, shape (4,).

    Returns
    -------
    int
        -1 for a motion that a curve does not contain.
    """
    starts, ceilings, targets, curves, widest = track
    front, speed, error = motion[FRONT], motion[SPEED], motion[POSITION_ERROR]
    foremost = front + error
    _ceiling(starts, ceilings, front - error, foremost, speeds)
    count, ahead = len(targets), 0
    while ahead < count and targets[ahead, LOCATION] < foremost:
        ahead += 1
    wider = motion[ACCELERATION] > widest[0] or motion[ERROR] > widest[1] or error > widest[2]
    first = ahead - 1 if ahead == count and count > 0 and targets[count - 1, IS_END] > 0.0 else ahead
    for index in range(first, count):
        if front < targets[index, BEGIN] and not wider:
            break
        _restrict(targets[index], curves, motion, speeds)
    for index in range(ahead, count):
        target = targets[index]
        if front < target[BEGIN] and not wider:
            return 0
        if speed > target[TARGET_SPEED]:
            place = _indication(target, curves, speed, motion)
            if not -inf < place < inf:
                return -1
            if foremost >= place:
                return 1
    return 0
