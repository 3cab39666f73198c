"""Search for gains: objective, search space, determinism, held-out runs, output, interruption; searches go on."""

import csv
import fcntl
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml
from test_falsify import CHEAP

import train_ato as ta
from train_ato.api.series_folder import RUNS, KeptRuns, SearchFolder
from train_ato.cli.main import main
from train_ato.judge.tracking import OUTCOMES
from train_ato.scenario.criteria import Criteria
from train_ato.scenario.scenario import load_scenario
from train_ato.studies import learn
from train_ato.studies.falsify import study
from train_ato.studies.tune import gain_space as gain_module
from train_ato.studies.tune import objective
from train_ato.studies.tune.gain_space import SEARCHED, GainRunner, gain_space, gain_tasks, read_tune_spec
from train_ato.studies.tune.tune import GainSearch

SHORT = {"duration": 10}
"""The metro train starts within 10 s."""
DONE: dict[str, Any] = {
    "status": "done", "speed_rmse_kmh": 0.2, "stop_error_max_m": 0.1, "command_variation_kn_per_s": 6.0,
    "coupler_draft_max_kn": 30.0, "coupler_buff_max_kn": -50.0, "overspeed_max_kmh": 0.0, "tracking_findings": [],
}  # fmt: skip
ONES = {term.key: 1.0 for term in objective.TERMS}


def test_score_is_the_weighted_mean_of_metrics_over_their_scales() -> None:
    """Breaks if a weight, a scale, the magnitude of a signed metric or a term is lost."""
    scales = {"speed": 0.4, "stop": 0.5, "command": 3.0, "coupler": 100.0, "overspeed": 0.5}
    weights = {"speed": 2.0, "stop": 1.0, "command": 1.0, "coupler": 1.0, "overspeed": 1.0}
    expected = (2 * 0.2 / 0.4 + 0.1 / 0.5 + 6.0 / 3.0 + 50.0 / 100.0 + 0.0) / 6
    assert objective.score_of_run(DONE, scales, weights) == pytest.approx(expected)
    without_stop = {key: value for key, value in DONE.items() if key != "stop_error_max_m"}
    assert objective.score_of_run(without_stop, scales, weights) == pytest.approx((1.0 + 2.0 + 0.5) / 5)


def test_scale_is_the_limit_of_the_criterion_or_the_reference_run() -> None:
    """Breaks if a limit in SI is used as km/h or kN, or if a tiny reference makes a term infinite."""
    criteria = Criteria(overspeed=0.5, coupler_draft=2e5, coupler_buff=1e5)
    scales = objective.scales_of(criteria, {**DONE, "stop_error_max_m": -0.001})
    assert scales == pytest.approx({"speed": 0.2, "stop": 0.1, "command": 6.0, "coupler": 100.0, "overspeed": 1.8})


def test_a_failed_criterion_costs_more_than_its_metric() -> None:
    """Breaks if the verdict has no effect on the score."""
    row = {"criterion": "jerk", "metric": "jerk_1s_max", "value": 0.9, "limit": 0.6, "passed": False}
    passed = objective.score_of_run({**DONE, "criteria": [{**row, "passed": True}]}, ONES, ONES)
    assert objective.score_of_run({**DONE, "criteria": [row]}, ONES, ONES) == pytest.approx(passed + 1.5)


def test_runs_that_are_not_tracked_rank_below_every_tracked_run() -> None:
    """Breaks if an infeasible run can win, or if the search has no direction among infeasible runs."""
    scores = [objective.score_of_run({**DONE, "speed_rmse_kmh": 1e9}, ONES, ONES)]
    for outcome in reversed(OUTCOMES[:-1]):
        for value in (2.1, -40.0):
            found = [{"outcome": outcome, "value": value, "limit": 2.0}]
            scores.append(objective.score_of_run({**DONE, "tracking_findings": found}, ONES, ONES))
    scores += [objective.score_of_run({"status": status}, ONES, ONES) for status in ("failed", "refused")]
    assert scores == sorted(scores) and len(set(scores)) == len(scores)
    assert scores[0] == objective.MAX_FEASIBLE < objective.NOT_TRACKED < scores[1]


def test_objective_counts_the_worst_run() -> None:
    """Breaks if gains that fail in one run of many pass as feasible."""
    score = objective.GainScore.of([1.0, 2.0, 103.0])
    assert score.objective == pytest.approx((106 / 3 + 103.0) / 2)
    assert not score.feasible and objective.GainScore.of([1.0, 99.0]).feasible


@pytest.mark.parametrize(("texts", "words"), [
    (["sped=1"], "unknown term 'sped'"), (["speed=-1"], "not a weight"), (["speed"], "not a weight"),
    (["speed=nan"], "not a weight"), ([f"{term.key}=0" for term in objective.TERMS], "every weight is 0"),
])  # fmt: skip
def test_bad_weights_are_refused(texts: list[str], words: str) -> None:
    """Breaks if a misspelt criterion is ignored."""
    with pytest.raises(ValueError, match=words):
        objective.read_weights(texts)


def test_ranges_are_a_factor_of_ten_within_the_declared_bounds() -> None:
    """Breaks if a bound of the law is exceeded, or if words, switches and zeros vary."""
    space = gain_space("smc", {"alpha": 5.0, "l2": 0.0})
    found = {entry.key: (entry.low, entry.high) for entry in space.dimensions}
    assert found["l1"] == (0.1, 10.0)
    assert found["alpha"] == (0.5, 10.0)
    assert {"l2", "phi", "anti_windup", "equivalent"}.isdisjoint(found)


def test_the_search_begins_at_the_gains_of_the_scenario() -> None:
    """Breaks if the coordinates of a logarithmic range are linear, or a start value is ignored."""
    space = gain_space("pid", {"kp": 0.3, "ki": 0.02}, ["kp", "ki"])
    assert space.gains_at(space.start_point) == {"kp": 0.3, "ki": 0.02}
    begun = gain_space("pid", {"kp": 0.3}, ["kp"], read_tune_spec({"start": {"kp": 0.04}}))
    assert begun.gains_at(begun.start_point) == {"kp": 0.04} and begun.initial == {"kp": 0.3}


def test_candidates_have_three_significant_digits_within_the_range() -> None:
    """Breaks if shipped gains differ from the evaluated ones, or rounding leaves the range."""
    spec = read_tune_spec(
        {"over": {"kp": {"from": 0.12345, "to": 0.98765}, "feedforward": [True], "gains": ["printed"]}}
    )
    space = gain_space("pid", {}, None, spec)
    assert space.gains_at([0.5])["kp"] == float(f"{(0.12345 + 0.98765) / 2:.3g}")
    assert [space.gains_at([share])["kp"] for share in (-1.0, 0.0, 1.0, 2.0)] == [0.12345, 0.12345, 0.98765, 0.98765]
    assert space.gains_at([0.5])["feedforward"] is True and len(space.dimensions) == 1


@pytest.mark.parametrize(
    ("names", "over", "words"),
    [
        (["kpp"], {}, r"--parameters kpp: no parameter of pid; did you mean 'kp'\?"),
        (["kd"], {}, r"--parameters kd: pid.kd is 0.0 in the scenario"),
        (["feedforward"], {}, "--parameters feedforward: pid.feedforward is True"),
        (None, {"kp": {"from": -1, "to": 1}}, "over: over: kp: beyond the bounds 0"),
        (None, {"gains": {"from": 1, "to": 2}}, "no numbers"),
        (None, {"laws.smc.l1": [1, 2]}, "over: over: laws.smc.l1: no parameter of pid"),
        (None, {"gains": ["printed"]}, "no numeric parameter"),
    ],
)
def test_bad_search_spaces_are_refused(names: list[str] | None, over: dict[str, Any], words: str) -> None:
    """Breaks if a wrong range ends in refused candidates in place of a message."""
    spec = read_tune_spec({"over": over} if over else {"start": {}})
    with pytest.raises(ValueError, match=words):
        gain_space("pid", {}, names, spec)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[1]", "no mapping"),
        ("law: pid", "unknown key 'law'; use over, start, variations"),
        ("over: {}", "over: no keys"),
        ("start: 3", "start: 3 is no mapping"),
        ("variations: 3", "variations: not a list"),
        ("variations: [{laws.pid.kp: 1}]", "entry 1: laws.pid.kp: law and seed have their own options"),
        ("variations: [{law: 'os:system'}]", "entry 1: law: law and seed"),
        ("over: {kp: !!python/object/apply:os.system [true]}", "spec.yaml"),
    ],
)
def test_bad_files_are_refused(tmp_path: Path, text: str, words: str) -> None:
    """Breaks if a wrong key is ignored, or a file can name code."""
    path = tmp_path / "spec.yaml"
    path.write_text(text)
    with pytest.raises(ValueError, match=words):
        read_tune_spec(path)


def test_optimizer_finds_the_minimum_of_a_known_function() -> None:
    """Breaks if scores go to the wrong points, or the start point and the bounds are ignored."""
    # Hundred times the squared distance from (0.3, 0.6): 20 generations of 6 points reduce it from 29 at the start to
    # less than 1, a distance of 0.1, for both seeds; points drawn at random reach it only near the target.
    for seed in (1, 2):
        optimizer = objective.CmaOptimizer([0.8, 0.8], seed, 6)
        for _ in range(20):
            points = optimizer.ask()
            assert all(0.0 <= share <= 1.0 for point in points for share in point)
            scores = [100 * ((x - 0.3) ** 2 + (y - 0.6) ** 2) for x, y in points]
            optimizer.tell(points, scores)
        assert max(scores) < 1.0
    assert all(len(point) == 1 for point in objective.CmaOptimizer([0.5], 1, 6).ask())


def test_equal_candidates_are_run_once() -> None:
    """Breaks if rounding makes the search repeat runs, or a repeated candidate gets the score of another."""
    tasks = gain_tasks([ta.scenario("xuzhou_metro").with_(duration=5)], "pid", SEARCHED, None)
    runs: list[Any] = []

    def counted(work: Any) -> dict[str, Any]:
        runs.append(work)
        return runner(work)

    runner = GainRunner(tasks)
    search = GainSearch(gain_space("pid", {}, ["kp"]), [0], [ONES], ONES, lambda works: [*map(counted, works)])
    search.evaluate([{}])
    found = search.evaluate([{"kp": 2.0}, {"kp": 0.1}, {"kp": 2.0}])
    assert found[0].scores == found[2].scores != found[1].scores
    assert len(runs) == 3 and [entry.number for entry in search.candidates] == [0, 1, 2, 3]
    assert search.best.score.objective == min(entry.score.objective for entry in search.candidates)


@pytest.fixture(scope="module")
def tuned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Path]:
    """Return a tuning of poor initial gains over two seeds, with held-out runs, and its folder."""
    out = tmp_path_factory.mktemp("tune") / "out"
    poor = {**SHORT, "laws.pid.kp": 0.05, "laws.pid.ki": 0.005, "plant.sensors.velocity_noise": 0.02}
    result = ta.tune(
        "xuzhou_metro", "pid", set=poor, parameters=["kp", "ki"], seeds=[1, 2], held_out=["xuzhou_metro:slower"],
        held_out_seeds=[7], runs=12, out=out,
    )  # fmt: skip
    return result, out


def test_tuned_gains_are_better_and_held_out_runs_are_beside(tuned: tuple[Any, Path]) -> None:
    """Breaks if the best candidate is not the result, or if a held-out run is missing or used by the search."""
    result, _ = tuned
    assert result.improved and result.score("tuned").objective < result.score("initial").objective
    assert result.score("tuned").objective == pytest.approx(result.history["objective"].min())
    held = [row["run"] for row in result.rows if row["part"] == "held out" and row["gains"] == "tuned"]
    assert held == [
        "xuzhou_metro, seed 7", "xuzhou_metro:slower, seed 1", "xuzhou_metro:slower, seed 2",
        "xuzhou_metro:slower, seed 7",
    ]  # fmt: skip
    assert [key for key in result.candidates[0] if key.startswith("score: ")] == [
        "score: xuzhou_metro, seed 1", "score: xuzhou_metro, seed 2",
    ]  # fmt: skip
    assert len({row["speed_rmse_kmh"] for row in result.rows}) == len(result.rows), "seeds without effect"


def test_overlay_reproduces_the_tuned_run_beside_its_tables(tuned: tuple[Any, Path]) -> None:
    """Breaks if the file lacks gains, law or changes of --set, or a candidate is missing from the history."""
    result, out = tuned
    row = next(row for row in result.rows if row["gains"] == "tuned")
    run = ta.run(out / "tuned.yaml", seed=1)
    assert run.metrics["controller"] == "pid" and run.metrics["simulated_s"] == 10
    assert run.metrics["speed_rmse_kmh"] == row["speed_rmse_kmh"]
    assert yaml.safe_load((out / "tuned.yaml").read_text())["base"] == "xuzhou_metro"
    with (out / "history.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["candidate"]) for row in rows] == list(range(1 + 6))
    assert [float(row["objective"]) for row in rows] == [entry["objective"] for entry in result.candidates]
    assert json.loads((out / "tune.json").read_text())["gains"] == result.gains
    assert (out / "table.csv").read_text().count("\n") == 1 + len(result.rows)


def test_the_number_of_processes_does_not_change_the_result(capfd: pytest.CaptureFixture[str]) -> None:
    """Breaks if scores are used in the order of completion, with a common random stream, or each process has a note."""
    late = [{"at": 50, "do": "gust", "acceleration": 0.1, "duration": 1}]
    given: Any = {"set": {"duration": 5, "interventions": late}, "parameters": ["kp"], "runs": 12, "search_seed": 3}
    one = ta.tune("xuzhou_metro", "pid", **given)
    two = ta.tune("xuzhou_metro", "pid", jobs=2, **given)
    assert one.candidates == two.candidates and one.rows == two.rows
    assert capfd.readouterr().err.count("before the intervention at 50 s") == 1
    other = ta.tune("xuzhou_metro", "pid", **{**given, "search_seed": 4, "runs": 6})
    assert other.candidates[1] != one.candidates[1]


def test_variations_are_runs_of_the_search(tmp_path: Path) -> None:
    """Breaks if a variation is not applied, or applied to the held-out runs."""
    spec = tmp_path / "spec.yaml"
    spec.write_text("over: {kp: {from: 0.5, to: 2, scale: log}}\nvariations: [{plant.mismatch.mass_scale: 0.8}]\n")
    result = ta.tune("xuzhou_metro", "pid", set=SHORT, over=spec, held_out=["xuzhou_metro:disturbed"], runs=12)
    first = [row for row in result.rows if row["gains"] == "initial"]
    assert [row["run"] for row in first] == [
        "xuzhou_metro", "xuzhou_metro, plant.mismatch.mass_scale=0.8", "xuzhou_metro:disturbed",
    ]  # fmt: skip
    assert first[1]["speed_rmse_kmh"] > first[0]["speed_rmse_kmh"]


def test_command_prints_one_json_value(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if another text is on standard output."""
    out = tmp_path / "out"
    command = ["tune", "xuzhou_metro", "--law", "pid", "--set", "duration=5", "--parameters", "kp"]
    assert main([*command, "--runs", "6", "--out", str(out), "--json"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["settings"]["candidates"] == 7
    assert load_scenario(str(out / "tuned.yaml"))[0].law == "pid"


def test_missing_optimizer_is_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "cma", None)
    assert main(["tune", "demo", "--law", "pid"]) == 2
    said = "train-ato: tune: the package 'cma' is not installed; install it: pip install cma\n"
    assert capsys.readouterr().err == said


class Killed(BaseException):
    """End of a process in the middle of a run."""


class Search(NamedTuple):
    """Command with the place of its runs, the files of its result, and an option that makes it another search."""

    words: tuple[str, ...]
    module: Any
    run: str
    files: tuple[str, ...]
    other: tuple[str, ...]
    kept: str = ""


SEARCHES = {
    "tune": Search(
        ("--law", "pid", "--parameters", "kp", "--runs", "12", "--held-out-seeds", "5"),
        gain_module, "run_engine", ("tuned.yaml", "table.csv", "history.csv", "tune.json"), ("--search-seed", "2"),
    ),
    "falsify": Search(
        ("--requirement", "G speed < 1000 km/h", "--over", "over.yaml", "--runs", "5"),
        study, "run_engine", ("runs.csv", "falsify.json"), ("--seed", "2"),
    ),
    "learn": Search(("--runs", "4"), learn, "drive", ("",), ("--spacing", "7"), ".runs"),
}  # fmt: skip


@pytest.mark.parametrize("command", SEARCHES)
def test_a_killed_search_goes_on(command, tmp_path, monkeypatch, capsys):
    """Breaks if finished runs are run again, the result is another one, or the results of another search are used."""
    monkeypatch.chdir(tmp_path)
    Path("cheap.yaml").write_text(json.dumps(CHEAP))
    Path("over.yaml").write_text("over: {plant.mismatch.mass_scale: {from: 0.9, to: 1.3}}\n")
    search = SEARCHES[command]
    run: Callable[..., Any] = getattr(search.module, search.run)
    calls, last = 0, 10_000

    def counted(*arguments: Any, **options: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls > last:
            raise Killed
        return run(*arguments, **options)

    monkeypatch.setattr(search.module, search.run, counted)

    def words(out: str, *more: str) -> list[str]:
        return [command, "cheap.yaml", *search.words, "--out", out, *more]

    assert main(words("whole.yaml")) == 0
    needed, calls, last = calls, 0, 3
    with pytest.raises(Killed):
        main(words("cut.yaml"))
    kept = Path(f"cut.yaml{search.kept}")
    with (kept / RUNS).open("a") as file:
        file.write('{"run": 4, "inp')  # the line that the killed process was writing
    assert main(words("cut.yaml", *search.other)) == 2
    assert "cut.yaml" in (said := capsys.readouterr().err) and "cannot be continued: the specification" in said
    with (kept / RUNS).open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert main(words("cut.yaml")) == 2
    assert "another search writes into it" in capsys.readouterr().err
    calls, last = 0, 10_000
    assert main(words("cut.yaml")) == 0
    assert calls == needed - 3
    for name in search.files:
        assert Path("cut.yaml", name).read_text() == Path("whole.yaml", name).read_text()
    assert not search.kept or not kept.exists()


def test_a_finished_search_goes_on_with_more_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the budget is part of the search: its runs would be lost when it was too small."""
    monkeypatch.chdir(tmp_path)
    Path("cheap.yaml").write_text(json.dumps(CHEAP))
    words = ["tune", "cheap.yaml", "--law", "pid", "--parameters", "kp", "--out"]
    assert main([*words, "more", "--runs", "6"]) == main([*words, "more", "--runs", "12"]) == 0
    assert main([*words, "once", "--runs", "12"]) == 0
    assert Path("more/history.csv").read_text() == Path("once/history.csv").read_text()


def test_results_are_found_by_their_input(tmp_path: Path) -> None:
    """Breaks if values that are no finite numbers, or equal in a few digits, are taken for others."""
    with SearchFolder(tmp_path).kept("falsify", {}, "") as kept:
        kept.add({"a": 0.1 + 0.2, "b": "nan"}, [float("nan"), ""])
        kept.add((1, None), {"value": float("inf")})
    with SearchFolder(tmp_path).kept("falsify", {}, "") as kept:
        assert isinstance(kept, KeptRuns) and len(kept) == 2
        assert str(kept.find({"a": 0.30000000000000004, "b": "nan"})) == "[nan, '']"
        assert kept.find({"a": 0.3, "b": "nan"}) is None
        assert kept.find([1, None]) == {"value": float("inf")}
