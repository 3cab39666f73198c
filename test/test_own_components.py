"""Observers and compensations without registration: names, classes and objects in all three modes."""

from __future__ import annotations

import importlib
import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import train_ato as ta
from train_ato.cli.main import main
from train_ato.control.compensation.base import CompensationBase
from train_ato.control.keyword_form import in_contract_form
from train_ato.control.registry import COMPENSATIONS, OBSERVERS

EXAMPLES = Path(__file__).parents[1] / "examples"
KEYS = ("speed_rmse_kmh", "coupler_draft_max_kn", "energy_traction_kwh")
SHORT = {"duration": 20}
OBSERVER, COMPENSATION = "my_observer:MyObserver", "my_compensation:MyCompensation"
CHANGES = {f"observers.{OBSERVER}.filter_time": 2.0, f"compensations.{COMPENSATION}.ratio": 0.5}


@pytest.fixture
def templates(monkeypatch):
    """Make the templates importable; return the classes of observer and compensation."""
    monkeypatch.setenv("PYTHONPATH", f"{EXAMPLES}:{EXAMPLES.parent}")
    monkeypatch.syspath_prepend(str(EXAMPLES))
    for registry in (OBSERVERS, COMPENSATIONS):
        monkeypatch.setattr(registry, "_unregistered", {})
    yield tuple(getattr(importlib.import_module(m), c) for m, c in (OBSERVER.split(":"), COMPENSATION.split(":")))
    for module in ("my_observer", "my_compensation"):
        sys.modules.pop(module, None)


def figures(run):
    return [run.metrics[key] for key in KEYS]


def test_names_classes_and_objects_give_the_same_run(templates, capsys):
    """Breaks if an object, a class with parameters, a name and the command result in different runs."""
    observer, compensation = templates
    by_object = ta.run("demo", observer=observer(filter_time=2.0), compensation=compensation(0.5), set=SHORT)
    assert by_object.metrics["observer"] == OBSERVER and by_object.metrics["compensation"] == COMPENSATION
    assert by_object["ato/estimate"].abs().to_numpy().max() > 0.0
    by_class = ta.run("demo", observer=observer, compensation=compensation, set={**CHANGES, **SHORT})
    by_name = ta.run("demo", observer=OBSERVER, compensation=COMPENSATION, set={**CHANGES, **SHORT})
    assert figures(by_class) == figures(by_object) == figures(by_name)
    other = ta.run("demo", observer=observer, compensation=compensation, set=SHORT)
    assert not other["ato/estimate"].equals(by_object["ato/estimate"]) and figures(other) != figures(by_object)
    arguments = ["run", "demo", "--engine", "--observer", OBSERVER, "--compensation", COMPENSATION, "--json"]
    arguments += [f"--set={key}={value}" for key, value in {**CHANGES, **SHORT}.items()]
    assert main([*arguments, "--out", "out"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [found[key] for key in KEYS] == figures(by_object)


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_a_comparison_uses_the_components(templates):
    """Breaks if `compare` ignores a class or an object."""
    observer, compensation = templates
    options = {"observer": observer(2.0), "compensation": compensation(ratio=0.5), "set": SHORT}
    table = ta.compare("demo", ["pid"], **options).table
    assert table.loc["pid", "speed_rmse_kmh"] == ta.run("demo", **options).metrics["speed_rmse_kmh"]


def test_a_class_of_a_registered_component_has_its_name():
    """Breaks if a registered class does not use the parameters of its name."""
    run = ta.run("demo", observer=OBSERVERS.get("eso"), compensation=COMPENSATIONS.get("twin"), set=SHORT)
    assert (run.metrics["observer"], run.metrics["compensation"]) == ("eso", "twin")


@pytest.mark.campaign
@pytest.mark.parametrize("mode", ["composed", "processes"])
def test_every_mode_gives_the_same_run(mode, templates):
    """Breaks if a node does not find a component by its module, or its parameters are lost."""
    changes = {**CHANGES, **SHORT}
    engine, graph = (
        ta.run("demo", observer=OBSERVER, compensation=COMPENSATION, set=changes, mode=way) for way in ("engine", mode)
    )
    for topic in ("train/vehicles", "ato/estimate", "ato/command"):
        pd.testing.assert_frame_equal(engine[topic], graph[topic], check_exact=True)


@dataclass
class Predicting(CompensationBase):
    """Compensation of a notebook with an attribute of the contract."""

    gain: float = 1.0
    predicts = True

    def step(self, inputs):
        return self.law_input(inputs, inputs.t, np.zeros(self.model.n_units), self.shoes.at(inputs.t, 0.0))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"observer": "esoo"}, r"unknown observer 'esoo' \(did you mean 'eso'\?\)"),
        ({"observer": 3}, r"observer 3: give a name, 'module:Class', a class or an object"),
        ({"compensation": ("twin",)}, r"compensation \('twin',\): give a name"),
        ({"compensation": "my_compensation:Nothing"}, r"module 'my_compensation' has no class 'Nothing'"),
        ({"observer": type("Empty", (), {})}, r"observer: class Empty has no method reset\(\)"),
        ({"compensation": Predicting, "law": "gpc"}, r"'gpc' .*Predicting.* predicts the state"),
        ({"compensation": Predicting, "set": {"compensations.pid.kp": 1}}, r"unknown compensation 'pid'"),
    ],
)
def test_bad_input_is_refused_in_one_line(options, message, templates, tmp_path):
    """Breaks if a wrong component starts a run, or the error has no remedy."""
    with pytest.raises(ValueError, match=message) as caught:
        ta.run("demo", **{"set": SHORT, **options})
    assert "\n" not in str(caught.value) and list(tmp_path.iterdir()) == []


def test_a_component_of_a_function_cannot_go_to_other_processes(templates):
    """Breaks if the refusal comes from another process."""

    class Local(templates[0]):
        pass

    with pytest.raises(ValueError, match="mode 'processes': another process cannot import the observer"):
        ta.run("demo", observer=Local(), mode="processes")


def test_a_keyword_component_keeps_the_module_of_its_class(templates):
    """Breaks if a registered component of another package gets a page of this package."""
    assert [in_contract_form(component).__module__ for component in templates] == ["my_observer", "my_compensation"]
