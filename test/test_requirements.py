"""Requirements: grammar with units, robustness beside rtamt and the definition, verdict of run, log and live page."""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from commands import answer
from engine_runs import setup_of
from recordings import recording_of
from refusals import one_line

import train_ato as ta
from train_ato.cli import main
from train_ato.judge import requirements as req
from train_ato.judge.recording import Recording
from train_ato.judge.stops import planned_stops
from train_ato.judge.verdict import judge_run
from train_ato.loop.engine import run_engine
from train_ato.report.page_data import empty_page_data
from train_ato.report.summary_rows import criterion_cells, verdict_texts
from train_ato.scenario.formula import UNITS, NumberTerm, Predicate, Temporal, nodes_of, parse_formula, signals_of
from train_ato.scenario.setup import RunSetup
from train_ato.scenario.signals import SIGNALS
from train_ato.view.live import LiveRequirements
from train_ato.view.snapshot import Snapshot

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
    with one_line("column", message):
        parse_formula(text)


@pytest.mark.parametrize(("one", "other"), [
    ("G speed <= 36 km/h", "always speed <= 10 m/s"),
    ("G jerk <= 0.3 m/s3", "G jerk <= 0.3 m/s³"),
    ("F[0, 2 min] speed > 0", "eventually[0:120] speed >= 0"),
    ("G speed <= limit and F speed > 0 or not G limit > 0",
     "((G (speed <= limit)) and (F speed > 0)) or (not (G limit > 0))"),
    ("G (speed > 0 -> limit > 0 -> speed > 0)", "G (speed > 0 -> (limit > 0 -> speed > 0))"),
    ("G (position / speed <= 2 s * 3)", "G ((position / speed) <= (2 s * 3))"),
    ("G -speed <= 1 m/s U limit > 0", "(G (-speed <= 1 m/s)) U[0, end] (limit > 0)"),
])  # fmt: skip
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
    assert SIGNALS.keys() == req.SERIES.keys()
    for signal in SIGNALS.values():
        assert signal.unit in {"s", "m", "m/s", "m/s²", "m/s³", "N", "Pa"}
        assert signals_of(parse_formula(f"G {signal.name} >= 0")) == (signal.name,)


def test_the_way_back_has_its_own_distance_to_the_stop() -> None:
    """To 100 m, a stop of 20 s, and back to 40 m: breaks if a train 30 m before the second stop is beyond it."""
    there = {"accelerate_to": 5.0}, {"brake_to": 0.0}, {"cruise_for": 20.0}
    setup = setup_of("xuzhou_metro", f"profile={{phases: {[*there, {'accelerate_to': -3.0}, {'brake_to': 0.0}]}}}")
    first, last = planned_stops(setup.profile)
    assert last.position < first.position
    times, places = np.array([0.0, last.arrival]), np.array([first.position - 30.0, last.position + 30.0])
    found = req.signal_series(["distance_to_stop"], setup, recording_of(times, 1, front_position=places))
    assert found["distance_to_stop"] == pytest.approx([30.0, 30.0])


def test_signals_have_the_values_of_the_recording() -> None:
    """Breaks if a signal is that of another topic, unit or sign, or a slow topic is not held."""
    setup = setup_of("demo", "duration=40")
    recording = run_engine(setup).recording
    assert recording is not None
    names = (*SIGNALS, "command_0", "effort_0")
    found = req.signal_series(names, setup, recording)
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
    assert (found["coupler_draft"] >= 0).all() and (found["coupler_buff"] <= 0).all()
    assert found["limit"][0] == min(limit.speed for limit in setup.line.speed_limits if limit.at <= found["front"][0])


def made_up(speed: np.ndarray) -> Recording:
    time = 0.1 * np.arange(speed.size)
    return recording_of(time, front_velocity=speed, front_position=np.cumsum(speed))


def test_the_row_has_value_time_unit_and_the_sign_decides() -> None:
    """Breaks if a broken requirement passes, or the place of the smallest margin is another one."""
    formulas = "{slow: 'G speed <= 3 m/s', moves: 'F[0.5,end] speed >= 2 m/s'}"
    setup = setup_of("demo", "duration=1", f"criteria.requirements={formulas}")
    slow, moves = req.requirement_rows(setup, made_up(np.array([0, 1, 4, 2, 1, 0, 1, 1.5, 0, 0])))
    assert (slow["criterion"], slow["value"], slow["at_s"], slow["unit"]) == ("slow", -1.0, pytest.approx(0.2), "m/s")
    assert (slow["passed"], moves["passed"], moves["value"], moves["at_s"]) == (False, False, -0.5, pytest.approx(0.7))
    exact = req.evaluate_formula(parse_formula("G speed <= 4 m/s"), setup, made_up(np.array([0, 1, 4.0] + 7 * [0.0])))
    assert exact.passed is True, "robustness 0 is no violation"


@pytest.mark.parametrize(("formula", "at_s"), [
    ("G speed <= 3 m/s and G speed >= 1 m/s", 0.2), ("F speed >= 9 m/s or G[0.4,end] speed <= 2 m/s", 0.2),
    ("not F speed >= 3 m/s", 0.2), ("F[0,0.1] speed >= -2 m/s -> G[0.4,end] speed >= 3 m/s", 0.9),
    ("speed >= 1 m/s and F speed >= 1 m/s", 0.0), ("speed >= 0 U speed >= 4 m/s", None),
])  # fmt: skip
def test_a_compound_formula_has_the_time_of_its_decisive_part(formula: str, at_s: float | None) -> None:
    """Breaks if the time is that of the part with the larger margin, or of the wrong end of a window."""
    speed = np.array([0, 1, 9, 2, 4, 4, 4, 4, 4, 2.0])
    found = req.evaluate_formula(parse_formula(formula), setup_of("demo", "duration=1"), made_up(speed))
    assert found.at_s == (None if at_s is None else pytest.approx(at_s))


def test_an_ended_run_is_judged_by_its_bounds_only() -> None:
    """Breaks if an interrupted run passes a requirement on its rest, or a violation before its end is lost."""
    setup = setup_of("demo", "duration=10")
    start = made_up(np.array([0.0, 1.0, 2.0]))
    texts = ("G speed <= 3 m/s", "G speed <= 1 m/s", "F speed >= 2 m/s", "F speed >= 3 m/s", "F[20, 30] speed >= 0")
    results = [req.evaluate_formula(parse_formula(text), setup, start).passed for text in texts]
    assert results == [None, False, True, None, None]


def test_mixed_quantities_have_no_unit() -> None:
    """Breaks if the minimum of a speed and a length is shown with one of both units."""
    setup = setup_of("demo", "duration=0.3")
    found = req.evaluate_formula(parse_formula("G (speed <= 3 m/s and position >= 0)"), setup, made_up(np.zeros(3)))
    assert (found.unit, found.value) == ("", 0.0)


def test_requirements_decide_the_verdict_of_a_run_and_are_on_its_page() -> None:
    """Breaks if a requirement is not evaluated in a run, its failure does not fail the run, or the page lacks it."""
    run = short(limit=LAW, force="G abs(command) <= 1 kN")
    rows = {row["criterion"]: row for row in run.metrics["criteria"]}
    assert run.metrics["verdict"] == "failed"
    assert (rows["limit"]["passed"], rows["force"]["passed"]) == (True, False)
    assert rows["force"]["value"] == pytest.approx(1e3 - np.abs(run["ato/command"]["unit_0_force_n"]).max())
    assert judge_run(run.setup.scenario.criteria, {"status": "done"}, [rows["limit"]])["verdict"] == "incomplete"
    page = empty_page_data("run", run.metrics, "")
    found = {words: cells for words, _, cells in criterion_cells([page])}
    assert found[f"limit: {LAW}"][0][1] == "passed"
    assert found["force: G abs(command) <= 1 kN"][0][1] == "failed"
    assert "force: robustness −" in verdict_texts([page])[0]["text"]


@pytest.mark.usefixtures("without_figure")
def test_the_log_gives_the_rows_of_the_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the evaluation of a log differs from that in memory, or a new formula cannot be evaluated on a log."""
    run = short(limit=LAW)
    folder = run.save(tmp_path / "run")
    summary = answer(capsys, "info", str(folder), "--requirement", LAW)
    (recorded,) = [row for row in summary["criteria"] if row["criterion"] == "limit"]
    assert {**summary["requirements"][0], "criterion": "limit"} == recorded
    assert main(["info", str(folder)]) == 0
    assert f"limit: {LAW} in m/s" in capsys.readouterr().out
    assert main(["verify", str(folder)]) == 0


def test_a_scenario_without_requirements_is_unchanged() -> None:
    """Breaks if the new key appears in the scenario of a run without one, and with it in its fingerprint."""
    assert "requirements" not in setup_of("demo", "duration=1").resolved_yaml()


def test_a_quantity_is_a_root_of_the_tree() -> None:
    """Breaks if the tree of the documented example changes its form."""
    formula = parse_formula(LAW)
    assert isinstance(formula, Temporal) and isinstance(formula.operand, Predicate)
    assert replace(formula, operator="F") == parse_formula("F (speed <= limit + 1 km/h)")


TICK = 0.1
SIZE, LONGEST = 40, 15


def samples(stream: np.random.Generator, size: int = SIZE) -> dict[str, np.ndarray]:
    return {name: stream.normal(size=size) for name in DRAWN}


def evaluated(node: Node, signals: dict[str, np.ndarray]) -> np.ndarray:
    formula = parse_formula(text_of(node))
    found = req.robustness_series(formula, signals, TICK)
    np.testing.assert_array_equal(req.robustness_at_start(formula, signals, TICK), found[0])
    return found


def assert_equal(found: np.ndarray, wanted: np.ndarray, text: str) -> None:
    """Require agreement but for rounding: the order of the operations is that of the definition."""
    finite = np.isfinite(wanted)
    assert np.array_equal(found[~finite], wanted[~finite]), text
    assert np.abs(found[finite] - wanted[finite]).max(initial=0.0) <= 1e-9, text


def test_500_random_formulas_equal_rtamt() -> None:
    """Breaks if an operator, a window, the end of the run or the precedence of the text has another meaning."""
    try:
        importlib.import_module("rtamt")
    except ImportError as error:
        pytest.skip(f"rtamt: {error}; it has no release for this Python")
    operators = set()
    for seed in range(500):
        stream = np.random.default_rng(seed)
        node, signals = random_formula(stream, 1 + seed % 4, LONGEST), samples(stream)
        operators.add(node.kind)
        assert_equal(evaluated(node, signals), with_rtamt(node, signals), text_of(node))
    assert operators == {"not", "and", "or", "->", "G", "F", "H", "O", "U", "S"}


def test_windows_up_to_beyond_the_run_equal_the_definition() -> None:
    """Breaks if a window is cut wrongly at the ends of a run, also where it is longer than the run."""
    for seed in range(150):
        stream = np.random.default_rng(1000 + seed)
        node, signals = random_formula(stream, 1 + seed % 2, 20), samples(stream, 12)
        wanted = np.array([textbook(node, signals, at) for at in range(12)])
        assert_equal(evaluated(node, signals), wanted, text_of(node))


def test_bounds_contain_every_continuation_and_close_with_the_run() -> None:
    """Breaks if a prefix of a run promises a result that a continuation does not have."""
    decided = 0
    for seed in range(150):
        stream = np.random.default_rng(2000 + seed)
        node, signals = random_formula(stream, 1 + seed % 3, LONGEST), samples(stream)
        formula = parse_formula(text_of(node))
        known = int(stream.integers(1, SIZE + 1))
        prefix = {name: values[:known] for name, values in signals.items()}
        lower, upper = req.robustness_bounds(formula, prefix, TICK, SIZE - known)
        for _ in range(5):
            other = samples(stream)
            whole = {name: np.append(prefix[name], other[name][known:]) for name in DRAWN}
            value = req.robustness_series(formula, whole, TICK)[0]
            assert lower <= value <= upper, text_of(node)
        decided += lower > 0 or upper < 0
        final = req.robustness_series(formula, signals, TICK)[0]
        assert req.robustness_bounds(formula, signals, TICK, 0) == (final, final)
    assert decided > 20, "the bounds never decide"


@pytest.mark.parametrize(("text", "wanted"), [
    ("G speed <= 4 m/s", 0.0), ("F[0.1, 0.3] speed >= 3 m/s", 0.0), ("G[0.1, 0.25] speed <= 4 m/s", 2.0),
    ("F[5, 6] speed >= 0", -np.inf), ("G[5, 6] speed >= 0", np.inf), ("speed <= 1 m/s U speed >= 3 m/s", -1.0),
    ("G[0.2, end] speed >= 3 m/s", -1.0),
])  # fmt: skip
def test_values_by_hand(text: str, wanted: float) -> None:
    """Breaks if a window counts a sample beside its limits, or an empty window is finite."""
    found = req.robustness_series(parse_formula(text), {"speed": np.arange(5.0)}, TICK)[0]
    assert found == pytest.approx(wanted, abs=1e-12)


def test_a_quotient_by_zero_is_not_evaluated_as_passed() -> None:
    """Breaks if a division by zero raises a warning, or counts as fulfilled."""
    signals = {"speed": np.zeros(3), "position": np.zeros(3)}
    assert np.isnan(req.robustness_series(parse_formula("G position / speed <= 3 s"), signals, TICK)[0])


FORMULAS = (
    "{slow: 'G speed <= 0.1 km/h', moves: 'F speed >= 1 km/h', force: 'G abs(command) <= 800 kN', "
    "pipe: 'G pipe_pressure >= 300 kPa', below: 'G speed <= permitted_speed', draft: 'G coupler_draft <= 900 kN', "
    "keeps: 'G (speed >= 0.5 km/h -> F[0,5] abs(speed_error) <= 2 km/h)'}"
)


def snapshots(setup: RunSetup, recording: Recording) -> list[Snapshot]:
    """Return a snapshot of every tick."""
    held, pipe = recording.of("atp/speeds", "speed"), recording.of("train/brake_pipe", "pressure")[1]
    rows = np.searchsorted(held[0], recording.time, side="right") - 1
    r = recording
    return [
        Snapshot(
            time=float(stamp), position=r.front_position[[row]], velocity=r.front_velocity[[row]], shoe=None,
            coupler=np.array([r.coupler_draft_max[row], r.coupler_buff_max[row]]), applied=r.applied[row],
            command=r.command[row], estimate=r.estimate[row], pipe=float(pipe[row, 0]), limits=held[1][rows[row], 1:],
            reference=tuple(float(part[row]) for part in
                            (r.reference_position, r.reference_velocity, r.reference_acceleration)),
        )
        for row, stamp in enumerate(recording.time)
    ]  # fmt: skip


def test_the_live_values_are_those_of_the_recording_and_never_contradict_it() -> None:
    """Breaks if a signal of the page is another one, or a requirement is decided against its later result."""
    setup = setup_of("demo", "duration=30", f"criteria.requirements={FORMULAS}")
    recording = run_engine(setup).recording
    moments = snapshots(setup, recording)
    live = LiveRequirements(setup)
    wanted = {row["criterion"]: row for row in req.requirement_rows(setup, recording)}
    early = {}
    for row, moment in enumerate(moments):
        live.add(moment)
        if row in (50, 250):
            early[row] = live.evaluate()
    for found in early.values():
        for name, bounds in found.items():
            assert bounds.lower <= wanted[name]["value"] <= bounds.upper
            assert bounds.passed in (None, wanted[name]["passed"])
    assert [early[250][name].passed for name in ("slow", "moves", "force")] == [False, True, None]
    final = live.evaluate()
    assert {name: found.value for name, found in final.items()} == {name: row["value"] for name, row in wanted.items()}
    assert "slow: broken, robustness" in live.markup or "slow: open" in live.markup


def test_a_page_that_joins_late_shows_nothing_and_frames_between_ticks_are_held() -> None:
    """Breaks if the missing start of a run counts as fulfilled, or a repeated frame as a new sample."""
    setup = setup_of("demo", "duration=3", f"criteria.requirements={FORMULAS}")
    moments = snapshots(setup, run_engine(setup).recording)
    late = LiveRequirements(setup)
    late.add(replace(moments[-1], time=5.0))
    assert late.evaluate() == {} and late.markup == ""
    sparse = LiveRequirements(setup)
    for moment in (moments[0], moments[0], moments[10]):
        sparse.add(moment)
    assert sparse._recording().time.size == 11
    assert sparse._recording().front_velocity[9] == moments[0].velocity[0]


def test_a_far_stamp_is_not_a_tick_of_the_run() -> None:
    """Breaks if one foreign message makes the page sample the run up to its stamp, or ends the evaluation."""
    setup = setup_of("demo", "duration=20", f"criteria.requirements={FORMULAS}")
    recording = run_engine(setup).recording
    live, moments = LiveRequirements(setup), snapshots(setup, recording)
    for moment in [*moments[:100], replace(moments[0], time=1e9), *moments[100:]]:
        live.add(moment)
    wanted = {row["criterion"]: row["passed"] for row in req.requirement_rows(setup, recording)}
    assert {name: part.passed for name, part in live.evaluate().items()} == wanted


DRAWN = ("speed", "limit", "reference_speed")
RTAMT_WORDS = {"G": "always", "F": "eventually", "H": "historically", "O": "once", "U": "until", "S": "since"}


@dataclass(frozen=True)
class Node:
    """Operator, operands (nodes, names or numbers) and window in samples, None without one."""

    kind: str
    parts: tuple = ()
    window: tuple[int, int] | None = None


def random_formula(stream: np.random.Generator, depth: int, longest: int) -> Node:
    """Return a random formula; windows end at most after ``longest`` samples."""
    if depth == 0:
        return Node(str(stream.choice(["<=", ">=", "<", ">"])), (random_term(stream, 2), random_term(stream, 0)))
    kind = str(stream.choice(["not", "and", "or", "->", "G", "F", "H", "O", "U", "S"]))
    count = 1 if kind in ("not", "G", "F", "H", "O") else 2
    below = [random_formula(stream, int(stream.integers(0, depth)), longest) for _ in range(count)]
    window = None
    if kind in RTAMT_WORDS and stream.random() < 0.8:
        begin, end = sorted(int(limit) for limit in stream.integers(0, longest + 1, 2))
        window = (begin, end)
    return Node(kind, tuple(below), window)


def random_term(stream: np.random.Generator, depth: int) -> Node:
    kind = str(stream.choice(["signal", "number", "abs", "+", "-", "*"])) if depth else "signal"
    if kind == "signal":
        return Node("signal", (str(stream.choice(DRAWN)),))
    if kind == "number":
        return Node("number", (round(float(stream.normal()), 3),))
    if kind == "abs":
        return Node("abs", (random_term(stream, depth - 1),))
    scaled = kind == "*"
    first = Node("factor", (round(float(stream.uniform(0.1, 3)), 3),)) if scaled else random_term(stream, depth - 1)
    return Node(kind, (first, random_term(stream, depth - 1)))


def text_of(node: Node, rtamt: bool = False) -> str:
    """Return the text of a node; a sample lasts 1 s for rtamt and 0.1 s here."""
    parts = [text_of(part, rtamt) for part in node.parts if isinstance(part, Node)]
    if node.kind in ("signal", "factor"):
        return str(node.parts[0])
    if node.kind == "number":
        return f"({node.parts[0]})" if rtamt else f"({node.parts[0]} m/s)"
    if node.kind in ("abs", "not"):
        return f"{node.kind}({parts[0]})"
    window = ""
    if node.window is not None:
        begin, end = node.window
        window = f"[{begin}:{end}]" if rtamt else f"[{begin / 10}, {end / 10}]"
    word = RTAMT_WORDS[node.kind] if rtamt and node.kind in RTAMT_WORDS else node.kind
    if len(parts) == 1:
        return f"{word}{window}({parts[0]})"
    return f"({parts[0]}) {word}{window} ({parts[1]})"


def textbook(node: Node, signals: dict[str, np.ndarray], at: int) -> float:
    """Return the robustness at one sample by the definition, without sharing of intermediate results."""
    size = len(signals["speed"])
    kind = node.kind
    if kind in ("<=", "<"):
        return term(node.parts[1], signals, at) - term(node.parts[0], signals, at)
    if kind in (">=", ">"):
        return term(node.parts[0], signals, at) - term(node.parts[1], signals, at)
    if kind == "not":
        return -textbook(node.parts[0], signals, at)
    if kind in ("and", "or", "->"):
        left, right = (textbook(part, signals, at) for part in node.parts)
        return min(left, right) if kind == "and" else max(left, right) if kind == "or" else max(-left, right)
    begin, end = node.window or (0, size)
    sign = -1 if kind in ("H", "O", "S") else 1
    places = [at + sign * step for step in range(begin, end + 1) if 0 <= at + sign * step < size]
    if kind in ("G", "H"):
        return min((textbook(node.parts[0], signals, place) for place in places), default=math.inf)
    if kind in ("F", "O"):
        return max((textbook(node.parts[0], signals, place) for place in places), default=-math.inf)
    found = -math.inf
    for place in places:
        before = [textbook(node.parts[0], signals, other) for other in range(at, place, sign)]
        found = max(found, min([textbook(node.parts[1], signals, place), *before]))
    return found


def term(node: Node, signals: dict[str, np.ndarray], at: int) -> float:
    if node.kind == "signal":
        return float(signals[node.parts[0]][at])
    if node.kind in ("number", "factor"):
        return float(node.parts[0])
    values = [term(part, signals, at) for part in node.parts]
    if node.kind == "abs":
        return abs(values[0])
    if node.kind == "*":
        return values[0] * values[1]
    return values[0] + values[1] if node.kind == "+" else values[0] - values[1]


def with_rtamt(node: Node, signals: dict[str, np.ndarray]) -> np.ndarray:
    """Return the robustness at every sample from the discrete-time evaluator of rtamt."""
    import rtamt

    spec = rtamt.StlDiscreteTimeSpecification()
    for name in DRAWN:
        spec.declare_var(name, "float")
    spec.spec = text_of(node, rtamt=True)
    spec.parse()
    size = len(signals["speed"])
    rows = spec.evaluate({"time": list(range(size)), **{name: list(signals[name]) for name in DRAWN}})
    return np.array([value for _, value in rows])
