"""A law as one compiled function over records, which Python, the nodes and the compiled loop call alike.

The function has the form ``law(p, state, now, units)``. ``p`` has the constants, ``state`` what the law keeps for every
power unit, ``now`` and ``units`` have the inputs; the law writes ``units[u].wanted``. :class:`LawForm` adds the guard:
inputs that are not valid change nothing, demands are finite and inside the limits. :class:`RecordLaw` is the object
with the contract of :class:`train_ato.control.contract.Law`.

Without the compiler (``NUMBA_DISABLE_JIT=1``) the same functions are plain Python, with the same bits.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

from numba import carray, typeof

from plant_sim.compiled import compiled, direct_call
from plant_sim.railway import fading_resistance
from plant_sim.record import dtype_of, fill, quantity, zeros
from train_ato.control.algorithms.couplers import UnitCouplers
from train_ato.control.contract import LawInput, LawOutput
from train_ato.control.guard import (
    GuardedLaw,
    LawNow,
    LawUnit,
    all_within,
    are_valid,
    invalid_inputs,
    limit_demands,
    write_inputs,
)
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array
from train_ato.messages.validity import MAX_POSITION

__all__ = [
    "INVALID", "NOT_FINITE", "STEPPED", "LawForm", "LawNow", "LawUnit", "RecordLaw", "TrainConstants",
    "train_resistance",
]  # fmt: skip


@dataclass(frozen=True)
class TrainConstants:
    """Train as one mass, for the constants of a law."""

    inertia: float = quantity("kg", "mass with rotating masses")
    running_0: float = quantity("N", "running resistance at standstill, before it fades")
    running_1: float = quantity("N s/m", "running resistance per speed")
    running_2: float = quantity("N s²/m²", "running resistance per square of the speed")


@compiled
def train_resistance(p: TrainConstants, now: LawNow, speed: float) -> float:
    """Return running, line and shoe force on the train [N], > 0 retards, at a speed [m/s]."""
    running = fading_resistance(p.running_0, p.running_1, p.running_2, speed)
    return float(running + now.line_force + now.train_shoe_force)


STEPPED, INVALID, NOT_FINITE = range(3)
"""Results of a guarded step."""


class LawForm:
    """The forms in which a law is called.

    Parameters
    ----------
    law
        Compiled function ``law(p, state, now, units)``.
    constants, unit
        Records of its constants and of its state for a unit.

    Attributes
    ----------
    step
        The guarded law, on arrays of records; returns ``STEPPED``, ``INVALID`` or ``NOT_FINITE``.
    entry
        The same for the compiled loop, which is compiled once: all laws have one type there (:mod:`.law_call`).
    """

    def __init__(self, law: Any, constants: type, unit: type) -> None:
        self.constants, self.unit = constants, unit

        @compiled
        def step(p: Any, state: Any, now: Any, units: Any) -> int:
            if not are_valid(now, units):
                return INVALID
            law(p[0], state, now[0], units)
            return STEPPED if limit_demands(units) else NOT_FINITE

        constant_fields, unit_fields = dtype_of(constants), dtype_of(unit)
        now_fields, input_fields = dtype_of(LawNow), dtype_of(LawUnit)

        @compiled
        def entry(tick: Any, p: Any, state: Any, now: Any, units: Any, n: Any, rows: Any) -> int:
            records = carray(now, (1,), now_fields), carray(units, (n,), input_fields)
            own = carray(state, (rows,), unit_fields)
            return int(step(carray(p, (1,), constant_fields), own, records[0], records[1]))

        self.step, self.entry = step, entry

    @cached_property
    def direct(self) -> Any:
        """The guarded law for the records of :func:`plant_sim.record.zeros` only."""
        return direct_call(
            self.step, *(typeof(zeros(kind, 1)) for kind in (self.constants, self.unit, LawNow, LawUnit))
        )


class RecordLaw(GuardedLaw):
    """Base of the laws over records: a subclass gives ``form`` and the values of its constants.

    A subclass with a ``demand()`` of its own is a law in Python, with the guard of :class:`GuardedLaw`.

    Parameters
    ----------
    parameters, model, period
        See :class:`train_ato.control.guard.GuardedLaw`.
    rows
        Number of records of the state; default: one for every unit.

    Attributes
    ----------
    form : LawForm
        The law.
    constants, state, now, units : Records
        Constants, state of every unit, and inputs with the last outputs.
    in_loop : bool
        True if the compiled loop may call the form; a law with a part in Python has False.
    couplers : UnitCouplers or None
        Couplers beside the units, of a law that uses their forces.
    uses_effect : bool
        The law uses acceleration or jerk at the effect, or the delay to it; False allows more compiled ticks.
    uses_train_forces : bool
        The law uses the line force or the shoe force on the train; False saves their computation.
    """

    form: ClassVar[LawForm]
    in_loop: bool = True
    couplers: UnitCouplers | None = None
    uses_effect: bool = True
    uses_train_forces: bool = True

    def __init_subclass__(cls) -> None:
        if "demand" in vars(cls):
            cls.step = GuardedLaw.step  # type: ignore[method-assign]

    def __init__(self, parameters: Any, model: TrainModel, period: float, rows: int | None = None) -> None:
        super().__init__(parameters, model, period)
        self.constants, self.state = zeros(self.form.constants, 1), zeros(self.form.unit, rows or self.n)
        self.now, self.units = self._records
        self._sent = self.units["force"]

    def set_constants(self, **more: float) -> None:
        """Set the constants: the parameters that are numbers, the period, and those that follow from them."""
        c0, c1, c2 = self.model.running
        train = {"inertia": self.model.inertia, "running_0": c0, "running_1": c1, "running_2": c2}
        fill(self.constants, self.parameters, period=self.period, **train, **more)
        self._cleared = self.state.copy()

    def clear_state(self) -> None:
        """Clear the state of the law."""
        self.state[:] = self._cleared

    def on_missed_sample(self) -> None:
        """Handle a missed sample: difference quotients must not bridge it."""
        if "known" in (self.state.dtype.names or ()):
            self.state["known"] = False

    def reset(self) -> None:
        """Clear all state, including the last demand."""
        super().reset()
        self.units["force"], self.units["saturated"] = 0.0, False

    def take_over(self, inputs: LawInput, force: Array) -> None:
        """Begin at the last command [N], shape (units,), in place of 0; laws with integrals set these in addition."""
        super().take_over(inputs, force)
        self.units["force"], self.units["saturated"] = force, False

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force demand of every unit [N] before its limits, for valid inputs."""
        self.units["force"], self.units["saturated"] = self._last_force, self.saturated
        self.call(inputs)
        wanted: list[float] = self.units["wanted"].tolist()
        return wanted

    def call(self, inputs: LawInput) -> int:
        """Step the law: ``STEPPED``, ``INVALID`` or ``NOT_FINITE``; the demands are in ``units``."""
        line_force, units = 0.0, self.units
        inside = (self.couplers is not None or self.uses_train_forces) and all_within(inputs.position, MAX_POSITION)
        if inside and self.uses_train_forces:
            line_force = self.model.line_force(self.model.front(inputs.position))
        if not write_inputs(inputs, self.now, units, line_force):
            return INVALID
        if inside and self.couplers is not None:
            self.couplers.write(inputs.coupler_force, units)
        found: int = self.form.direct(self.constants, self.state, self.now, units)
        return found

    def step(self, inputs: LawInput) -> LawOutput:
        """Return the force demand of every unit [N], finite and inside the limits."""
        found = self.call(inputs)
        if found == STEPPED:
            return LawOutput(self._sent.copy())
        self._last_force = self._sent.tolist()
        if found == INVALID:
            self.on_missed_sample()
            return self._hold(inputs, f"invalid inputs: {', '.join(invalid_inputs(inputs))}")
        self.clear_state()
        return self._hold(inputs, f"computed {str(self.units['wanted'].tolist())[:60]} N")
