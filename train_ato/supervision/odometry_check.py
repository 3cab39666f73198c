"""Plausibility of the odometry: its distances follow from its speeds."""

from __future__ import annotations

from plant_sim.states import Odometry
from train_ato.supervision.odometry import odometer_error

MOVING_SPEED = 0.1
"""Speed above which the counted distance changes [m/s]."""
STEP_TOLERANCE, STEP_SHARE = 1.0, 0.05
"""Largest difference of a counted distance from the speeds at its ends [m], and its part of the distance."""


class OdometryCheck:
    """Detects frozen and foreign odometry, from the last plausible one.

    One of the two odometers may be wrong, for example that of a sliding wheel: the larger value counts.

    Attributes
    ----------
    last : Odometry or None
        Last plausible odometry.
    """

    def __init__(self) -> None:
        self.last: Odometry | None = None

    def problem(self, odometry: Odometry) -> str:
        """Return the problem of an odometry as text, "" if one of its odometers is plausible."""
        if self.last is not None:
            problems = [_problem(odometry, self.last, index) for index in range(odometry.speed.size)]
            if all(problems):
                return problems[0]
        self.last = odometry
        return ""


def _problem(odometry: Odometry, last: Odometry, index: int) -> str:
    """Return the problem of one odometer as text, "" for plausible values."""
    position, speed = float(odometry.position[index]), float(odometry.speed[index])
    since, before = float(odometry.since_balise[index]), float(last.since_balise[index])
    span = (odometry.stamp - last.stamp) * 1e-9
    ends = speed * span, float(last.speed[index]) * span
    tolerance = STEP_TOLERANCE + STEP_SHARE * max(abs(ends[0]), abs(ends[1]))
    if since < before:
        tolerance += odometer_error(before)  # a balise has corrected the position
    moved = position - float(last.position[index])
    if not min(ends) - tolerance <= moved <= max(ends) + tolerance:
        return f"moved by {moved:.1f} m in {span:.1f} s at {speed * 3.6:.1f} km/h"
    if since == before and abs(speed) > MOVING_SPEED:
        return f"frozen at {speed * 3.6:.1f} km/h"
    return ""
