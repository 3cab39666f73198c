"""Contract tests of a disturbance observer."""

import dataclasses
import math
from functools import cached_property
from typing import Any

import numpy as np

from plant_sim.units import number_text
from train_ato.control.laws.pid import Pid
from train_ato.control.observers.contract import ObserverInput
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
    writable,
)
from train_ato.studies.check_component.trains import PERIOD, Bench, RigidTrain

LAG = 0.4
"""Lag of the actuators [s]."""
LAST = 100
"""Number of steps at the end of a run of which the mean estimate is compared."""
COMPUTED = ("t", "shoe_force", "train_shoe_force")
"""Inputs that the loop computes."""
TOLERANCE = 0.2
"""Largest relative error of an estimate that counts as found."""


class ObserverRig:
    """An observer on one train, driven by `pid` against a constant disturbance."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.bench = Bench(name, lag=LAG)
        self.model = self.bench.model
        self.disturbance = -0.5 * self.bench.moderate_acceleration() * self.model.inertia

    @cached_property
    def recorded(self) -> list[ObserverInput]:
        """Inputs of a run of one minute."""
        law = Pid(Pid.Parameters(), self.model, PERIOD)
        train = RigidTrain(self.model, *self.bench.profile.at(0.0)[:2], self.disturbance)
        samples = self.bench.samples(law, train=train)
        return [ObserverInput.of(sample.state.measurement) for sample in samples]

    def prepare(self, observer: Any) -> None:
        """Do nothing: an observer is ready after its constructor."""

    def inputs(self, step: int, observer: Any, speed_error: float = 0.0) -> ObserverInput:
        """Return the input of a step, with a change of the speed [m/s]."""
        given: ObserverInput = writable(self.recorded[step])
        return dataclasses.replace(given, velocity=given.velocity + speed_error)

    def outputs(self, observer: Any, steps: int) -> Array:
        """Return the estimates [N], shape (steps, units)."""
        return self.estimates(observer, self.recorded[:steps])

    def estimates(self, observer: Any, inputs: list[ObserverInput]) -> Array:
        """Return the estimates for the inputs [N], shape (steps, units)."""
        return np.array([np.array(observer.step(writable(given)), dtype=np.float64) for given in inputs])

    def fault(self, output: Any, given: ObserverInput) -> str:
        """Return the fault of an estimate; empty for none."""
        wrong = array_fault("the estimate", output, given.velocity.shape)
        return wrong or ("" if np.isfinite(output).all() else f"not finite: {output}")

    fault_of_hostile = fault

    def hostile_values(self, path: str) -> tuple[float, ...]:
        """Return the invalid values of an input: the loop passes on every measurement."""
        return () if path in COMPUTED else HOSTILE


def _convergence(make: Make, rig: ObserverRig) -> tuple[bool | None, str]:
    """Compare the estimate at the end with the disturbance; fail only if no estimate is better."""
    found = float(rig.estimates(make(), rig.recorded)[-LAST:].sum(axis=1).mean())
    error = abs(found - rig.disturbance) / abs(rig.disturbance)
    stated = f"{number_text(found / 1e3, 3)} kN of {number_text(rig.disturbance / 1e3, 3)} kN"
    detail = f"estimate {stated} after {len(rig.recorded) * PERIOD:g} s"
    if error <= TOLERANCE:
        return True, detail
    if error <= 1.0 + 1e-9:
        return None, f"{detail}: the disturbance is not found"
    return False, f"{detail}: worse than no estimate"


def _recovery(make: Make, rig: ObserverRig) -> tuple[bool, str]:
    """Compare the estimates at the end with and without invalid speeds before."""
    spoilt = list(rig.recorded)
    for step in range(200, 205):
        spoilt[step] = dataclasses.replace(spoilt[step], velocity=spoilt[step].velocity * math.nan)
    usual, after = (rig.estimates(make(), inputs)[-LAST:].sum(axis=1) for inputs in (rig.recorded, spoilt))
    end, undisturbed = (number_text(entry.mean() / 1e3, 3) for entry in (after, usual))
    detail = f"estimate at the end {end} kN, undisturbed {undisturbed} kN"
    return bool(abs(after.mean() - usual.mean()) <= TOLERANCE * abs(rig.disturbance)), detail


OBSERVER_TESTS: dict[str, Test] = {
    "time of a step": timing, "same inputs, same bits": determinism, "finite estimate of every unit": valid_output,
    "reset forgets everything": reset, "leaves its inputs alone": untouched, "hostile inputs": hostile,
    "finds a constant disturbance": _convergence, "recovers after NaN": _recovery,
}  # fmt: skip
"""Contract tests, in this order."""
