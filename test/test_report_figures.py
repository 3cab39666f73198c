"""Figures of a report: axes, pressure, style, reduced samples, words, force limits, titles, and a log alone."""

import re
import shutil
from dataclasses import replace
from itertools import accumulate
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from chromium import browser
from engine_runs import setup_of
from hypothesis import given
from hypothesis import strategies as st
from import_files import MASS, metro, recorded, take, text_of
from matplotlib.figure import Figure
from recordings import recording_of
from report_runs import drive

from plant_sim.library import load_line
from train_ato.judge.metrics import summarise
from train_ato.judge.recording import BRAKE_PIPE_TAIL, Recording
from train_ato.judge.series import TopicSamples, aligned
from train_ato.judge.tracking import time_at_force_limit
from train_ato.log.recorded import open_recording
from train_ato.loop.engine import run_engine
from train_ato.messages.types import Diagnostic
from train_ato.report.curves import CURVES, NotAvailable, _without_saturation, delays, found_delay
from train_ato.report.events import detect_events, scenario_events
from train_ato.report.page_data import NO_CODE, PageData, heat_map, kept, page_data, track_shape
from train_ato.report.page_sections import comparison_sections, run_sections
from train_ato.report.print_figures import SHEET_SIZE, STYLE, comparison_figure, run_figure, save_figure, styled, titles
from train_ato.report.quantities import axis_range
from train_ato.report.summary_rows import GROUPS, filled_groups, shown
from train_ato.report.words import driven_laws, longer
from train_ato.report.writing import comparison_title, write_page

ROOT = Path(__file__).resolve().parents[1]
SPEED = np.array([0.0, 20.0, 30.0])


@pytest.mark.parametrize("ending", [".png", ".PNG", ".svg", ".SVG", ".pdf", ".PDF", ".jpg", ".eps"])
def test_a_figure_has_neither_date_nor_version_in_every_ending(ending: str, tmp_path: Path) -> None:
    """Breaks if an ending is refused by the words of matplotlib, or equal figures give other files a second later."""
    figure = Figure(figsize=(1, 1))
    save_figure(figure, tmp_path / f"one{ending}")
    written = (tmp_path / f"one{ending}").read_bytes()
    dated = re.search(rb"Matplotlib v|Software|Date>|CreationDate", written, re.IGNORECASE)
    assert written and (dated is None or ending in (".jpg", ".eps"))


@pytest.fixture(scope="module")
def braked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    events = "brake={policy: planned, events: [{time: 20, reduction_kpa: 50}, {time: 40, reduction_kpa: 0}]}"
    return drive(tmp_path_factory.mktemp("axes"), "braked", "demo", "--set=duration=60", f"--set={events}")


def test_the_range_of_an_axis_is_that_of_its_lines() -> None:
    """Breaks if a limit squashes the curve or a near one is cut off, or an axis of errors begins at zero."""
    far = axis_range("speed", [("speed", SPEED), ("limit", np.array([80.0, 80.0, 60.0]))])
    assert (far.low, far.high, far.from_zero) == (0.0, 30.0, True)
    assert far.remark("limit") == " (outside: 60 or more)" and far.remark("speed") == ""
    near = axis_range("speed", [("speed", SPEED), ("limit", np.full(3, 40.0))])
    assert (near.high, near.far, near.remark("limit")) == (40.0, {}, "")
    crossing = axis_range("speed", [("speed", SPEED), ("permitted_speed", np.array([80.0, 50.0, 10.0]))])
    assert crossing.far == {"permitted_speed": 10.0} and crossing.remark("permitted_speed") == ""
    assert not axis_range("speed", [("speed", -SPEED)]).from_zero, "a train that runs backwards"
    assert not axis_range("speed_error", [("speed_error", SPEED)]).from_zero
    empty = axis_range("speed", [("speed", np.full(3, np.nan)), ("limit", np.full(3, 80.0))])
    assert (empty.low, empty.high, empty.far) == (0.0, 80.0, {})


def test_the_figure_of_a_comparison_has_the_difference_from_the_first_run(braked: Path) -> None:
    """Breaks if the difference is missing or has the wrong sign, or a figure of one run has one."""
    first = replace(page_data(open_recording(braked)), label="first")
    assert first.motion is not None
    faster = replace(first, label="faster", motion=replace(first.motion, speed=first.motion.speed + 1.5))
    alone, both = comparison_figure([first], "one"), comparison_figure([first, faster], "both")
    assert alone is not None and both is not None and len(both.axes) == len(alone.axes) + 1
    panel = both.axes[1]
    assert panel.get_ylabel() == "speed difference in km/h"
    drawn, zero = (np.asarray(line.get_ydata(), dtype=float) for line in panel.get_lines())
    assert drawn == pytest.approx(np.full(drawn.size, 1.5)) and drawn.size > 100 and not zero.any()


def test_the_figure_of_a_run_has_the_ranges_of_the_page(braked: Path) -> None:
    """Breaks if figure.png is squashed by the limit of 80 km/h."""
    figure = run_figure(open_recording(braked))
    assert figure is not None
    low, high = figure.axes[0].get_ylim()
    assert low == 0.0 and high < 20.0
    assert any("outside: 80" in text.get_text() for text in figure.axes[0].get_legend().get_texts())


def test_the_pressure_at_the_tail_is_beside_that_at_the_head(braked: Path) -> None:
    """Breaks if a recorded tail pressure is not drawn, or a log without it has no figure."""
    base = open_recording(braked)
    time, head = base.of("train/brake_pipe", "pressure")
    tail = TopicSamples(time, {"pressure": head - 7e3})
    found = CURVES["pipe"](replace(base, topics={**base.topics, BRAKE_PIPE_TAIL: tail}))
    np.testing.assert_allclose(found.columns["pipe"] - found.columns["pipe_tail"], 7.0)
    topics = {name: samples for name, samples in base.topics.items() if name != BRAKE_PIPE_TAIL}
    assert set(CURVES["pipe"](replace(base, topics=topics)).columns) == {"pipe_demand", "pipe"}


def test_no_tooltip_covers_a_curve(braked: Path) -> None:
    """Breaks if a figure of lines has a tooltip at the cursor in place of the line above it."""
    sections, _ = run_sections(page_data(open_recording(braked)))
    plots = {placed.heading: placed.figure for section in sections for placed in section.placed}
    lines = ("Speed against profile", "Speed over distance", "Speed error", "Extremes", "Brake pipe")
    for heading in lines:
        plot = plots[heading]
        assert not [tool for tool in plot.toolbar.tools if type(tool).__name__ == "HoverTool"], heading
        assert "mousemove" in plot.js_event_callbacks, heading


def test_all_figures_take_their_colours_from_one_table() -> None:
    """Breaks if a figure declares a colour of its own, or draws its own grid."""
    folders = ("train_ato/papers", "train_ato/playback", "train_ato/studies", "train_ato/report")
    found = []
    for folder in (*folders, "msgs_docs/generate/law_pages"):
        for path in (ROOT / folder).rglob("*.py"):
            if path.name != "quantities.py":
                text = path.read_text(encoding="utf-8")
                found += [f"{path.name}: {match}" for match in re.findall(r'"#[0-9a-f]{6}"|\.grid\(alpha', text)]
    assert found == []


def test_a_sheet_has_the_style_of_print_with_larger_text() -> None:
    """Breaks if the sizes are not scaled together, or the style stays after the figure."""
    before = mpl.rcParams["axes.labelsize"]
    with styled(SHEET_SIZE):
        assert mpl.rcParams["font.size"] == SHEET_SIZE
        assert mpl.rcParams["legend.fontsize"] == pytest.approx(STYLE["legend.fontsize"] * SHEET_SIZE / 8.0)
        assert mpl.rcParams["axes.grid"]
    assert mpl.rcParams["axes.labelsize"] == before


@given(st.integers(1, 5), st.integers(1, 4000), st.integers(20, 300), st.integers(0, 2**32 - 1))
def test_no_peak_of_any_column_is_lost(columns: int, count: int, rows: int, seed: int) -> None:
    """Breaks if downsampling loses an extreme, the ends or the order, or keeps too many rows."""
    table = list(np.random.default_rng(seed).standard_normal((columns, count)))
    chosen = kept(table, rows)
    assert chosen.size <= max(rows, 2 * columns + 2) and (np.diff(chosen) > 0).all()
    assert (chosen[0], chosen[-1]) == (0, count - 1)
    for column in table:
        assert (column[chosen].max(), column[chosen].min()) == (column.max(), column.min())


@given(st.integers(0, 99_999))
def test_a_spike_of_one_tick_in_an_hour_stays_at_its_time(place: int) -> None:
    """Breaks if peaks are averaged or shifted in time."""
    values = np.sin(np.arange(100_000) / 5000.0)
    values[place] = -7.0
    assert place in kept([values, np.zeros(100_000)], 2000)


def test_gaps_stay_gaps() -> None:
    """Breaks if a line is drawn across a gap, or its ends move."""
    values = np.sin(np.arange(50_000) / 300.0)
    values[20_000:30_000] = np.nan
    chosen = kept([values], 1000)
    assert np.isnan(values[chosen]).any()
    good = chosen[~np.isnan(values[chosen])]
    assert (good[good < 25_000].max(), good[good > 25_000].min()) == (19_999, 30_000)


@given(st.integers(1, 3000), st.integers(1, 40), st.integers(10, 500), st.integers(0, 2**32 - 1))
def test_a_heat_map_keeps_every_vehicles_extreme(count: int, vehicles: int, columns: int, seed: int) -> None:
    """Breaks if a cell shows the mean, loses the sign, or a regular log has gaps."""
    values = np.random.default_rng(seed).standard_normal((count, vehicles)) * 1e3
    picture = heat_map(0.1 * np.arange(count), values, columns)
    assert picture.codes.shape == (vehicles, min(count, columns))
    assert NO_CODE not in picture.codes
    vehicle = int(np.abs(values).max(axis=0).argmax())
    extreme = values[np.abs(values[:, vehicle]).argmax(), vehicle]
    shown = picture.codes[vehicle] * picture.unit
    # A value of the other sign may have the same code: the extreme is among the shown ones, not always the first.
    assert np.abs(shown - extreme).min() <= abs(extreme) / 127
    largest = np.abs(picture.codes).max(axis=1) * picture.unit
    assert largest == pytest.approx(np.abs(values).max(axis=0), abs=picture.unit)


def test_a_heat_map_of_a_log_with_a_gap_is_grey_there() -> None:
    """Breaks if missing messages are shown as zero force."""
    time = np.concatenate((np.arange(0, 100, 0.1), np.arange(150, 200, 0.1)))
    picture = heat_map(time, np.ones((time.size, 3)), 200)
    middles = picture.begin + (np.arange(200) + 0.5) * (picture.end - picture.begin) / 200
    grey = (picture.codes == NO_CODE).all(axis=0)
    assert grey[(middles > 105) & (middles < 149)].all()
    assert not grey[(middles < 99) | (middles > 151)].any()


def test_another_scale_changes_codes_not_values() -> None:
    """Breaks if a common scale changes the forces."""
    values = np.linspace(-400, 400, 500)[:, None]
    picture = heat_map(0.1 * np.arange(500), values, 500)
    wide = picture.scaled(800.0)
    assert wide.largest == pytest.approx(800.0)
    assert wide.codes * wide.unit == pytest.approx(picture.codes * picture.unit, abs=wide.unit)


def test_values_at_other_times_are_exact_linear_or_missing() -> None:
    """Breaks if a slow topic is held too long, or a gap has values."""
    time = np.arange(10.0)
    assert aligned(time, time, time**2).tolist() == (time**2).tolist()
    assert aligned(np.array([0.5, 2.25]), time, 2 * time) == pytest.approx([1.0, 4.5])
    gap = np.array([0.0, 1.0, 2.0, 7.0, 8.0])
    found = aligned(np.array([1.5, 4.5, 7.5]), gap, gap)
    assert found[[0, 2]] == pytest.approx([1.5, 7.5])
    assert np.isnan(found[1])
    assert np.isnan(aligned(time, np.empty(0), np.empty(0))).all()


@pytest.mark.parametrize(
    ("delay", "lag", "tick"), [(0.8, 0.4, 0.1), (0.0, 0.0, 0.1), (1.25, 0.0, 0.05), (0.3, 0.6, 0.02)]
)
def test_a_delay_is_found_to_a_part_of_a_tick(delay: float, lag: float, tick: float) -> None:
    """Breaks if the identified delay is wrong, or the lag is missing in it."""
    fine = 20
    time = np.arange(0.0, 400.0, tick)
    demand = 1e5 * (np.sin(time / 7) + 0.5 * np.sin(time / 2.3 + 1))
    moments = np.arange(0.0, 400.0, tick / fine)
    held = np.maximum(np.floor((moments - delay) / tick + 1e-9).astype(int), 0)
    force = demand[held]
    if lag:
        gain = 1 - np.exp(-tick / fine / lag)
        force = np.array(list(accumulate(force, lambda state, value: state + gain * (value - state))))
        force = np.concatenate((force[:1], force[:-1]))
    middle, found = found_delay(time, demand, force[::fine], 4.0, lag)
    assert middle.size > 5
    assert np.isfinite(found).all()
    assert np.median(found) == pytest.approx(delay + lag, abs=0.5 * tick)


def test_no_delay_is_found_where_nothing_moves() -> None:
    """Breaks if a delay is identified from the noise of a constant force."""
    time = np.arange(0.0, 200.0, 0.1)
    demand = np.where(time < 100, 1e5 * np.sin(time), 2e5)
    _, found = found_delay(time, demand, np.roll(demand, 5), 3.0)
    assert np.isfinite(found[: found.size // 2 - 2]).all()
    assert np.isnan(found[found.size // 2 + 2 :]).all()
    assert found_delay(time[:3], demand[:3], demand[:3], 3.0)[0].size == 0


def test_a_track_has_its_grades_heights_and_curves() -> None:
    """Breaks if grades are shifted, equal ones are split at curves, or heights are wrong."""
    line = load_line("daqin_section")
    shape = track_shape(line, 0.0, 45_000.0)
    assert shape.grade[-1] == shape.grade[-2]
    assert (np.diff(shape.grade[:-1]) != 0).all()
    rise = (np.diff(shape.place) * shape.grade[:-1]).sum()
    assert shape.height[-1] == pytest.approx(rise)
    assert len(shape.curves) == sum(curve.begin < 45_000 for curve in line.curves)
    for begin, end, radius in shape.curves:
        assert 0 <= begin < end <= 45
        assert radius > 100
    assert track_shape(load_line("level"), 0.0, 1000.0).is_plain


ROWS = {row.key: row for rows in GROUPS.values() for row in rows}


@pytest.fixture(scope="module")
def gusty(tmp_path_factory: pytest.TempPathFactory) -> PageData:
    """Run twelve seconds of the demo with a gust."""
    gust = "--set=plant.disturbances=[{kind: gust, begin: 4, end: 8, acceleration: -0.02}]"
    return page_data(open_recording(drive(tmp_path_factory.mktemp("gusty"), "run", "demo", "--set=duration=12", gust)))


@pytest.mark.parametrize(("key", "value", "text"), [
    ("coupler_draft_max_kn", 552.4, "552"), ("coupler_draft_max_kn", 0.1649, "0.16"),
    ("position_rmse_m", 0.00342, "0.0034"), ("position_rmse_m", 1e-12, "0.00"),
    ("stop_error_m", -0.000117, "−0.00012"), ("replans", 0, "0"), ("stop_error_m", None, "–"),
])  # fmt: skip
def test_a_small_figure_is_no_nought(key: str, value: float | None, text: str) -> None:
    """Breaks if an error of 3 mm is shown as 0.00 m."""
    assert shown(ROWS[key], {key: value}) == text


def test_a_train_of_one_vehicle_has_no_figures_of_couplers(tmp_path: Path) -> None:
    """Breaks if the report of a train without couplers shows coupler forces of 0 kN."""
    summary = page_data(open_recording(drive(tmp_path, "metro", "xuzhou_metro", "--set=duration=5"))).summary
    found = {row.key for _, rows in filled_groups([summary]) for row, _ in rows}
    assert "energy_traction_kwh" in found
    assert not {"coupler_draft_max_kn", "coupler_buff_max_kn"} & found


def test_events_leave_the_colours_of_a_heat_map_alone(gusty: PageData) -> None:
    """Breaks if the band of a gust covers the coupler forces and changes their colours."""
    sections, _ = run_sections(gusty)
    figures = [placed.figure for section in sections for placed in section.placed]
    fills: dict[bool, set[str | None]] = {True: set(), False: set()}
    for figure in figures:
        kinds = [(type(drawn.glyph).__name__, drawn.glyph) for drawn in figure.renderers]
        fills["Image" in dict(kinds)] |= {glyph.fill_color for kind, glyph in kinds if kind == "VStrip"}
    assert fills[True] == {None}
    assert fills[False]
    assert None not in fills[False]


def test_no_delay_is_told_of_a_force_that_a_limit_cut() -> None:
    """Breaks if a force that follows its envelope to standstill is identified as a force without delay."""
    totals = zip((0, 10, 20, 30, 40), ("0.0", "0.0", "0.0", "8.0", "8.0"), strict=True)
    reports = tuple(Diagnostic(at * 10**9, "plant", 0, "", {"saturated": total}) for at, total in totals)
    _, delay = _without_saturation(Recording(kept_reports=reports), np.array([5.0, 15.0, 25.0, 35.0]), np.full(4, 0.4))
    assert np.isnan(delay).tolist() == [False, False, True, False]


@pytest.mark.parametrize(
    ("factor", "add", "words"),
    [
        (1.0, 0.4, "command delay 0.4 s longer"),
        (1.0, -0.2, "command delay 0.2 s shorter"),
        (1.5, 0.0, "command delay times 1.5"),
        (2.0, 0.1, "command delay times 2, then 0.1 s longer"),
    ],
)
def test_a_longer_delay_in_words(factor: float, add: float, words: str) -> None:
    """Breaks if the text of an addition contains the factor 1."""
    assert longer(factor, add) == words


@pytest.mark.campaign
def test_the_table_of_many_runs_can_be_read(gusty: PageData, tmp_path: Path) -> None:
    """Breaks if the columns of seven runs are too narrow for their names."""
    names = [f"line_of_a_long_name_{letter}" for letter in "abcdefg"]
    runs = [replace(gusty, label=f"run {name[-1]}", facts={**gusty.facts, "line": name}) for name in names]
    write_page(runs, tmp_path / "seven.html", compared=True)
    with browser() as page:
        page.open((tmp_path / "seven.html").as_uri(), 1720, 1000)
        page.wait_for("document.querySelectorAll('.facts td').length > 0")
        cells = page.evaluate(
            "[...document.querySelectorAll('.facts tr')].map(r => [...r.cells].map(c => c.innerText))"
        )
        rows = {row[0]: row[1:] for row in cells}
        assert rows["run"] == [run.label for run in runs]
        assert rows["line"] == names
        assert rows["seed"] == ["1 in all runs"]
        line = "[...document.querySelectorAll('.facts tr')].find(r => r.cells[0].innerText == 'line')"
        assert page.evaluate(f"{line}.getBoundingClientRect().height") < 30, "a name is cut into pieces"
        assert page.console == []


GOLDEN = Path(__file__).resolve().parent / "golden" / "short_train" / "run.mcap"


def test_a_log_that_lies_in_another_runs_folder_is_not_that_run(tmp_path, capsys):
    """Breaks if train, summary and name on the page are those of the folder instead of the log."""
    take(tmp_path, capsys, recorded(0.2, 60.0))
    other = tmp_path / "imported" / "other.mcap"
    shutil.copy(GOLDEN, other)
    found, alone = open_recording(other), open_recording(GOLDEN)
    assert found.name == "other"
    assert found.setup is not None
    assert alone.setup is not None
    assert found.setup.consist == alone.setup.consist
    assert "measured_file" not in found.summary
    own = open_recording(tmp_path / "imported" / "run.mcap")
    assert own.name == "imported"
    assert own.summary["measured_file"] == "run.csv"


@pytest.mark.parametrize(
    ("train", "reason"),
    [("hxd1_c80_105", "the log has nothing of an air brake"), ("xuzhou_metro_3", "the train has no air brake")],
)
def test_a_train_with_an_air_brake_is_not_said_to_have_none(train, reason, tmp_path, capsys):
    """Breaks if a missing recording of the brake pipe is reported as a property of the train."""
    time = np.arange(0.0, 60.25, 0.5)
    mass, slower = {"hxd1_c80_105": (10684e3, 12.0), "xuzhou_metro_3": (MASS, 1.0)}[train]
    speed, position, force = (column / slower for column in metro(time))
    text = text_of(
        {"time_s": time, "speed_kmh": 3.6 * speed, "position_m": position, "force_kn": force * mass / MASS / 1e3}
    )
    take(tmp_path, capsys, text, train=["--consist", train, "--line", "level"])
    recording = open_recording(tmp_path / "imported")
    for name in ("pipe", "shoe_force"):
        with pytest.raises(NotAvailable, match=reason):
            CURVES[name](recording)


def reported(plant: list[float], controller: list[float]) -> Recording:
    """Return a run with the counts of plant [s] and controller [steps], once a second from 0 s on."""
    counts = (("plant", "saturated", plant), ("controller", "saturated_steps", controller))
    reports = [
        Diagnostic(t * 1_000_000_000, node, 0, "", {key: str(value)})
        for node, key, values in counts
        for t, value in enumerate(values)
    ]
    return Recording(kept_reports=tuple(sorted(reports, key=lambda report: report.stamp)))


@pytest.mark.parametrize(
    ("plant", "controller", "wanted"),
    [
        ([0, 0, 0, 0, 0], [0, 10, 20, 20, 20], 2.0),  # clipped by the law alone: the plant sees no excess
        ([0, 0, 1, 2, 2], [0, 0, 0, 0, 0], 2.0),  # limit of the train below that of the model
        ([0, 0, 1, 2, 2], [0, 10, 20, 20, 20], 2.0),  # the same demand in both counts, after delay and tick
        ([0, 1, 1, 1, 1], [0, 0, 0, 10, 10], 2.0),  # one after the other
        ([0, 0, 0, 0, 0], [0, 10, 0, 10, 10], 2.0),  # restarted controller
    ],
)
def test_a_demand_at_a_limit_counts_once_however_it_came_there(
    plant: list[float], controller: list[float], wanted: float
) -> None:
    """Breaks if a demand clipped by the law is missing, or one that both count is counted twice."""
    found = time_at_force_limit(setup_of("demo", "links.command.delay=0.9"), reported(plant, controller))
    assert found is not None and found[1][-1] == pytest.approx(wanted)


def test_the_metric_is_at_least_the_time_of_the_commands_at_the_limits_of_the_model() -> None:
    """Breaks if the summary has the count of the plant only: 0 s of a law that clips itself."""
    setup = setup_of("demo", "duration=150", "law=smc", "laws.smc.gains=printed")
    outcome = run_engine(setup)
    assert outcome.recording is not None
    velocity = outcome.recording.topics["train/measurement"]["velocity"]
    command = outcome.recording.command
    limits = [setup.model.force_limits(row) for row in velocity[: len(command)]]
    clipped = [
        bool(np.any((force != 0) & ((force <= low) | (force >= high))))
        for force, (low, high) in zip(command, limits, strict=True)
    ]
    told = setup.tick * sum(clipped)
    counted = outcome.recording.totals["saturated"]
    assert told > counted + 1.0
    last_report = 1.0  # the controller reports once a second
    assert told - last_report <= outcome.summary["saturated_s"] <= told + counted + 1e-6


def test_lost_and_late_commands_are_metrics() -> None:
    """Breaks if a lost, missed, refused, late or absent command is not in the summary."""
    values = {"commands_lost": "3", "missed ato/command": "5", "refused ato/command": "7"}
    values |= {"wall_late": "9", "wall_held": "11"}
    setup, reports = setup_of("demo", "duration=2"), (Diagnostic(0, "plant", 0, "", values),)
    figures = summarise(setup, replace(run_engine(setup).recording, kept_reports=reports))
    names = ("commands_lost", "commands_missed", "commands_refused", "commands_late")
    assert [figures[name] for name in names] == [3, 5 + 11, 7, 9]


def test_a_run_with_a_changed_law_says_so_in_every_title(tmp_path: Path) -> None:
    """Breaks if a title names the first law only, or error metrics end before the stop and no figure says so."""
    changes, cut = (
        "--set=law_changes=[{at: 10, law: smc}, {at: 20, laws: {smc: {ks: 0.5}}}]",
        "--set=evaluation.until_km=0.9",
    )
    data = page_data(open_recording(drive(tmp_path, "swapped", "demo", "--set=duration=30", changes, cut)))
    laws = "pid → smc at 10 s, parameters changed"
    assert driven_laws(data.summary) == data.facts["law"] == laws
    assert laws in titles(data.summary)[0]
    write_page([data], tmp_path / "page.html", compared=False)
    page = (tmp_path / "page.html").read_text()
    assert f"<h1>demo: {laws}</h1>" in page and f"<title>demo: {laws}" in page
    assert f"swapped: {laws}" in comparison_title([data, data])
    note = "error metrics end at km 0.9; those of the run include the braking to the stop"
    for sections in (run_sections(data)[0], comparison_sections([data, data])[0]):
        captions = {placed.heading: placed.caption for section in sections for placed in section.placed}
        assert note in captions["Speed error"] and note in captions["Position error"]
        assert note not in captions["Extremes" if "Extremes" in captions else "Largest draft along the train"]


def test_the_laws_of_a_run_are_named_in_their_order() -> None:
    """Breaks if many changes are all named, or the report of a restarted controller is a change of the law."""
    many = [{"at_s": at, "name": "controller", "value": ("pid", "smc")[at % 2]} for at in range(1, 9)]
    assert driven_laws({"controller": "pid", "changes": many}).endswith("→ ... (8 changes)")
    again = {"at_s": 9.0, "name": "controller", "value": "pid"}
    assert driven_laws({"controller": "pid"}) == driven_laws({"controller": "pid", "changes": [again]}) == "pid"


@pytest.mark.parametrize(
    ("kind", "times"),
    [
        ("gust, begin: 10, end: 20, acceleration: 0.05", [(17.0, 27.0)]),
        ("paper001", [(67.0, 87.0)]),
        ("travelling_load, acceleration: -0.05, begin: 10, duration: 5, interval: 2", [(17.0, 32.0)]),
        ("travelling_load, acceleration: -0.05, begin: 10, duration: 5, period: 20", [(17.0, 99.0)]),
    ],
)
def test_a_disturbance_has_the_times_of_its_forces(kind: str, times: list[tuple[float, float]]) -> None:
    """Breaks if the shift of 7 s, the way of a load over six vehicles, or its repetition is left out."""
    setup = setup_of("demo", f"plant.disturbances=[{{kind: {kind}, shift: 7, vehicles: [0, 1, 2, 3, 4, 5]}}]")
    run = replace(recording_of(np.arange(100.0), 1), setup=setup)
    assert [(event.begin, event.end) for event in scenario_events(run)] == times


def test_the_delay_as_set_follows_jumps_of_lag_and_the_delay_of_every_unit() -> None:
    """Delays of 0, .1 and .8 s, .2 s less from 10 s on, lag .4 s and then .6 s: .3 + .4, then (0 + 0 + .6)/3 + .6."""
    jump, delay = "plant.jumps=[{at: 10, what: lag, factor: 1.5}]", "links.command={delay: [0, 0.1, 0.8]}"
    setup = setup_of("crh380a_gpc:strong", jump, delay, "plant.lag=0.4")
    run = replace(recording_of(np.arange(20.0), 3), setup=setup)
    found = delays(run, [(10.0, 1.0, -0.2)])["delay_set"]
    assert found == pytest.approx(np.where(np.arange(20.0) < 10, 0.7, 0.8))


def test_events_at_a_force_limit_include_those_of_the_law() -> None:
    """Breaks if the list of events has only the excess that the plant counts."""
    base = reported([0, 0, 0, 0, 0], [0, 10, 20, 20, 20])
    setup = setup_of("demo", "links.command.delay=0.9")
    (event,) = [found for found in detect_events(replace(base, setup=setup)) if found.kind == "limit"]
    assert "2.0 s" in event.text
