"""Contract tests of a control law."""

import math
from typing import Any

import numpy as np

from train_ato.control.contract import LawInput
from train_ato.messages.types import Array
from train_ato.studies.check_component.common import (
    HOSTILE,
    Make,
    Test,
    array_fault,
    determinism,
    hostile,
    reset,
    timing,
    untouched,
    valid_output,
)
from train_ato.studies.check_component.trains import Bench


class LawRig:
    """A law on one train."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.bench = Bench(name)
        self.model = self.bench.model

    def prepare(self, law: Any) -> None:
        """Do nothing: a law is ready after its constructor."""

    def inputs(self, step: int, law: Any, speed_error: float = 0.0) -> LawInput:
        """Return the input in a step on the profile, with a speed error [m/s]."""
        return self.bench.on_profile(step, law, speed_error)

    def outputs(self, law: Any, steps: int) -> Array:
        """Return the forces on a simulated train [N], shape (steps, units)."""
        return self.bench.drive(law, steps)[0]

    def fault(self, output: Any, given: LawInput) -> str:
        """Return the fault of an output; empty for none."""
        force = getattr(output, "force", None)
        wrong = array_fault("force", force, given.force_min.shape)
        if wrong or force is None:
            return wrong
        if not np.isfinite(force).all():
            return f"not finite: {force}"
        if (force < given.force_min - 1e-6).any() or (force > given.force_max + 1e-6).any():
            return f"{force} N is outside {given.force_min} ... {given.force_max} N"
        pipe = getattr(output, "brake_pipe", None)
        return "" if pipe is None or math.isfinite(pipe) else f"brake pipe pressure {pipe}"

    fault_of_hostile = fault

    def hostile_values(self, path: str) -> tuple[float, ...]:
        """Return the invalid values of an input; limits are not varied, because the loop always computes valid ones."""
        return () if path in ("force_min", "force_max") else HOSTILE


def _recovery(make: Make, rig: LawRig) -> tuple[bool, str]:
    _, errors = rig.bench.drive(make())
    forces, spoilt = rig.bench.drive(make(), spoil=range(200, 205))
    if not np.isfinite(forces).all():
        return False, "the force is not finite"
    usual, after = np.abs(errors[-100:]).max(), np.abs(spoilt[-100:]).max()
    detail = f"speed error at the end {after:.3g} m/s, undisturbed {usual:.3g}"
    return bool(after <= max(2.0 * usual, 0.05)), detail


LAW_TESTS: dict[str, Test] = {
    "time of a step": timing, "same inputs, same bits": determinism, "finite and inside the limits": valid_output,
    "reset forgets everything": reset, "leaves its inputs alone": untouched, "hostile inputs": hostile,
    "recovers after NaN": _recovery,
}  # fmt: skip
"""Contract tests, in this order."""
