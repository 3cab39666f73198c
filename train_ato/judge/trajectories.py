"""Conversion of profiles and limits to messages and back."""

import numpy as np

from train_ato.messages.types import Array, Trajectory
from train_ato.profile.profile import Profile
from train_ato.scenario.setup import RunSetup


def trajectory_of(profile: Profile, planned: int = 0) -> Trajectory:
    """Return the message of a profile; ``planned`` is the stamp of its planning [ns]."""
    time_ns = np.rint(profile.time * 1e9).astype(np.int64)
    return Trajectory(planned, "train", time_ns, profile.position, profile.velocity, profile.acceleration)


def profile_of(trajectory: Trajectory) -> Profile:
    """Return the profile of a message, bit-identical to the sent one."""
    seconds: Array = np.asarray(trajectory.time * 1e-9, dtype=np.float64)
    return Profile(seconds, trajectory.position, trajectory.velocity, trajectory.acceleration)


def limits_of(setup: RunSetup) -> Trajectory:
    """Return the speed limits of the line as steps over the place."""
    places: Array = np.array([limit.at for limit in setup.line.restricted_limits], dtype=np.float64)
    speeds: Array = np.array([limit.speed for limit in setup.line.restricted_limits], dtype=np.float64)
    return Trajectory(0, "limit", np.zeros(places.size, dtype=np.int64), places, speeds, np.zeros(0))
