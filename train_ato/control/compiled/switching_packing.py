"""Law `rbf_switching_smc` as arrays of its compiled step, and back."""

from __future__ import annotations

import numpy as np

from train_ato.control.algorithms.rbf import RBF_CENTERS
from train_ato.control.compiled import switching as c
from train_ato.control.laws.rbf_switching_smc import RbfSwitchingSmc
from train_ato.messages.types import Array


def switching_constants(law: RbfSwitchingSmc) -> Array:
    """Return the constants of the law."""
    p, network = law.parameters, law._sensitivity[0]
    kind = {"rbf": c.RBF, "tanh": c.TANH, "sign": c.RELAY}[p.switching]
    head = [
        p.c, p.k_w, p.phi, kind, p.width, p.eta, p.alpha, p.weight_limit, p.clip, p.anti_windup, p.identify,
        p.sensitivity == "value", law._literal, law._literal_input, law.period, network._rate, network._weights._bound,
        network.WIDTH, network.MAX_UNEXPLAINED**2, network._reach,
    ]  # fmt: skip
    return np.array([*map(float, head), *RBF_CENTERS, *law._mass])


def switching_state(law: RbfSwitchingSmc) -> Array:
    """Return the present state of the law."""
    values = [float(law._rates is not None)]
    rates = law._rates or [0.0] * law.n
    for own, found, pull, rate in zip(law._control, law._sensitivity, law._pull, rates, strict=True):
        weights = found._weights
        values += [*own.values, *own._moved, *weights.values, *weights._moved]
        values += [*found._before, found._size, found._missing, found.slope, pull, rate]
    return np.array(values)


def take_switching_state(law: RbfSwitchingSmc, values: list[float]) -> None:
    """Set the state of the law."""
    rates, n = [], c.CENTRES
    for unit, (own, found) in enumerate(zip(law._control, law._sensitivity, strict=True)):
        row = values[1 + c.UNIT_ENTRIES * unit : 1 + c.UNIT_ENTRIES * (unit + 1)]
        for weights, first in ((own, c.WEIGHTS), (found._weights, c.FOUND_WEIGHTS)):
            weights.values[:], weights._moved[:] = row[first : first + n], row[first + n : first + 2 * n]
        before, second, found._size, found._missing, found.slope, law._pull[unit], rate = row[c.SINGLE :]
        found._before = (before, second)
        rates.append(rate)
    law._rates = rates if values[0] else None
