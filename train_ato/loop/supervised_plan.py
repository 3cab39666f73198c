"""Planned profile within the limits of the supervisor.

A plan brakes with the service deceleration. The braking curves of the supervisor have the guaranteed deceleration of
the emergency brake, which on a falling grade can be much smaller. Where the planned speed comes near the warning
speed, the plan has a lower speed limit there and is made again; a plan that is far enough away is not changed.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from train_ato.messages.types import Array
from train_ato.profile.profile import Profile
from train_ato.supervision.fixed_values import KMH
from train_ato.supervision.odometry import motion_estimate
from train_ato.supervision.track_supervision import TrackSupervision

__all__ = ["SpeedCeiling", "profile_within"]

MIN_PLACE_STEP, MAX_PLACES = 5.0, 4000
"""Distance of the compared places [m], and their largest number, beyond which the distance is longer."""
ROUNDS = 8
"""Largest number of plans with a lower ceiling."""
AVERAGING_TIME = 1.0
"""Time before and after a place over which the jerk limit of a plan mixes its speeds [s]."""
TOLERANCE = 0.05
"""Excess over the ceiling that does not need another plan [m/s]."""


class SpeedCeiling:
    """Speeds of a profile compared with the warning speed of the supervisor.

    Parameters
    ----------
    track
        Limits of the supervisor.
    half
        Distance from the centre of vehicle 0 to the front [m].
    balise_spacing
        Distance of the balises [m]; the position error of the odometry begins at each.
    reaction
        Time over which the run-time assurance predicts the speed [s].
    margin
        Least distance from the warning speed [m/s].
    """

    def __init__(
        self, track: TrackSupervision, half: float, balise_spacing: float, reaction: float, margin: float
    ) -> None:
        self._track, self._half, self._spacing = track, half, balise_spacing
        self._reaction, self._margin = reaction, margin

    def excess(self, profile: Profile, places: Array) -> tuple[Array, Array]:
        """Return the ceiling at places of the front, and the excess of a profile over it [m/s].

        The ceiling is the warning speed minus the margin and the rise of the speed over the reaction time.

        Parameters
        ----------
        profile
            Profile, whose acceleration and speed are inputs of the limits.
        places : Array, shape (n,)
            Increasing places of the front [m].
        """
        front = profile.position + self._half
        speed = np.interp(places, front, profile.velocity)
        acceleration = np.maximum(np.interp(places, front, profile.acceleration), 0.0)
        warning = np.array(
            [self._warning(*row) for row in zip(places.tolist(), speed.tolist(), acceleration.tolist(), strict=True)]
        )
        # at standstill no limit is supervised
        ceiling = np.maximum(warning - self._margin - self._reaction * acceleration, 0.0)
        return ceiling, np.where(speed > 0.0, speed - ceiling, 0.0)

    def _warning(self, front: float, speed: float, acceleration: float) -> float:
        since_balise = front - self._spacing * math.floor(front / self._spacing)
        return self._track.evaluate(front, motion_estimate(speed, acceleration, since_balise)).warning

    def grid(self, profile: Profile) -> Array:
        """Return the compared places of the front of a profile [m]."""
        first, last = float(profile.position[0]) + self._half, float(profile.position[-1]) + self._half
        step = max(MIN_PLACE_STEP, (last - first) / MAX_PLACES)
        return np.linspace(first, last, max(2, math.ceil((last - first) / step) + 1))


def profile_within(ceiling: SpeedCeiling, first: Profile, plan: Callable[[tuple[Array, Array]], Profile]) -> Profile:
    """Return a planned profile below the ceiling, the first one if it is.

    Parameters
    ----------
    ceiling
        Comparison with the limits of the supervisor.
    first
        Profile without a ceiling.
    plan
        Function of places [m] and speeds [m/s] of a ceiling that returns the profile below it.

    Raises
    ------
    ValueError
        If no profile is below the ceiling; one line: place, reason; fix.
    """
    places = ceiling.grid(first)
    speeds, excess = ceiling.excess(first, places)
    if not (excess > 0.0).any():
        return first
    lowest = speeds
    for _ in range(ROUNDS):
        try:
            profile = plan((places, lowest))
        except ValueError as error:
            raise ValueError(_refusal(places, lowest, str(error))) from None
        speeds, excess = ceiling.excess(profile, places)
        if not (excess > TOLERANCE).any():
            return profile
        lowest = np.minimum(lowest, speeds) - _around(excess, places, speeds)
        lowest = np.maximum(lowest, 0.0)
    raise ValueError(_refusal(places, lowest, f"{ROUNDS} plans exceed it by {KMH * float(excess.max()):.1f} km/h"))


def _around(excess: Array, places: Array, speeds: Array) -> Array:
    """Return the largest excess [m/s] over the distance of the averaging that limits the jerk, at every place.

    The averaging rounds a corner of the ceiling to both sides, so that the plan exceeds it there.
    """
    found = np.zeros(places.size)
    for at in np.flatnonzero(excess > 0.0).tolist():
        near = np.abs(places - places[at]) <= AVERAGING_TIME * speeds[at] + MIN_PLACE_STEP
        found[near] = np.maximum(found[near], excess[at])
    return found


def _refusal(places: Array, ceiling: Array, reason: str) -> str:
    """Return the message for a ceiling [m/s] without a profile below it."""
    at = int(ceiling[:-1].argmin())
    return (
        f"profile.plan: no profile below the limits of the supervisor, which are {KMH * ceiling[at]:.1f} km/h at km "
        f"{places[at] / 1000:.3f}: {reason}; increase supervision.overlap or the emergency brake of the train, or set "
        "supervision.plan_margin: null"
    )
