"""Laws as arrays of their compiled steps, and back."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from plant_sim.record import zeros
from train_ato.control.algorithms.couplers import UnitCouplers
from train_ato.control.algorithms.guard import GuardedLaw
from train_ato.control.compiled import laws as c
from train_ato.control.compiled.law_call import NO_CALL, LawCall
from train_ato.control.law import LawUnit, RecordLaw
from train_ato.control.laws.funnel import (
    A1,
    A2,
    BETA1,
    FILTER_STEP,
    GAMMA_M,
    IOTA,
    MAX_FUNNEL,
    P1,
    Funnel,
)
from train_ato.messages.types import Array


class RecordStep:
    """Law over records in the compiled loop, with the interface of :class:`CompiledLaw`.

    Parameters
    ----------
    law
        The law; the loop changes its records.
    """

    number = c.CALLED

    def __init__(self, law: RecordLaw) -> None:
        self._law, self.constant, self.couplers = law, law.constants, law.couplers
        self.call = LawCall(lambda *_: law.form.step(law.constants, law.state, law.now, law.units), law.form.entry)
        self.uses_shoes = law.couplers is not None or law.uses_train_forces
        self.uses_effect = law.uses_effect

    def state(self) -> Any:
        """Return the state of the law."""
        return self._law.state

    def inputs(self, units: int) -> Any:
        """Return the inputs of the law."""
        return self._law.units

    def take_state(self, state: Any, inputs: Any) -> None:
        """Do nothing: the law has its state."""


class CompiledLaw:
    """Constants and state of a law as arrays; the law keeps its state between the compiled spans.

    Parameters
    ----------
    law
        Law with a compiled step.

    Attributes
    ----------
    number : int
        Number of the law in :mod:`train_ato.control.compiled.laws`.
    constant : Array
        Constants of the law.
    couplers : UnitCouplers or None
        Couplers beside the units, of a law that uses their forces.
    call : LawCall
        Call of a law in Python, unused.
    """

    def __init__(self, law: GuardedLaw) -> None:
        self._law = law
        self.number, constant = next((number, make) for kind, number, make in _FORMS if kind is type(law))
        self.constant = constant(law)
        self.call = NO_CALL
        self.couplers: UnitCouplers | None = None

    @property
    def uses_shoes(self) -> bool:
        """Return True if the law uses the forecast of the shoe forces by itself, beside the feed-forward."""
        own = self.number == c.FUNNEL and bool(self.constant[c.F_USES_MODEL])
        return self.couplers is not None or own

    @property
    def uses_effect(self) -> bool:
        """Return True if the law uses the profile at the effect of the command, beside the feed-forward."""
        return self.couplers is not None

    def state(self) -> Array:
        """Return the present state of the law."""
        law: Any = self._law
        return _funnel_state(law)

    def inputs(self, units: int) -> Any:
        """Return the array of the inputs of a span, with shares, limits reached and last forces of the law."""
        inputs, law = zeros(LawUnit, units), self._law
        inputs["share"], inputs["saturated"], inputs["force"] = law.share, law.saturated, law._last_force
        return inputs

    def take_state(self, state: Array, inputs: Any) -> None:
        """Set the state of the law after the last inputs."""
        law: Any = self._law
        law.saturated, law._last_force = inputs["saturated"].tolist(), inputs["force"].tolist()
        values = state.tolist()
        _take_funnel_state(law, values)


LawStep = CompiledLaw | RecordStep


def has_compiled_step(law: Any) -> bool:
    """Return True for a law with a compiled step for its parameters."""
    if isinstance(law, RecordLaw):
        return law.in_loop and type(law).step is _RECORD_STEP
    return _STEPS.get(type(law)) is type(law).step


def _funnel_constants(law: Funnel) -> Array:
    p = law.parameters
    constant = np.zeros(c.FUNNEL_CONSTANTS)
    values = {
        c.F_PRINTED: law._printed, c.F_K10: law._k10, c.F_K20: law._k20, c.F_BETA2: law._beta2, c.F_LEAK: law._leak,
        c.F_DECAY: law._decay, c.F_CHARGE: law._charge, c.F_CLIP: law._clip, c.F_NEGATIVE: law._negative_gains,
        c.F_NARROW: law._narrow, c.F_INERTIA: law.model.inertia, c.F_PERIOD: law.period,
        c.F_DELAY_STATE: law._uses_delay_state, c.F_GAMMA_W: p.gamma_w, c.F_BIAS_RATE: p.bias_rate,
        c.F_WEIGHT_LIMIT: p.weight_limit, c.F_FIXED: p.funnel == "fixed", c.F_DYNAMIC: p.funnel == "dynamic",
        c.F_PRINTED_KAPPA: p.kappa == "printed", c.F_DELTA: p.delta, c.F_WIDTH: law._width, c.F_TWO: 2.0,
        c.F_CENTRES: p.rbf_centers, c.F_A1: A1, c.F_A2: A2, c.F_BETA1: BETA1, c.F_P1: P1,
        c.F_MAX_FUNNEL: MAX_FUNNEL, c.F_IOTA: IOTA, c.F_GAMMA_M: GAMMA_M,
        c.F_FEEDFORWARD: p.feedforward, c.F_USES_MODEL: p.resistance != "network" and not p.feedforward,
        c.F_USES_NETWORK: p.resistance != "model", c.F_C0: law.model.running[0],
        c.F_C1: law.model.running[1], c.F_C2: law.model.running[2],
        c.F_FILTER_STEPS: max(1, math.ceil(law.period / FILTER_STEP - 1e-9)),
    }  # fmt: skip
    constant[list(values)] = list(values.values())
    return constant


def _funnel_state(law: Any) -> Array:
    room, weights = law._excess.maxlen, law._weights.values
    head = [
        law._bias, law.phi1, law.phi2, law._h, law._bound, law._t, float(law._alpha is not None), law._alpha or 0.0,
        float(law._wanted is not None), law._wanted or 0.0, float(len(law._excess)), float(room),
    ]  # fmt: skip
    return np.array([*head, *weights, *law._excess, *[0.0] * (room - len(law._excess))])


def _take_funnel_state(law: Any, values: list[float]) -> None:
    law._bias, law.phi1, law.phi2, law._h, law._bound, law._t = values[: c.H_HAS_ALPHA]
    law._alpha = values[c.H_ALPHA] if values[c.H_HAS_ALPHA] else None
    law._wanted = values[c.H_WANTED] if values[c.H_HAS_WANTED] else None
    excess = c.H_WEIGHTS + len(law._weights.values)
    law._weights.values[:] = values[c.H_WEIGHTS : excess]
    count = int(values[c.H_EXCESS_COUNT])
    law._excess = deque(values[excess : excess + count], maxlen=law._excess.maxlen)


_FORMS: tuple[tuple[Any, int, Callable[[Any], Array]], ...] = ((Funnel, c.FUNNEL, _funnel_constants),)
"""Laws with a compiled step, their numbers and their constants."""
_RECORD_STEP = RecordLaw.step
_STEPS = {kind: kind.step for kind, _, _ in _FORMS}
"""Steps with a compiled form: a step that a program replaces at run time has none."""
