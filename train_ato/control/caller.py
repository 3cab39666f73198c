"""Law of :class:`train_ato.Env`: the caller of the environment gives the force of every step."""

import base64
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import carray

from plant_sim.compiled import compiled
from plant_sim.record import dtype_of, zeros
from train_ato.control.contract import LawInput, LawOutput, parameter
from train_ato.control.law import STEPPED, LawUnit
from train_ato.control.law_call import LawCall
from train_ato.messages.types import Array

NAME = "train_ato.control.caller:Caller"
"""Name of this law in a scenario."""


@dataclass
class Caller:
    """Force given by the caller of the environment, or the recorded forces of such a run.

    Attributes
    ----------
    force : Array, shape (units,), or None
        Force demand of every unit in the next step [N].
    """

    forces: str = parameter("", "", 0.0, 0.0, "recorded forces of all steps, see forces_text(); empty: from the caller")

    def __post_init__(self) -> None:
        """Begin without a force of a caller."""
        self.force: Array | None = None

    def bind(self, model: Any, period: float) -> None:
        """Take the number of units and the control period [s]."""
        self.model, self._period, self._recorded = model, period, _forces_of(self.forces, model.n_units)

    def reset(self) -> None:
        """Keep the force: the caller has already given that of the step in which a law begins after a takeover."""

    def step(self, inputs: LawInput) -> LawOutput:
        """Return the force of the caller, or the recorded one."""
        if self.force is not None:
            return LawOutput(self.force)
        step = round(inputs.t / self._period)
        if step >= len(self._recorded):
            raise ValueError(f"no force at {inputs.t:g} s: the law is the caller of train_ato.Env; choose another law")
        return LawOutput(self._recorded[step])


_UNIT = dtype_of(LawUnit)


@compiled
def _entry(tick, p, state, now, units, n, rows):  # type: ignore[no-untyped-def]
    """Demand the force of the caller: ``state`` has that of every unit."""
    own, force = carray(units, (n,), _UNIT), carray(state, (n,), np.float64)
    for unit in range(n):
        own[unit].wanted = force[unit]
    return STEPPED


class CallerStep:
    """Force of the caller in the compiled loop, with the attributes of a step over records.

    Parameters
    ----------
    law
        The law; ``force`` is read at every step.
    """

    whole, couplers, uses_shoes, uses_effect = False, None, False, False

    def __init__(self, law: Caller) -> None:
        assert law.force is not None
        self.constant, self.state, self.units = np.zeros(0), law.force, zeros(LawUnit, law.model.n_units)
        self.units["share"] = law.model.share
        self.call = LawCall(self._take, _entry)

    def _take(self, *_: Any) -> int:
        self.units["wanted"] = self.state
        return STEPPED


def forces_text(forces: Sequence[Array]) -> str:
    """Return the forces of all steps as text of a scenario: their bytes (float64, step by step), zlib, base64."""
    return base64.b64encode(zlib.compress(np.array(forces, dtype="<f8").tobytes())).decode("ascii")


def _forces_of(text: str, units: int) -> Array:
    try:
        found = np.frombuffer(zlib.decompress(base64.b64decode(text, validate=True)) if text else b"", dtype="<f8")
        return found.astype(np.float64).reshape(-1, units)
    except (ValueError, zlib.error) as error:
        raise ValueError(f"forces: not the recorded forces of {units} units ({error}); record the run again") from None
