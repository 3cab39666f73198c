"""Contract tests of a component: a control law, an observer or a delay compensation.

``check_component("observer", "package.module:Observer")`` runs the component on shipped rigid trains along a profile
of one minute, and with invalid inputs. A component may reject a train by a ValueError with the reason, but not all of
them. The tests of every kind are in :mod:`train_ato.studies.check_component.common`, those of a compensation beside it.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from plant_sim.units import number_text
from train_ato.control.component_fault import text_of_error
from train_ato.control.contract import LawInput, make_parameters, parameters_of
from train_ato.control.gains import has_rule
from train_ato.control.laws.pid import Pid
from train_ato.control.observers.contract import ObserverInput
from train_ato.control.registry import (
    COMPENSATIONS,
    LAWS,
    OBSERVERS,
    Registry,
    in_contract_form,
    load_class,
    preview_fault,
)
from train_ato.messages.types import Array
from train_ato.studies.check_component.common import (
    TOO_SLOW,
    Make,
    Rig,
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
from train_ato.studies.check_component.compensation import COMPENSATION_TESTS, CompensationRig
from train_ato.studies.check_component.random_trips import random_trips, trips_text
from train_ato.studies.check_component.trains import PERIOD, Bench, RigidTrain

LAG = 0.4
"""Lag of the actuators [s]."""
LAST = 100
"""Number of steps at the end of a run of which the mean estimate is compared."""
COMPUTED = ("t", "shoe_force", "train_shoe_force")
"""Inputs that the loop computes."""
TOLERANCE = 0.2
"""Largest relative error of an estimate that counts as found."""


class ObserverRig(Rig):
    """An observer on one train, driven by `pid` against a constant disturbance."""

    guaranteed = COMPUTED

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


OBSERVER_TESTS: dict[str, Test] = {
    "time of a step": timing, "same inputs, same bits": determinism, "finite estimate of every unit": valid_output,
    "reset forgets everything": reset, "leaves its inputs alone": untouched, "hostile inputs": hostile,
    "finds a constant disturbance": _convergence, "recovers after NaN": _recovery,
}  # fmt: skip
"""Contract tests, in this order."""


class LawRig(Rig):
    """A law on one train."""

    guaranteed = ("force_min", "force_max")

    def __init__(self, name: str) -> None:
        self.name = name
        self.bench = Bench(name)
        self.model = self.bench.model

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


LAW_TESTS: dict[str, Test] = {
    "time of a step": timing, "same inputs, same bits": determinism, "finite and inside the limits": valid_output,
    "reset forgets everything": reset, "leaves its inputs alone": untouched, "hostile inputs": hostile,
    "recovers after NaN": _law_recovery,
}  # fmt: skip
"""Contract tests, in this order."""


TRAINS = ("xuzhou_metro_3", "freight_five", "crh380a_three_units", "hxd1_c80_105")
"""Shipped trains of the tests; the last has a sensor at its first coupler."""
DESCRIBED = "describes its parameters"


@dataclass(frozen=True)
class Finding:
    """Result of one test on one train; ``passed`` is None for information only."""

    train: str
    test: str
    passed: bool | None
    detail: str = ""


@dataclass(frozen=True)
class ComponentKind:
    """Kind of component.

    Attributes
    ----------
    noun : str
        Noun in messages, with its article.
    registry : Registry
        Registered components.
    optional : tuple of str
        Names of the methods that it may have.
    rig : type
        Inputs and outputs of the component on one train.
    tests : dict
        Contract tests, in this order.
    """

    noun: str
    registry: Registry
    optional: tuple[str, ...]
    rig: Callable[[str], Rig]
    tests: dict[str, Test]


KINDS = {
    "law": ComponentKind("a law", LAWS, ("on_missed_sample",), LawRig, LAW_TESTS),
    "observer": ComponentKind("an observer", OBSERVERS, (), ObserverRig, OBSERVER_TESTS),
    "compensation": ComponentKind(
        "a compensation", COMPENSATIONS, ("set_brake_policy", "on_command_sent"), CompensationRig, COMPENSATION_TESTS
    ),
}
"""Kinds of component; ``train-ato check-KIND`` tests one."""


def check_component(
    kind: str,
    target: str | type,
    values: dict[str, Any] | None = None,
    progress: Callable[[float, str], None] | None = None,
    random_trains: int = 0,
) -> list[Finding]:
    """Run every contract test.

    Parameters
    ----------
    kind
        ``law``, ``observer`` or ``compensation``.
    target
        Class of the component, ``package.module:Class``, or a registered name.
    values
        Parameters that differ from the defaults.
    progress
        Called with the completed part of the work, 0 ... 1, and its description.
    random_trains
        Number of random trains that a law with ``gains: model`` drives.

    Returns
    -------
    list of Finding
        Results; the component passes if none has ``passed`` False.

    Raises
    ------
    ValueError
        If the class cannot be loaded, or the name is not registered.
    """
    named: Any = target
    if isinstance(target, str):
        named = load_class(target) if {":", "."} & set(target) else KINDS[kind].registry.get(target)
    try:
        component = in_contract_form(named)
    except ValueError as error:
        return [Finding("", DESCRIBED, False, str(error))]
    findings = [_described(component)]
    if findings[0].passed is False:
        return findings
    parameters = component.Parameters(**(values or {}))
    of, accepted = KINDS[kind], 0
    for index, name in enumerate(TRAINS):
        rig = of.rig(name)
        try:
            made = component(parameters, rig.model, PERIOD)
        except ValueError as error:
            findings.append(Finding(name, "accepts the train", None, f"rejected: {error}"))
            continue
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            findings.append(Finding(name, "accepts the train", False, f"raised {text_of_error(error)}"))
            continue
        accepted += 1
        wrong = _misshapen(made, of)
        findings.append(Finding(name, f"has the methods and attributes of {of.noun}", not wrong, wrong))
        if wrong:
            continue
        if kind == "law" and (note := getattr(component, "gains_note", None)):
            delays = f"delay {rig.model.delay.max():g} s, lag {rig.model.lag:g} s"
            findings.append(Finding(name, "gains of the model", None, f"{delays}: {note(rig.model, values or {})}"))
        for finding in _on_train(
            lambda model=rig.model: component(parameters, model, PERIOD),  # type: ignore[misc]
            rig,
            of.tests,
        ):
            findings.append(finding)
            if progress is not None:
                done = (index + (1 + list(of.tests).index(finding.test)) / len(of.tests)) / len(TRAINS)
                progress(done, f"{name}, {finding.test}")
    findings.append(Finding("all", "accepts at least one train", accepted > 0, f"{accepted} of {len(TRAINS)}"))
    if random_trains and kind == "law" and has_rule(component):
        name = LAWS.name_of(getattr(component, "component", component))
        trips = random_trips(name, random_trains, values=values)
        findings.append(Finding(f"{random_trains} random trains", "gains of the model fit", *trips_text(trips)))
    return findings


RANDOM_TRAINS = 20
"""Number of random trains that a law drives."""


def check_law(law: str | type, **values: Any) -> list[Finding]:
    """Run the contract tests on a law, as ``train-ato check-law`` does.

    Parameters
    ----------
    law
        Registered name, ``module:Class``, or a class.
    **values
        Parameters that differ from the defaults.

    Returns
    -------
    list of Finding
        Results; the law passes if none has ``passed`` False.

    Raises
    ------
    ValueError
        If the class cannot be loaded, or the name is not registered.
    """
    return check_component("law", law, values, random_trains=RANDOM_TRAINS)


def findings_table(findings: list[Finding]) -> str:
    """Return the findings as text, one per line."""
    words = {True: "ok", False: "FAILED", None: "note"}
    width = max(len(finding.test) for finding in findings)
    return "\n".join(f"{words[f.passed]:6}  {f.train:20}  {f.test:{width}}  {f.detail}" for f in findings)


def _described(component: Any) -> Finding:
    declared = getattr(component, "Parameters", None)
    test = DESCRIBED
    if not (isinstance(declared, type) and dataclasses.is_dataclass(declared)):
        return Finding("", test, False, "the class has no dataclass `Parameters`; add one")
    try:
        listed = parameters_of(declared)
        make_parameters(declared, {}, component.__name__)
    except KeyError as error:
        return Finding("", test, False, f"a field lacks {error}; declare it by parameter()")
    except ValueError as error:
        return Finding("", test, False, str(error))
    for entry in listed:
        if not entry.meaning:
            return Finding("", test, False, f"{entry.name} has no description")
    return Finding("", test, True, f"{len(listed)} parameters")


def _misshapen(component: Any, kind: ComponentKind) -> str:
    """Return the violation of the contract by the members of a component; empty for none."""
    for name in kind.registry.methods:
        if not callable(getattr(component, name, None)):
            return f"no method {name}()"
    for name in kind.optional:
        if not callable(getattr(component, name, _misshapen)):
            return f"{name} is not a method"
    return preview_fault(component) if kind.registry is LAWS else ""


def _on_train(make: Callable[[], Any], rig: Rig, tests: dict[str, Test]) -> Iterator[Finding]:
    """Run the tests on one train; after a timing slower than the control period the others are skipped."""
    for test, run in tests.items():
        try:
            passed, detail = run(make, rig)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # as in a run
            passed, detail = False, f"raised {text_of_error(error)}"
        yield Finding(rig.name, test, passed, detail)
        if detail.startswith(TOO_SLOW):
            return
