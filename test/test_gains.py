"""Gains of a law for its train: choice, table, rule, and given values."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from plant_sim.library import load_consist
from train_ato.cli import main
from train_ato.control.gains import MODEL, TABLE, has_gains
from train_ato.control.registry import LAWS
from train_ato.loop.setup import RunSetup, prepare
from train_ato.papers.claims import Case
from train_ato.scenario.scenario import load_scenario

OWN_TRAIN = """\
schema: train_ato/scenario/1
name: own
summary: metro train of another mass under the name of the shipped one
tick: 0.05
step: 0.005
seed: 1
duration: 60
plant:
  consist:
    schema: train_ato/consist/1
    name: xuzhou_metro_3
    summary: with 300 t
    gravity: 9.8
    vehicle_types:
      train:
        mass_t: 300
        length: 60
        resistance: {n: [2000, 50, 5]}
        traction: [{to_kmh: 100, force_kn: 300}]
        brake: [{to_kmh: 100, force_kn: 300}]
    train: [{type: train}]
  line: level
  lag: 0.4
links: {command: {delay: 0.3}}
profile:
  limits: {jerk: 0.6, acceleration: 0.5, deceleration: 0.5}
  phases: [{cruise_for: 2}, {accelerate_to_kmh: 20}, {brake_to: 0}]
law: pid
compensation: none
"""


def prepared(name: str, *assignments: str) -> RunSetup:
    """Return the prepared run of a scenario with assignments of `--set`."""
    return prepare(*load_scenario(name, assignments))


@pytest.fixture
def own(tmp_path: Path) -> str:
    """Return the file of a scenario with a train that only shares its name with a shipped one."""
    path = tmp_path / "own.yaml"
    path.write_text(OWN_TRAIN)
    return str(path)


def test_a_shipped_train_takes_the_table_and_given_values_remain() -> None:
    """Breaks if a given value replaces all fitted ones, is lost, or the choice counts as a given value."""
    table = {train: entry["laws"] for entry in yaml.safe_load(TABLE.read_text()) for train in entry["trains"]}
    gains = prepared("demo", "laws.smc.ks=0.5", "laws.smc.gains=fitted").gains("smc")
    assert gains.values == {**table["hxd1_c80_105"]["smc"], "ks": 0.5, "gains": "fitted"}
    assert (gains.source, gains.reason) == ("fitted", "fitted to hxd1_c80_105; ks given")


def test_a_train_of_the_same_name_and_a_longer_delay_take_the_rule(own: str) -> None:
    """Breaks if the name alone decides, or gains for 0.8 s control a train with 1.5 s: kp = 1/(2 (0.3+0.4+0.05) s)."""
    gains = prepared(own).gains("pid")
    assert gains.source == "model" and gains.values["kp"] == pytest.approx(1.0 / 1.5)
    late = prepared("demo", "links.command.delay=1.5").gains("pid")
    assert late.source == "model" and "up to a delay of 0.8 s" in late.reason


def test_the_first_entry_that_holds_decides_and_names_the_rule_where_it_fits_best() -> None:
    """Breaks if the entry without delay serves a train with delay or hides the other, or `model` is not the rule."""
    ideal, late = prepared("daqin_heavy_haul:ideal"), prepared("daqin_heavy_haul")
    rule = LAWS.get("pid").model_gains(ideal.model, ideal.control_period)  # type: ignore[attr-defined]
    assert ideal.gains("pid").values == rule
    assert (ideal.gains("pid").source, late.gains("pid").source) == ("model", "fitted")
    assert late.gains("pid").values == {"kp": 0.05, "ki": 0.001}
    assert ideal.gains("smc").values == late.gains("smc").values
    assert "the best found" in late.gains("funnel").reason and late.gains("funnel").values["feedforward"]


def test_printed_gains_are_the_defaults_of_the_parameters() -> None:
    """Breaks if a claim of a paper runs with fitted gains, or `printed` takes a part of the table."""
    law = Case("demo", {"law": "smc"}).setup().law("smc")
    assert law.parameters == LAWS.get("smc").Parameters(gains="printed")  # type: ignore[attr-defined]


def test_the_resolved_scenario_runs_with_the_same_gains(tmp_path: Path) -> None:
    """Breaks if a recorded run is repeated with the table of a later version, or its source changes."""
    first = prepared("demo", "law=lag_smc", "laws.lag_smc.c1=0.2")
    path = tmp_path / "scenario.yaml"
    path.write_text(first.resolved_yaml())
    again = prepared(str(path))
    assert set(again.controller_parameters["lag_smc"]) == {entry.name for entry in LAWS.parameters("lag_smc")}
    assert again.law("lag_smc").parameters == first.law("lag_smc").parameters  # type: ignore[attr-defined]
    assert again.gains("lag_smc").reason == first.gains("lag_smc").reason


def test_the_table_names_shipped_trains_with_their_mass_and_parameters_of_the_laws() -> None:
    """Breaks if a changed train keeps its gains in silence, or a renamed parameter stays in the table."""
    for entry in yaml.safe_load(TABLE.read_text()):
        assert {"trains", "delay", "lag", "period", "laws"} == set(entry)
        shipped = next(iter(entry["trains"]))
        assert load_consist(shipped).mass / 1e3 == pytest.approx(entry["trains"][shipped], rel=1e-6)
        for law, values in entry["laws"].items():
            assert has_gains(LAWS.get(law))
            if values != MODEL:
                LAWS.check_parameters(law, values)


def test_one_line_of_advice_names_gains_and_delay_with_a_remedy_that_works(own: str) -> None:
    """Breaks if printed gains or an uncompensated delay run in silence, or after the remedy a line remains."""
    assert prepared(own, "laws.pid.gains=printed").advice() == (
        "pid: printed gains, not made for this train, delay 0.3 s and lag 0.4 s without compensation; "
        "try --set laws.pid.gains=model --compensation preview"
    )
    assert prepared(own, "laws.pid.gains=model", "compensation=preview").advice() == ""
    assert prepared(own, "laws.pid.kp=0.4", "compensation=preview").advice() == ""
    assert prepared(own, "law=mpc").advice() == "", "mpc predicts over the delay"


def test_a_law_and_a_scenario_list_their_gains(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if `list` does not say which gains a run would take and why."""
    assert main(["list", "smc"]) == 0
    assert "fitted: hxd1_c80_105" in capsys.readouterr().out
    assert main(["list", "demo"]) == 0
    assert "fitted, fitted to hxd1_c80_105: kp 0.05, ki 0.001" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("assignment", "start"),
    [
        ("laws.pid.kpp=1", "laws.pid.kpp: no such parameter"),
        ("law=smcc", "unknown law 'smcc'"),
        ("plant.lagg=1", "plant.lagg: "),
    ],
)
def test_a_wrong_option_is_named_once_without_the_shipped_file(
    assignment: str, start: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if a wrong `--set` blames the shipped file, lacks the block of its key, or repeats its problem."""
    assert main(["run", "demo", "--engine", "--set", assignment]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"train-ato: --set {assignment}: {start}")
    assert "demo.yaml" not in error and error.count("did you mean") == 1
