"""Shares of the power units by place that lower the coupler forces of a planned run.

A force d more at a power unit, and less at the next one, shifts the forces of all couplers between the two by d, and
leaves the others as they are. The least d that keeps the forces f_j of these couplers within a band +-L is therefore::

    d = min(L - max f_j, 0) + max(-L - min f_j, 0)       if max f_j - min f_j <= 2 L
    d = -(max f_j + min f_j) / 2                         else

f_j is the force of the run with the present shares; it contains grades, brake waves and draft gears. d is averaged over
time, because commands do not damp the waves in the couplers. Unit i gets d_i - d_(i-1) more. Shares are from 0 to 1: no
unit pulls against another one. The couplers behind the last unit do not depend on the shares.
"""

from __future__ import annotations

import numpy as np

from train_ato.control.force_distribution import SharesAt
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array
from train_ato.profile.trip.driven_run import TripRun

SPACING = 200.0
"""Distance between the places of the shares [m]; the search has cells of 100 m."""
WINDOW = 40.0
"""Window of the average of the shifts [s], several periods of the slowest motion between the vehicles."""
BAND = 200e3
"""Coupler force up to which the shares remain [N]: a cycle of this amplitude has a hundredth of the unit damage."""
SMALL_FORCE = 100e3
"""Total force below which the shares approach the former ones [N]."""


def shares_for_run(model: TrainModel, run: TripRun, former: tuple[SharesAt, ...]) -> tuple[SharesAt, ...]:
    """Return the shares by place that centre the coupler forces of a run between the power units.

    Parameters
    ----------
    model
        Nominal train.
    run
        Run of the nominal train with the former shares.
    former
        Shares of the run; empty for the fixed ones of the model.
    """
    moving = np.concatenate(([True], np.diff(run.position) > 0.0))
    position, total = run.position[moving], run.force[moving]
    shift = _averaged(_shifts(model, run.couplers[moving]), max(1, round(WINDOW / run.period)) | 1)
    added = np.diff(shift, axis=1, prepend=0.0, append=0.0)
    moved = added * (total / (total**2 + SMALL_FORCE**2))[:, None]
    base = _rows(model, former, position)
    shares = np.clip(base + moved, 0.0, 1.0)
    shares /= shares.sum(axis=1, keepdims=True)
    places = np.arange(position[0], position[-1], SPACING)
    table = np.stack([np.interp(places, position, column) for column in shares.T], axis=1).round(3)
    return tuple(
        SharesAt(at=at, shares=tuple(row)) for at, row in zip(places.round(1).tolist(), table.tolist(), strict=True)
    )


def _shifts(model: TrainModel, couplers: Array) -> Array:
    """Return the force from every unit to the next one that keeps the band [N], shape (n, units - 1)."""
    shifts = []
    for front, rear in zip(model.units, model.units[1:], strict=False):
        draft, buff = couplers[:, front:rear].max(axis=1), couplers[:, front:rear].min(axis=1)
        needed = np.minimum(BAND - draft, 0.0) + np.maximum(-BAND - buff, 0.0)
        shifts.append(np.where(draft - buff > 2 * BAND, -0.5 * (draft + buff), needed))
    return np.stack(shifts, axis=1)


def _averaged(values: Array, width: int) -> Array:
    """Return the moving average of columns over an odd number of rows."""
    padded = np.pad(values, ((width // 2, width // 2), (0, 0)), mode="edge")
    kernel = np.full(width, 1.0 / width)
    return np.stack([np.convolve(column, kernel, mode="valid") for column in padded.T], axis=1)


def _rows(model: TrainModel, shares: tuple[SharesAt, ...], position: Array) -> Array:
    """Return the shares at positions, shape (n, units)."""
    if not shares:
        return np.tile(model.share, (position.size, 1))
    places = [entry.at for entry in shares]
    table = np.array([entry.shares for entry in shares])
    return np.stack([np.interp(position, places, column) for column in table.T], axis=1)
