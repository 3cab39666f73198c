"""Laws by name and their parameters: what is wrong is refused in one line, before anything runs."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import EntryPoint

import pytest
from law_trains import FIVE, HAULED, PUSHED, SINGLE, inputs, model

from train_ato.compensate.registry import COMPENSATIONS
from train_ato.control import registry
from train_ato.control.contract import parameter, parameters_of
from train_ato.control.laws.pid import Pid
from train_ato.control.parameters import make_parameters
from train_ato.control.registry import LAWS, Registry
from train_ato.observe.registry import OBSERVERS

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
    """Breaks if a check is lost or the message stops naming key, value and remedy."""
    with pytest.raises(ValueError, match=message):
        make_parameters(Sample, values, "x")


def test_right_parameters_keep_their_types():
    """Breaks if an integer for a float is refused, or a float arrives where a count is due."""
    made = make_parameters(Sample, {"gain": 2, "count": 4.0, "on": False, "mode": "fast"}, "x")
    assert made == Sample(2.0, 4, False, "fast")
    assert isinstance(made.gain, float)
    assert isinstance(made.count, int)


@pytest.mark.parametrize(("kind", "name"), ALL, ids=[f"{kind.kind}-{name}" for kind, name in ALL])
def test_every_registered_block_describes_itself(kind, name):
    """Breaks if a default lies outside its own range, a unit or meaning is missing, or a docstring is."""
    assert len(kind.summary(name)) > 10
    for entry in parameters_of(kind.get(name).Parameters):
        assert entry.meaning, entry.name
        if isinstance(entry.default, str):
            assert entry.default in entry.choices
        elif not isinstance(entry.default, bool):
            assert entry.low <= entry.default <= entry.high, entry.name


def test_unknown_names_get_a_hint():
    """Breaks if a misspelt law is not answered with the near one and the list."""
    with pytest.raises(ValueError, match=r"unknown controller 'smcc' \(did you mean 'smc'\?\); known: .*pid"):
        LAWS.make("smcc", {}, None, 0.1)
    with pytest.raises(ValueError, match=r"smc\.kss: no such parameter.*'ks'"):
        LAWS.check_parameters("smc", {"kss": 1.0})


def test_other_packages_register_by_entry_point(monkeypatch):
    """Breaks if entry points are not read, hide a built-in law, or a broken one ends in a traceback."""
    points = {
        "train_ato.controllers": [
            EntryPoint("theirs", "train_ato.control.laws.pid:Pid", "train_ato.controllers"),
            EntryPoint("broken", "no_such_module:Law", "train_ato.controllers"),
            EntryPoint("smc", "no_such_module:Law", "train_ato.controllers"),
        ]
    }
    monkeypatch.setattr(registry, "entry_points", lambda group: points.get(group, []))
    laws = Registry("controller", "train_ato.controllers", {"smc": "train_ato.control.laws.smc:Smc"})
    assert laws.names() == ("broken", "smc", "theirs")
    assert laws.get("theirs") is Pid
    assert laws.get("smc").__name__ == "Smc"
    with pytest.raises(ValueError, match="controller 'broken' cannot be loaded: ModuleNotFoundError"):
        laws.get("broken")


def test_registration_by_class_and_only_once():
    """Breaks if a name can be taken twice."""
    laws = Registry("controller", "none.such", {})
    laws.register("mine", Pid)
    of = model(SINGLE)
    assert laws.make("mine", {"feedforward": False}, of, 0.1).step(inputs(of)).force[0] == 0.0
    with pytest.raises(ValueError, match="'mine' is registered already"):
        laws.register("mine", Pid)


def test_a_law_that_makes_no_sense_says_why():
    """Breaks if smc runs on a hauled train without the first coupler's sensor, or refuses one that has it."""
    with pytest.raises(ValueError, match=r"controller 'smc': needs the force measured at coupler_0, or 184 t"):
        LAWS.make("smc", {}, model(HAULED), 0.1)
    LAWS.make("smc", {}, model(HAULED, sensors=(0,)), 0.1)
    LAWS.make("smc", {}, model(SINGLE), 0.1)
    LAWS.make("smc", {}, model(FIVE), 0.1)
    with pytest.raises(ValueError, match=r"observer 'ndo': .*coupler_0, coupler_3: fit the sensors"):
        OBSERVERS.make("ndo", {"scope": "vehicle"}, model(PUSHED), 0.1)
