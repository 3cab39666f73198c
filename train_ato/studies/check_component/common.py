"""Contract tests that laws, observers and compensations share."""

import dataclasses
import math
import time
from collections.abc import Callable, Iterator
from typing import Any, Protocol

import numpy as np

from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array
from train_ato.studies.check_component.trains import PERIOD

HOSTILE = (math.nan, math.inf, -math.inf, 1e300, -1e300, 1e18)
"""Invalid values of an input."""
SPEED_ERRORS = (0.0, -5.0, 5.0, 0.3)
"""Speed errors of valid inputs [m/s]."""
STEPS = 200
"""Number of steps of a comparison."""
TIMING_BUDGET = 3.0
"""Largest time for the timing of one component on one train [s]."""
TOO_SLOW = "slower than the control period"
"""First words of the detail of a failed timing."""


class Rig(Protocol):
    """Inputs and outputs of one kind of component on one train.

    Attributes
    ----------
    name
        Name of the train.
    model
        Its model.
    guaranteed
        Inputs that the loop guarantees to be valid.
    """

    name: str
    model: TrainModel
    guaranteed: tuple[str, ...]

    def prepare(self, component: Any) -> None:
        """Apply the settings of a new component; by default it is ready after its constructor."""

    def inputs(self, step: int, component: Any, speed_error: float = 0.0) -> Any:
        """Return a valid input of a step, with a speed error [m/s]."""

    def outputs(self, component: Any, steps: int) -> Array:
        """Return the outputs on a simulated train, shape (steps, values)."""

    def fault(self, output: Any, given: Any) -> str:
        """Return the fault of an output for a valid input; empty for none."""

    def fault_of_hostile(self, output: Any, given: Any) -> str:
        """Return the fault of an output for an invalid input; empty for none."""
        return self.fault(output, given)

    def hostile_values(self, path: str) -> tuple[float, ...]:
        """Return the values that the loop may give to an input; empty for an input that it guarantees."""
        return () if path in self.guaranteed else HOSTILE


Make = Callable[..., Any]
"""Constructor of new components for the model of the rig, or for the model that is its argument."""
Test = Callable[[Make, Any], tuple[bool | None, str]]
"""A test of new components on a rig: passed, or None for information only, and detail."""


def new(make: Make, rig: Rig) -> Any:
    """Return a new component, ready for the first step."""
    component = make()
    rig.prepare(component)
    return component


def valid_output(make: Make, rig: Rig) -> tuple[bool, str]:
    """Check the outputs for valid inputs."""
    component = new(make, rig)
    for speed_error in SPEED_ERRORS:
        for step in range(50):
            given = rig.inputs(step, component, speed_error)
            wrong = rig.fault(component.step(given), given)
            if wrong:
                return False, f"{speed_error:+g} m/s off: {wrong}"
        component.reset()
    return True, ""


def determinism(make: Make, rig: Rig) -> tuple[bool, str]:
    """Compare the outputs of two new components."""
    first, second = (rig.outputs(new(make, rig), STEPS) for _ in range(2))
    return first.tobytes() == second.tobytes(), ""


def reset(make: Make, rig: Rig) -> tuple[bool, str]:
    """Compare the outputs before and after reset()."""
    component = new(make, rig)
    first = rig.outputs(component, STEPS)
    component.reset()
    rig.prepare(component)
    second = rig.outputs(component, STEPS)
    off = np.flatnonzero((first != second).any(axis=1))
    return off.size == 0, f"the run after reset() differs from step {off[0]} on" if off.size else ""


def untouched(make: Make, rig: Rig) -> tuple[bool, str]:
    """Compare the inputs before and after a step, with writable arrays."""
    component = new(make, rig)
    for step in range(STEPS):
        given = writable(rig.inputs(step, component))
        before = {name: np.array(value) for name, value in numbers_of(given) if isinstance(value, np.ndarray)}
        component.step(given)
        for name, value in numbers_of(given):
            if name in before and not np.array_equal(before[name], value):
                return False, f"changed {name} in step {step}"
    return True, ""


def hostile(make: Make, rig: Rig) -> tuple[bool, str]:
    """Set one input at a time to every invalid value, each followed by a valid step."""
    component = new(make, rig)
    for step in range(20):
        component.step(rig.inputs(step, component))
    valid = rig.inputs(20, component)
    spoilt = 0
    for name, value in numbers_of(valid):
        if not isinstance(value, (float, np.ndarray)) or np.size(value) == 0:
            continue
        for bad in rig.hostile_values(name):
            given = replaced(valid, name, np.full_like(value, bad) if isinstance(value, np.ndarray) else bad)
            spoilt += 1
            wrong = rig.fault_of_hostile(component.step(given), given)
            wrong = wrong or rig.fault(component.step(valid), valid)
            if wrong:
                return False, f"{name} = {bad:g}: {wrong}"
    return True, f"{spoilt} invalid inputs"


def timing(make: Make, rig: Rig) -> tuple[bool | None, str]:
    """Measure the time of up to 300 steps; only a component slower than the control period fails."""
    component = new(make, rig)
    taken: list[float] = []
    for step in range(300):
        given = rig.inputs(step, component)
        begin = time.perf_counter_ns()
        component.step(given)
        if step > 0:  # the first one may compile the component
            taken.append((time.perf_counter_ns() - begin) / 1e3)
        if sum(taken) > TIMING_BUDGET * 1e6:
            break
    median, high = np.percentile(np.array(taken[len(taken) // 6 :]), [50, 99])
    if median > PERIOD * 1e6:
        return (
            False,
            f"{TOO_SLOW} of {PERIOD * 1e3:.0f} ms: median {median / 1e3:.0f} ms, no further test on this train",
        )
    return None, f"median {median:.1f} µs, 99 % below {high:.1f} µs"


def array_fault(name: str, value: Any, shape: tuple[int, ...]) -> str:
    """Return the fault of the type and shape of an array; empty for none."""
    if not isinstance(value, np.ndarray) or value.shape != shape or value.dtype != np.float64:
        return f"{name} is not a float64 array of shape {shape}: {value!r}"
    return ""


def numbers_of(record: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield name and value of every field of a record and of the records in it."""
    for entry in dataclasses.fields(record):
        value, name = getattr(record, entry.name), prefix + entry.name
        if dataclasses.is_dataclass(value):
            yield from numbers_of(value, f"{name}.")
        else:
            yield name, value


def replaced(record: Any, name: str, value: Any) -> Any:
    """Return a record with one field ``a.b`` changed."""
    owner, _, rest = name.partition(".")
    return dataclasses.replace(record, **{owner: replaced(getattr(record, owner), rest, value) if rest else value})


def writable(record: Any) -> Any:
    """Return a copy of a record with writable arrays."""
    for name, value in numbers_of(record):
        if isinstance(value, np.ndarray):
            record = replaced(record, name, np.array(value))
    return record
