"""Plausibility of the odometry: its distances follow from its speeds."""

# mypy: no-warn-return-any

from __future__ import annotations

from typing import Any

from plant_sim.compiled import compiled
from plant_sim.odometry import OdometryReading, write_reading
from plant_sim.record import zeros
from plant_sim.states import Odometry
from train_ato.supervision.odometry import odometer_error

MOVING_SPEED = 0.1
"""Speed above which the counted distance changes [m/s]."""
STEP_TOLERANCE, STEP_SHARE = 1.0, 0.05
"""Largest difference of a counted distance from the speeds at its ends [m], and its part of the distance."""
PLAUSIBLE, MOVED, FROZEN = range(3)
"""Results of :func:`odometer_problem`."""


@compiled
def odometer_problem(now: OdometryReading, last: OdometryReading, index: int) -> int:
    """Return the problem of one odometer: a distance that its speeds do not give, or none at a speed."""
    span, speed = (now.stamp - last.stamp) * 1e-9, now.speed[index]
    since, before = now.since_balise[index], last.since_balise[index]
    end, begin = speed * span, last.speed[index] * span
    tolerance = STEP_TOLERANCE + STEP_SHARE * max(abs(end), abs(begin))
    if since < before:
        tolerance += odometer_error(before)  # a balise has corrected the position
    moved = now.position[index] - last.position[index]
    if not min(end, begin) - tolerance <= moved <= max(end, begin) + tolerance:
        return MOVED
    return FROZEN if since == before and abs(speed) > MOVING_SPEED else PLAUSIBLE


@compiled
def odometry_problem(now: OdometryReading, last: OdometryReading) -> int:
    """Return the problem of the wheel odometer if the radar has one too.

    One of the two odometers may be wrong, for example that of a sliding wheel: the larger value counts.
    """
    found = odometer_problem(now, last, 0)
    return found if odometer_problem(now, last, 1) != PLAUSIBLE else PLAUSIBLE


@compiled
def _problem(now: Any, last: Any) -> int:
    return odometry_problem(now[0], last[0])


class OdometryCheck:
    """Detects frozen and foreign odometry, from the last plausible one.

    Attributes
    ----------
    last : Array of :class:`plant_sim.odometry.OdometryReading`, shape (1,)
        Last plausible odometry; its stamp is negative before the first.
    """

    def __init__(self) -> None:
        self.last, self._now = zeros(OdometryReading, 1), zeros(OdometryReading, 1)
        self.last["stamp"] = -1

    def problem(self, odometry: Odometry) -> str:
        """Return the problem of an odometry as text, "" if one of its odometers is plausible."""
        write_reading(self._now, odometry)
        found = _problem(self._now, self.last) if self.last["stamp"][0] >= 0 else PLAUSIBLE
        if found == PLAUSIBLE:
            self.last[:] = self._now
            return ""
        now, last = self._now[0], self.last[0]
        speed = f"{now['speed'].item(0) * 3.6:.1f} km/h"
        if found == FROZEN:
            return f"frozen at {speed}"
        moved = now["position"].item(0) - last["position"].item(0)
        return f"moved by {moved:.1f} m in {(now['stamp'] - last['stamp']) * 1e-9:.1f} s at {speed}"
