"""Output of the command line: help, hints, plain text, full numbers and rows, JSON of every command."""

import importlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from import_files import TRAIN, recorded

from plant_sim.units import number_text
from train_ato.cli import main
from train_ato.cli.main import COMMANDS, MODULES, WITHOUT_JSON
from train_ato.cli.screen import print_names, print_table
from train_ato.judge.metric_names import PROTECTION, RESULTS, format_value, metric_heading

ROOT = Path(__file__).resolve().parents[1]
SHORT = ["--set=duration=2", "--set=supervision.enabled=false"]


def program(*arguments: str, folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run the program of the source tree with its output in pipes."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "40", **variables}
    return subprocess.run(
        [sys.executable, "-m", "train_ato", *arguments],
        cwd=folder, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip


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


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (999.7, "1000"), (1000.0, "1000"), (-999.96, "-1000"), (1234567.0, "1234567"), (999.4, "999"),
        (0.0123456, "0.0123"), (float("nan"), "nan"), (float("-inf"), "-inf"),
    ],
)  # fmt: skip
def test_numbers_of_tables_have_no_exponent(value: float, text: str) -> None:
    """Breaks if a number from 999.5 on is printed as ``1e+03``."""
    assert format_value(value) == text


def test_ranges_of_parameters_have_no_exponent(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if ``list`` or a refusal prints a bound as ``1e+06``."""
    assert number_text(1e9) == "1000000000"
    assert main(["list", "pid"]) == 0
    assert "(0 ... 1000000000)" in capsys.readouterr().out
    assert main(["run", "demo", "--engine", "--set", "laws.pid.kp=-1"]) == 2
    assert "0 ... 1000000000" in capsys.readouterr().err


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


@pytest.mark.parametrize(
    ("line", "names"),
    [
        ("train-ato co", {"compare", "completion"}),
        ("train-ato sweep spec.yaml --sch", {"--scheduler"}), ("train-ato run de", {"demo"}),
        ("train-ato run following", {"following", "following_metro"}),
        ("train-ato run daqin_heavy_haul:id", {"daqin_heavy_haul:ideal"}),
        ("train-ato run demo --law sm", {"smc"}), ("train-ato compare demo --laws pid,sm", {"pid,smc"}),
        ("train-ato inject emer", {"emergency-brake"}), ("train-ato plan xu", {"xuzhou_metro_test"}),
        ("train-ato report runs/", {"runs/one"}),
    ],
)  # fmt: skip
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
