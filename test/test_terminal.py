"""Output of the command line: help, hints, lists, comparisons, plain text, full numbers, JSON, units of display."""

import argparse
import csv
import importlib
import json
import os
import re
import subprocess
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from case_costs import sampled
from commands import answer, complaint
from import_files import TRAIN, recorded
from programs import python

import train_ato as ta
from plant_sim.library import consist_path, line_path
from plant_sim.units import number_text
from train_ato.api.compare import compare
from train_ato.cli.list import catalogue
from train_ato.cli.main import COMMANDS, MODULES, WITHOUT_JSON, main
from train_ato.cli.screen import kept_for_result, kilometre_cell, print_json, print_names, print_table
from train_ato.control.laws.pid import Pid
from train_ato.control.registry import LAWS
from train_ato.judge.metric_names import PROTECTION, RESULTS, format_value, metric_heading
from train_ato.judge.verdict import verdict_line
from train_ato.program.arguments import declare_options
from train_ato.program.display_units import displayed_in, shown_data, shown_table, shown_text, stored_units
from train_ato.report.plan_figure import shown_per
from train_ato.report.quantities import axis_title, style_of
from train_ato.scenario.scenario_files import shipped_following, shipped_scenarios

SHORT = ["--set=duration=2", "--set=supervision.enabled=false"]


def program(*arguments: str, folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run the program of the source tree with its output in pipes."""
    return python("-m", "train_ato", *arguments, folder=folder, **{"COLUMNS": "40", **variables})


def test_no_arguments_print_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the program without arguments is an error, or prints less than ``--help``."""
    assert main([]) == 0
    alone = capsys.readouterr()
    with pytest.raises(SystemExit, match="0"):
        main(["--help"])
    assert alone.out == capsys.readouterr().out
    assert alone.err == ""


BRACKETS = "V [/kmh] [bold] :car: km/h]"
"""Text that rich reads as markup and as an emoji name."""


def test_tables_print_every_text_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a text of a user is read as markup: an error, or words that vanish."""
    print_table((BRACKETS, "value"), [(BRACKETS, BRACKETS)], BRACKETS)
    print_names(BRACKETS, [(BRACKETS, BRACKETS)])
    assert capsys.readouterr().out.count(BRACKETS) == 7


def test_headers_with_brackets_reach_the_summary_and_info(tmp_path: Path) -> None:
    """Breaks if ``import`` or ``info`` fails on a header such as ``V [/kmh]``, or prints it without its brackets."""
    text = recorded().replace("speed_kmh", "V [/kmh]").replace("force_kn", "F [bold]")
    (tmp_path / "V [km_h].csv").write_text(text)
    renames = ["--rename", "V [/kmh]:=speed_kmh", "F [bold]:=force_kn"]
    done = program("import", "V [km_h].csv", *TRAIN, *renames, "--name", "run", "--out", "run", folder=tmp_path)
    assert (done.returncode, "Traceback" in done.stderr) == (0, False), done.stderr
    shown = program("info", "run", folder=tmp_path)
    assert shown.returncode == 0, shown.stderr
    assert all(title in shown.stdout for title in ("V [km_h].csv", "V [/kmh]", "F [bold]"))


@pytest.mark.parametrize(("value", "text"), [
    (999.7, "1000"), (1000.0, "1000"), (-999.96, "-1000"), (1234567.0, "1234567"), (999.4, "999"),
    (0.0123456, "0.0123"), (float("nan"), "nan"), (float("-inf"), "-inf"),
])  # fmt: skip
def test_numbers_of_tables_have_no_exponent(value: float, text: str) -> None:
    """Breaks if a number from 999.5 on is printed as ``1e+03``."""
    assert format_value(value) == text


def test_ranges_of_parameters_have_no_exponent(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if ``list`` or a refusal prints a bound as ``1e+06``."""
    assert number_text(1e9) == "1000000000"
    assert main(["list", "pid"]) == 0
    assert "(0 ... 1000000000)" in capsys.readouterr().out
    assert "0 ... 1000000000" in complaint(capsys, "run", "demo", "--engine", "--set", "laws.pid.kp=-1")


def test_a_pipe_has_complete_rows(tmp_path: Path) -> None:
    """Breaks if a table in a pipe is cut or folded at the width of a terminal."""
    run = program("run", "demo", "--engine", *SHORT, "--out", "run", folder=tmp_path)
    assert run.returncode == 0, run.stderr
    for arguments in (["list"], ["list", "hxd1_c80_105"], ["info", "run"]):
        shown = program(*arguments, folder=tmp_path)
        assert shown.returncode == 0, shown.stderr
        assert "…" not in shown.stdout
        assert max(map(len, shown.stdout.splitlines())) > 80
    assert re.search(r"^/train/brake_shoes +\d+ +10 ", shown.stdout, flags=re.M)


def test_every_command_with_data_has_json() -> None:
    without = {name for name, _ in COMMANDS if f"train_ato.cli.{MODULES.get(name, name)}" in WITHOUT_JSON}
    assert without == {"completion"}


class Talks(Pid):
    """Law that prints."""

    def step(self, inputs):
        print("spoken")
        return super().step(inputs)


@pytest.mark.usefixtures("without_figure")
def test_json_is_the_only_output_of_a_law_that_prints(tmp_path, monkeypatch, capsys):
    """Breaks if a program that reads the JSON of a run meets a text of the law before it."""
    monkeypatch.setitem(LAWS._loaded, "talks", Talks)
    assert main(["run", "demo", "--engine", "--law", "talks", *SHORT, "--json", "--out", str(tmp_path / "run")]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["ticks"] == 20 and err.count("spoken") == 20


def test_json_is_the_only_output_of_workers_whose_law_prints(tmp_path, monkeypatch, capfd):
    """Breaks if workers, which inherit descriptor 1, write a text of the law before the JSON of a sweep."""
    (tmp_path / "talks_aloud.py").write_text("from train_ato.control.laws.pid import Pid\nprint('spoken')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    monkeypatch.syspath_prepend(tmp_path)
    spec = tmp_path / "spec.yaml"
    spec.write_text('{scenario: demo, over: {seed: [1]}, set: {duration: 2, law: "talks_aloud:Pid"}}')
    assert main(["sweep", str(spec), "--jobs", "1", "--json", "--out", str(tmp_path / "out")]) == 0
    out, err = capfd.readouterr()
    assert json.loads(out)["counts"] == {"done": 1} and "spoken" in err


def test_standard_output_is_back_after_a_broken_command(capfd):
    """Breaks if an error in a command with ``--json`` leaves descriptor 1 with the errors."""
    with pytest.raises(ValueError, match="broken"), kept_for_result(as_json=True):
        os.write(1, b"spoken")
        print_json(1)
        raise ValueError("broken")
    os.write(1, b"back")
    assert capfd.readouterr() == ("1\nback", "spoken")


def test_the_output_of_a_run_fits_a_screen_and_its_page_explains_every_line(tmp_path, capsys):
    """Breaks if a run prints more than a screen of 80 columns, or a row that the page of its last line lacks."""
    assert main(["run", "demo", "--engine", "--set", "duration=20", "--out", str(tmp_path / "r")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert sum(-(-len(line) // 80) for line in lines) < 24
    page, _, heading = lines[-1].removeprefix("every line is explained in ").partition(", ")
    text = (Path(__file__).resolve().parents[1] / page).read_text().partition(f"## {heading}\n")[2]
    explained = {row.split(" | ")[0].strip("| ") for row in text.partition("\n## ")[0].splitlines()}
    printed = {line.rsplit(None, 1)[0].strip() for line in lines[3:-2]}
    assert len(printed) > 10 and printed | {metric_heading(key) for key in (*RESULTS, *PROTECTION)} <= explained


@pytest.mark.usefixtures("without_figure")
@pytest.mark.parametrize("mode", [[], ["--processes"]])
def test_a_graph_run_prints_its_domain(mode: list[str], tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Breaks if the domain of a run is missing off a terminal, or mixed with the result."""
    assert main(["run", "demo", *mode, *SHORT, "--json", "--out", str(tmp_path / "run")]) == 0
    out, err = capfd.readouterr()
    (domain,) = re.findall(r"^ROS domain (\d+)$", err, flags=re.M)
    assert 1 <= int(domain) <= 101
    assert json.loads(out)["ticks"] == 20


def completed(line: str, folder: Path) -> list[str]:
    """Return the completions of a command line, as bash receives them."""
    answer = folder / "answer"
    done = program(
        folder=folder, _ARGCOMPLETE="1", _ARGCOMPLETE_IFS="\n", _ARGCOMPLETE_STDOUT_FILENAME=str(answer),
        _ARGCOMPLETE_COMP_WORDBREAKS=" ", COMP_TYPE="9", COMP_LINE=line, COMP_POINT=str(len(line)),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return [word.strip() for word in answer.read_text().split("\n")]


@pytest.mark.parametrize(("line", "names"), [
    ("train-ato co", {"compare", "completion"}),
    ("train-ato sweep spec.yaml --sch", {"--scheduler"}), ("train-ato run de", {"demo"}),
    ("train-ato run following", {"following", "following_metro"}),
    ("train-ato run daqin_heavy_haul:id", {"daqin_heavy_haul:ideal"}),
    ("train-ato run demo --law sm", {"smc"}), ("train-ato compare demo --laws pid,sm", {"pid,smc"}),
    ("train-ato inject emer", {"emergency-brake"}), ("train-ato plan xu", {"xuzhou_metro_test"}),
    ("train-ato report runs/", {"runs/one"}),
])  # fmt: skip
def test_a_shell_completes_commands_options_and_names(line: str, names: set[str], tmp_path: Path) -> None:
    """Breaks if a command, an option, a shipped name or a run is not offered."""
    pytest.importorskip("argcomplete")
    (tmp_path / "runs" / "one").mkdir(parents=True)
    (tmp_path / "runs" / "one" / "scenario.yaml").touch()
    assert names <= set(completed(line, tmp_path))


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_code_for_a_shell_names_the_program(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the code is missing, or completes another program."""
    pytest.importorskip("argcomplete")
    assert main(["completion", shell]) == 0
    assert "train-ato" in capsys.readouterr().out


def test_every_completed_argument_exists() -> None:
    completion = importlib.import_module("train_ato.cli.completion")
    from train_ato.cli.main import command_line

    (commands,) = [action for action in command_line()._actions if action.dest == "command"]
    found = set()
    for command in dict.values(commands.choices):  # type: ignore[arg-type]
        command.declare()
        found |= {action.dest for action in command._actions}
    assert set(completion.NAMES) <= found


@pytest.mark.parametrize("slip", ["--out DIR new folder", "--ouT DIR  new folder"])
def test_a_slip_in_the_options_of_a_docstring_is_an_error(slip: str) -> None:
    """Breaks if an option is lost without a word, because its line has no gap or its settings have another name."""
    module = ModuleType("command", f"Do it.\n\nOptions::\n\n    run RUN  folder\n    {slip}\n")
    vars(module)["OPTIONS"] = {"--out": {"required": True}}
    with pytest.raises(RuntimeError, match=r"command: .*--out"):
        declare_options(argparse.ArgumentParser(), module)
    module.__doc__, module.__file__ = None, "/gone/command.py"
    with pytest.raises(ValueError, match=r"/gone/command.py: .* use -O$"):
        declare_options(argparse.ArgumentParser(), module)


NAMES = sorted({name for entries in catalogue().values() for name in entries})


def listed(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, dict[str, str]]:
    return dict(answer(capsys, "list", *arguments))


def test_every_name_has_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    found = listed(capsys)
    assert list(found) == [
        "scenarios", "following", "laws", "observers", "compensations", "consists", "lines", "expected",
    ]  # fmt: skip
    assert all(summary and "\n" not in summary for entries in found.values() for summary in entries.values())
    assert main(["list"]) == 0
    table = capsys.readouterr().out
    assert re.search(r"crh380a_gpc:light +failed +train mass", table)
    assert [name for name in NAMES if name not in table] == []


@pytest.mark.parametrize("name", sampled(NAMES, every=3))
def test_every_listed_name_has_details(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    for title, facts in listed(capsys, name).items():
        assert title.endswith(f" {name}") and facts["summary"]


def test_figures_of_a_train_a_line_and_a_law(capsys: pytest.CaptureFixture[str]) -> None:
    """Values by hand of test_plan_checks.py and test_shipped.py; a parameter with its unit; a law of 004."""
    train = listed(capsys, "hxd1_c80_105")["consist hxd1_c80_105"]
    assert train["balancing speed"].startswith("110 km/h at 0 per mille, 80 km/h at 2 per mille")
    assert train["steepest starting grade"] == "6.3 per mille"
    line = listed(capsys, "daqin_section")["line daqin_section"]
    assert line["grades"] == "-11.2 ... 2 per mille" and line["extent"] == "from km 0 to km 52"
    assert listed(capsys, "pid")["law pid"]["filter_time"].startswith("0.0 s (0 ... 60): time constant")
    assert list(listed(capsys, "none")) == ["observer none", "compensation none"]
    assert listed(capsys, "daqin_heavy_haul:ideal")["scenario daqin_heavy_haul:ideal"]["compensation"] == "none"
    facts = listed(capsys, "crh380a_gpc")["scenario crh380a_gpc"]
    assert (facts["law"], facts["compensation"]) == ("gpc", "preview")


@pytest.mark.parametrize(
    ("path", "name"),
    [
        (consist_path("hxd1_c80_105"), "hxd1_c80_105"),
        (line_path("daqin_section"), "daqin_section"),
        (shipped_scenarios()["crh380a_gpc"], "crh380a_gpc"),
        (shipped_following()["following"], "following"),
    ],
)
def test_a_file_has_the_details_of_its_name(path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a file of a scenario, a consist or a line is refused, or shown differently from its name."""
    (file,) = listed(capsys, str(path)).values()
    (named,) = listed(capsys, name).values()
    assert {key: value for key, value in file.items() if not key.startswith(str(path))} == {
        key: value for key, value in named.items() if not key.startswith(f"{name}:")
    }


def compared(folder: Path, *options: str) -> int:
    short = ["--set=duration=3", "--set=supervision.enabled=false"]
    return main(["compare", *options, *short, f"--out={folder / 'compared'}"])


@pytest.mark.usefixtures("without_figure")
def test_a_leaderboard_counts_the_laws_over_scenarios_and_seeds(tmp_path: Path, capsys) -> None:
    """Breaks if a run is counted twice or for another law, a seed is repeated, or a refused law has a run."""
    words = ["--laws=pid,lag_smc", "--seeds=2", "--seed=4", "--set=plant.lag=0.4", "--set=model.lag=0"]
    folder = tmp_path / "compared"
    compared(tmp_path, "demo", "xuzhou_metro:ideal", *words)
    told = json.loads((folder / "summary.json").read_text())
    cells = [(row["scenario"], row["seed"], row["controller"]) for rows in told["runs"] for row in rows]
    assert sorted(set(cells)) == sorted(cells) and len(cells) == 8
    assert {cell[:2] for cell in cells} == {(name, seed) for name in ("demo", "xuzhou_metro:ideal") for seed in (4, 5)}
    for law in told["laws"]:
        own = [row for rows in told["runs"] for row in rows if row["controller"] == law["law"]]
        driven = [row for row in own if row["status"] != "refused"]
        assert (law["runs"], law["refused"]) == (len(driven), len(own) - len(driven))
        assert law["passed"] == sum(row.get("verdict") == "passed" for row in driven)
    assert sum(law["first"] for law in told["laws"]) == 4
    assert (folder / "leaderboard.md").read_text().count("\n| ") >= 3 and "leaderboard" in capsys.readouterr().out
    assert main(["compare", "demo", "--seeds=0"]) == 2 and main(["compare", "demo", "--seeds=2", "--keep"]) == 2


def test_ctrl_c_keeps_the_finished_comparisons(tmp_path, monkeypatch, capsys) -> None:
    """Breaks if Ctrl-C in the third of four comparisons loses the first two."""
    done: list[ta.Comparison] = []

    def pressed(*arguments: Any, **options: Any) -> ta.Comparison:
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(compare(*arguments, **options))
        return done[-1]

    monkeypatch.setattr("train_ato.api.compare.compare", pressed)
    assert compared(tmp_path, "demo", "--laws=pid", "--seeds=4") == 1
    assert "interrupted after 2 of 4 comparisons, in " in capsys.readouterr().err
    told = json.loads((tmp_path / "compared" / "summary.json").read_text())
    assert [row["seed"] for rows in told["runs"] for row in rows] == [1, 2] and told["laws"][0]["runs"] == 2
    assert "ended after 2 of 4 comparisons" in (tmp_path / "compared" / "leaderboard.md").read_text()


@pytest.mark.usefixtures("without_figure")
def test_gains_of_every_law_have_their_source(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if printed gains run in silence, fitted ones have a note, or `laws: {}` counts as a choice of gains."""
    options = ["--set=laws.smc.gains=printed", "--set=laws.lag_smc.c1=0.4", "--set=duration=5", "--engine"]
    assert compared(tmp_path, "demo", "--laws=pid,smc,lag_smc,mpc", *options) == 0
    notes = [line for line in capsys.readouterr().err.splitlines() if "gains" in line]
    assert len(notes) == 1 and notes[0].startswith("train-ato: smc: printed gains, not made for this train; try ")
    rows = {row["controller"]: row for row in json.loads((tmp_path / "compared" / "summary.json").read_text())}
    assert {law: row["gains"] for law, row in rows.items()} == {
        "pid": "fitted", "smc": "printed", "lag_smc": "fitted", "mpc": "model",
    }  # fmt: skip
    assert "c1 given" in rows["lag_smc"]["gains_reason"]


@pytest.mark.usefixtures("without_figure")
def test_a_refused_law_has_a_row_and_the_others_are_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a refused law stops the comparison, ends with status 0, or is missing in the table or the JSON."""
    laws = ["demo", "--laws=lag_smc,pid", "--compensation=twin", *SHORT]
    assert compared(tmp_path / "a", *laws) == 1
    shown = capsys.readouterr()
    assert "refused: lag_smc: with compensation 'twin'" in shown.out and " overspeed " in shown.out
    assert "difference from" not in shown.out
    assert "train-ato: lag_smc: with compensation 'twin'" in shown.err
    assert compared(tmp_path / "b", *laws, "--json") == 1
    rows = json.loads(capsys.readouterr().out)
    assert [(row["controller"], row["status"]) for row in rows] == [("pid", "done"), ("lag_smc", "refused")]
    assert "twin" in rows[1]["reason"] and rows[0]["speed_rmse_kmh"] >= 0


def test_every_law_starts_at_the_begin_of_the_profile() -> None:
    """Breaks if a law after the first one starts at position 0, 38 m behind its reference."""
    both = ta.compare("crh380a_gpc:short", ["pid", "smc"], set={"duration": 4})
    for law, error in both.table["position_error_max_m"].items():
        assert error == ta.run("crh380a_gpc:short", law=law, set={"duration": 4}).metrics["position_error_max_m"]


@pytest.mark.parametrize(
    ("text", "us"),
    [  # by hand: 1 mi is 1609.344 m, 1 lbf is 4.44822 N, 1 psi is 6894.76 Pa
        ("speed error 100 km/h rms", "speed error 62.1 mph rms"),  # 100 / 1.609344
        ("couplers -413 ... +505 kN (limits 1125 kN)", "couplers -92800 ... +114000 lbf (limits 252900 lbf)"),
        ("overspeed 2.50 km/h (limit 5) at 3.0 s, km 16.093", "overspeed 1.55 mph (limit 3.11) at 3.0 s, mi 9.9997"),
        ("falls at 19.4-25.3, 33.4 and 42.2 km", "falls at 12.1-15.7, 20.8 and 26.2 mi"),
        ("stopped 1 m short; takeovers 1 (limit 0)", "stopped 3.28 ft short; takeovers 1 (limit 0)"),
        ("105 C80, 2 m/s², 12+345 km 84+500, 500 kPa", "105 C80, 2 m/s², 12+345 km 84+500, 72.5 psi"),
    ],
)
def test_a_quantity_of_a_text_is_shown_in_us_units(text, us):
    """Breaks if a factor is wrong, a range is converted in part, or a number without a unit changes."""
    assert shown_text(text) == text
    with displayed_in("us"):
        assert shown_text(text) == us


def test_a_verdict_in_us_units_is_converted_before_it_is_rounded():
    """By hand: 1.0049 / 1.609344 = 0.62441, 0.3 / 0.3048 = 0.98425: breaks if 1.00 km/h is converted, or no limit."""
    row = {"criterion": "stop_window", "metric": "stop_error_max_m", "value": None, "limit": 0.3, "passed": False}
    summary = {"verdict": "failed", "criteria": [row], "stops": [{"beyond_m": None}], "speed_rmse_kmh": 1.0049,
               "coupler_buff_max_kn": -1126.0, "coupler_draft_max_kn": 505.49}  # fmt: skip
    plain = "did not stop (limit 0.3); couplers -1126 ... +505 kN; speed error 1 km/h rms"
    assert verdict_line(summary) == f"failed (1 of 1 criterion): {plain}"
    with displayed_in("us"):
        us = "did not stop (limit 0.984); couplers -253100 ... +114000 lbf; speed error 0.624 mph rms"
        assert shown_text(verdict_line(summary)) == f"failed (1 of 1 criterion): {us}"
        with stored_units():
            assert verdict_line(summary) == f"failed (1 of 1 criterion): {plain}"


def test_keys_and_headings_name_the_unit_of_their_numbers():
    """Breaks if a number changes without its key, or a count or a time is taken for a length."""
    data = {
        "speed_max_kmh": 160.9344, "stops": [{"km": 1.609344, "at_s": 2.0}], "rate_kn_per_s": 4.4482216152605,
        "metric": "stop_error_m", "value": 0.3048, "limit": None, "resistance_n_per_kn": 2, "held": True,
        "at 60 km/h": "a quantity, no heading: shown_text has it",
    }  # fmt: skip
    table = (("metric", "value", "km"), [("speed, rms in km/h", 8.04672, "1.609"), ("ticks", 7, None)])
    assert shown_data(data) == data
    assert shown_table(*table) == ([*table[0]], [[*row] for row in table[1]])
    assert shown_table(("stop, km",), [[kilometre_cell(1.609344)]]) == (["stop, km"], [["1.609"]])
    with displayed_in("us"):
        found = shown_data(data)
        assert list(found) == ["speed_max_mph", "stops", "rate_lbf_per_s", "metric", "value", "limit",
                               "resistance_n_per_kn", "held", "at 60 km/h"]  # fmt: skip
        assert found["speed_max_mph"] == pytest.approx(100.0) and found["rate_lbf_per_s"] == pytest.approx(1e3)
        assert found["stops"] == [{"mi": pytest.approx(1.0), "at_s": 2.0}]
        assert (found["metric"], found["value"], found["limit"]) == ("stop_error_ft", pytest.approx(1.0), None)
        heads, rows = shown_table(*table)
        assert heads == ["metric", "value", "mi"] and rows[1] == ["ticks", 7, None]
        assert rows[0] == ["speed, rms in mph", pytest.approx(5.0), "0.9998"]
        assert shown_table(("stop, km",), [[kilometre_cell(1.609344)]]) == (["stop, mi"], [["1"]])
        assert axis_title("coupler") == "coupler force in lbf (draft > 0)" and style_of("pipe").unit == "psi"
    with displayed_in("metric"):
        assert shown_data({"speed_m_s": 10.0, "force_n": 2e3}) == {"speed_kmh": 36.0, "force_kn": 2.0}


@pytest.fixture(scope="module")
def short_run(demo_run):
    return demo_run("duration=15")


def test_commands_print_and_export_us_units(short_run, tmp_path, capsys):
    """Breaks if a command ignores the option."""
    tables = {}
    for units in ((), ("--units", "us")):
        out = tmp_path / f"tables{len(units)}"
        assert main(["export", str(short_run), "--csv", "--topics", "train/vehicles", "--out", str(out), *units]) == 0
        head, *rows = csv.reader((out / "train_vehicles.csv").open(newline=""))
        tables[units] = dict(zip(head, rows[-1], strict=True))
    si, us = tables.values()
    assert float(us["vehicle_0_speed_mph"]) == pytest.approx(float(si["vehicle_0_speed_m_s"]) / 0.44704)
    assert float(us["vehicle_0_position_ft"]) == pytest.approx(float(si["vehicle_0_position_m"]) / 0.3048)
    assert us["time_s"] == si["time_s"] and len(us) == len(si)
    capsys.readouterr()
    plan = ["plan", "xuzhou_metro_test", "xuzhou_metro_3", "--json"]
    drawn = tmp_path / "plan.svg"
    extras = ((), ("--units", "us", "--out", str(drawn)))
    found = [json.loads(capsys.readouterr().out) for extra in extras if main([*plan, *extra]) == 0]
    assert all(title in drawn.read_text() for title in ("speed in mph", "force in lbf", "front in mi"))
    with displayed_in("us"):
        assert [shown_per(unit) for unit in ("km/h", "kN", "km")] == pytest.approx(
            [1 / 0.44704, 1 / 4.4482216152605, 1 / 1609.344]
        )
    assert found[1]["distance_ft"] == pytest.approx(found[0]["distance_m"] / 0.3048)
    assert found[1]["running_time_s"] == found[0]["running_time_s"]


def test_braking_curves_have_one_system_of_units(tmp_path, capsys):
    """Breaks if a table, a deviation or a release speed keeps metres, or the head of its column does."""
    case = str(Path(__file__).parent / "data" / "etcs_braking_cases.json")

    def printed(*more: str) -> str:
        assert main(["curves", case, *more]) == 0
        return capsys.readouterr().out

    si, us = (json.loads(printed("--deviation", "--json", *units)) for units in ((), ("--units", "us")))
    for name, entry in si.items():
        for curve, rows in entry["curves"].items():
            shown = np.array(us[name]["curves"][curve])
            assert shown == pytest.approx(np.array(rows) / (1.609344, 0.3048), abs=1e-9)
        assert us[name]["deviation_ft"] == pytest.approx(
            {curve: each / 0.3048 for curve, each in entry["deviation_m"].items() if each is not None}
        )
    text = printed("--units", "us", "--out", str(tmp_path / "curves.svg"))
    assert "before the target in ft" in text and "   mph" in text and " m" not in text.replace(" mph", "")
    drawn = (tmp_path / "curves.svg").read_text(encoding="utf-8")
    assert "speed in mph" in drawn and "target in ft" in drawn


def test_a_report_has_one_system_of_units(short_run, tmp_path):
    """Breaks if a part of the page keeps km/h, kN or kPa."""
    page = tmp_path / "page.html"
    assert main(["report", str(short_run), "--out", str(page), "--units", "us"]) == 0
    text = page.read_text(encoding="utf-8").partition("<header>")[2]
    assert "mph" in text and "lbf" in text
    assert not [unit for unit in (" km/h", " kN", " kPa", '"km/h"', '"kN"', '"kPa"') if unit in text]
