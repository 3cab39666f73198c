"""Force of the rigid nominal train along the profile, computed once per profile."""

from __future__ import annotations

from array import array
from typing import Protocol

import numpy as np

from plant_sim.railway import between_entries, each_between_entries
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array


class ProfileLike(Protocol):
    """Interface of a speed profile: evenly spaced knots and values at any time."""

    @property
    def time(self) -> Array:
        """Times of the knots [s], evenly spaced."""

    @property
    def position(self) -> Array:
        """Position of vehicle 0's centre [m]."""

    @property
    def velocity(self) -> Array:
        """Speed [m/s]."""

    @property
    def acceleration(self) -> Array:
        """Acceleration [m/s²]."""

    def at(self, t: float) -> tuple[float, float, float, float]:
        """Return position, speed, acceleration and jerk at a time [m, m/s, m/s², m/s³]."""

    def jerk(self) -> Array:
        """Return the jerk between the knots [m/s³]."""

    def window(self, t: float, count: int, period: float) -> tuple[Array, Array, Array]:
        """Return position, speed and acceleration at ``count`` times from ``t`` on, each of shape (count,)."""

    def at_times(self, t: Array) -> tuple[Array, Array, Array]:
        """Return position, speed and acceleration at many times [s], each of the shape of ``t``."""


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
    inertial, resisting : array of float
        Inertial force M a, and running plus line resistance, at the knots of the profile [N].
    begin, spacing : float
        Time of the first knot, and time between knots [s].
    """

    def __init__(self, model: TrainModel, profile: ProfileLike) -> None:
        self.model = model
        self.profile = profile
        inertial = model.inertia * profile.acceleration
        resisting = model.resisting_forces(profile.position, profile.velocity)
        self.inertial, self.resisting = array("d", inertial.tobytes()), array("d", resisting.tobytes())
        self._total = array("d", (inertial + resisting).tobytes())
        self.begin = float(profile.time[0])
        last = len(self._total) - 1
        self.spacing = float(profile.time[-1] - profile.time[0]) / last if last else 1.0

    def total(self, t: float) -> float:
        """Return the total force at a time [s] in N."""
        return float(between_entries(self._total, (t - self.begin) / self.spacing))

    def totals(self, t: Array) -> Array:
        """Return :meth:`total` at many times [s] in N, equal bit for bit."""
        return np.asarray(each_between_entries(np.frombuffer(self._total), (t - self.begin) / self.spacing))

    def aheads(self, t: Array, lag: float) -> Array:
        """Return :meth:`ahead` at many times [s] in N, equal bit for bit."""
        if lag <= 0.0:
            return self.totals(t)
        h = 0.5 * self.spacing
        return self.totals(t) + lag * ((self.totals(t + h) - self.totals(t - h)) / self.spacing)

    def resistances(self, t: Array) -> Array:
        """Return :meth:`resistance` at many times [s] in N."""
        return np.asarray(each_between_entries(np.frombuffer(self.resisting), (t - self.begin) / self.spacing))

    def resistance(self, t: float) -> float:
        """Return running and line resistance at a time [s] in N."""
        return float(between_entries(self.resisting, (t - self.begin) / self.spacing))

    def slope(self, t: float) -> float:
        """Return the central difference quotient of :meth:`total` at a time [s] in N/s."""
        h = 0.5 * self.spacing
        return (self.total(t + h) - self.total(t - h)) / self.spacing

    def ahead(self, t: float, lag: float) -> float:
        """Return the demand F + lag F' that gives :meth:`total` at a time [s] through a first-order lag [s], in N."""
        return self.total(t) if lag <= 0.0 else self.total(t) + lag * self.slope(t)
