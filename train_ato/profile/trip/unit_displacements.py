"""Displacements of the power units against the profile in a planned run.

The profile of a train with several power units is the averaged speed of the whole train: the force of a rigid train
along it, M a + R(x, v) + shoes, is the planned force. Vehicle 0 and the other power units move by some metres against
this mean. As a part of the profile, their motion would be multiplied by the mass of the whole train; therefore it is a
table of its own (:mod:`train_ato.control.planned_displacement`).
"""

from __future__ import annotations

import numpy as np

from train_ato.control.planned_displacement import DisplacementAt
from train_ato.profile.profile import Profile
from train_ato.profile.trip.driven_run import TripRun

SPACING = 50.0
"""Distance between the places of the displacements [m]: 3 s at 60 km/h; the couplings move with periods above 30 s."""


def displacements_for_run(run: TripRun, profile: Profile, until: float) -> tuple[DisplacementAt, ...]:
    """Return the displacements of the power units against a profile by place; 0 at its end.

    Parameters
    ----------
    run
        Run of the nominal train.
    profile
        Profile made from it.
    until
        Time from which the profile is not that of the run [s].
    """
    inside = run.time <= until
    moved = run.units[inside] - profile.at_times(run.time[inside])[0][:, None]
    position = np.maximum.accumulate(run.position[inside])
    places = np.append(np.arange(position[0], position[-1], SPACING), profile.position[-1])
    table = np.stack([np.interp(places, position, column) for column in moved.T], axis=1).round(3)
    table[-1] = 0.0  # at the stop only the place of vehicle 0 counts, and the forces of the couplers are small
    return tuple(
        DisplacementAt(at=at, displacement=tuple(row))
        for at, row in zip(places.round(1).tolist(), table.tolist(), strict=True)
    )
