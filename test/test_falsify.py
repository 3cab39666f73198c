"""Falsification: search on known functions, files that reproduce the break, refusals, Ctrl-C."""

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import train_ato as ta
from train_ato.api.scenario_choice import choose_scenario
from train_ato.cli import main
from train_ato.loop.engine import run_engine
from train_ato.scenario.dimensions import read_dimensions
from train_ato.scenario.scenario_data import PartCache
from train_ato.studies.falsify import study
from train_ato.studies.falsify.search import FalsificationSearch, GaussianProcess, SearchSpace, search_space
from train_ato.studies.falsify.study import (
    RUNS_TABLE,
    Falsification,
    TargetRun,
    requirement_target,
    run_target,
    write_study,
)
from train_ato.studies.sweep.row import drive_point

MASS = {"plant.mismatch.mass_scale": {"from": 0.9, "to": 1.3}}
DELAY = {"links.command.delay": {"from": 0.0, "to": 0.8}}
SLOW = "G speed_error >= -0.8 km/h"
CHEAP = {
    "schema": "train_ato/scenario/1", "base": "xuzhou_metro", "name": "cheap", "duration": 8, "tick": 0.2, "step": 0.02,
    "plant": {"line": {"schema": "train_ato/line/1", "name": "short", "end_km": 2}},
    "profile": {"phases": [{"accelerate_to_kmh": 10}, {"brake_to": 0}]},
}  # fmt: skip
"""A metro train as one mass for 8 s: some hundredths of a second per run."""


@pytest.fixture
def cheap(tmp_path: Path) -> str:
    path = tmp_path / "cheap.yaml"
    path.write_text(json.dumps(CHEAP))
    return str(path)


def unit_space(*nominal: float) -> SearchSpace:
    names = [f"x{axis}" for axis in range(len(nominal))]
    dimensions = read_dimensions({name: {"from": 0.0, "to": 1.0} for name in names}, "over")
    return SearchSpace(dimensions, np.array(nominal), dict(zip(names, nominal, strict=True)))


def searched(space: SearchSpace, function: Callable[..., float], runs: int, seed: int = 1, batch: int = 1):
    search = FalsificationSearch(
        space, lambda changes: [TargetRun(function(*change.values())) for change in changes], runs, batch, seed=seed
    )
    search.find()
    search.shrink()
    return search


def test_the_smallest_departure_of_a_half_space_is_found() -> None:
    """Breaks if the break is far from the nearest one (x + y > 1.5: 0.354), or names a key that does not matter."""
    nearest = 0.5 / math.sqrt(2.0)
    found = [
        searched(unit_space(0.5, 0.5), lambda x, y: 1.5 - x - y, 60, seed).smallest.departure for seed in range(10)
    ]
    assert min(found) >= nearest
    assert np.median(found) <= 1.05 * nearest, found
    for seed in range(5):
        search = searched(unit_space(0.5, 0.2, 0.8), lambda x, y, z: 0.8 - x, 60, seed)
        assert search.smallest.point[1:].tolist() == [0.2, 0.8]
        assert 0.3 < search.smallest.departure <= 0.32


def test_a_rare_break_needs_a_third_of_the_runs_of_random_search() -> None:
    """Breaks if the proposals are no better than random: the corner x + y > 1.859 is 1 % of the space."""
    needed = []
    for seed in range(20):
        search = FalsificationSearch(
            unit_space(0.5, 0.5),
            lambda changes: [TargetRun(1.859 - change["x0"] - change["x1"]) for change in changes],
            100,
            seed=seed,
        )  # fmt: skip
        search.find()
        needed.append(len(search.rows))
    assert np.median(needed) <= math.log(0.5) / math.log(0.99) / 3, needed


def test_a_search_keeps_its_budget_and_ends_at_a_broken_nominal_scenario() -> None:
    """Breaks if a batch overruns the budget, a point or a broken nominal is run again, or a failed run is a break."""
    for batch in (1, 4):
        search = searched(unit_space(0.5, 0.5), lambda x, y: 1.0, 19, batch=batch)
        points = {tuple(row.point) for row in search.rows}
        assert len(points) == len(search.rows) == 19 and search.smallest is None
    search = searched(unit_space(0.5), lambda x: -1.0, 50)
    assert (len(search.rows), search.smallest.departure) == (1, 0.0)
    search = searched(unit_space(0.5, 0.5), lambda x, y: math.nan if x < 0.4 else 0.3 - y, 40)
    assert search.smallest is not None and search.smallest.point[1] > 0.3
    assert searched(unit_space(0.5), lambda x: math.nan, 12).smallest is None


def test_the_gaussian_process_interpolates_and_is_uncertain_elsewhere() -> None:
    """Breaks if mean or deviation do not fit the samples."""
    points = np.random.default_rng(1).random((25, 2))
    values = np.sin(3 * points[:, 0]) + points[:, 1]
    process = GaussianProcess(points, values)
    mean, deviation = process.predict(points)
    np.testing.assert_allclose(mean, values, atol=1e-3)
    other = np.array([[0.5, 0.5], [0.3, 0.7]])
    found, spread = process.predict(other)
    assert (np.abs(found - np.sin(3 * other[:, 0]) - other[:, 1]) <= 4 * spread + 1e-3).all()
    far, alone = GaussianProcess(points[:2], values[:2]).predict(np.array([[5.0, 5.0]]))
    assert alone[0] > 100 * deviation.max() and far[0] == pytest.approx(values[:2].mean(), rel=0.1)


def test_lists_integers_suffixes_and_entries_of_lists() -> None:
    """Breaks if a value of a list or an integer is interpolated, or a key with a unit or a number is not found."""
    choice = choose_scenario("demo").with_(
        {"duration": 40, "interventions": [{"do": "gust", "at": 5, "acceleration": 0.0, "duration": 3}]}
    )
    over = {
        "compensation": ["none", "preview", "twin"],
        "seed": {"from": 1, "to": 9},
        "criteria.overspeed_kmh": {"from": 0.0, "to": 1.0},
        "interventions.0.acceleration": {"from": -0.1, "to": 0.1},
    }
    space = search_space(choice, read_dimensions(over, "over"), "over")
    assert space.nominal_values == {
        "compensation": "preview", "seed": 1, "criteria.overspeed_kmh": 0.5, "interventions.0.acceleration": 0.0,
    }  # fmt: skip
    assert space.values(space.nominal) == space.nominal_values
    point = space.on_values(np.array([0.9, 0.3, 0.5, 0.75]))
    values = space.values(point)
    assert (values["compensation"], values["seed"]) == ("twin", 3)
    assert space.departure(point) == pytest.approx(math.sqrt(1 + 0.25**2 + 0.25**2))
    gust = choice.with_(values).checked.interventions[0]
    assert (gust.acceleration, gust.at) == (pytest.approx(0.05), 5.0)


@pytest.mark.parametrize("requirement", ["overspeed", "speed_error", "coupler_buff", "jerk"])
def test_a_criterion_has_its_limit_minus_the_metric(requirement: str) -> None:
    """Breaks if a criterion is compared in another unit or sign."""
    choice = choose_scenario("demo").with_({"duration": 10, "criteria.jerk": 0.3})
    setup = choice.prepare()
    result = run_engine(setup)
    (row,) = [row for row in result.summary["criteria"] if row["criterion"] == requirement]
    target = requirement_target(requirement, choice.checked)
    assert target.robustness(setup, result) == row["limit"] - abs(row["value"])


def test_the_written_scenario_reproduces_the_break(cheap: str, tmp_path: Path, capsys) -> None:
    """Breaks if the counterexample is not complete, lacks the requirement, or has other numbers than the search."""
    spec = tmp_path / "spec.yaml"
    spec.write_text(json.dumps({"over": {**MASS, **DELAY}}))
    out = tmp_path / "out"
    arguments = [cheap, "--requirement", SLOW, "--over", str(spec), "--out", str(out)]
    assert main(["falsify", *arguments, "--runs", "10", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["found"] and found["robustness"] < 0
    rows = (out / "runs.csv").read_text().splitlines()
    assert len(rows) == found["runs"] + 1
    assert rows[0] == "run,phase,plant.mismatch.mass_scale,links.command.delay,departure,robustness,problem"
    summary = ta.run(out / "counterexample.yaml").metrics
    (row,) = [row for row in summary["criteria"] if row.get("formula") == SLOW]
    assert (row["value"], summary["verdict"]) == (found["robustness"], "failed")
    assert (out / "counterexample.yaml").read_text().startswith(f"# breaks falsified: {SLOW}\n")
    assert main(["falsify", *arguments[:-1], str(tmp_path / "strict"), "--runs", "8", "--first", "--strict"]) == 1
    assert "broken: falsified: smallest departure" in capsys.readouterr().err


def test_every_run_is_written_when_it_ends(cheap: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a killed search has lost its runs: they were written at its end only."""
    written: list[int] = []

    def counted(result: Falsification, folder: Path) -> None:
        write_study(result, folder)
        written.append(len((folder / RUNS_TABLE).read_text().splitlines()) - 1)

    monkeypatch.setattr(study, "write_study", counted)
    spec = tmp_path / "spec.yaml"
    spec.write_text(json.dumps({"over": MASS}))
    options = ["--over", str(spec), "--runs", "4", "--out", str(tmp_path / "out")]
    assert main(["falsify", cheap, "--requirement", "G speed < 1000 km/h", *options]) == 0
    assert written == [1, 2, 3, 4, 4]
    assert json.loads((tmp_path / "out" / "falsify.json").read_text())["interrupted"] is False


def test_the_runs_of_a_study_have_no_line_on_an_entry_after_their_end(cheap: str, capsys) -> None:
    """Breaks if a search, or every worker of a sweep, prints a line for each of its runs."""
    gust = {"kind": "gust", "begin": 1, "end": 90, "acceleration": 0.001}
    choice, late = choose_scenario(cheap).with_({"plant.disturbances": [gust]}), {"plant.disturbances.0.begin": 21.5}
    run_target(choice, requirement_target(SLOW, choice.checked), late)
    assert drive_point(choice, 1, late, PartCache())["status"] == "done" and capsys.readouterr().err == ""
    choice.with_(late).prepare()
    assert "before the disturbance at 21.5 s" in capsys.readouterr().err


def test_the_runs_of_workers_are_those_of_one_process(cheap: str) -> None:
    """Breaks if a worker runs another scenario, or the order of the results changes."""
    found = ta.falsify(cheap, "G speed_error >= -9 km/h", {**MASS, **DELAY}, jobs=2, runs=6, progress=False)
    assert not found.found
    choice = found.scenario
    for row in found.rows:
        setup = choice.with_(found.space.values(row.point)).prepare()
        assert row.run.robustness == found.target.robustness(setup, run_engine(setup))


@pytest.mark.parametrize(("requirement", "over", "message"), [
    ("keeps_up", MASS, "requirement 'keeps_up': no requirement of the scenario; as a formula: column 1"),
    ("jerk", MASS, "requirement jerk: the scenario has no limit of it; add criteria.jerk"),
    ("G speed <= 3 kN", MASS, "compares m/s with N"),
    ("G command_5 <= 3 kN", MASS, "signal 'command_5': the train has 1 power units; use command_0"),
    (SLOW, {}, "over: no keys"),
    (SLOW, {"plant.mas": [1, 2]}, "over: plant.mas: unknown key 'mas'"),
    (SLOW, {"plant.lag": {"from": 1.1, "to": 2}}, "0.4, the value of the scenario, is outside of 1.1 to 2"),
    (SLOW, {"plant.lag": {"from": -1, "to": 2}}, "over: plant.lag: -1.0: the scenario refuses this value"),
    (SLOW, {"law": ["smc", "funnel"]}, "the list lacks 'pid', the value of the scenario; add it"),
    (SLOW, {"law": {"from": 1, "to": 2}}, "'pid' of the scenario is no number"),
    (SLOW, {"plant.adhesion.factor": [1, 2]}, "the scenario has no value; add its nominal value"),
    (SLOW, {"interventions.3.at": [1, 2]}, "'3' is no entry of a list of 0; add an entry"),
])  # fmt: skip
def test_bad_input_is_refused_in_one_line(requirement: str, over: dict, message: str) -> None:
    """Breaks if a search starts with a wrong key, range or requirement."""
    with pytest.raises(ValueError, match=r"\w") as error:
        ta.falsify("demo", requirement, over, set={"duration": 2}, runs=3)
    assert message in str(error.value) and "\n" not in str(error.value)
