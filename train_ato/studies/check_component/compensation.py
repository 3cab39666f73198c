"""Contract tests of a delay compensation."""

import dataclasses
from typing import Any

import numpy as np

from plant_sim.train import compile_kernel
from train_ato.control.air_brake.policy import BrakeEvent, BrakeSpec, make_brake_policy
from train_ato.control.compensation.contract import CompensationInput
from train_ato.control.contract import LawInput, Preview
from train_ato.control.guard import invalid_inputs, is_valid
from train_ato.control.laws.pid import Pid
from train_ato.messages.types import Array
from train_ato.messages.validity import MAX_FORCE, MAX_POSITION, MAX_SPEED
from train_ato.studies.check_component.common import (
    STEPS,
    Make,
    Rig,
    Test,
    array_fault,
    determinism,
    hostile,
    new,
    numbers_of,
    reset,
    timing,
    untouched,
    valid_output,
)
from train_ato.studies.check_component.trains import PERIOD, Bench, CoupledTrain, TrainSample

DELAY, LAG = 0.5, 0.4
"""Delay of the commands and lag of the actuators [s]."""
CONTROLLED_STEPS = 400
"""Number of steps of a controlled run."""
HORIZON = 5
"""Number of entries of the preview."""
BRAKING = BrakeSpec(
    policy="planned", events=(BrakeEvent(time=5.0, reduction=50e3), BrakeEvent(time=40.0, reduction=0.0))
)
"""Air brake of the tests: one application."""
STATE_TOLERANCE = 1e-6
"""Largest difference of state and reference without delay [m, m/s, m/s²]."""
MAX_MAGNITUDES = {
    "measurement.position": MAX_POSITION, "measurement.velocity": MAX_SPEED, "measurement.applied": MAX_FORCE,
    "disturbance": MAX_FORCE, "commands_in_flight": MAX_FORCE,
}  # fmt: skip
"""Largest magnitude of the inputs that the loop checks before the step, SI."""
COMPUTED = ("pressure", "force_min", "force_max", "saturated")
"""Inputs that the loop computes."""
ARRAYS = tuple(entry.name for entry in dataclasses.fields(LawInput) if entry.type == "Array")
"""Inputs of the law that are arrays."""
PREVIEWS = tuple(f"preview.{entry.name}" for entry in dataclasses.fields(Preview))
"""Arrays of its preview."""
PASSED_ON = ("disturbance", "force_min", "force_max")
"""Inputs that the law receives unchanged."""


class PreviewPid(Pid):
    """`pid` with a preview, so that the tests include it."""

    horizon = HORIZON


class CompensationRig(Rig):
    """A compensation on one train, with `pid` as law.

    Parameters
    ----------
    name
        Name of the consist.
    delay, lag
        Delay of the commands and lag of the actuators [s].
    brake
        Use of the air brake, if there is one.
    """

    guaranteed = COMPUTED

    def __init__(self, name: str, delay: float = DELAY, lag: float = LAG, brake: BrakeSpec = BRAKING) -> None:
        compile_kernel()  # as before a run: a simulated train inside a compensation uses the kernel
        self.name = name
        self.bench = Bench(name, delay, lag)
        self.model = self.bench.model
        self._brake = brake
        self._air_brake = self.model.consist.air_brake is not None

    def prepare(self, compensation: Any) -> None:
        """Set profile and brake policy."""
        compensation.set_profile(self.bench.rigid)
        set_brake_policy = getattr(compensation, "set_brake_policy", None)
        if set_brake_policy is not None:
            set_brake_policy(self._policy())

    def inputs(self, step: int, compensation: Any, speed_error: float = 0.0) -> CompensationInput:
        """Return the input in a step on the profile, with a speed error [m/s]."""
        given = dataclasses.replace(self.bench.state_on_profile(step, speed_error), horizon=HORIZON)
        return dataclasses.replace(given, pressure=self._policy().step(0.0, 0.0, 0.0)) if self._air_brake else given

    def samples(self, compensation: Any, steps: int, *, coupled: bool = False) -> list[TrainSample]:
        """Return the steps of the train, rigid or with its couplers, under `pid`."""
        train = CoupledTrain(self.model, self.bench.profile) if coupled else None
        law, policy = PreviewPid(Pid.Parameters(), self.model, PERIOD), self._policy()

        def pressure(t: float) -> float | None:
            demanded: float = policy.step(t, 0.0, 0.0)
            return demanded if self._air_brake else None

        return list(self.bench.samples(law, steps, compensation=compensation, train=train, pressure=pressure))

    def outputs(self, compensation: Any, steps: int) -> Array:
        """Return the inputs of the law, shape (steps, values)."""
        return np.array([_numbers(sample.given) for sample in self.samples(compensation, steps)])

    def fault(self, output: Any, given: CompensationInput) -> str:
        """Return the fault of an input of the law; empty for none."""
        wrong = self.fault_of_hostile(output, given)
        if wrong:
            return wrong
        if output.t != given.t:
            return f"t is {output.t:g} s for a measurement at {given.t:g} s"
        for name in PASSED_ON:
            if not np.array_equal(getattr(output, name), getattr(given, name)):
                return f"{name} differs from that of the loop"
        return "" if is_valid(output) else f"invalid values: {', '.join(invalid_inputs(output))}"

    def fault_of_hostile(self, output: Any, given: CompensationInput) -> str:
        """Return the fault of type and shape; the laws check the values."""
        if not isinstance(output, LawInput):
            return f"not a LawInput: {output!r}"
        units, sensors = (self.model.n_units,), (len(self.model.sensors),)
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(("deflection", "rate", "coupler_force"), sensors)
        shapes["commands_in_flight"] = (np.shape(output.commands_in_flight)[0], *units)
        shapes |= dict.fromkeys(PREVIEWS, (given.horizon,))
        values = dict(numbers_of(output))
        faults = (array_fault(name, values.get(name), shapes.get(name, units)) for name in (*ARRAYS, *PREVIEWS))
        return next(filter(None, faults), "")

    def hostile_values(self, path: str) -> tuple[float, ...]:
        """Return the largest values of the inputs that the loop checks, and invalid values of the others."""
        largest = MAX_MAGNITUDES.get(path)
        return super().hostile_values(path) if largest is None else (largest, -largest)

    def _policy(self) -> Any:
        return make_brake_policy(self._brake if self._air_brake else BrakeSpec(), self.model, self.model.line)


def _numbers(given: LawInput) -> Array:
    """Return all values of an input of the law in one array."""
    return np.concatenate([np.ravel(np.asarray(value, dtype=np.float64)) for _, value in numbers_of(given)])


def _without_delay(make: Make, rig: CompensationRig) -> tuple[bool | None, str]:
    """Compare state and reference with the measured ones on a train without delay and lag."""
    ideal = CompensationRig(rig.name, 0.0, 0.0)
    try:
        compensation = make(ideal.model)
    except ValueError as error:
        return None, f"rejected: {error}"
    ideal.prepare(compensation)
    for step, sample in enumerate(ideal.samples(compensation, STEPS)):
        measurement, reference, given = sample.state.measurement, sample.state.reference, sample.given
        expected = {
            "position": measurement.position,
            "velocity": measurement.velocity,
            "reference_position": reference.position - ideal.model.offsets,
            "reference_velocity": reference.velocity,
            "reference_acceleration": reference.acceleration,
            "delay_to_effect": 0.0,
        }
        for name, value in expected.items():
            off = float(np.abs(getattr(given, name) - value).max())
            if not off <= STATE_TOLERANCE:
                return False, f"{name} differs by {off:.3g} in step {step}"
    return True, ""


def _speed_error(rig: CompensationRig, compensation: Any) -> float:
    """Return the rms speed error of vehicle 0 under `pid` [m/s]."""
    errors = [sample.speed_error for sample in rig.samples(compensation, CONTROLLED_STEPS, coupled=True)]
    return float(np.sqrt(np.mean(np.square(errors))))


def _control(make: Make, rig: CompensationRig) -> tuple[bool, str]:
    """Compare the speed error of `pid` with the compensation and without one, on the train with its couplers."""
    released = CompensationRig(rig.name, brake=BrakeSpec())
    found, usual = (_speed_error(released, compensation) for compensation in (new(make, released), None))
    return found <= 2.0 * usual, f"rms speed error of pid {found:.3g} m/s, without compensation {usual:.3g}"


COMPENSATION_TESTS: dict[str, Test] = {
    "time of a step": timing, "same inputs, same bits": determinism, "valid input of the law": valid_output,
    "reset forgets everything": reset, "leaves its inputs alone": untouched, "hostile inputs": hostile,
    "no effect without delay": _without_delay, "the law controls the train": _control,
}  # fmt: skip
"""Contract tests, in this order."""
