"""Pages of laws, observers and compensations, and of every law on nominal scenarios, agree with code and runs."""

import argparse
import json
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml
from case_costs import sampled
from engine_runs import setup_of
from matplotlib import image

from msgs_docs.generate import __main__ as command_line
from msgs_docs.generate import any_law_page as table
from msgs_docs.generate.__main__ import LAWS as FOLDER
from msgs_docs.generate.__main__ import law_pages, main, stale, unmeasured
from msgs_docs.generate.law_pages.measure import command, measure_components
from msgs_docs.generate.law_pages.pages import DEMO_RUNS, Component, DemoRun, components, demo_of, sections
from msgs_docs.generate.rows import read_rows
from train_ato.cli import run as run_command
from train_ato.cli.scenario_options import prepare_from
from train_ato.control.gains import PRINTED
from train_ato.control.registry import LAWS
from train_ato.judge.ranking import rank_of, standings
from train_ato.papers.claims import Case, printed
from train_ato.program.arguments import declare_options
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import RunSetup, prepare

COMPONENTS = {component.key: component for component in components()}
CASES = {command(case): case for entry in COMPONENTS.values() for case in demo_of(entry.kind, entry.name).runs.values()}
MEASURED = read_rows(command_line.MEASURED)
MAX_PNG = 60_000


def test_every_generated_file_is_that_of_the_code(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a docstring, model, table or row changes and its page, schema or measured figure does not."""
    assert (command_line.main(["--check"]), capsys.readouterr().out) == (0, "")


def test_a_new_law_is_documented_by_one_command(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a new law needs more than its file and its line in the registry, or a missing part is not named."""
    monkeypatch.setitem(LAWS._targets, "lqi", "train_ato.control.laws.pid:Pid")
    monkeypatch.setattr(LAWS, "_loaded", dict(LAWS._loaded))  # get() adds the law, which must not stay
    (text,) = [text for path, text in law_pages(MEASURED).items() if path.stem == "lqi"]
    assert text.startswith("# lqi")
    remedy = "run python -m msgs_docs.generate --measure lqi"
    assert unmeasured(MEASURED) == [
        f"law/lqi: its demonstration runs are not measured; {remedy}",
        f"law/lqi: its figure is missing; {remedy}",
    ]
    assert "msgs_docs/laws/lqi.md: is missing; run python -m msgs_docs.generate" in stale(law_pages(MEASURED))


@pytest.mark.parametrize("key", COMPONENTS)
def test_a_component_says_what_it_does_and_has_a_small_figure(key: str) -> None:
    """Breaks if a docstring loses what the component does or needs, or its figure is missing or large."""
    title, does, law, needs = sections(COMPONENTS[key].text, {})
    assert min(map(len, (title, does))) > 20, f"{key}: begin its module's docstring with a title and a paragraph"
    assert len(needs) >= len("Nothing."), f"{key}: end its module's docstring with a paragraph 'Needs: ...'"
    assert law or COMPONENTS[key].name == "none", f"{key}: describe its equations in the docstring of its module"
    path = FOLDER / f"{COMPONENTS[key].page}.png"
    assert path.stat().st_size < MAX_PNG and min(image.imread(path).shape[:2]) > 300


@pytest.mark.parametrize("line", sampled(CASES, every=8))
def test_the_command_beside_a_figure_drives_its_run(line: str) -> None:
    parser = argparse.ArgumentParser()
    declare_options(parser, run_command)
    program, name, *arguments = shlex.split(line)
    assert (program, name) == ("train-ato", "run")
    options = parser.parse_args(arguments)
    case = CASES[line]
    measured = prepare(*printed(*load_scenario(case.scenario, changes=dict(case.changes))))
    assert driven(prepare_from(options)) == driven(measured)


def driven(setup: RunSetup) -> dict[str, Any]:
    """Return the resolved scenario with the parameters of the law that drives."""
    resolved = yaml.safe_load(setup.resolved_yaml())
    return {**resolved, "laws": resolved["laws"].get(resolved["law"])}


def test_a_block_with_an_empty_line_is_one_block_and_a_reference_loses_its_tilde() -> None:
    text = "T.\n\nDoes it.\n\nPer unit::\n\n    S\n\n    u\n\n* to :class:`~x.Y`"
    assert sections(text, {})[2] == "Per unit:\n\n```text\nS\n\nu\n```\n\n* to `x.Y`"


def short(monkeypatch: pytest.MonkeyPatch, **changes: object) -> Component:
    component = COMPONENTS["law/pid"]
    runs = {
        name: Case("xuzhou_metro", {"duration": 40, **changes, "seed": seed}) for seed, name in enumerate(("a", "b"))
    }
    monkeypatch.setitem(DEMO_RUNS, component.key, DemoRun(runs))
    return component


def test_measuring_drives_and_draws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the command makes no table and small figure out of runs, or puts half of a run on a page."""
    component = short(monkeypatch)
    shares: list[float] = []
    found = measure_components([component], tmp_path, lambda share, _: shares.append(share))
    assert shares == [0.5, 1.0] and [row["run"] for row in found[component.key]] == ["a", "b"]
    assert 0.0 < found[component.key][0]["speed_rmse_kmh"] < 1.0
    assert (tmp_path / "pid.png").stat().st_size < MAX_PNG
    component = short(monkeypatch, law="smcc")
    (tmp_path / "none").mkdir()
    with pytest.raises(OSError, match=r"train-ato run xuzhou_metro .*unknown law 'smcc'"):
        measure_components([component], tmp_path / "none", lambda *_: None)
    assert not list((tmp_path / "none").iterdir())


ROWS = read_rows(Path(__file__).resolve().parents[1] / table.MEASURED)


@pytest.mark.parametrize(("name", "nominal"), [
    ("demo", True), ("crh380a_funnel:planned_ahead", True), ("crh380a_gpc:strong", True),
    ("crh380a_funnel:saturated", False), ("crh380a_funnel:delay_half_more", False),
    ("crh380a_funnel:lagging", False), ("crh380a_funnel:light", False), ("crh380a_funnel:noise", False),
    ("crh380a_funnel:replanned", False), ("crh380a_gpc:jump", False), ("xuzhou_metro:slower", False),
    ("freight_consensus:realistic", False),
])  # fmt: skip
def test_nominal_is_a_plant_as_modelled_with_the_force_of_its_profile(name: str, nominal: bool) -> None:
    """Breaks if a disturbance, noise, another mass, delay or lag, or a lack of force counts as nominal."""
    assert table.is_nominal(name) is nominal


def test_a_variant_that_gives_only_gains_has_no_rows() -> None:
    """Breaks if the same eight runs are made twice, or a variant that changes the train is left out."""
    names = table.shipped_names()
    assert "demo" in names and "daqin_heavy_haul:ideal" in names
    assert not [name for name in names if name.endswith(":tuned")]


def test_one_scenario_is_measured_and_the_other_rows_remain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a measurement of one scenario loses others, keeps its old rows or those of a former scenario."""
    monkeypatch.setattr(LAWS, "names", lambda: ["pid"])
    path = tmp_path / table.MEASURED
    path.parent.mkdir()
    kept = {"scenario": "xuzhou_metro:ideal", "law": "pid", "gains": "fitted", "outcome": "lost"}
    path.write_text(json.dumps([kept, {**kept, "scenario": "former"}, {**kept, "scenario": "demo"}]))
    table.measure(tmp_path, ["demo"])
    rows = json.loads(path.read_text())
    assert [(row["scenario"], row["gains"]) for row in rows] == [
        ("demo", "fitted"), ("demo", "printed"), ("xuzhou_metro:ideal", "fitted"),
    ]  # fmt: skip
    assert rows[0]["outcome"] == "tracked" and rows[2] == kept


@pytest.mark.parametrize("name", ["any_law:xuzhou_metro:slower", "any_law:dema", "faults:demo", "smcc"])
def test_a_page_or_scenario_without_rows_is_refused(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a wrong name is measured as nothing and the page counts as new, or a misspelt one has no remedy."""
    with pytest.raises(SystemExit) as stopped:
        main(["--measure", name])
    assert stopped.value.code == 2
    err = capsys.readouterr().err
    assert f"--measure {name}" in err
    assert name != "smcc" or "--measure smcc: no such page; did you mean 'smc'?" in err


def test_the_page_has_every_cell_and_a_reason_for_every_miss() -> None:
    """Breaks if a law has no row, more than five cells are not met, one has no reason, or a reason has no cell."""
    names = [name for name in table.shipped_names() if name in {row["scenario"] for row in ROWS}]
    default = [(row["scenario"], row["law"]) for row in ROWS if row["gains"] != PRINTED]
    assert default == [(name, law) for name in names for law in LAWS.names()]
    missed = [(row["scenario"], row["law"]) for row in table.not_met(ROWS)]
    assert len(missed) <= 5 and sorted(missed) == sorted(table.REASONS)
    assert all(row["choice"] != "nearest choice: " for row in ROWS if row["outcome"] == "refused")


def test_the_leaderboard_counts_every_run_once() -> None:
    """Breaks if a run is lost or counted as passed that misses a criterion, or a scenario has two first laws."""
    kept = {"status": "done", "tracking_findings": [], "verdict": "passed", "stop_error_m": -0.2}
    runs = [
        {**kept, "controller": "pid", "speed_rmse_kmh": 0.2},
        {**kept, "controller": "smc", "speed_rmse_kmh": 0.1, "verdict": "failed", "criteria": [{"passed": False}]},
        {**kept, "controller": "gpc", "speed_rmse_kmh": 0.1, "verdict": "failed", "tracking_findings": ["limit cycle"]},
        {"controller": "mpc", "status": "refused"},
    ]
    other = {**kept, "controller": "pid", "speed_rmse_kmh": 0.4}
    board = [list(row.values()) for row in standings([sorted(runs, key=rank_of), [other]])]
    assert board == [
        ["pid", 2, 2, 2, 2, 0, 1, pytest.approx(0.3), 0.2],
        ["smc", 1, 0, 1, 0, 0, 2, 0.1, 0.2],
        ["gpc", 1, 0, 0, 0, 0, 3, None, None],
        ["mpc", 0, 0, 0, 0, 1, None, None, None],
    ]


@pytest.mark.campaign
def test_the_page_has_the_nominal_scenarios_that_are_shipped_and_the_gains_of_their_runs() -> None:
    """Breaks if a new nominal scenario has no rows, or a row says `fitted` for gains of the rule."""
    assert list(dict.fromkeys(row["scenario"] for row in ROWS)) == table.nominal_names()
    setups = {name: setup_of(name) for name in table.nominal_names()}
    for row in ROWS:
        if "source" in row:
            setup, law = setups[row["scenario"]], row["law"]
            given = {**setup.scenario.laws.get(law, {}), **({"gains": PRINTED} if row["gains"] == PRINTED else {})}
            taken = setup.gains(law, given).source
            assert row["source"] == taken, row
            assert table.gains_text(row) == (taken if row["gains"] else "own")
