"""Planned profile within the limits of the supervisor.

A plan brakes with the service deceleration. The braking curves of the supervisor have the guaranteed deceleration of
the emergency brake, which on a falling grade can be much smaller. Where the planned speed comes near the warning speed,
the plan gets a lower speed limit and is made again. A plan that is far enough away does not change.
"""

import math
from collections.abc import Callable

import numpy as np

from plant_sim.units import KMH
from train_ato.messages.types import Array
from train_ato.profile.profile import Profile
from train_ato.supervision.odometry import motion_estimate
from train_ato.supervision.track_supervision import TrackSupervision

MIN_PLACE_STEP, MAX_PLACES = 5.0, 4000
"""Distance of the compared places [m], and their largest number, beyond which the distance is longer."""
ROUNDS = 8
"""Largest number of plans with a lower ceiling."""
AVERAGING_TIME = 1.0
"""Time by which a ceiling holds earlier; half the averaging of the jerk limit is 0.8 s with the default limits [s]."""
HOLD_TIME = 20.0
"""Time over which a plan that accelerated towards a braking curve keeps its speed [s]."""
NEXT_TARGET = 0.5
"""Rise of the ceiling behind a target [m/s]."""
SMALL_RISE = 1.5
"""Rise of the ceiling that a plan does not use if it ends within ``HOLD_TIME``, as behind a balise [m/s]."""
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

    def compare(self, profile: Profile, places: Array) -> tuple[Array, Array, Array]:
        """Return two ceilings at places of the front, and the excess of a profile over the second one [m/s].

        The first ceiling is the warning speed without an acceleration, minus the margin. The second one has the
        acceleration of the profile in the warning speed, and less the rise of the speed over the reaction time.

        Parameters
        ----------
        profile
            Profile of vehicle 0's centre.
        places : Array, shape (n,)
            Increasing places of the front [m].
        """
        front = profile.position + self._half
        speed = np.interp(places, front, profile.velocity)
        acceleration = np.maximum(np.interp(places, front, profile.acceleration), 0.0)
        rows = list(zip(places.tolist(), speed.tolist(), acceleration.tolist(), strict=True))
        steady = np.array([self._warning(place, v, 0.0) for place, v, _ in rows]) - self._margin
        moving = steady.copy()
        for k, (place, v, a) in enumerate(rows):
            if a > 0.0:
                moving[k] = self._warning(place, v, a) - self._margin - self._reaction * a
        steady, moving = np.maximum(steady, 0.0), np.maximum(moving, 0.0)
        return steady, moving, np.where(speed > 0.0, speed - moving, 0.0)

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
    profile, lowest, further, allowed = first, np.full(places.size, np.inf), 0.0, 0.0
    for _ in range(ROUNDS):
        steady, moving, excess = ceiling.compare(profile, places)
        if not (excess > allowed).any():
            return profile
        if profile is not first:
            further += float(np.where(moving < steady, 0.0, np.maximum(excess, 0.0)).max())
        held = np.where((excess > 0.0) & (moving < steady), moving, np.inf)
        if profile is not first:  # the averaging of the jerk limit rounds a corner upwards
            held = np.where(excess > 0.0, np.minimum(held, lowest) - excess, held)
        lowest = np.minimum(lowest, _lowered(places, np.maximum(steady - further, 0.0), np.maximum(held, 0.0)))
        allowed = TOLERANCE
        try:
            profile = plan((places, lowest))
        except ValueError as error:
            raise ValueError(_refusal(places, lowest, str(error))) from None
    raise ValueError(_refusal(places, lowest, f"{ROUNDS} plans exceed it by {KMH * float(excess.max()):.1f} km/h"))


def _lowered(places: Array, steady: Array, held: Array) -> Array:
    """Return the speed limit of the next plan [m/s] from the ceiling and the speeds to hold, infinite without one.

    A plan that accelerates towards a braking curve keeps its speed instead, up to the curve; a lower limit only at the
    places of the acceleration would move it ahead. The limit holds earlier by half the time of the averaging that
    limits the jerk, which rounds the corners of a falling limit upwards. It has no small rise that ends soon.
    """
    limit = steady.copy()
    for at in np.flatnonzero(np.isfinite(held)).tolist():
        near, passed = AVERAGING_TIME * held[at] + MIN_PLACE_STEP, False
        for k in range(int(np.searchsorted(places, places[at] - near)), places.size):
            passed |= k > at and bool(steady[k] > steady[k - 1] + NEXT_TARGET)
            if places[k] - places[at] > (near if passed else HOLD_TIME * held[at]):
                break
            limit[k] = min(limit[k], held[at])
    limit = _without_small_rises(places, limit)
    ahead = places + AVERAGING_TIME * limit
    ends = np.searchsorted(places, ahead, side="right")
    least = np.array([limit[k : max(end, k + 1)].min() for k, end in enumerate(ends.tolist())])
    return np.asarray(np.minimum(least, np.interp(ahead, places, limit)))


def _without_small_rises(places: Array, limit: Array) -> Array:
    """Return a limit [m/s] with a steady deceleration in place of every small rise that ends soon.

    Behind a balise the error of the odometry is small, and the ceiling of a braking train rises. A plan that used this
    would release and apply its brakes within seconds, which makes large coupler forces in a long train.
    """
    square, k = limit**2, 0
    while k < places.size - 1:
        k += 1
        if square[k] <= square[k - 1]:
            continue
        end = int(np.searchsorted(places, places[k - 1] + HOLD_TIME * limit[k - 1], side="right"))
        lower = np.flatnonzero(square[k:end] <= square[k - 1])
        if lower.size and math.sqrt(square[k : k + lower[0]].max()) <= limit[k - 1] + SMALL_RISE:
            ahead = places[k:end] - places[k - 1]
            slope = float(((square[k:end] - square[k - 1]) / ahead).min())
            if k > 1 and square[k - 1] < square[k - 2]:  # no stronger braking ahead of a steeper fall
                slope = max(slope, float((square[k - 1] - square[k - 2]) / (places[k - 1] - places[k - 2])))
            steady = square[k - 1] + slope * ahead
            last = k + int((steady >= square[k:end] - 1e-9).argmax())
            square[k : last + 1] = steady[: last + 1 - k]
            k = last
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def _refusal(places: Array, ceiling: Array, reason: str) -> str:
    """Return the message for a ceiling [m/s] without a profile below it."""
    at = int(ceiling[:-1].argmin())
    return (
        f"profile.plan: no profile below the limits of the supervisor, which are {KMH * ceiling[at]:.1f} km/h at km "
        f"{places[at] / 1000:.3f}: {reason}; increase supervision.overlap or the emergency brake of the train, or set "
        "supervision.plan_margin: null"
    )
