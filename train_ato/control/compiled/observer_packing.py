"""Observers as arrays of their compiled steps, and back."""

from __future__ import annotations

from typing import Any

import numpy as np

from train_ato.control.algorithms.couplers import UnitCouplers
from train_ato.control.compiled import observers as c
from train_ato.control.compiled.entries import TRAIN_ENTRIES
from train_ato.control.compiled.train_packing import train_constants
from train_ato.control.observers.cascade import Cascade, ExplicitCascade, ImplicitCascade, LevantCascade
from train_ato.control.observers.cascaded import Cascaded
from train_ato.control.observers.eso import Eso
from train_ato.control.observers.force_balance import BalanceState, ForceBalance
from train_ato.control.observers.ndo import Ndo
from train_ato.control.observers.none import NoObserver
from train_ato.messages.types import Array

_STEPS = {kind: kind.step for kind in (NoObserver, Eso, Ndo, Cascaded)}
"""Steps with a compiled form: a step that a program replaces at run time has none."""


def has_compiled_observer(observer: Any) -> bool:
    """Return True for an observer with a compiled step."""
    return _STEPS.get(type(observer)) is type(observer).step


class CompiledObserver:
    """Constants and state of an observer as arrays; the observer keeps its state between the compiled spans.

    Parameters
    ----------
    observer
        Observer with a compiled step.

    Attributes
    ----------
    number : int
        Number of the observer in :mod:`train_ato.control.compiled.observers`.
    constant : Array
        Constants of the observer.
    couplers : UnitCouplers or None
        Couplers of the balance of every unit's vehicle; None without this balance.
    """

    def __init__(self, observer: Any) -> None:
        self._observer = observer
        self.number, self.constant = c.NO_OBSERVER, np.zeros(0)
        self.couplers: UnitCouplers | None = None
        if type(observer) is NoObserver:
            return
        balance: ForceBalance = observer._balance
        constant = np.zeros(c.O_MASS + len(balance._mass))
        constant[:TRAIN_ENTRIES] = train_constants(observer.model)
        constant[[c.O_WHOLE_TRAIN, c.O_MODEL_FACTOR, c.O_WEIGHT, c.O_PERIOD]] = (
            balance.whole_train, balance._model_factor, balance._weight, observer.period,
        )  # fmt: skip
        constant[c.O_MASS :] = balance._mass
        self.constant = constant
        self.couplers = None if balance.whole_train else balance._couplers
        if type(observer) is Eso:
            self.number, vehicle = c.ESO, observer._vehicles[0]
            constant[[c.E_GAIN, c.E_RATE_GAIN]] = vehicle._gain, vehicle._rate_gain
        elif type(observer) is Ndo:
            self.number = c.NDO
            constant[c.N_DECAY] = observer._decay
        else:
            self.number = _cascade_constants(observer, constant)

    def state(self) -> Array:
        """Return the present state of the observer."""
        if self.number == c.NO_OBSERVER:
            return np.zeros(0)
        observer: Any = self._observer
        before, bodies = observer._before, observer._balance.count
        rows = [(0.0, 0.0, 0.0)] * bodies if before is None else before
        own: list[tuple[float, ...]]
        if self.number == c.ESO:
            own = [(v._value is not None, v._value or 0.0, v.unknown_rate) for v in observer._vehicles]
        elif self.number == c.NDO:
            own = [(value,) for value in observer._filtered]
        else:
            own = [_cascade_state(cascade) for cascade in observer.cascades]
        return np.array([float(before is not None), *np.ravel(rows), *np.ravel(own)], dtype=np.float64)

    def take_state(self, state: Array, last: list[float]) -> None:
        """Set the state of the observer and its last estimate [N] of every unit."""
        if self.number == c.NO_OBSERVER:
            return
        observer: Any = self._observer
        bodies, first = observer._balance.count, 1 + c.BALANCE_ENTRIES * observer._balance.count
        rows = state[1:first].reshape(bodies, -1).tolist()
        observer._before = [BalanceState(*row) for row in rows] if state[0] else None
        observer._last_estimate = list(last)
        own = state[first:].reshape(bodies, -1).tolist()
        if self.number == c.ESO:
            for vehicle, (known, value, rate) in zip(observer._vehicles, own, strict=True):
                vehicle._value, vehicle.unknown_rate = value if known else None, rate
        elif self.number == c.NDO:
            observer._filtered = [value for (value,) in own]
        else:
            for cascade, values in zip(observer.cascades, own, strict=True):
                _take_cascade_state(cascade, values)


def _cascade_constants(observer: Cascaded, constant: Array) -> int:
    """Write the constants of the cascades; return the number of the observer."""
    cascade: Any = observer.cascades[0]
    constant[c.C_UNMATCHED] = 1.0 if observer._unmatched else 0.0
    if type(cascade) is LevantCascade:
        h, l1, l2 = cascade._period, cascade._l1, cascade._l2
        scale = l1 ** (1.0 / 3.0)
        values = {
            c.V_BOUND: l2, c.V_TWO_THIRDS: 2.0 / 3.0, c.V_THIRD: 1.0 / 3.0,
            c.V_LAYER: l1 * h**3, c.V_FAST_LAYER: l2 * h * h, c.V_PLACE_GAIN: h * 2.0 * scale,
            c.V_OFFSET_GAIN: h * 2.12 * scale**2, c.V_RATE_GAIN: h * 1.1 * l1, c.V_SPEED_GAIN: h * 1.5,
            c.V_DISTURBANCE_GAIN: h * 1.1 * l2,
        }  # fmt: skip
        constant[list(values)] = list(values.values())
        return c.CASCADED_LEVANT
    gains = (cascade._k1, cascade._k2, cascade._k3, cascade._k4, cascade._decay)
    constant[[c.C_K1, c.C_K2, c.C_K3, c.C_K4, c.C_DECAY]] = gains
    assert type(cascade) in (ExplicitCascade, ImplicitCascade)
    return c.CASCADED_IMPLICIT if type(cascade) is ImplicitCascade else c.CASCADED_EXPLICIT


def _cascade_state(cascade: Any) -> tuple[float, ...]:
    last = getattr(cascade, "_measured", 0.0) if type(cascade) is LevantCascade else cascade._offset
    head = (float(cascade._x is not None), cascade._x or 0.0, cascade._v)
    return (*head, cascade.d1, cascade.d1_rate, cascade.d2, last)


def _take_cascade_state(cascade: Cascade, values: list[float]) -> None:
    known, x, cascade._v, cascade.d1, cascade.d1_rate, cascade.d2, last = values
    cascade._x = x if known else None
    if isinstance(cascade, LevantCascade):
        cascade._measured = last
    elif isinstance(cascade, ExplicitCascade):
        cascade._offset = last
