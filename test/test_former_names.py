"""Former names of scenario keys and commands: read with a notice, written under the present name."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

import train_ato as ta
from train_ato.cli import main
from train_ato.cli.main import COMMANDS, command_line
from train_ato.loop.setup import prepare
from train_ato.scenario import former_names
from train_ato.scenario.former_names import FORMER_COMMANDS, FORMER_KEYS, FORMER_OPTIONS
from train_ato.scenario.scenario import Scenario, load_scenario

VALUES: dict[str, tuple[str, Any]] = {
    "controller": ("demo", "smc"),
    "controllers": ("demo", {"pid": {"kp": 0.04}}),
    "controller_changes": ("demo", [{"at": 30, "law": "smc"}]),
    "swaps": ("demo", [{"at": 30, "law": "smc"}]),
    "score": ("demo", {"until_km": 4}),
    "profile.then": ("demo", [{"cruise_for": 3}]),
    "plant.unlimited": ("demo", True),
    "plant.holding": ("demo", 0.2),
    "brake.trigger.above": ("demo", 12.0),
    "brake.trigger.ahead": ("demo", 2000.0),
    "brake.trigger.steeper": ("demo", -0.01),
    "brake.trigger.longer": ("demo", 400.0),
    "brake.trigger.drop": ("demo", 3.0),
    "brake.trigger.margin": ("demo", 0.3),
    "replan.sitting": ("demo", 8),
}
"""Scenario that accepts the key, and a value other than its default."""
CASES = [pytest.param(former, *VALUES[former], id=former) for former in FORMER_KEYS]


@pytest.fixture(autouse=True)
def _no_notice_printed_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(former_names, "_printed", set())


def present_path(former: str) -> str:
    parent, _, _ = former.rpartition(".")
    return f"{parent}.{FORMER_KEYS[former]}".lstrip(".")


def nested(path: str, value: Any) -> dict[str, Any]:
    for part in reversed(path.split(".")):
        value = {part: value}
    return value


def notice(former: str, source: str | Path) -> str:
    name = former.rpartition(".")[2]
    return f"{source}: key '{name}' is now '{FORMER_KEYS[former]}'; the old name is read until version 0.3\n"


def text(scenario: Scenario) -> str:
    return scenario.model_dump_json(by_alias=True)


@pytest.mark.parametrize(("former", "base", "value"), CASES)
def test_former_key_in_a_file_and_its_variants(
    former: str, base: str, value: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if a file with the former key is refused, read differently, or read without exactly one notice."""
    path = tmp_path / "own.yaml"
    head = {"schema": "train_ato/scenario/1", "base": base, "name": "own"}
    path.write_text(yaml.safe_dump(head | nested(former, value)))
    expected, _ = load_scenario(base, (), {"name": "own", **nested(present_path(former), value)})
    assert text(load_scenario(str(path))[0]) == text(expected) != text(load_scenario(base, (), {"name": "own"})[0])
    assert capsys.readouterr().err == notice(former, path)
    path.write_text(yaml.safe_dump(head | {"variants": {"other": nested(former, value)}}))
    varied = load_scenario(f"{path}:other", (), {"name": "own"})[0]
    assert text(varied) == text(expected)


@pytest.mark.parametrize(("former", "base", "value"), CASES)
def test_former_key_in_an_option(former: str, base: str, value: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if ``--set`` refuses a former path or sets another key than the present path does."""
    expected = load_scenario(base, (f"{present_path(former)}={value}",))[0]
    assert capsys.readouterr().err == ""
    assert text(load_scenario(base, (f"{former}={value}",))[0]) == text(expected)
    assert capsys.readouterr().err == notice(former, "--set")
    parent, _, last = former.rpartition(".")
    if parent in ("brake.trigger", "replan"):  # blocks without required keys
        assert text(load_scenario(base, (f"{parent}={{{last}: {value}}}",))[0]) == text(expected)


@pytest.mark.parametrize(("former", "base", "value"), CASES)
def test_resolved_scenario_has_the_present_key(
    former: str, base: str, value: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if ``scenario.yaml`` of a run contains a former key, or the text reads back as another scenario."""
    scenario, path = load_scenario(base, (f"{former}={value}",))
    capsys.readouterr()
    resolved = yaml.safe_load(prepare(scenario, path).resolved_yaml())
    block = resolved
    for part in present_path(former).split("."):
        block = block[part]
    assert former_names.replace_former_keys(resolved, "resolved") == resolved
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    "path, suffix, value",
    [
        ("brake.trigger.above", "_kmh", 50),
        ("brake.trigger.ahead", "_km", 2),
        ("brake.trigger.steeper", "_permille", -9),
        ("brake.trigger.longer", "_km", 0.3),
        ("brake.trigger.drop", "_kmh", 9),
        ("brake.trigger.margin", "_kmh", 1.5),
        ("plant.holding", "_percent", 20),
        ("replan.sitting", "_min", 0.1),
    ],
)
def test_unit_suffix_of_a_former_key_is_kept(path: str, suffix: str, value: float) -> None:
    """Breaks if ``margin_kmh`` is unknown or loses its unit."""
    former, present = (
        load_scenario("demo", (f"{path}{suffix}={value}",)),
        load_scenario("demo", (f"{present_path(path)}{suffix}={value}",)),
    )
    assert text(former[0]) == text(present[0])


def test_key_under_both_names_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if one of two contradicting values is dropped without a word."""
    path = tmp_path / "own.yaml"
    path.write_text("schema: train_ato/scenario/1\nbase: demo\nplant: {holding: 0.2, holding_brake_ratio: 0.3}\n")
    assert main(["run", str(path), "--engine"]) == 2
    assert capsys.readouterr().err == (
        f"train-ato: {path}: plant.holding: is the former name of 'holding_brake_ratio'; keep 'holding_brake_ratio' "
        "only\n"
    )


def test_shipped_files_have_present_names_only(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a shipped scenario prints a notice."""
    assert main(["list"]) == 0
    assert capsys.readouterr().err == ""


def test_recorded_run_with_former_names_verifies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a run folder written before the change of names cannot be opened or does not repeat."""
    run = tmp_path / "run"
    options = ["--engine", "--set=duration=8", "--set=law_changes=[{at: 3, law: smc}]", f"--out={run}"]
    assert main(["run", "demo", *options]) == 0
    for file in sorted(run.glob("scenario*.yaml")):
        before = file.read_text()
        former = re.sub(r"^law_changes:", "swaps:", before, flags=re.M)
        former = re.sub(r"^evaluation:", "score:", former, flags=re.M)
        former = re.sub(r"^  holding_brake_ratio:", "  holding:", former, flags=re.M)
        former = re.sub(r"^  ideal_actuator:", "  unlimited:", former, flags=re.M)
        trigger = re.search(r"^  trigger:\n(?:    .*\n)*", former, flags=re.M)
        if trigger:
            former = former.replace(trigger[0], trigger[0].replace("    release_margin:", "    margin:"))
        assert former != before
        file.write_text(former)
    capsys.readouterr()
    assert main(["verify", str(run)]) == 0
    shown = capsys.readouterr()
    assert "messages are equal, bit for bit" in shown.out
    assert all("the old name is read until version 0.3" in line for line in shown.err.splitlines())


@pytest.mark.parametrize(("former", "present"), FORMER_COMMANDS.items())
def test_former_command_runs_the_present_one(former: str, present: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a former command is unknown, stays silent or is shown by ``--help``."""
    assert present in dict(COMMANDS) and former not in dict(COMMANDS)
    with pytest.raises(SystemExit, match="0"):
        main([former, "--help"])
    shown = capsys.readouterr()
    assert shown.out.startswith(f"usage: train-ato {present} ")
    assert shown.err == (f"train-ato: command '{former}' is now '{present}'; the old name is read until version 0.3\n")
    with pytest.raises(SystemExit, match="0"):
        main(["--help"])
    assert not re.search(rf"^ +{former} ", capsys.readouterr().out, flags=re.M)


def test_former_keys_in_the_entries_of_a_list() -> None:
    """Breaks if an entry of ``law_changes`` with former keys is refused or read differently."""
    former = load_scenario("demo", ("swaps=[{at: 30, controller: smc}, {at: 40, controllers: {smc: {ks: 0}}}]",))[0]
    present = load_scenario("demo", ("law_changes=[{at: 30, law: smc}, {at: 40, laws: {smc: {ks: 0}}}]",))[0]
    assert text(former) == text(present)


@pytest.mark.parametrize(
    ("command", "arguments", "present"),
    [
        ("run", ["demo", "--controller", "smc", "--pace=5"], ["demo", "--law", "smc", "--rate=5"]),
        ("run", ["demo", "--realtime", "2"], ["demo", "--no-lockstep", "--rate", "2"]),
        ("run", ["demo", "--engine", "--realtime=2"], ["demo", "--engine", "--rate=2"]),
        ("compare", ["demo", "--controllers=pid,smc"], ["demo", "--laws=pid,smc"]),
        ("view", ["--scenario", "demo", "--pace", "2"], ["--scenario", "demo", "--rate", "2"]),
        ("replay", ["run", "--controller", "smc"], ["run", "--law", "smc"]),
        (
            "plan",
            ["level", "freight_five", "--from", "1", "--to=2", "--speed-max-kmh", "50"],
            ["level", "freight_five", "--from-km", "1", "--to-km=2", "--max-speed-kmh", "50"],
        ),
    ],
)
def test_former_options_are_the_present_ones(
    command: str, arguments: list[str], present: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if a former option is refused, read differently, stays silent, or is in the help."""
    former = command_line().parse_args([command, *arguments])
    notices = capsys.readouterr().err.splitlines()
    expected = command_line().parse_args([command, *present])
    for options in (former, expected):
        vars(options).pop("publishing", None)  # actions of the parser
    assert vars(former) == vars(expected)
    assert capsys.readouterr().err == ""
    names = {word.partition("=")[0] for word in arguments if word.partition("=")[0] in FORMER_OPTIONS}
    assert len(notices) == len(names)
    assert all(any(f"option '{name}' is now" in line for line in notices) for name in names)
    with pytest.raises(SystemExit, match="0"):
        main([command, "--help"])
    shown = capsys.readouterr().out
    assert not [name for name in names if re.search(rf"{name}\b(?!-)", shown)]


def test_former_arguments_of_the_python_interface(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if ``controller=`` or ``controllers=`` is refused, silent or without effect."""
    short = {"duration": 2, "supervision.enabled": False}
    assert ta.run("demo", controller="smc", set=short).metrics["controller"] == "smc"
    assert [law.label for law in ta.compare("demo", controllers=["pid"], set=short).laws] == ["pid"]
    notices = capsys.readouterr().err
    assert "argument 'controller' is now 'law'" in notices and "argument 'controllers' is now 'laws'" in notices
    with pytest.raises(TypeError, match="unexpected keyword argument 'colour'"):
        ta.run("demo", colour="red")
