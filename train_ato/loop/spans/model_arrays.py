"""Constants of the nominal model as arrays of the compiled ticks."""

from __future__ import annotations

from typing import Any

import numpy as np

from train_ato.control.train_model import GRID
from train_ato.loop.setup import RunSetup
from train_ato.messages.types import Array


def model_arrays(setup: RunSetup) -> tuple[Array, tuple[Array, Array, Array], Array, Any]:
    """Return the constants of the nominal model.

    Returns
    -------
    own : Array, shape (units, 7)
        Constants of every unit's vehicle and of the line, by the names in the kernel.
    tables : tuple of Array
        Line force per mass [N/kg], on the whole train [N], and its learned part per mass [N/kg], empty without one, on
        the grid of the model.
    segments : Array, shape (segments, 4)
        Segments of all envelopes.
    bounds : Array of int, shape (units, 4)
        First segment and end of brake and of traction.
    """
    model = setup.model
    rows = [(*own, model._begin, GRID, offset) for own, offset in zip(model._own, model.offsets.tolist(), strict=True)]
    segments, bounds, end = [np.zeros((0, 4))], [], 0
    for brake, traction in zip(model.brake, model.traction, strict=True):
        middle, last = end + len(brake.rows), end + len(brake.rows) + len(traction.rows)
        segments += [brake.rows, traction.rows]
        bounds.append((end, middle, middle, last))
        end = last
    tables = (np.array(model._specific), np.array(model._total), np.array(model._learned))
    return np.array(rows, dtype=np.float64), tables, np.concatenate(segments), np.array(bounds, dtype=np.int64)
