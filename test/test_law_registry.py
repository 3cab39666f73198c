"""Components by name and their parameters: errors are reported in one line before the start."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import EntryPoint

import pytest
from law_trains import FIVE, HAULED, PUSHED, SINGLE, inputs, model

from train_ato.control import registry
from train_ato.control.contract import parameter, parameters_of
from train_ato.control.laws.pid import Pid
from train_ato.control.parameters import make_parameters
from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS, Registry
from train_ato.loop.setup import prepare
from train_ato.scenario.scenario import load_scenario

ALL = [(kind, name) for kind in (LAWS, OBSERVERS, COMPENSATIONS) for name in kind.names()]


@dataclass(frozen=True)
class Sample:
    gain: float = parameter(1.0, "1/s", 0.0, 10.0, "a gain")
    count: int = parameter(3, "1", 1, 9, "a number")
    on: bool = parameter(True, "", 0, 1, "a switch")
    mode: str = parameter("slow", "", 0, 0, "a choice", choices=("slow", "fast"))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"gian": 1.0}, r"x\.gian: no such parameter \(did you mean 'gain'\?\); x has: gain, count, on, mode"),
        ({"gain": float("nan")}, r"x\.gain: nan is outside 0 \.\.\. 10 1/s"),
        ({"gain": 11}, r"x\.gain: 11 is outside 0 \.\.\. 10 1/s"),
        ({"gain": "1"}, r"x\.gain: '1' is not a number"),
        ({"gain": True}, r"x\.gain: True is not a number"),
        ({"count": 2.5}, r"x\.count: 2\.5 is not a whole number"),
        ({"on": 1}, r"x\.on: 1 is not true or false"),
        ({"mode": "fats"}, r"x\.mode: 'fats' is not allowed \(did you mean 'fast'\?\); choose from: slow, fast"),
    ],
)
def test_wrong_parameters_are_refused(values, message):
    """Breaks if a check is missing or the message lacks key, value or remedy."""
    with pytest.raises(ValueError, match=message):
        make_parameters(Sample, values, "x")


def test_right_parameters_keep_their_types():
    """Breaks if an integer for a float is rejected, or a count becomes a float."""
    made = make_parameters(Sample, {"gain": 2, "count": 4.0, "on": False, "mode": "fast"}, "x")
    assert made == Sample(2.0, 4, False, "fast")
    assert isinstance(made.gain, float)
    assert isinstance(made.count, int)


@pytest.mark.parametrize(("kind", "name"), ALL, ids=[f"{kind.kind}-{name}" for kind, name in ALL])
def test_every_registered_component_is_described(kind, name):
    """Breaks if a default is outside its range, or a unit, a description or a docstring is missing."""
    assert len(kind.summary(name)) > 10
    for entry in parameters_of(kind.get(name).Parameters):
        assert entry.meaning, entry.name
        if isinstance(entry.default, str):
            assert entry.default in entry.choices
        elif not isinstance(entry.default, bool):
            assert entry.low <= entry.default <= entry.high, entry.name


def test_unknown_names_get_a_hint():
    """Breaks if the message for a misspelt law lacks the nearest name or the list."""
    with pytest.raises(ValueError, match=r"unknown law 'smcc' \(did you mean 'smc'\?\); known: .*pid"):
        LAWS.make("smcc", {}, None, 0.1)
    with pytest.raises(ValueError, match=r"smc\.kss: no such parameter.*'ks'"):
        LAWS.check_parameters("smc", {"kss": 1.0})


def test_other_packages_register_by_entry_point(monkeypatch):
    """Breaks if entry points are ignored, replace a built-in law, or a broken one gives a traceback."""
    points = {
        "train_ato.controllers": [
            EntryPoint("theirs", "train_ato.control.laws.pid:Pid", "train_ato.controllers"),
            EntryPoint("broken", "no_such_module:Law", "train_ato.controllers"),
            EntryPoint("smc", "no_such_module:Law", "train_ato.controllers"),
        ]
    }
    monkeypatch.setattr(registry, "entry_points", lambda group: points.get(group, []))
    laws = Registry("law", "train_ato.controllers", {"smc": "train_ato.control.laws.smc:Smc"})
    assert laws.names() == ("broken", "smc", "theirs")
    assert laws.get("theirs") is Pid
    assert laws.get("smc").__name__ == "Smc"
    with pytest.raises(ValueError, match="law 'broken' cannot be loaded: ModuleNotFoundError"):
        laws.get("broken")


def test_registration_by_class_and_only_once():
    """Breaks if a name can be registered twice."""
    laws = Registry("law", "none.such", {})
    laws.register("mine", Pid)
    of = model(SINGLE)
    assert laws.make("mine", {"feedforward": False}, of, 0.1).step(inputs(of)).force[0] == 0.0
    with pytest.raises(ValueError, match="'mine' is registered already"):
        laws.register("mine", Pid)


def test_a_law_rejects_an_unsuitable_train_with_the_reason():
    """Breaks if smc accepts a hauled train without the sensor of its first coupler, or rejects one with it."""
    with pytest.raises(
        ValueError, match=r"law 'smc': equivalent: measured needs the force of coupler_0, or a unit of 184 t"
    ):
        LAWS.make("smc", {"gains": "printed"}, model(HAULED), 0.1)
    LAWS.make("smc", {"gains": "printed"}, model(HAULED, sensors=(0,)), 0.1)
    LAWS.make("smc", {}, model(SINGLE), 0.1)
    LAWS.make("smc", {}, model(FIVE), 0.1)
    with pytest.raises(ValueError, match=r"observer 'ndo': .*coupler_0, coupler_3; fit the sensors"):
        OBSERVERS.make("ndo", {"scope": "vehicle"}, model(PUSHED), 0.1)


class Unregistered(Pid):
    """Law that no test registers."""


def test_an_unregistered_class_is_no_registered_name():
    """Breaks if the lists of names, and the parameters of the nodes, depend on the laws that a process has used."""
    before = LAWS.names()
    name = LAWS.name_of(Unregistered)
    assert name == f"{__name__}:Unregistered" and LAWS.get(name) is Unregistered
    assert LAWS.names() == before and name not in LAWS.loadable()
    assert name in prepare(*load_scenario("demo", ("duration=1",), {"law": name})).laws
