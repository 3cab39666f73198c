"""Force that makes the nominal train, taken as rigid, follow the profile: worked out once for the whole profile."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from train_ato.types import Array

if TYPE_CHECKING:
    from train_ato.model import TrainModel


class ProfileLike(Protocol):
    """What is needed of a speed profile: knots at the tick and the value at any time."""

    @property
    def time(self) -> Array:
        """Knots [s], evenly spaced."""

    @property
    def position(self) -> Array:
        """Of vehicle 0's centre [m]."""

    @property
    def velocity(self) -> Array:
        """Speed [m/s]."""

    @property
    def acceleration(self) -> Array:
        """Acceleration [m/s²]."""

    def at(self, t: float) -> tuple[float, float, float, float]:
        """Return position, velocity, acceleration, jerk."""

    def window(self, t: float, count: int, period: float) -> tuple[Array, Array, Array]:
        """Return position, velocity, acceleration at ``count`` times from ``t`` on."""


class RigidForce:
    """Total force of the nominal train along a profile, without the air brake.

    Parameters
    ----------
    model
        The nominal train.
    profile
        The speed profile.

    Attributes
    ----------
    inertial, resisting : list of float
        M a and running plus line resistance at the profile's knots [N].
    """

    def __init__(self, model: TrainModel, profile: ProfileLike) -> None:
        self.model = model
        self.profile = profile
        places, speeds = profile.position.tolist(), profile.velocity.tolist()
        self.inertial: list[float] = (model.inertia * profile.acceleration).tolist()
        self.resisting = [
            model.running_resistance(speed) + model.line_force(place)
            for place, speed in zip(places, speeds, strict=True)
        ]
        self._total: list[float] = np.add(self.inertial, self.resisting).tolist()
        self._begin = float(profile.time[0])
        self._last = len(self._total) - 1
        self._spacing = float(profile.time[-1] - profile.time[0]) / self._last if self._last else 1.0

    def total(self, t: float) -> float:
        """Return the force at ``t`` [N]."""
        return self._between(self._total, t)

    def resistance(self, t: float) -> float:
        """Return running and line resistance at ``t`` [N]."""
        return self._between(self.resisting, t)

    def slope(self, t: float) -> float:
        """Return the rate of :meth:`total` at ``t`` [N/s], over the knots beside it."""
        h = 0.5 * self._spacing
        return (self.total(t + h) - self.total(t - h)) / self._spacing

    def ahead(self, t: float, lag: float) -> float:
        """Return the demand that gives :meth:`total` at ``t`` through a first-order lag [N]: F + lag F'."""
        return self.total(t) if lag <= 0.0 else self.total(t) + lag * self.slope(t)

    def _between(self, table: list[float], t: float) -> float:
        place = (t - self._begin) / self._spacing
        if place <= 0.0:
            return table[0]
        if place >= self._last:
            return table[self._last]
        index = int(place)
        low = table[index]
        return low + (place - index) * (table[index + 1] - low)
