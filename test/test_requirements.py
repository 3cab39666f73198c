"""Requirements of a scenario: grammar with units, refusals, verdict of a run and of its log."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recordings import recording_of

import train_ato as ta
from train_ato.cli import main
from train_ato.loop.engine import run_engine
from train_ato.loop.recording import Recording
from train_ato.loop.requirements import evaluate_formula, requirement_rows
from train_ato.loop.series import TopicSamples
from train_ato.loop.setup import RunSetup, prepare
from train_ato.loop.signal_series import SERIES, signal_series
from train_ato.loop.verdict import judge_run
from train_ato.scenario.dimension import UNITS
from train_ato.scenario.formula import NumberTerm, Predicate, Temporal, nodes_of, signals_of
from train_ato.scenario.formula_parser import parse_formula
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.signals import SIGNALS

LAW = "G (speed <= limit + 1 km/h)"


def short(**requirements: str) -> ta.Run:
    return ta.run("demo", set={"duration": 40, "criteria.requirements": requirements})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("G (sped <= limit)", "column 4: 'sped': unknown signal; did you mean 'speed'?"),
        ("G speed <= 5", "column 9: '<=': compares m/s and a number without unit; write the unit, for example '5 m/s'"),
        ("G speed <= 200 kN", "column 9: '<=': compares m/s with N; compare quantities of one unit"),
        ("G (speed + position <= 3 m)", "column 10: '+': adds m/s with m"),
        ("G speed <= 5 knots", "column 14: 'knots': unknown unit"),
        ("G (speed <= limit", "column 18: end of the formula: expected ')'; add it"),
        ("G speed = 3 m/s", "column 9: '=': is no comparison of samples; write abs(a - b) <= tolerance"),
        ("speed", "column 1: 'speed': has a number or signal as operand"),
        ("G[3, 1] speed >= 0", "column 2: '[': the interval begins at 3 s and ends at 1 s; exchange them"),
        ("G[0, 3 m] speed >= 0", "column 6: '3 m': is no time"),
        ("G speed >= 0 limit", "column 14: 'limit': expected an operator or the end of the formula"),
        ("G 1 <= 2", "column 1: 'G': the formula has no signal"),
        ("not " * 60 + "speed >= 0", "more than 50 nested operators"),
        ("(" * 1990, "more than 50 nested operators"),
        ("", "column 1: end of the formula: expected a signal"),
        ("G speed >= 0 # x", "column 14: '#': unknown character"),
    ],
)
def test_a_wrong_formula_is_refused_at_its_place(text: str, message: str) -> None:
    """Breaks if a fault is accepted, or the message has another column or no remedy."""
    with pytest.raises(ValueError, match="column") as error:
        parse_formula(text)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("G speed <= 36 km/h", "always speed <= 10 m/s"),
        ("G jerk <= 0.3 m/s3", "G jerk <= 0.3 m/s³"),
        ("F[0, 2 min] speed > 0", "eventually[0:120] speed >= 0"),
        ("G speed <= limit and F speed > 0 or not G limit > 0",
         "((G (speed <= limit)) and (F speed > 0)) or (not (G limit > 0))"),
        ("G (speed > 0 -> limit > 0 -> speed > 0)", "G (speed > 0 -> (limit > 0 -> speed > 0))"),
        ("G (position / speed <= 2 s * 3)", "G ((position / speed) <= (2 s * 3))"),
        ("G -speed <= 1 m/s U limit > 0", "(G (-speed <= 1 m/s)) U[0, end] (limit > 0)"),
    ],
)  # fmt: skip
def test_spellings_units_and_precedence(one: str, other: str) -> None:
    """Breaks if a unit has another factor, or an operator another binding."""
    assert parse_formula(one) == parse_formula(other)


def test_every_unit_has_its_si_value() -> None:
    """Breaks if a suffix of the data files means another factor in a formula."""
    for unit, value in {"km/h": 1 / 3.6, "kN": 1e3, "MN": 1e6, "t": 1e3, "min": 60.0, "mm": 1e-3, "kPa": 1e3}.items():
        assert 1 / UNITS[unit][1] == pytest.approx(value)
        formula = parse_formula(f"G speed * (1 {unit}) >= 0")
        assert value in [pytest.approx(node.value) for node in nodes_of(formula) if isinstance(node, NumberTerm)]


def test_every_signal_has_a_series_and_a_unit() -> None:
    """Breaks if the table of the scenario layer and the series differ."""
    assert SIGNALS.keys() == SERIES.keys()
    for signal in SIGNALS.values():
        assert signal.unit in {"s", "m", "m/s", "m/s²", "m/s³", "N", "Pa"}
        assert signals_of(parse_formula(f"G {signal.name} >= 0")) == (signal.name,)


def setup_of(*assignments: str) -> RunSetup:
    return prepare(*load_scenario("demo", assignments))


def test_signals_have_the_values_of_the_recording() -> None:
    """Breaks if a signal is that of another topic, unit or sign, or a slow topic is not held."""
    setup = setup_of("duration=40")
    recording = run_engine(setup).recording
    assert recording is not None
    names = (*SIGNALS, "command_0", "effort_0")
    found = signal_series(names, setup, recording)
    assert all(found[name].shape == recording.time.shape and np.isfinite(found[name]).all() for name in names)
    speed = recording.front_velocity
    np.testing.assert_array_equal(found["speed_error"], speed - recording.reference_velocity)
    np.testing.assert_array_equal(found["command_0"], recording.command[:, 0])
    np.testing.assert_allclose(found["acceleration"][1:], np.diff(speed) / setup.tick)
    half = setup.consist.vehicles[0].length / 2
    np.testing.assert_array_equal(found["front"], recording.front_position + half)
    end = setup.profile.position[-1]
    np.testing.assert_allclose(found["distance_to_stop"], end - recording.front_position)
    means = [np.mean(found["acceleration"][row - 9 : row + 1]) for row in (50, 40)]
    assert found["jerk"][50] == pytest.approx(means[0] - means[1])
    times, values = recording.of("atp/speeds", "speed")
    row = int(np.searchsorted(times, recording.time[7], side="right")) - 1
    assert found["permitted_speed"][7] == values[row, 1]
    assert (found["coupler_draft"] >= 0).all()
    assert (found["coupler_buff"] <= 0).all()
    assert found["limit"][0] == min(limit.speed for limit in setup.line.speed_limits if limit.at <= found["front"][0])


def made_up(speed: np.ndarray) -> Recording:
    time = 0.1 * np.arange(speed.size)
    return recording_of(time, front_velocity=speed, front_position=np.cumsum(speed))


def test_the_row_has_value_time_unit_and_the_sign_decides() -> None:
    """Breaks if a broken requirement passes, or the place of the smallest margin is another one."""
    formulas = "{slow: 'G speed <= 3 m/s', moves: 'F[0.5,end] speed >= 2 m/s'}"
    setup = setup_of("duration=1", f"criteria.requirements={formulas}")
    slow, moves = requirement_rows(setup, made_up(np.array([0, 1, 4, 2, 1, 0, 1, 1.5, 0, 0])))
    assert (slow["criterion"], slow["value"], slow["at_s"], slow["unit"]) == ("slow", -1.0, pytest.approx(0.2), "m/s")
    assert (slow["passed"], moves["passed"], moves["value"], moves["at_s"]) == (False, False, -0.5, pytest.approx(0.7))
    exact = evaluate_formula(parse_formula("G speed <= 4 m/s"), setup, made_up(np.array([0, 1, 4.0] + 7 * [0.0])))
    assert exact.passed is True, "robustness 0 is no violation"


@pytest.mark.parametrize(
    ("formula", "at_s"),
    [
        ("G speed <= 3 m/s and G speed >= 1 m/s", 0.2),
        ("F speed >= 9 m/s or G[0.4,end] speed <= 2 m/s", 0.2),
        ("not F speed >= 3 m/s", 0.2),
        ("F[0,0.1] speed >= -2 m/s -> G[0.4,end] speed >= 3 m/s", 0.9),
        ("speed >= 1 m/s and F speed >= 1 m/s", 0.0),
        ("speed >= 0 U speed >= 4 m/s", None),
    ],
)
def test_a_compound_formula_has_the_time_of_its_decisive_part(formula: str, at_s: float | None) -> None:
    """Breaks if the time is that of the part with the larger margin, or of the wrong end of a window."""
    speed = np.array([0, 1, 9, 2, 4, 4, 4, 4, 4, 2.0])
    found = evaluate_formula(parse_formula(formula), setup_of("duration=1"), made_up(speed))
    assert found.at_s == (None if at_s is None else pytest.approx(at_s))


def test_an_ended_run_is_judged_by_its_bounds_only() -> None:
    """Breaks if an interrupted run passes a requirement on its rest, or a violation before its end is lost."""
    setup = setup_of("duration=10")
    start = made_up(np.array([0.0, 1.0, 2.0]))
    texts = ("G speed <= 3 m/s", "G speed <= 1 m/s", "F speed >= 2 m/s", "F speed >= 3 m/s", "F[20, 30] speed >= 0")
    results = [evaluate_formula(parse_formula(text), setup, start).passed for text in texts]
    assert results == [None, False, True, None, None]


def test_mixed_quantities_have_no_unit() -> None:
    """Breaks if the minimum of a speed and a length is shown with one of both units."""
    setup = setup_of("duration=0.3")
    found = evaluate_formula(parse_formula("G (speed <= 3 m/s and position >= 0)"), setup, made_up(np.zeros(3)))
    assert (found.unit, found.value) == ("", 0.0)


def test_requirements_decide_the_verdict_of_a_run() -> None:
    """Breaks if a requirement is not evaluated in a run, or its failure does not fail the run."""
    run = short(limit=LAW, force="G abs(command) <= 1 kN")
    rows = {row["criterion"]: row for row in run.metrics["criteria"]}
    assert run.metrics["verdict"] == "failed"
    assert rows["limit"]["passed"] is True
    assert rows["force"]["passed"] is False
    assert rows["force"]["value"] == pytest.approx(1e3 - np.abs(run["ato/command"]["unit_0_force_n"]).max())
    assert judge_run(run.setup.scenario.criteria, {"status": "done"}, [rows["limit"]])["verdict"] == "incomplete"


def test_the_log_gives_the_rows_of_the_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the evaluation of a log differs from that in memory, or a new formula cannot be evaluated on a log."""
    run = short(limit=LAW)
    folder = run.save(tmp_path / "run")
    assert main(["info", str(folder), "--json", "--requirement", LAW]) == 0
    summary = json.loads(capsys.readouterr().out)
    (recorded,) = [row for row in summary["criteria"] if row["criterion"] == "limit"]
    assert {**summary["requirements"][0], "criterion": "limit"} == recorded
    assert main(["info", str(folder)]) == 0
    assert f"limit: {LAW} in m/s" in capsys.readouterr().out
    assert main(["verify", str(folder)]) == 0


def test_the_report_has_formula_and_robustness() -> None:
    """Breaks if the page of a run leaves out its requirements."""
    from train_ato.apps.report.page_data import empty_page_data
    from train_ato.apps.report.verdict_rows import criterion_cells, verdict_texts

    metrics = short(limit=LAW, force="G abs(command) <= 1 kN").metrics
    page = empty_page_data("run", metrics, "")
    found = {entry.words: entry.cells for entry in criterion_cells([page])}
    assert found[f"limit: {LAW}"][0][1] == "passed"
    assert found["force: G abs(command) <= 1 kN"][0][1] == "failed"
    assert "force: robustness −" in verdict_texts([page])[0].text


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("criteria.requirements={a: 'G sped <= 0'}", "'}: criteria.requirements.a: column 3: 'sped': unknown"),
        ("criteria.requirements={a: 'G command_3 >= 0'}", "the train has 1 power units; use command_0"),
        ("criteria.requirements={'a b': 'G speed >= 0'}", "criteria.requirements"),
        ("criteria.requirements={a: 5}", "criteria.requirements.a"),
    ],
)  # fmt: skip
def test_a_wrong_requirement_is_refused_before_the_run(
    assignment: str, message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Breaks if a run starts with a requirement that it cannot evaluate, or a refusal has a traceback."""
    arguments = ["run", "demo", "--engine", "--set", assignment, "--out", str(tmp_path / "out")]
    assert main(arguments) == 2
    printed = capsys.readouterr().err
    assert message in printed
    assert printed.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("signal", ["pipe_pressure", "coupler_draft", "limit", "permitted_speed"])
def test_a_signal_that_the_train_lacks_is_refused(signal: str) -> None:
    """Breaks if a requirement on a missing brake pipe, coupler, limit or supervisor passes unevaluated."""
    with pytest.raises(ValueError, match=rf"criteria\.requirements\.a: signal '{signal}': the run needs"):
        prepare(*load_scenario("xuzhou_metro", (f"criteria.requirements={{a: 'G {signal} >= 0'}}",)))


def test_a_scenario_without_requirements_is_unchanged() -> None:
    """Breaks if the new key appears in the scenario of a run without one, and with it in its fingerprint."""
    assert "requirements" not in setup_of("duration=1").resolved_yaml()


def test_a_quantity_is_a_root_of_the_tree() -> None:
    """Breaks if the tree of the documented example changes its form."""
    formula = parse_formula(LAW)
    assert isinstance(formula, Temporal)
    assert isinstance(formula.operand, Predicate)
    assert replace(formula, operator="F") == parse_formula("F (speed <= limit + 1 km/h)")
    assert isinstance(made_up(np.zeros(3)).topics["train/vehicles"], TopicSamples)
