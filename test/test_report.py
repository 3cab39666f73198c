"""Report: agreement with the log including peaks and times, also for incomplete runs."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from commands import answer, complaint
from frames_logs import write_log
from import_files import recorded, take
from matplotlib.figure import Figure
from report_runs import EVENTFUL, drive, without
from test_engine import Breaks
from test_wire import LONG

import train_ato as ta
from train_ato.api.run import Run
from train_ato.cli import main
from train_ato.cli.run import print_run
from train_ato.control.registry import LAWS
from train_ato.judge.recording import Recording
from train_ato.judge.recording_builder import reduced
from train_ato.judge.series import TopicSamples
from train_ato.log.recorded import open_recording
from train_ato.messages.topics import TOPICS
from train_ato.messages.types import Diagnostic
from train_ato.report import print_figures
from train_ato.report.curves import CURVES
from train_ato.report.events import detect_events
from train_ato.report.page_data import MAPS, page_data, share_of
from train_ato.report.print_figures import clock_axis, titles, write_print_figures
from train_ato.report.summary_rows import filled_groups, run_groups
from train_ato.report.writing import short_clock, write_page


@pytest.fixture(scope="module")
def eventful(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory.mktemp("report"), "eventful", "demo", *EVENTFUL)


@pytest.fixture
def breaking(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Name a law that fails ``breaks``; return the folder of its run."""
    monkeypatch.setitem(LAWS._loaded, "breaks", Breaks)
    return tmp_path / "run"


@pytest.fixture(scope="module")
def several_units(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five power units without air brake, on a line without limits, grades and curves."""
    return drive(tmp_path_factory.mktemp("report"), "units", "freight_consensus", "--set=duration=3")


def test_events_of_a_run_are_found_at_their_times(eventful: Path) -> None:
    """Breaks if an event is lost, late by one diagnostics period, or has a wrong text."""
    found = {(event.kind, round(event.begin, 3), event.end and round(event.end, 3)) for event in
             detect_events(open_recording(eventful)) if event.kind != "limit"}  # fmt: skip
    assert found == {
        ("disturbance", 12.0, 18.0), ("law", 30.0, None), ("fault", 35.0, None), ("law", 40.5, None),
        ("air_brake", 45.0, None), ("fault", 52.0, 53.0), ("air_brake", 60.0, None), ("outside", 48.0, 51.0),
        ("outside", 66.2, None), ("protection", 66.3, 70.0), ("ato", 66.4, None), ("ato", 69.6, None),
    }  # fmt: skip
    texts = " | ".join(event.text for event in detect_events(open_recording(eventful)))
    for words in (
        "law pid → smc", "law smc → pid", "600 → 550 kPa", "550 → 600 kPa", "-0.02 m/s²", "0.4 s longer", "+0.01 m/s²",
        "emergency brake applied", "unit 0: measured position and speed frozen",
    ):  # fmt: skip
        assert words in texts


def test_thousands_of_events_are_told_in_a_few(eventful: Path) -> None:
    """Breaks if a permanently changing pressure fills the page with marks."""
    base = open_recording(eventful)
    time, pressure = base.of("ato/brake_pipe_command", "pressure")
    restless = 550e3 + 50e3 * (np.arange(pressure.size) % 2)[:, None]
    samples = TopicSamples(time, {"pressure": restless})
    noisy = replace(base, topics={**base.topics, "ato/brake_pipe_command": samples})
    (found,) = [event for event in detect_events(noisy) if event.kind == "air_brake"]
    assert found.text.startswith(f"{time.size - 1} times: ")
    assert (found.begin, found.end) == (time[1], time[-1])


def test_every_figure_of_an_eventful_run_is_there_and_holds_the_log(eventful: Path) -> None:
    """Breaks if a figure loses its peaks or shows a wrong topic, unit or quantity."""
    recording = open_recording(eventful)
    found = page_data(recording)
    assert set(found.left_out) == {"unit_forces"}
    cars, command = recording.topics["train/vehicles"], recording.topics["ato/command"]
    speed, forces, extremes = (found.curves[name].columns for name in ("speed", "forces", "coupler_extremes"))
    assert speed["speed"].max() == pytest.approx(3.6 * cars["velocity"][:, 0].max(), abs=1e-12)
    assert speed["position_km"][-1] == pytest.approx(cars["position"][-1, 0] / 1e3)
    assert np.nanmax(forces["demand"]) == pytest.approx(command["force"].max() / 1e3)
    assert extremes["draft"].max() == pytest.approx(cars["coupler_force"].max() / 1e3)
    assert extremes["buff"].min() == pytest.approx(min(0.0, cars["coupler_force"].min() / 1e3))
    assert found.maps["couplers"].codes.shape[0] == 105
    shoes = recording.topics["train/brake_shoes"]["shoe_force"]
    assert found.curves["shoe_force"].columns["shoe_force"].max() == pytest.approx(shoes.sum(axis=1).max() / 1e3)
    assert np.nanmin(found.curves["pipe"].columns["pipe_demand"]) == pytest.approx(550.0)
    summary = json.loads((eventful / "summary.json").read_text())
    energy = found.curves["energy"].columns
    assert energy["traction"][-1] == pytest.approx(summary["energy_traction_kwh"])
    work = sum(values[-1] for name, values in energy.items() if name != "kinetic")
    assert work == pytest.approx(energy["kinetic"][-1], abs=0.02 * energy["traction"][-1])


def test_the_delay_in_the_log_is_found_and_follows_its_jump(eventful: Path) -> None:
    """Breaks if the delay has an error of one tick, or the delay jump or the lag is missing."""
    lines = page_data(open_recording(eventful)).curves["delay"]
    before, after = lines.time < 33, lines.time > 42
    assert np.nanmedian(lines.columns["delay"][before]) == pytest.approx(1.2, abs=0.05)
    assert np.nanmedian(lines.columns["delay"][after]) == pytest.approx(1.6, abs=0.05)
    assert lines.columns["delay_set"][before] == pytest.approx(1.2)
    assert lines.columns["delay_set"][after] == pytest.approx(1.6)
    assert np.nanmax(lines.columns["delay_assumed"]) == pytest.approx(1.2)


def test_one_command_writes_one_small_file(eventful: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the page needs other files or a network, or the JSON differs from the files."""
    told = answer(capsys, "report", str(eventful), f"--out={tmp_path / 'page.html'}")
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]
    assert told["bytes"] == (tmp_path / "page.html").stat().st_size < 5e6
    assert told["left_out"] == {"eventful": {"unit_forces": "the train has a single power unit"}}
    page = (tmp_path / "page.html").read_text()
    assert not re.search(r"<(script|link|img|iframe)[^>]*(src|href)=\"?(http|//|file)", page)
    assert "default-src 'none'" in page
    for row_key in ("speed_rmse_kmh", "coupler_draft_max_kn", "energy_regenerated_kwh"):
        assert row_key in page


@pytest.mark.parametrize("topic", [
    "train/vehicles", "train/measurement", "ato/reference", "ato/command", "ato/estimate", "/diagnostics",
    "ato/profile", "ato/limits", "train/brake_pipe", "train/brake_shoes", "train/disturbance",
    "ato/brake_pipe_command", "atp/speeds", "ato/state", "train/protection",
])  # fmt: skip
def test_a_missing_topic_leaves_out_its_figures_alone(topic: str, eventful: Path, tmp_path: Path) -> None:
    run = without(eventful, tmp_path / "run", {topic})
    found = page_data(open_recording(run))
    gone = {
        "train/vehicles": {"couplers", "coupler_extremes"},
        "train/measurement": {"delay"},
        "ato/reference": {"speed_error", "position_error"},
        "ato/command": {"delay"},
        "train/brake_shoes": {"shoes", "shoe_force"},
    }
    assert set(found.left_out) - {"unit_forces"} == gone.get(topic, set())
    assert all(reason for reason in found.left_out.values())


def test_a_measured_run_has_the_figures_of_what_was_measured(eventful: Path, tmp_path: Path) -> None:
    """Breaks if a log with only forces and speeds, as of a real train, is refused or shown as truth."""
    keep = {"train/measurement", "ato/reference", "atp/speeds", "train/protection", "ato/state"}
    run = without(eventful, tmp_path / "run", {topic.name for topic in TOPICS} - keep)
    (run / "scenario.yaml").unlink()
    (run / "summary.json").unlink()
    recording = open_recording(run)
    found = page_data(recording)
    assert {"speed", "speed_error", "position_error", "forces", "energy"} == set(found.curves)
    assert "measured_speed" in found.curves["speed"].columns
    applied, speed = recording.topics["train/measurement"]["applied"], recording.topics["train/measurement"]["velocity"]
    work = (np.maximum(applied * speed, 0.0)[1:, 0] * 0.1).sum() / 3.6e6
    assert found.curves["energy"].columns["traction"][-1] == pytest.approx(work)
    assert any("measured" in remark for remark in found.remarks) and main(["report", str(run)]) == 0


def test_an_imported_run_leaves_out_what_was_not_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if measured forces are shown as commands, or the measured speed as reference with zero error."""
    take(tmp_path, capsys, recorded())
    run = tmp_path / "imported"
    found = page_data(open_recording(run))
    assert set(found.curves) == {"speed", "forces", "energy"}
    assert set(found.curves["forces"].columns) == {"applied", "envelope_low", "envelope_high"}
    assert all("not measured" in found.left_out[name] for name in ("delay", "speed_error"))
    assert main(["report", str(run)]) == 0
    assert "run.csv" in (run / "report.html").read_text()


def test_a_log_of_nonsense_without_scenario_is_drawn(tmp_path: Path) -> None:
    """Breaks if the report needs a scenario, ordered messages, plausible numbers or equal times."""
    write_log(tmp_path, LONG, 40)
    assert main(["report", str(tmp_path)]) == 0
    assert main(["report", str(tmp_path / "run.mcap"), f"--out={tmp_path / 'again.html'}"]) == 0
    found = page_data(open_recording(tmp_path))
    assert any(remark.startswith("No scenario") for remark in found.remarks)


@pytest.mark.parametrize("ticks", [1, 2, 15])
def test_a_run_of_a_few_ticks_is_drawn(ticks: int, tmp_path: Path) -> None:
    """Breaks if a very short run has too few points for a figure."""
    run = drive(tmp_path, "short", "demo", f"--set=duration={ticks / 10}")
    figures = [f"--figures={tmp_path / 'figures'}"] if ticks < 2 else []
    assert main(["report", str(run), *figures]) == 0
    assert page_data(open_recording(run)).curves["speed"].time.size == ticks + 1


def test_several_units_have_a_line_each(several_units: Path) -> None:
    """Breaks if power units are summed, exchanged or compared with the position of vehicle 0."""
    recording = open_recording(several_units)
    found = page_data(recording)
    assert list(found.curves["position_error"].columns) == [f"position_error:{unit}" for unit in range(5)]
    reference = recording.topics["ato/reference"]["position"][0, 0]
    start = recording.topics["train/vehicles"]["position"][0]
    for unit in range(5):
        error = found.curves["position_error"].columns[f"position_error:{unit}"][0]
        assert error == pytest.approx(start[unit] + recording.setup.model.offsets[unit] - reference)
    assert {"pipe", "shoes", "shoe_force"} == set(found.left_out)


def test_a_failed_run_says_so_at_the_top(breaking: Path) -> None:
    """Breaks if the page of a failed run has no warning, a second one is refused, or a temporary file remains."""
    assert main(["run", "demo", "--engine", "--law", "breaks", "--set=duration=20", f"--out={breaking}"]) == 1
    assert [main(["report", str(breaking)]) for _ in range(2)] == [0, 0]
    assert {path.name for path in breaking.glob("report*")} == {"report.html"}
    warning = re.search(r'class="warning">([^<]*)<', (breaking / "report.html").read_text())
    assert warning is not None
    assert warning[1].startswith("The run failed at 0:0") and "boom" in warning[1]
    failure = json.loads((breaking / "summary.json").read_text())["failure"]
    assert [event.text for event in detect_events(open_recording(breaking)) if event.kind == "end"] == [failure]


def test_a_recovered_run_has_its_figures_worked_out_from_the_log(eventful: Path, tmp_path: Path) -> None:
    """Breaks if the summary of a killed run is missing or differs from the summary of the run."""
    run = without(eventful, tmp_path / "run", ())
    (run / "summary.json").unlink()
    worked_out, told = page_data(open_recording(run)).summary, json.loads((eventful / "summary.json").read_text())
    assert worked_out["status"] == "killed"
    for key in ("speed_rmse_kmh", "position_error_max_m", "coupler_draft_max_kn", "energy_traction_kwh", "jerk_max"):
        assert worked_out[key] == pytest.approx(told[key], rel=1e-9, abs=1e-9), key


@pytest.mark.campaign
def test_runs_side_by_side_have_a_column_and_a_colour_each(eventful, several_units, tmp_path, capsys):
    """Breaks if runs of different trains, durations and ticks cannot be compared, or two of one name are merged."""
    page = tmp_path / "several.html"
    (tmp_path / "other").mkdir()
    twin = without(eventful, tmp_path / "other" / "eventful", ())
    runs = [str(run) for run in (eventful, several_units, twin)]
    told = answer(capsys, "report", *runs, f"--out={page}", f"--figures={tmp_path / 'figures'}", "--format=svg")
    assert len(told["runs"]) == 3 and "units" in told["runs"]
    text = page.read_text()
    summary = text[text.index('<table class="summary">') :]
    assert len(re.findall(r'<th class="value"><span class="swatch"', summary[: summary.index("</thead>")])) == 3
    assert {Path(path).name for path in told["figures"]} >= {"comparison.svg", "couplers.svg"}
    assert all(Path(path).is_file() for path in told["figures"])


@pytest.mark.campaign
def test_compare_leaves_table_figure_and_report(breaking: Path, tmp_path: Path, capsys: Any) -> None:
    """Breaks if compare writes no page, keeps logs without --keep, or one failed law stops the others."""
    out = breaking
    assert main(["compare", "demo", "--laws=breaks,pid,smc", "--set=duration=30", f"--out={out}", "--json"]) == 1
    errors = [entry["speed_rmse_kmh"] for entry in json.loads(capsys.readouterr().out) if entry["status"] == "done"]
    assert len(errors) == 2 and errors == sorted(errors)
    assert {path.name for path in out.iterdir()} == {"summary.json", "figure.png", "comparison.html"}
    page = (out / "comparison.html").read_text()
    assert "breaks: The run failed" in page and "train_ato_compare_" not in page, "folders that are gone"
    kept = tmp_path / "kept"
    assert main(["compare", "demo", "--laws=pid", "--set=duration=5", f"--out={kept}", "--keep"]) == 0
    assert (kept / "pid" / "run.mcap").is_file()
    assert main(["report", str(kept / "pid")]) == 0


@pytest.mark.campaign
def test_figures_for_print_are_equal_for_equal_runs(eventful: Path, tmp_path: Path) -> None:
    """Breaks if a figure is missing, contains a date or a random name, or has text as paths."""
    for name, kind in (("one", "svg"), ("two", "svg"), ("pixels", "png")):
        page, figures = tmp_path / f"{name}.html", tmp_path / name
        assert main(["report", str(eventful), f"--out={page}", f"--figures={figures}", f"--format={kind}"]) == 0
    names = {path.stem for path in (tmp_path / "one").iterdir()}
    assert names == {path.stem for path in (tmp_path / "pixels").glob("*.png")}
    assert names == {
        "speed", "speed_over_distance", "errors", "forces", "couplers", "air_brake", "disturbance", "delay", "energy"
    }  # fmt: skip
    for name in names:
        assert (tmp_path / "one" / f"{name}.svg").read_bytes() == (tmp_path / "two" / f"{name}.svg").read_bytes(), name
    assert "coupler force in kN" in (tmp_path / "one" / "couplers.svg").read_text()


def test_a_killed_run_is_refused_with_the_remedy(several_units, tmp_path, capsys):
    """Breaks if a partial log is drawn without an error, or the error has no remedy."""
    shutil.copy(several_units / "scenario.yaml", tmp_path)
    (tmp_path / "run.mcap.partial").write_bytes((several_units / "run.mcap").read_bytes()[:-500])
    assert "train-ato recover" in complaint(capsys, "report", str(tmp_path))
    assert main(["recover", str(tmp_path)]) == 0
    assert main(["report", str(tmp_path)]) == 0


@pytest.mark.campaign
def test_the_longest_train_with_noise_on_everything_stays_small(eventful: Path, tmp_path: Path) -> None:
    """Breaks if the size of a page grows with the run: one hour of noise, 212 vehicles, 8 power units."""
    random = np.random.default_rng(1)
    base = open_recording(eventful)
    time = 0.1 * np.arange(36_000)

    def noise(columns: int) -> np.ndarray:
        return 1e5 * random.standard_normal((time.size, columns), dtype=np.float32).astype(np.float64)

    along, units = noise(212), noise(8)
    topics = {
        "train/vehicles": TopicSamples(time, {"position": along, "velocity": along, "coupler_force": along}),
        "train/measurement": TopicSamples(time, {"position": units, "velocity": units, "applied": units}),
        "train/disturbance": TopicSamples(time, {"force": along}),
        "train/brake_shoes": TopicSamples(time, {"shoe_force": along}),
        "train/brake_pipe": TopicSamples(time, {"pressure": noise(1)}),
        "ato/brake_pipe_command": TopicSamples(time, {"pressure": noise(1)}),
        "ato/reference": TopicSamples(time, {"position": noise(1), "velocity": noise(1), "acceleration": noise(1)}),
        "ato/estimate": TopicSamples(time, {"force": noise(8)}),
        "ato/command": TopicSamples(time, {"force": noise(8)}),
    }
    topics = {name: TopicSamples(time, reduced(name, part.values, [], vehicles=True)) for name, part in topics.items()}
    worst = Recording(topics, base.profiles, kept_reports=base.reports, name="worst", path=tmp_path)
    data = page_data(worst)
    assert set(CURVES) | set(MAPS) == set(data.curves) | set(data.maps) | {"signals"}  # own signals: not in this run
    assert write_page([data], tmp_path / "worst.html", compared=False) < 5e6
    several = [page_data(worst, name, share_of(3)) for name in "abc"]
    assert write_page(several, tmp_path / "several.html", compared=True) < 10e6


def test_the_summary_is_told_with_words_and_units(eventful: Path) -> None:
    """Breaks if an important figure of summary.json is not in the table."""
    summary = json.loads((eventful / "summary.json").read_text())
    told = {row.key for _, rows in run_groups(summary) for row, _ in rows}
    named = {"scenario", "controller", "observer", "compensation", "seed", "status", "version", "mode", "ticks",
             "ato_disengaged_s"}  # fmt: skip
    numbers = {key for key, value in summary.items() if isinstance(value, (int, float)) and key not in named}
    assert numbers <= told
    texts = dict((row.key, texts[0]) for _, rows in filled_groups([summary]) for row, texts in rows)  # noqa: C402
    assert float(texts["coupler_buff_max_kn"].replace("−", "-")) == round(summary["coupler_buff_max_kn"])


@pytest.mark.parametrize("stamp", [1e6, -2e8])
@pytest.mark.parametrize("topic", ["ato/command", "train/vehicles", "train/measurement"])
@pytest.mark.parametrize("alone", [False, True], ids=["run", "log alone"])
def test_a_foreign_message_with_a_far_stamp_does_not_change_the_figures(eventful, topic, stamp, alone):
    """Breaks if one message stretches the time axes: the ticks of figure.png then take the processor for ever."""
    clean = open_recording(eventful)
    clean = replace(clean, setup=None) if alone else clean
    samples = clean.topics[topic]
    row = 0 if stamp < 0 else samples.time.size
    values = {name: np.insert(rows, row, rows[0], axis=0) for name, rows in samples.values.items()}
    foreign = TopicSamples(np.insert(samples.time, row, stamp), values)
    far = Diagnostic(int(1e15), "plant", 0, "running", {"energy_traction": "1"})
    reports = (*clean.kept_reports, far)
    found = replace(clean, topics={**clean.topics, topic: foreign}, kept_reports=reports).within_span()
    assert found.span == pytest.approx(clean.span, abs=0.11)
    for name, samples in found.topics.items():
        assert samples.time.size == pytest.approx(clean.topics[name].time.size, abs=1)
    assert found.reports == clean.reports
    assert clean.within_span() is clean


def test_a_time_axis_of_any_length_has_few_ticks() -> None:
    """Breaks if the distance of the ticks of a long run ends at four hours: 1e9 s would have 69 000 of them."""
    for end in (0.5, 725.0, 86_400.0, 1e6, 1e9):
        axes = Figure().subplots()
        axes.set_xlim(0.0, end)
        clock_axis(axes, end)
        assert 2 <= axes.xaxis.get_major_locator().tick_values(0.0, end).size <= 13


@pytest.mark.parametrize(("slowest_us", "named"), [(99_000.0, False), (504_000.0, True), (None, False)])
def test_a_law_that_is_slower_than_its_ticks_is_named(eventful: Path, slowest_us: float | None, named: bool, capsys):
    """Breaks if the median of .1 ms is the only word on a law that needs .5 s in one of 50 steps."""
    metrics = json.loads((eventful / "summary.json").read_text()) | {"step_time_us_p99": slowest_us}
    print_run(SimpleNamespace(metrics=metrics, path=eventful), as_json=False)
    assert ("one step in 100 longer than 0.504 s, at a tick of 0.1 s" in capsys.readouterr().out) == named


def test_result_and_reason_are_printed_before_the_figure_is_drawn(breaking, monkeypatch, capsys):
    """Breaks if a figure that takes long keeps the end of the run from its user, or the reason is printed twice."""
    before: list[tuple[str, str]] = []
    monkeypatch.setattr(Run, "plot", lambda run, path: before.append(capsys.readouterr()))
    assert main(["run", "demo", "--engine", "--law", "breaks", "--set=duration=20", f"--out={breaking}"]) == 1
    ((printed, told),) = before
    assert printed.startswith("failed: node controller failed: law breaks: ") and "recorded in" in printed
    assert printed.count("boom") == 1 and "node controller failed: law breaks" in told
    assert json.loads((breaking / "summary.json").read_text())["status"] == "failed"
    assert "boom" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("time", "text"), [(0.0, "0:00.0"), (59.96, "1:00.0"), (725.3, "12:05.3"), (3661.0, "1:01:01.0")]
)
def test_clock(time: float, text: str) -> None:
    """Breaks if 60.0 seconds are not shown as a minute."""
    assert short_clock(time) == text


def test_the_figure_of_a_run_says_how_it_was_driven_and_how_it_ended() -> None:
    """Breaks if the title omits an interruption or the mode."""
    summary = {"scenario": "demo", "controller": "pid", "observer": "none", "compensation": "preview", "seed": 1}
    assert titles({**summary, "status": "done"}) == ["demo: pid, observer none, compensation preview, seed 1"]
    (mode,) = titles({**summary, "status": "interrupted", "mode": "processes"})[1:]
    assert mode == "mode: ROS nodes, one process per node, INTERRUPTED"


def test_unfinished_runs_are_marked_at_their_end(eventful: Path) -> None:
    recording = open_recording(eventful)
    cut = replace(recording, summary={**recording.summary, "status": "interrupted"})
    ends = [event for event in detect_events(cut) if event.kind == "end"]
    assert [(event.begin, event.text) for event in ends] == [(recording.span[1], "the run was interrupted")]


@pytest.mark.usefixtures("without_figure")
def test_the_figures_have_verdict_limits_and_stations(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a figure hides the verdict, a near limit, or a station, or a far limit stretches the axis."""
    metro = ta.scenario(Path(__file__).resolve().parents[1] / "examples" / "metro" / "scenario.yaml")
    changes = {"duration": 30, "criteria": {"speed_error": 0.02}, "profile": {"plan": {}}}
    scenario = metro.with_(changes)
    run = ta.run(scenario, out=tmp_path / "near")
    figure = run.plot()
    assert " ".join(figure.get_suptitle().split()).endswith(run.result.title)
    far = ta.run(scenario, set={"criteria.speed_error": 20.0}).plot()
    for drawn, criterion in ((figure, "criterion: 0.072 km/h"), (far, "criterion: 72 km/h (outside)")):
        errors = next(axes for axes in drawn.axes if axes.get_ylabel() == "speed error in km/h")
        assert criterion in [text.get_text() for text in errors.get_legend().get_texts()]
        if drawn is figure:
            bounds = {line.get_ydata()[0] for line in errors.lines if line.get_label() != "speed error"}
            assert bounds == {0.072, -0.072}
    assert errors.get_ylim()[1] < 10
    data = page_data(open_recording(tmp_path / "near"))
    half = run.setup.consist.vehicles[0].length / 2
    assert data.stations[1] == (pytest.approx((run.setup.line.stops[1].at - half) / 1e3), "Market")
    assert [name for _, name in data.stations] == ["Harbour", "Market", "Castle", "Garden", "Airport"]
    monkeypatch.setattr(print_figures, "PRINT_FIGURES", {})  # those over time are not the subject
    (written,) = write_print_figures(data, tmp_path, "svg")
    assert written.stem == "speed_over_distance" and "Castle" in written.read_text()
    write_page([data], tmp_path / "page.html", compared=False)
    assert '"text":"Castle"' in (tmp_path / "page.html").read_text()
