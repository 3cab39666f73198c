"""Compensation `predictor` as arrays of its compiled step."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from train_ato.control.algorithms.force_shares import PAIRWISE, mean_over_units
from train_ato.control.compensation.predictor import Predictor
from train_ato.control.compiled.train_packing import train_constants
from train_ato.messages.types import Array


class PackedPrediction(NamedTuple):
    """Arrays of :func:`train_ato.control.compiled.prediction.predict`; without entries for other compensations."""

    constant: Array
    rows: NDArray[np.int64]
    table: Array


def has_compiled_prediction(compensation: Any, units: int) -> bool:
    """Return True for `predictor` with one rigid mass, known delays independent of the sign, and few units.

    From :data:`~train_ato.control.algorithms.force_shares.PAIRWISE` units on, numpy adds forces in another order.
    """
    if type(compensation) is not Predictor or type(compensation).step is not _STEP or units >= PAIRWISE:
        return False
    known = compensation._estimate is None and compensation.forward == compensation.backward
    return known and compensation._coupled_units is None


_STEP = Predictor.step
"""The step with a compiled form: a step that a program replaces at run time has none."""


def packed_prediction(compensation: Any, oldest: int) -> PackedPrediction:
    """Return the arrays of a compensation, empty for one without a compiled prediction.

    Parameters
    ----------
    compensation
        Delay compensation with a profile.
    oldest
        Number of commands in flight.
    """
    if type(compensation) is not Predictor:
        return PackedPrediction(np.zeros(0), np.zeros((0, 0), dtype=np.int64), np.zeros(0))
    model, rigid = compensation.model, compensation.rigid
    delay = mean_over_units(model.share.tolist(), compensation.forward)
    if delay <= 0.0:
        return PackedPrediction(np.zeros(0), np.zeros((0, model.n_units), dtype=np.int64), np.zeros(0))
    count = max(1, math.ceil(delay / model.tick - 1e-9))
    h = delay / count
    decay = math.exp(-h / model.lag) if model.lag > 0.0 else 0.0
    lasting = (1.0 - decay) * model.lag / h
    own = (h, decay, lasting, float(compensation.parameters.disturbance), rigid._begin, rigid._spacing)
    numbers = np.broadcast_to(np.arange(1.0, oldest + 1)[:, None], (oldest, model.n_units))
    rows = np.rint(compensation._due(numbers, count, h)).astype(np.int64) - 1
    return PackedPrediction(np.array([*train_constants(model), *own]), rows, np.array(rigid.resisting))
