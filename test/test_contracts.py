"""Contract tests of laws, observers and compensations: shipped components pass, and every fault is found."""

import dataclasses
import json
import math
import time
from pathlib import Path

import numpy as np
import pytest
from case_costs import sampled
from commands import answer, complaint
from hypothesis import given
from hypothesis import strategies as st
from law_trains import FIVE, SINGLE, inputs, model

from train_ato.cli import main
from train_ato.control.compensation.preview import PreviewFeedforward
from train_ato.control.contract import LawInput, LawOutput, Lookahead, NoParameters, make_parameters, parameter
from train_ato.control.laws.pid import Pid
from train_ato.control.observers.ndo import Ndo
from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS, load_class
from train_ato.studies.check_component import checking, contract_tests
from train_ato.studies.check_component.checking import TRAINS, check_component, findings_table

EXAMPLES = Path(__file__).parents[1] / "examples"
TEMPLATES = {
    "law": "my_law:MyLaw", "observer": "my_observer:MyObserver", "compensation": "my_compensation:MyCompensation",
}  # fmt: skip
SHIPPED = [("law", LAWS.get(name)) for name in LAWS.names()]
SHIPPED += [("observer", OBSERVERS.get(name)) for name in OBSERVERS.names()]
SHIPPED += [("compensation", COMPENSATIONS.get(name)) for name in COMPENSATIONS.names()]
FIELDS = [
    entry.name
    for entry in dataclasses.fields(LawInput)
    if entry.name not in ("preview", "saturated", "force_min", "force_max", "commands_in_flight", "deflection", "rate")
]
HALVES = sampled([list(TRAINS[1::2]), list(TRAINS[::2])], every=2)
"""Two of the four trains in each case; those of the second half belong to the campaign."""
WILD = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True), st.floats(-1e12, 1e12), st.sampled_from([math.nan, 1e300, -1e300])
)


def failures(findings):
    return [finding for finding in findings if finding.passed is False]


@pytest.mark.parametrize("trains", HALVES, ids=" ".join)
@pytest.mark.parametrize(("kind", "component"), SHIPPED, ids=lambda value: getattr(value, "__name__", value))
def test_every_shipped_component_passes(kind, component, trains, monkeypatch):
    """Bounds, determinism, reset, hostile inputs, recovery after NaN, on four shipped trains."""
    monkeypatch.setattr(checking, "TRAINS", trains)
    found = check_component(kind, component)
    assert not failures(found), findings_table(found)
    assert {finding.test for finding in found} >= set(checking.KINDS[kind].tests)


@pytest.mark.parametrize("kind", TEMPLATES)
def test_the_template_passes(kind, monkeypatch):
    """Breaks if a template fails a contract test, or is longer than a screen."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    found = check_component(kind, TEMPLATES[kind])
    assert not failures(found), findings_table(found)
    lines = (EXAMPLES / f"{TEMPLATES[kind].partition(':')[0]}.py").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= (55 if kind == "law" else 60)


def _filled(entry, value):
    """Return an entry of the input of a law with a value in all its places."""
    if isinstance(entry, Lookahead):
        return Lookahead(*np.full((4, entry.position.size), value))
    return np.full_like(entry, value) if isinstance(entry, np.ndarray) else value


@pytest.mark.parametrize("name", LAWS.names())
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
        assert np.isfinite(out.force).all() and (np.abs(out.force) <= 400e3).all()


class Wrapped:
    """Calls ``of``, an observer without fault; ``spoil`` changes its result. ``kept`` is not cleared by a reset."""

    Parameters = NoParameters
    of = Ndo
    kept = 0.0

    def __init__(self, parameters, model, period):
        self.inner = self.of(self.of.Parameters(), model, period)
        self.steps = 0

    def reset(self):
        self.inner.reset()
        self.steps = 0

    def spoil(self, given, result):
        return result

    def step(self, given):
        self.steps += 1
        return self.spoil(given, self.inner.step(given))


class Layer(Wrapped):
    """Calls a compensation without fault; ``change`` returns the changed fields of its output."""

    of = PreviewFeedforward

    def set_profile(self, rigid):
        self.inner.set_profile(rigid)

    def change(self, given, output):
        return {}

    def spoil(self, given, output):
        return dataclasses.replace(output, **self.change(given, output))


class Leaky(Wrapped):
    """Keeps its state on reset()."""

    def reset(self):
        pass


class Counting(Layer):
    """Keeps the number of its steps on reset()."""

    def change(self, given, output):
        self.kept += 1
        return {"feedforward": output.feedforward + self.kept}


class Mute:
    """Has no step()."""

    Parameters = Pid.Parameters

    def __init__(self, parameters, of, period):
        self.reset()

    def reset(self):
        pass


class NoReset:
    """Keyword form without reset()."""

    def step(self, inputs):
        return 0.0 * inputs.velocity


@dataclasses.dataclass
class Beyond(NoReset):
    """Has a default outside its range."""

    gain: float = parameter(3.0, "1", 0.0, 2.0, "gain")

    def reset(self):
        pass


def test_a_default_outside_its_range_is_refused_by_every_run():
    """Breaks if the engine drives with a default that the graph refuses as a ROS parameter."""
    with pytest.raises(ValueError, match=r"Beyond.gain: default 3 is outside 0 ... 2; correct one of them"):
        OBSERVERS.check_parameters("test_contracts:Beyond", {})
    for choices, fault in (((), "a text with the unit 1"), (("a", "b"), "none of a, b")):
        field = ("gain", str, parameter("3", "1", 0, 2, "gain", choices=choices))
        of = dataclasses.make_dataclass("Texts", [field])
        with pytest.raises(ValueError, match=rf"own.gain: default '3' is {fault}; correct it"):
            make_parameters(of, {}, "own")


def test_a_whole_number_has_64_bits():
    """Breaks if the engine drives with a number that no parameter of ROS can have."""
    of = dataclasses.make_dataclass("Counts", [("count", int, parameter(3, "1", 0, 10**30, "count"))])
    assert make_parameters(of, {"count": 2**63 - 1025}, "own").count == 2**63 - 1025
    with pytest.raises(ValueError, match=r"own.count: 1e\+30 is outside 0 ... 9.22337e\+18 1"):
        make_parameters(of, {"count": 10**30}, "own")


def test_a_default_that_is_no_number_has_no_range():
    """Breaks if the range of a default of None is a traceback."""
    field = ("extra", float, parameter(None, "1", 0.0, 2.0, "extra"))
    assert make_parameters(dataclasses.make_dataclass("Optional", [field]), {}, "own").extra is None


def broken(base, **members):
    return type("Broken", (base,), members)


def fail(error):
    raise error


def kept(part, value):
    """Add a value to what a component keeps over a reset, and return the sum."""
    part.kept = getattr(part, "kept", 0.0) + value
    return part.kept


def late(part, given):
    """Raise in the hundredth step."""
    return fail(ZeroDivisionError("late")) if kept(part, 1) >= 100 else 0.0


def overwritten(values, value=0.0):
    """Write into an array of the inputs, if it can be written."""
    if values.flags.writeable:
        values[0] = value
    return 0.0


def clipped(given, force):
    return LawOutput(np.clip(force, given.force_min, given.force_max))


def finite(values):
    return 0.0 if np.isfinite(values).all() else fail(RuntimeError("not finite"))


def forces(change):
    """Return a law whose forces are changed by a function of the law, its input and its forces."""
    return broken(Pid, demand=lambda law, given: [f + change(law, given) for f in Pid.demand(law, given)])


def law(step):
    return broken(Pid, step=step)


def layer(change):
    return broken(Layer, change=change)


def estimate(spoil):
    return broken(Wrapped, spoil=spoil)


FAULTS = {
    "law": [
        ("time of a step", "raises from its hundredth step on", forces(late)),
        ("same inputs, same bits", "ends the program", law(lambda law, given: fail(SystemExit(3)))),
        ("accepts the train", "raises in its constructor",
         broken(Pid, __init__=lambda law, *rest: fail(TypeError("not made")))),
        ("has the methods and attributes of a law", "has no step()", Mute),
        ("has the methods and attributes of a law", "declares a negative horizon", broken(Pid, horizon=-3)),
        ("leaves its inputs alone", "writes into its preview after 10 s",
         broken(forces(lambda law, given: overwritten(given.preview.velocity) if given.t > 10.0 else 0.0), horizon=5)),
        ("leaves its inputs alone", "writes into its inputs",
         forces(lambda law, given: overwritten(given.velocity, given.velocity[0] + 1.0))),
        ("reset forgets everything", "keeps its state on reset()",
         broken(forces(lambda law, given: kept(law, 1 / 5)), reset=lambda law: None)),
        ("finite and inside the limits", "returns forces beyond the limits",
         law(lambda law, given: LawOutput(np.array(law.demand(given)) * 50.0))),
        ("hostile inputs", "keeps a NaN in its state",
         law(lambda law, given: clipped(given, np.array(law.demand(given)) + kept(law, 0.0 * given.velocity[0])))),
        ("hostile inputs", "raises when a speed is not finite",
         law(lambda law, given: finite(given.velocity) or Pid.step(law, given))),
        ("recovers after NaN", "returns 0 N after a NaN",
         law(lambda law, given: LawOutput(
             Pid.step(law, given).force * (not kept(law, not np.isfinite(given.velocity).all())),
         ))),
    ],
    "observer": [
        ("describes its parameters", "has a default outside its range", Beyond),
        ("describes its parameters", "has no reset()", NoReset),
        ("accepts the train", "raises in its constructor",
         broken(Wrapped, __init__=lambda part, *rest: fail(TypeError("not made")))),
        ("accepts at least one train", "rejects every train",
         broken(Wrapped, __init__=lambda part, *rest: fail(ValueError("no train")))),
        ("has the methods and attributes of an observer", "has no step()", broken(Wrapped, step=None)),
        ("time of a step", "raises from its hundredth step on",
         estimate(lambda part, given, force: force + late(part, given))),
        ("same inputs, same bits", "ends the program", estimate(lambda part, given, force: fail(SystemExit(3)))),
        ("same inputs, same bits", "raises no Exception", estimate(lambda part, given, force: fail(GeneratorExit()))),
        ("same inputs, same bits", "adds a random force",
         estimate(lambda part, given, force: force + np.random.default_rng().normal())),
        ("finite estimate of every unit", "returns the force of the train",
         estimate(lambda part, given, force: force.sum())),
        ("finite estimate of every unit", "is infinite for a slow train",
         estimate(lambda part, given, force: force / 0.0 if given.velocity[0] < 6.0 else force)),
        ("reset forgets everything", "keeps its state on reset()", Leaky),
        ("leaves its inputs alone", "writes into its inputs after 10 s",
         estimate(lambda part, given, force: force + (given.t > 10.0 and overwritten(given.applied)))),
        ("hostile inputs", "keeps a NaN in its state",
         estimate(lambda part, given, force: force + kept(part, 0.0 * given.velocity[0]))),
        ("hostile inputs", "raises when a speed is not finite",
         estimate(lambda part, given, force: force + finite(given.velocity))),
        ("finds a constant disturbance", "has the wrong sign", estimate(lambda part, given, force: -force)),
        ("recovers after NaN", "returns 0 N after a NaN",
         estimate(lambda part, given, force: force * (not kept(part, bool(np.isnan(given.velocity).any()))))),
    ],
    "compensation": [
        ("has the methods and attributes of a compensation", "has no set_profile()", broken(Layer, set_profile=None)),
        ("has the methods and attributes of a compensation", "has a number for a method",
         broken(Layer, on_command_sent=3)),
        ("same inputs, same bits", "adds a random force",
         layer(lambda part, given, out: {"feedforward": out.feedforward + np.random.default_rng().normal()})),
        ("valid input of the law", "returns its own input", broken(Layer, step=lambda part, given: given)),
        ("valid input of the law", "changes the limits of the force",
         layer(lambda part, given, out: {"force_max": out.force_max * 2.0})),
        ("valid input of the law", "changes the time of the measurement",
         layer(lambda part, given, out: {"t": out.t + 0.5})),
        ("valid input of the law", "omits the preview",
         broken(Layer, step=lambda part, given: Layer.step(part, dataclasses.replace(given, horizon=0)))),
        ("valid input of the law", "gives the feed-forward of the train",
         layer(lambda part, given, out: {"feedforward": np.array([out.feedforward.sum()])})),
        ("valid input of the law", "gives NaN for a slow train",
         layer(lambda part, given, out: {
             "feedforward": out.feedforward * (math.nan if given.measurement.velocity[0] < 6.0 else 1.0),
         })),
        ("reset forgets everything", "keeps the number of its steps on reset()", Counting),
        ("reset forgets everything", "keeps the brake events on reset()",
         broken(PreviewFeedforward, reset=lambda part: None)),
        ("leaves its inputs alone", "writes into the measurement",
         layer(lambda part, given, out: dict.fromkeys((), overwritten(given.measurement.velocity, -1.0)))),
        ("hostile inputs", "raises for an invalid sensor of a coupler",
         layer(lambda part, given, out: dict.fromkeys((), finite(given.measurement.force)))),
        ("hostile inputs", "reads a table at the measured position",
         layer(lambda part, given, out: dict.fromkeys((), np.zeros(200_000)[int(given.measurement.position[0])]))),
        ("hostile inputs", "keeps an invalid reference in a filter",
         layer(lambda part, given, out: {"acceleration_at_effect": kept(part, given.reference.acceleration)})),
        ("no effect without delay", "compensates a delay of another model",
         layer(lambda part, given, out: {"delay_to_effect": 0.5})),
        ("no effect without delay", "shifts the measured position",
         layer(lambda part, given, out: {"position": out.position + 0.1})),
        ("the law controls the train", "gives the feed-forward with the wrong sign",
         layer(lambda part, given, out: {"feedforward": -3.0 * out.feedforward})),
    ],
}  # fmt: skip
"""Faults of components by kind: the contract test that finds the fault, and the class with it."""
AIR_BRAKE = ("keeps the brake events on reset()", "raises for an invalid sensor of a coupler")
"""Faults of a train with an air brake and a sensor at a coupler."""


@pytest.mark.parametrize(("kind", "fault"), [(kind, fault) for kind, rows in FAULTS.items() for _, fault, _ in rows])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_every_fault_is_found(kind, fault, monkeypatch):
    monkeypatch.setattr(checking, "TRAINS", ("hxd1_c80_105" if fault in AIR_BRAKE else "freight_five",))
    ((test, component),) = [(test, component) for test, name, component in FAULTS[kind] if name == fault]
    alone = {name: run for name, run in checking.KINDS[kind].tests.items() if name == test}
    monkeypatch.setitem(checking.KINDS, kind, dataclasses.replace(checking.KINDS[kind], tests=alone))
    assert test in {finding.test for finding in failures(check_component(kind, component))}


def test_an_observer_without_effect_has_a_note(monkeypatch):
    """Breaks if an estimate of 0 fails, or is reported as a disturbance found."""
    monkeypatch.setattr(checking, "TRAINS", ("xuzhou_metro_3",))
    found = check_component("observer", estimate(lambda part, given, force: force * 0.0))
    assert not failures(found)
    (note,) = [finding for finding in found if finding.test == "finds a constant disturbance"]
    assert note.passed is None and note.detail.endswith("the disturbance is not found")


@pytest.mark.parametrize(("kind", "base"), [("law", Pid), ("observer", Wrapped)])
@pytest.mark.parametrize(("slow_steps", "failed"), [(2, ["time of a step"]), (1, [])])
def test_a_component_slower_than_its_period_fails_without_further_tests(kind, base, slow_steps, failed, monkeypatch):
    """Breaks if such a component passes, runs the other tests, or fails by a first step that compiles it."""
    monkeypatch.setattr(contract_tests, "TIMING_BUDGET", 0.0)
    monkeypatch.setattr(checking, "TRAINS", ("xuzhou_metro_3",))
    steps = []

    class Sleeping(base):
        def step(self, given):
            steps.append(time.sleep(0.11 if len(steps) < slow_steps else 0.0))
            return super().step(given)

    assert [finding.test for finding in failures(check_component(kind, Sleeping))] == failed
    assert (len(steps) == 2) == bool(failed)


def test_output_of_a_law_does_not_mix_with_the_findings(monkeypatch, tmp_path, capsys):
    """Breaks if --json writes more than one JSON value to standard output."""
    lines = ["from train_ato.control.laws.pid import Pid", "class Loud(Pid):", "    def demand(self, given):"]
    lines += ["        print('step')", "        return super().demand(given)"]
    (tmp_path / "loud_law.py").write_text("\n".join(lines), encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(checking, "RANDOM_TRAINS", 1)
    monkeypatch.setattr(checking, "TRAINS", ("xuzhou_metro_3",))
    assert main(["check-law", "loud_law:Loud", "--json"]) == 0
    out, err = capsys.readouterr()
    assert all(finding["passed"] is not False for finding in json.loads(out)) and "step" in err


@pytest.mark.parametrize(("kind", "component"), [("observer", Leaky), ("compensation", Counting)])
def test_the_commands_end_with_the_status_of_the_checks(kind, component, monkeypatch, capsys):
    """Breaks if a fault ends with status 0, bad input with 1, or the JSON value is not alone on standard output."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    monkeypatch.setattr(checking, "TRAINS", ("xuzhou_metro_3",))
    found = answer(capsys, f"check-{kind}", TEMPLATES[kind])
    assert {finding["passed"] for finding in found} == {True, None}
    name = f"test_contracts:{component.__name__}"
    assert main([f"check-{kind}", name]) == 1
    out, err = capsys.readouterr()
    assert "FAILED  xuzhou_metro_3" in out
    assert err.endswith(f"train-ato: {name}: failed 1 of {len(found)} tests: reset forgets everything\n")
    assert "has no class 'Nothing'" in complaint(capsys, f"check-{kind}", "my_observer:Nothing")


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("no_such_module:Law", "module 'no_such_module' cannot be imported"),
        ("train_ato.control.laws.pid:Pidd", r"has no class 'Pidd'; did you mean 'Pid'\?"),
        ("law", "'law' does not name a class; write package.module:Class"),
        (".law:Law", "'.law:Law' does not name a class; write package.module:Class"),
        ("bad_value:Law", "module 'bad_value' cannot be imported: ValueError: 3, .*bad_value.py:2; correct name"),
        ("bad_exit:Law", "module 'bad_exit' cannot be imported: called sys.exit\\(3\\), .*bad_exit.py:2; "),
        ("bad_text:Law", "module 'bad_text' cannot be imported: SyntaxError: .*bad_text.py, line 2\\); correct name"),
        ("bad_null:Law", "module 'bad_null' cannot be imported: (Syntax|Value)Error: source code .*null bytes"),
        ("laws/my_law.py:MyLaw", "'laws/my_law.py:MyLaw' names a file; write my_law:MyLaw, in the folder laws"),
    ],
)
def test_a_target_that_is_no_class_is_refused(target, message, tmp_path, monkeypatch):
    """Breaks if a module that cannot be imported gives a traceback or another exit status, or its line is missing."""
    bad = {"value": "raise ValueError(3)", "exit": "raise SystemExit(3)", "text": "class Law(", "null": "\0"}
    for name, line in bad.items():
        (tmp_path / f"bad_{name}.py").write_text(f"import sys\n{line}\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ValueError, match=message):
        load_class(target)


def test_the_present_folder_stays_after_the_import_of_a_component(tmp_path, monkeypatch):
    """Breaks if a law that changes its folder moves the files of the run, which are then not where the end says."""
    (tmp_path / "moving_law.py").write_text("import os\nos.chdir('/')\nclass Law:\n    pass\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert load_class("moving_law:Law").__name__ == "Law" and Path.cwd() == tmp_path


@pytest.mark.parametrize(("kind", "name"), [("law", "pid"), ("observer", "eso")])
def test_a_registered_name_is_checked(kind, name, monkeypatch):
    """Breaks if only ``module:Class`` is accepted, or the name of a law is looked up among the observers."""
    monkeypatch.setattr(checking, "TRAINS", ("xuzhou_metro_3",))
    assert not failures(check_component(kind, name))
    with pytest.raises(ValueError, match=f"unknown {kind} 'pidd'"):
        check_component(kind, "pidd")


def test_refusals_are_reported_not_raised():
    """A law for trains with one unit passes, and the rejected trains are listed; parameters must be declared."""

    class Picky(Pid):
        def __init__(self, parameters, of, period):
            if of.n_units > 1:
                raise ValueError("one unit only")
            super().__init__(parameters, of, period)

    found = check_component("law", Picky)
    assert not failures(found) and sum("one unit only" in finding.detail for finding in found) == 2
    assert model(SINGLE).n_units == 1
    assert failures(check_component("law", type("Bare", (), {})))[0].test == "describes its parameters"
