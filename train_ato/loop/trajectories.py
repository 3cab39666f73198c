"""Profiles and limits as they go over topics, and back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from train_ato.profile.profile import Profile
from train_ato.run_setup import RunSetup
from train_ato.types import (
    Array,
    Trajectory,
)

if TYPE_CHECKING:
    pass


def trajectory_of(profile: Profile, planned: int = 0) -> Trajectory:
    """Return a profile's knots as they go over the topic; ``planned`` is the stamp at which it was made [ns]."""
    time_ns = np.rint(profile.time * 1e9).astype(np.int64)
    return Trajectory(planned, "train", time_ns, profile.position, profile.velocity, profile.acceleration)


def profile_of(trajectory: Trajectory) -> Profile:
    """Return the profile that came over the topic, equal to the sent one bit for bit."""
    seconds: Array = np.asarray(trajectory.time * 1e-9, dtype=np.float64)
    return Profile(seconds, trajectory.position, trajectory.velocity, trajectory.acceleration)


def limits_of(setup: RunSetup) -> Trajectory:
    """Return the line's speed limits as steps over the distance."""
    places: Array = np.array([limit.at for limit in setup.line.speed_limits], dtype=np.float64)
    speeds: Array = np.array([limit.speed for limit in setup.line.speed_limits], dtype=np.float64)
    return Trajectory(0, "limit", np.zeros(places.size, dtype=np.int64), places, speeds, np.zeros(0))
