"""Registry of laws, observers and compensations, and the checks of their parameters."""

from dataclasses import dataclass

import pytest
from engine_runs import setup_of
from law_trains import FIVE, HAULED, PUSHED, SINGLE, inputs, model

from train_ato.control.contract import make_parameters, parameter
from train_ato.control.laws.pid import Pid
from train_ato.control.registry import LAWS, OBSERVERS, Registry


@dataclass(frozen=True)
class Sample:
    gain: float = parameter(1.0, "1/s", 0.0, 10.0, "a gain")
    count: int = parameter(3, "1", 1, 9, "a number")
    on: bool = parameter(True, "", 0, 1, "a switch")
    mode: str = parameter("slow", "", 0, 0, "a choice", choices=("slow", "fast"))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"gian": 1.0}, r"x\.gian: no such parameter; did you mean 'gain'\?; x has: gain, count, on, mode"),
        ({"gain": float("nan")}, r"x\.gain: nan is outside 0 \.\.\. 10 1/s"),
        ({"gain": 11}, r"x\.gain: 11 is outside 0 \.\.\. 10 1/s"),
        ({"gain": "1"}, r"x\.gain: '1' is not a number"),
        ({"gain": True}, r"x\.gain: True is not a number"),
        ({"count": 2.5}, r"x\.count: 2\.5 is not a whole number"),
        ({"on": 1}, r"x\.on: 1 is not true or false"),
        ({"mode": "fats"}, r"x\.mode: 'fats' is not allowed; did you mean 'fast'\?; choose from: slow, fast"),
    ],
)
def test_wrong_parameters_are_refused(values, message):
    """Breaks if a check is missing or the message lacks key, value or remedy."""
    with pytest.raises(ValueError, match=message):
        make_parameters(Sample, values, "x")


def test_right_parameters_keep_their_types():
    """Breaks if an integer for a float is rejected, or a count becomes a float."""
    made = make_parameters(Sample, {"gain": 2, "count": 4.0, "on": False, "mode": "fast"}, "x")
    assert made == Sample(2.0, 4, False, "fast") and isinstance(made.gain, float)
    assert isinstance(made.count, int)


def test_names_of_the_registry():
    """Breaks if a misspelt law has no hint, a name is registered twice, or used classes change the list of names."""
    with pytest.raises(ValueError, match=r"unknown law 'smcc'; did you mean 'smc'\?; known: .*pid"):
        LAWS.make("smcc", {}, None, 0.1)
    with pytest.raises(ValueError, match=r"smc\.kss: no such parameter.*'ks'"):
        LAWS.check_parameters("smc", {"kss": 1.0})
    laws = Registry("law", "none.such", {})
    laws.register("mine", Pid)
    of = model(SINGLE)
    assert laws.make("mine", {"feedforward": False}, of, 0.1).step(inputs(of)).force[0] == 0.0
    with pytest.raises(ValueError, match="'mine' is registered already"):
        laws.register("mine", Pid)
    before = LAWS.names()
    name = LAWS.name_of(Unregistered)
    assert name == f"{__name__}:Unregistered" and LAWS.get(name) is Unregistered
    assert LAWS.names() == before and name not in LAWS.loadable()
    assert name in setup_of("demo", "duration=1", changes={"law": name}).laws


def test_other_packages_register_by_entry_point(tmp_path, monkeypatch):
    """Breaks if entry points are ignored, are not seen after an installation, or a broken one gives a traceback."""
    monkeypatch.syspath_prepend(tmp_path)
    laws = Registry("law", "train_ato.controllers", {"smc": "train_ato.control.laws.smc:Smc"})
    assert laws.names() == ("smc",)
    installed = tmp_path / "theirs-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    names = ("theirs = train_ato.control.laws.pid:Pid", "broken = no_such_module:Law", "smc = no_such_module:Law")
    (installed / "entry_points.txt").write_text("\n".join(("[train_ato.controllers]", *names)))
    assert laws.names() == ("broken", "smc", "theirs") and laws.get("theirs") is Pid
    assert laws.get("smc").__name__ == "Smc"
    with pytest.raises(ValueError, match="law 'broken': module 'no_such_module' cannot be imported"):
        laws.get("broken")


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
