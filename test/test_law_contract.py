"""Every law with invalid inputs, and the checker itself: accepted laws and detected faults."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from law_trains import FIVE, SINGLE, inputs, model

from train_ato.apps.check_component.checking import check_component, findings_table
from train_ato.cli import main
from train_ato.control.contract import LawInput, LawOutput, Lookahead
from train_ato.control.laws.pid import Pid
from train_ato.control.registry import LAWS, load_class

TEMPLATE = Path(__file__).parents[1] / "examples" / "my_law.py"
NAMES = LAWS.names()
FIELDS = [
    entry.name
    for entry in dataclasses.fields(LawInput)
    if entry.name not in ("preview", "saturated", "force_min", "force_max", "commands_in_flight", "deflection", "rate")
]
WILD = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True), st.floats(-1e12, 1e12), st.sampled_from([math.nan, 1e300, -1e300])
)


def failures(findings):
    return [finding for finding in findings if finding.passed is False]


@pytest.mark.parametrize("name", NAMES)
def test_every_law_passes_the_contract(name):
    """Bounds, determinism, reset, hostile inputs, recovery after NaN, on four shipped trains."""
    found = check_component("law", LAWS.get(name))
    assert not failures(found), findings_table(found)
    assert sum(finding.test == "recovers after NaN" for finding in found) >= 2


def _filled(entry, value):
    """Return an entry of the input of a law with a value in all its places."""
    if isinstance(entry, Lookahead):
        return Lookahead(*np.full((4, entry.position.size), value))
    return np.full_like(entry, value) if isinstance(entry, np.ndarray) else value


@pytest.mark.parametrize("name", NAMES)
@given(steps=st.lists(st.dictionaries(st.sampled_from(FIELDS), WILD, max_size=4), min_size=1, max_size=8))
def test_no_law_ever_returns_a_force_that_may_not_be_sent(name, steps):
    """For any sequence of values every force is finite and inside the limits."""
    of = model(FIVE)
    law = LAWS.make(name, {}, of, 0.1)
    size = len(getattr(law, "lookahead_times", ()))
    for spoilt in steps:
        base = dataclasses.replace(inputs(of), lookahead=Lookahead(*np.zeros((4, size))))
        changes = {field: _filled(getattr(base, field), value) for field, value in spoilt.items()}
        out = law.step(dataclasses.replace(base, **changes))
        assert np.isfinite(out.force).all()
        assert (np.abs(out.force) <= 400e3).all()


def test_the_template_passes(monkeypatch):
    """The example passes the contract tests, and has at most 55 lines."""
    monkeypatch.syspath_prepend(str(TEMPLATE.parent))
    assert not failures(check_component("law", "my_law:MyLaw"))
    assert len(TEMPLATE.read_text(encoding="utf-8").splitlines()) <= 55


class Leaky(Pid):
    """Keeps its state on reset()."""

    def reset(self):
        pass

    def demand(self, given):
        self.steps = getattr(self, "steps", 0) + 1
        return [force + self.steps for force in super().demand(given)]


class Unbounded(Pid):
    """Returns forces beyond the limits."""

    def step(self, given):
        return LawOutput(np.array(self.demand(given)) * 50.0)


class Scribbler(Pid):
    """Writes into its inputs."""

    def demand(self, given):
        given.velocity[0] += 1.0
        return super().demand(given)


class Poisoned(Pid):
    """Keeps a NaN in its state."""

    total = 0.0

    def step(self, given):
        self.total += float(given.velocity[0]) * 0.0
        return LawOutput(np.clip(np.array(self.demand(given)) + self.total, given.force_min, given.force_max))


class Brittle(Pid):
    """Raises when a speed is not finite."""

    def step(self, given):
        if not np.isfinite(given.velocity).all():
            raise RuntimeError("no speed")
        return super().step(given)


class Deaf(Pid):
    """Returns 0 N after a NaN."""

    dead = False

    def step(self, given):
        self.dead = self.dead or not np.isfinite(given.velocity).all()
        out = super().step(given)
        return LawOutput(out.force * 0.0) if self.dead else out


class Throwing(Pid):
    """Raises from its hundredth step on."""

    def clear_state(self):
        super().clear_state()
        self.steps = 0

    def demand(self, given):
        self.steps += 1
        if self.steps >= 100:
            raise ZeroDivisionError("late")
        return super().demand(given)


class Leaving(Pid):
    """Ends the program."""

    def step(self, given):
        raise SystemExit(3)


class Unmade(Pid):
    """Raises in its constructor, for any train."""

    def __init__(self, parameters, of, period):
        raise TypeError("not made")


class Mute:
    """Has no step()."""

    Parameters = Pid.Parameters

    def __init__(self, parameters, of, period):
        self.reset()

    def reset(self):
        pass


class Backward(Pid):
    """Declares a negative horizon."""

    horizon = -3


class LateScribbler(Pid):
    """Writes into its preview after 10 s."""

    horizon = 5

    def demand(self, given):
        if given.t > 10.0 and given.preview.velocity.flags.writeable:
            given.preview.velocity[0] = 0.0
        return super().demand(given)


@pytest.mark.parametrize(
    ("law", "test"),
    [
        (Throwing, "time of a step"),
        (Leaving, "same inputs, same bits"),
        (Unmade, "accepts the train"),
        (Mute, "has the methods and attributes of a law"),
        (Backward, "has the methods and attributes of a law"),
        (LateScribbler, "leaves its inputs alone"),
        (Leaky, "reset forgets everything"),
        (Unbounded, "finite and inside the limits"),
        (Scribbler, "leaves its inputs alone"),
        (Poisoned, "hostile inputs"),
        (Brittle, "hostile inputs"),
        (Deaf, "recovers after NaN"),
    ],
)
def test_the_checker_finds_faults(law, test, monkeypatch):
    """Breaks if a contract test does not detect its fault."""
    monkeypatch.setattr("train_ato.apps.check_component.checking.TRAINS", ("freight_five",))
    assert test in {finding.test for finding in failures(check_component("law", law))}


def test_a_law_slower_than_its_period_fails_without_further_tests(monkeypatch):
    """Breaks if such a law passes, or runs the thousands of steps of the other tests."""
    monkeypatch.setattr("train_ato.apps.check_component.common.TIMING_BUDGET", 0.0)
    monkeypatch.setattr("train_ato.apps.check_component.checking.TRAINS", ("xuzhou_metro_3",))
    steps = []

    class Sleeping(Pid):
        def step(self, given):
            steps.append(time.sleep(0.11))
            return super().step(given)

    assert [finding.test for finding in failures(check_component("law", Sleeping))] == ["time of a step"]
    assert len(steps) == 1


def test_output_of_a_law_does_not_mix_with_the_findings(monkeypatch, tmp_path, capsys):
    """Breaks if --json writes more than one JSON value to standard output."""
    lines = ["from train_ato.control.laws.pid import Pid", "class Loud(Pid):", "    def demand(self, given):"]
    lines += ["        print('step')", "        return super().demand(given)"]
    (tmp_path / "loud_law.py").write_text("\n".join(lines), encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr("train_ato.apps.check_component.checking.RANDOM_TRAINS", 1)
    assert main(["check-law", "loud_law:Loud", "--json"]) == 0
    out, err = capsys.readouterr()
    assert all(finding["passed"] is not False for finding in json.loads(out))
    assert "step" in err


def test_the_checker_needs_declared_parameters():
    class Bare:
        pass

    assert failures(check_component("law", Bare))[0].test == "describes its parameters"


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("no_such_module:Law", "module 'no_such_module' cannot be imported"),
        ("train_ato.control.laws.pid:Pidd", r"has no class 'Pidd' \(did you mean 'Pid'\?\)"),
        ("law", "'law' does not name a class; write package.module:Class"),
    ],
)
def test_a_target_that_is_no_class_is_refused(target, message):
    with pytest.raises(ValueError, match=message):
        load_class(target)


@pytest.mark.parametrize(("kind", "name"), [("law", "pid"), ("observer", "eso")])
def test_a_registered_name_is_checked(kind, name):
    """Breaks if only ``module:Class`` is accepted, or the name of a law is looked up among the observers."""
    assert not failures(check_component(kind, name))
    with pytest.raises(ValueError, match=f"unknown {kind} 'pidd'"):
        check_component(kind, "pidd")


def test_refusals_are_reported_not_raised():
    """A law for trains with one unit passes, and the rejected trains are listed."""

    class Picky(Pid):
        def __init__(self, parameters, of, period):
            if of.n_units > 1:
                raise ValueError("one unit only")
            super().__init__(parameters, of, period)

    found = check_component("law", Picky)
    assert not failures(found)
    assert sum("one unit only" in finding.detail for finding in found) == 2
    assert model(SINGLE).n_units == 1
