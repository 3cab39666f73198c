"""Contract tests: those that laws, observers and compensations share, and those of every kind."""

import dataclasses
import math
import time
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any

import numpy as np

from plant_sim.train import compile_kernel
from plant_sim.units import number_text
from train_ato.control.air_brake.policy import BrakeEvent, BrakeSpec, make_brake_policy
from train_ato.control.compensation.contract import CompensationInput
from train_ato.control.contract import LawInput, Preview
from train_ato.control.guard import invalid_inputs, is_valid
from train_ato.control.laws.pid import Pid
from train_ato.control.observers.contract import ObserverInput
from train_ato.messages.types import Array
from train_ato.messages.validity import MAX_FORCE, MAX_POSITION, MAX_SPEED
from train_ato.studies.check_component.trains import PERIOD, Bench, CoupledTrain, RigidTrain, TrainSample

HOSTILE = (math.nan, math.inf, -math.inf, 1e300, -1e300, 1e18)
SPEED_ERRORS = (0.0, -5.0, 5.0, 0.3)
"""Speed errors of valid inputs [m/s]."""
STEPS = 200
"""Number of steps of a comparison."""
TIMING_BUDGET = 3.0
"""Largest time for the timing of one component on one train [s]."""
TOO_SLOW = "slower than the control period"
"""First words of the detail of a failed timing."""


class Rig:
    """Inputs and outputs of one kind of component on one train.

    Parameters
    ----------
    name
        Name of the train.
    delay, lag
        Delay of the commands and lag of the actuators [s].

    Attributes
    ----------
    guaranteed
        Inputs that the loop guarantees to be valid.
    """

    guaranteed: tuple[str, ...]

    def __init__(self, name: str, delay: float = 0.0, lag: float = 0.0) -> None:
        self.name = name
        self.bench = Bench(name, delay, lag)
        self.model = self.bench.model

    def prepare(self, component: Any) -> None:
        """Apply the settings of a new component; by default it is ready after its constructor."""

    def inputs(self, step: int, component: Any, speed_error: float = 0.0) -> Any:
        """Return a valid input of a step, with a speed error [m/s]."""

    def outputs(self, component: Any, steps: int) -> Array:
        """Return the outputs on a simulated train, shape (steps, values)."""
        raise NotImplementedError

    def fault(self, output: Any, given: Any) -> str:
        """Return the fault of an output for a valid input; empty for none."""
        raise NotImplementedError

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


def tests_with(valid: str, own: dict[str, Test]) -> dict[str, Test]:
    """Return the tests of a kind in their order: those of all kinds, with the name of the valid output, and its own."""
    return {
        "time of a step": timing, "same inputs, same bits": determinism, valid: valid_output,
        "reset forgets everything": reset, "leaves its inputs alone": untouched, "hostile inputs": hostile, **own,
    }  # fmt: skip


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
    changes = {}
    for entry in dataclasses.fields(record):
        value = getattr(record, entry.name)
        if isinstance(value, np.ndarray):
            changes[entry.name] = np.array(value)
        elif dataclasses.is_dataclass(value):
            changes[entry.name] = writable(value)
    return dataclasses.replace(record, **changes)


LAST = 100
"""Number of steps at the end of a run of which the mean estimate is compared."""
TOLERANCE = 0.2
"""Largest relative error of an estimate that counts as found."""


class ObserverRig(Rig):
    """An observer on one train, driven by `pid` against a constant disturbance."""

    guaranteed = ("t", "shoe_force", "train_shoe_force")

    def __init__(self, name: str) -> None:
        super().__init__(name, lag=LAG)
        self.disturbance = -0.5 * self.bench.moderate_acceleration() * self.model.inertia

    @cached_property
    def recorded(self) -> list[ObserverInput]:
        """Inputs of a run of one minute."""
        law = Pid(Pid.Parameters(), self.model, PERIOD)
        train = RigidTrain(self.model, *self.bench.profile.at(0.0)[:2], self.disturbance)
        samples = self.bench.samples(law, train=train)
        return [ObserverInput.of(sample.state.measurement) for sample in samples]

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


OBSERVER_TESTS = tests_with(
    "finite estimate of every unit", {"finds a constant disturbance": _convergence, "recovers after NaN": _recovery}
)


class LawRig(Rig):
    """A law on one train."""

    guaranteed = ("force_min", "force_max")

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


def _law_recovery(make: Make, rig: LawRig) -> tuple[bool, str]:
    _, errors = rig.bench.drive(make())
    forces, spoilt = rig.bench.drive(make(), spoil=range(200, 205))
    if not np.isfinite(forces).all():
        return False, "the force is not finite"
    usual, after = np.abs(errors[-100:]).max(), np.abs(spoilt[-100:]).max()
    detail = f"speed error at the end {after:.3g} m/s, undisturbed {usual:.3g}"
    return bool(after <= max(2.0 * usual, 0.05)), detail


LAW_TESTS = tests_with("finite and inside the limits", {"recovers after NaN": _law_recovery})

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
ARRAYS = tuple(entry.name for entry in dataclasses.fields(LawInput) if entry.type == "Array")
"""Inputs of the law that are arrays."""
PREVIEWS = tuple(f"preview.{entry.name}" for entry in dataclasses.fields(Preview))
PASSED_ON = ("disturbance", "force_min", "force_max")
"""Inputs that the law receives unchanged."""


class PreviewPid(Pid):
    """`pid` with a preview, so that the tests include it."""

    horizon = HORIZON


class CompensationRig(Rig):
    """A compensation on one train, with `pid` as law.

    Parameters
    ----------
    name, delay, lag
        As for :class:`Rig`.
    brake
        Use of the air brake, if there is one.
    """

    guaranteed = ("pressure", "force_min", "force_max", "saturated")

    def __init__(self, name: str, delay: float = DELAY, lag: float = LAG, brake: BrakeSpec = BRAKING) -> None:
        compile_kernel()  # as before a run: a simulated train inside a compensation uses the kernel
        super().__init__(name, delay, lag)
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


COMPENSATION_TESTS = tests_with(
    "valid input of the law", {"no effect without delay": _without_delay, "the law controls the train": _control}
)
