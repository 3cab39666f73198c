"""Contract tests of a component: a control law, an observer or a delay compensation.

``check_component("observer", "package.module:Observer")`` runs the component on shipped rigid trains along a profile
of one minute, and with invalid inputs. A component may reject a train by a ValueError with the reason, but not all of
them. The tests are in :mod:`train_ato.studies.check_component.contract_tests`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from train_ato.control.component_fault import text_of_error
from train_ato.control.contract import make_parameters, parameters_of
from train_ato.control.gains import has_rule
from train_ato.control.registry import (
    COMPENSATIONS,
    LAWS,
    OBSERVERS,
    KeywordForm,
    Registry,
    in_contract_form,
    load_class,
    preview_fault,
)
from train_ato.studies.check_component import contract_tests
from train_ato.studies.check_component.random_trips import random_trips, trips_text
from train_ato.studies.check_component.trains import PERIOD

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
    rig: Callable[[str], contract_tests.Rig]
    tests: dict[str, contract_tests.Test]


KINDS = {
    "law": ComponentKind("a law", LAWS, ("on_missed_sample",), contract_tests.LawRig, contract_tests.LAW_TESTS),
    "observer": ComponentKind("an observer", OBSERVERS, (), contract_tests.ObserverRig, contract_tests.OBSERVER_TESTS),
    "compensation": ComponentKind(
        "a compensation",
        COMPENSATIONS,
        ("set_brake_policy", "on_command_sent"),
        contract_tests.CompensationRig,
        contract_tests.COMPENSATION_TESTS,
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
    """
    named: Any = target
    if isinstance(target, str):
        named = load_class(target) if {":", "."} & set(target) else KINDS[kind].registry.get(target)
    elif not isinstance(target, (type, KeywordForm)):
        raise ValueError(f"{kind} {target!r:.60}: is no class; give the class, for example MyLaw in place of MyLaw()")
    try:
        component = in_contract_form(named)
    except ValueError as error:
        return [Finding("", DESCRIBED, False, str(error))]
    findings = [_described(component)]
    if findings[0].passed is False:
        return findings
    parameters = make_parameters(component.Parameters, values or {}, str(getattr(target, "__name__", target)))
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
    test = DESCRIBED
    try:
        listed = parameters_of(component.Parameters)
        make_parameters(component.Parameters, {}, component.__name__)
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


def _on_train(
    make: Callable[[], Any], rig: contract_tests.Rig, tests: dict[str, contract_tests.Test]
) -> Iterator[Finding]:
    """Run the tests on one train; after a timing slower than the control period the others are skipped."""
    for test, run in tests.items():
        try:
            passed, detail = run(make, rig)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # as in a run
            passed, detail = False, f"raised {text_of_error(error)}"
        yield Finding(rig.name, test, passed, detail)
        if detail.startswith(contract_tests.TOO_SLOW):
            return
