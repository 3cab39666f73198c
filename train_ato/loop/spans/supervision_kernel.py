"""Compiled steps of the supervisor without effect on the train: odometry, limits, and the checks of the ATO.

A step with an effect (a brake, a takeover, an implausible value) or backwards is left to the stages in Python.
"""

# mypy: allow-untyped-defs

from __future__ import annotations

import numpy as np

from plant_sim.compiled import compiled
from train_ato.control.assurance import RATE_TIME
from train_ato.loop.spans import limits_kernel as c
from train_ato.supervision.odometry_check import MOVING_SPEED, STEP_SHARE, STEP_TOLERANCE
from train_ato.supervision.position_estimate import ACCELERATION_TIME
from train_ato.supervision.supervisor import STANDSTILL_SPEED

ESTIMATE_NS, RATE_NS = ACCELERATION_TIME * 1e9, RATE_TIME * 1e9
MAX_POSITION, MAX_SPEED = 1e6, 100.0
"""Position [m] and speed [m/s] beyond which a step is left to Python, far inside the limits of validity."""
# Entries of `odometers`; the counted distances and those since the last balise are of wheel and radar.
ORIGIN, COUNTED, COUNTED_RADAR, SINCE, SINCE_RADAR, TRUE_FRONT = range(6)
# Entries of `count`: period of the supervisor [ns], 0 without one; steps so far; stamp of the step before [ns];
# first speed of the estimate and of the assurance, and end of the speeds.
PERIOD, STEPS, STAMP, FIRST_ESTIMATED, FIRST_RATED, END = range(6)
# Entries of `constant`. REACTION < 0: no assurance; LIMIT: entry of the speeds.
WHEEL, RADAR, SPACING, HALF, REACTION, LIMIT, SPEED_DIFFERENCE, POSITION_DIFFERENCE, FRONT_OFFSET = range(9)
# Columns of `steps`, one row per step after the one before the span.
(
    STEP_POSITION, STEP_POSITION_RADAR, STEP_SPEED, STEP_SPEED_RADAR, STEP_SINCE, STEP_SINCE_RADAR, STEP_FRONT,
    STEP_FOREMOST, STEP_ESTIMATE, STEP_LIMITS,
) = range(10)  # fmt: skip
STEP_ACCELERATION, STEP_ERROR, STEP_INDICATED, STEP_MOVING = range(STEP_LIMITS + 4, STEP_LIMITS + 8)
STEP_COLUMNS = STEP_LIMITS + 8


@compiled
def _move(constant, odometers, front):
    """Count the distance to a true front position [m], as :meth:`plant_sim.odometry.Odometers.move`."""
    wheel, radar = constant[WHEEL], constant[RADAR]
    moved = front - odometers[TRUE_FRONT]
    balise = constant[SPACING] * np.floor(front / constant[SPACING])
    if moved > 0.0 and balise > odometers[TRUE_FRONT]:
        odometers[ORIGIN] = balise
        odometers[COUNTED] = odometers[SINCE] = (front - balise) * wheel
        odometers[COUNTED_RADAR] = odometers[SINCE_RADAR] = (front - balise) * radar
    else:
        odometers[COUNTED] += moved * wheel
        odometers[COUNTED_RADAR] += moved * radar
        odometers[SINCE] += abs(moved) * wheel
        odometers[SINCE_RADAR] += abs(moved) * radar
    odometers[TRUE_FRONT] = front


@compiled
def _is_plausible(span, now, before):
    """Return True if both odometers are plausible, as :class:`train_ato.supervision.odometry_check.OdometryCheck`."""
    for index in range(2):
        speed, since, earlier = now[STEP_SPEED + index], now[STEP_SINCE + index], before[STEP_SINCE + index]
        one, other = speed * span, before[STEP_SPEED + index] * span
        tolerance = STEP_TOLERANCE + STEP_SHARE * max(abs(one), abs(other))
        if since < earlier:
            tolerance += c.odometry_position_error(earlier)
        moved = now[STEP_POSITION + index] - before[STEP_POSITION + index]
        if not min(one, other) - tolerance <= moved <= max(one, other) + tolerance:
            return False
        if since == earlier and abs(speed) > MOVING_SPEED:
            return False
    return True


@compiled
def _rate(stamps, speeds, first, end, stamp, window):
    """Return the first speed of an average and its time [s] after a new speed was added at the end."""
    while end - first > 2 and stamp - stamps[first + 1] >= window:
        first += 1
    return first, (stamp - stamps[first]) * 1e-9


@compiled
def _is_tracked(constant, row, position, velocity):
    """Return True without a difference of :class:`train_ato.control.plausibility.MeasurementCheck`."""
    expected, estimate = row[STEP_ESTIMATE], row[STEP_FRONT]
    if abs(velocity - expected) > constant[SPEED_DIFFERENCE] + c.odometry_speed_error(expected):
        return False
    front = position + constant[FRONT_OFFSET]
    return not abs(front - estimate) > constant[POSITION_DIFFERENCE] + row[STEP_FOREMOST] - estimate


@compiled
def supervise(stamp, x_front, v_front, position, velocity, supervision, motion):
    """Run the supervisor at a stamp; return False for a tick that is left to Python, whose states are then undefined.

    Parameters
    ----------
    stamp
        Stamp of the tick [ns].
    x_front, v_front
        True position [m] and speed [m/s] of vehicle 0.
    position, velocity
        Measured position [m] and speed [m/s] of the first power unit.
    supervision
        Arrays of :class:`train_ato.loop.spans.supervised.SupervisedTicks`.
    motion
        Memory, shape (5,).
    """
    count, constant, odometers, stamps, speeds, track, steps = supervision
    _move(constant, odometers, x_front + constant[HALF])
    if stamp % count[PERIOD] != 0:
        return True
    number, end = count[STEPS] + 1, count[END]
    row, before = steps[number], steps[number - 1]
    row[STEP_POSITION] = odometers[ORIGIN] + odometers[COUNTED]
    row[STEP_POSITION_RADAR] = odometers[ORIGIN] + odometers[COUNTED_RADAR]
    row[STEP_SPEED], row[STEP_SPEED_RADAR] = v_front * constant[WHEEL], v_front * constant[RADAR]
    row[STEP_SINCE], row[STEP_SINCE_RADAR] = odometers[SINCE], odometers[SINCE_RADAR]
    wheel, radar = row[STEP_SPEED], row[STEP_SPEED_RADAR]
    speed = radar if abs(radar) > abs(wheel) else wheel
    if not (0.0 <= speed < MAX_SPEED and abs(x_front) < MAX_POSITION):
        return False
    if not _is_plausible((stamp - count[STAMP]) * 1e-9, row, before):
        return False
    stamps[end], speeds[end] = stamp, speed
    first, span = _rate(stamps, speeds, count[FIRST_ESTIMATED], end + 1, stamp, ESTIMATE_NS)
    motion[c.ACCELERATION] = (speed - speeds[first]) / span if span > 0.0 else 0.0
    motion[c.FRONT] = max(row[STEP_POSITION], row[STEP_POSITION_RADAR])
    motion[c.SPEED], motion[c.ERROR] = speed, c.odometry_speed_error(speed)
    motion[c.POSITION_ERROR] = c.odometry_position_error(max(row[STEP_SINCE], row[STEP_SINCE_RADAR]))
    limits = row[STEP_LIMITS : STEP_LIMITS + 4]
    indicated = c.evaluate(track, motion, limits)
    row[STEP_FRONT], row[STEP_FOREMOST] = motion[c.FRONT], motion[c.FRONT] + motion[c.POSITION_ERROR]
    row[STEP_ESTIMATE], row[STEP_INDICATED] = speed, indicated
    row[STEP_ACCELERATION], row[STEP_ERROR] = motion[c.ACCELERATION], motion[c.POSITION_ERROR]
    row[STEP_MOVING] = speed >= STANDSTILL_SPEED
    above = speed > limits[1] or speed > limits[2] or speed > limits[3]
    if speed >= STANDSTILL_SPEED and (indicated < 0 or above):
        return False
    rated, span = _rate(stamps, speeds, count[FIRST_RATED], end + 1, stamp, RATE_NS)
    if constant[REACTION] >= 0.0:
        share = constant[REACTION] / span if span > 0.0 else 0.0
        predicted = speed + (speed - speeds[rated]) * share
        if speed > 0.0 and not max(speed, predicted) < limits[int(constant[LIMIT])]:
            return False
    if not _is_tracked(constant, row, position, velocity):
        return False
    count[STEPS], count[STAMP], count[END] = number, stamp, end + 1
    count[FIRST_ESTIMATED], count[FIRST_RATED] = first, rated
    return True
