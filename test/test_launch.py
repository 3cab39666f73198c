"""Launch files, and the parameter files of the nodes that they read."""

import ast
import json
import re
import runpy
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest
import yaml

from train_ato.cli.main import main
from train_ato.messages.topics import Role
from train_ato.ros.standalone.entry import run_role

ROOT = Path(__file__).resolve().parents[1]
LAUNCH = sorted((ROOT / "launch").glob("*.launch.py"))


def literals(file: Path) -> dict[str, Any]:
    """Return the constants of a launch file by name."""
    found = {}
    for node in ast.parse(file.read_text()).body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            try:
                found[node.targets[0].id] = ast.literal_eval(node.value)
            except ValueError:
                continue
    return found


def test_launch_files_name_nodes_and_options_that_exist(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Breaks if a node or an option is renamed and a launch file, which needs a ROS 2 installation, is not."""
    assert [file.name.partition(".")[0] for file in LAUNCH] == ["demo", "external", "two_hosts", "two_trains"]
    of_demo, of_hosts = literals(LAUNCH[0])["ARGUMENTS"], literals(LAUNCH[2])["HOSTS"]
    roles = {role.value for role in Role}
    assert set(of_demo["nodes"][0].split()) == roles
    assert sorted(" ".join(of_hosts.values()).split()) == sorted(roles)
    for node in roles:
        with pytest.raises(SystemExit) as ended:
            run_role(Role(node), ["--help"])
        assert ended.value.code == 0
        options = ["--scenario", "--external", *{"recorder": ["--out"], "plant": ["--recorded"]}.get(node, [])]
        text = capsys.readouterr().out
        assert all(option in text for option in options)
    for words, status, says in ((["--help"], 0, "see `NODE --help`"), (["contoller"], 2, "did you mean 'controller'?")):
        monkeypatch.setattr(sys, "argv", ["standalone", *words])
        with pytest.raises(SystemExit) as ended:
            runpy.run_module("train_ato.ros.standalone", run_name="__main__")
        assert ended.value.code == status and says in "".join(capsys.readouterr())
    source = LAUNCH[0].read_text()
    assert all(f'given["{name}"]' in source for name in of_demo)


@pytest.mark.parametrize("file", LAUNCH, ids=lambda file: file.name)
def test_launch_files_describe_a_launch(file: Path) -> None:
    pytest.importorskip("launch_ros", reason="launch_ros comes with a ROS 2 installation; there is no wheel of it")
    from launch import LaunchContext
    from launch.launch_description_sources import PythonLaunchDescriptionSource

    description = PythonLaunchDescriptionSource(str(file)).get_launch_description(LaunchContext())
    names = [argument.name for argument in description.get_launch_arguments()]
    assert names and all(argument.description for argument in description.get_launch_arguments())


def launched(monkeypatch: pytest.MonkeyPatch, file: Path, function: str, **changes: str) -> None:
    """Run a launch file with stubs of launch, for whose ROS part there is no wheel."""
    modules = ("launch", "launch.actions", "launch.event_handlers", "launch.events", "launch.events.process")
    for name in (*modules, "launch_ros", "launch_ros.actions"):
        monkeypatch.setitem(sys.modules, name, MagicMock())
    found = runpy.run_path(str(file))
    values = {name: default for name, (default, _) in found["ARGUMENTS"].items()}
    found[function](SimpleNamespace(launch_configurations=values | changes))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"nodes": "plant controler"}, "nodes:=plant controler: no node 'controler'; choose from recorder, supervisor"),
        ({"external": "nope"}, "external:=nope: no node 'nope'; choose from supervisor, profile, observer, controller"),
        ({"external": "recorder"}, "external:=recorder: no node 'recorder'"),
        ({"params": "nowhere.yaml"}, "params:=nowhere.yaml: no such file"),
        ({"rate": "fast"}, "rate:=fast: give simulated seconds per second of wall time, or max"),
    ],
)
def test_a_launch_refuses_what_no_node_can_take(
    changes: dict[str, str], says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Breaks if the launch goes on without the node or the parameters, or does not name the argument."""
    with pytest.raises(ValueError, match=f"^{re.escape(says)}"):
        launched(monkeypatch, LAUNCH[0], "_nodes", **changes)


@pytest.mark.parametrize("status", [1, 2])
def test_a_refused_node_ends_the_others_of_its_launch(status: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if they wait for it for ever; after a failure, status 1, they stop the train and close the log."""
    launched(monkeypatch, LAUNCH[0], "_nodes", nodes="plant recorder")
    ended = sys.modules["launch.event_handlers"].OnProcessExit.call_args.kwargs["on_exit"]
    node = sys.modules["launch_ros.actions"].Node.return_value
    assert len(ended(SimpleNamespace(action=node, returncode=status), None)) == (2 if status == 2 else 0)
    assert not ended(SimpleNamespace(action="of another train", returncode=status), None)


def test_a_launch_of_following_trains_has_their_scenarios(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the launch file does not fit the function that writes the scenarios."""
    launched(monkeypatch, LAUNCH[3], "_trains", folder=str(tmp_path / "out"), following="following_metro")
    given = dict(sys.modules["launch.actions"].IncludeLaunchDescription.call_args.kwargs["launch_arguments"])
    assert given["scenario"] == str(tmp_path / "out" / "t3.yaml") and given["followed"] == ""


@pytest.mark.parametrize(("followed", "rate"), [("false", "max"), ("true", "2"), ("", "")])
def test_values_of_a_launch_are_taken_as_said(followed: str, rate: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if followed:=false counts as true, or rate:=max ends the launch."""
    launched(monkeypatch, LAUNCH[0], "_nodes", followed=followed, rate=rate, nodes="plant")
    given = sys.modules["launch_ros.actions"].Node.call_args.kwargs
    assert ("--followed" in given["arguments"]) == (followed == "true")
    rates = [entry["rate"] for entry in given["parameters"] if isinstance(entry, dict) and "rate" in entry]
    assert rates == {"max": [0.0], "2": [2.0], "": []}[rate]


@pytest.mark.graph
def test_the_parameters_of_a_scenario_are_those_of_its_nodes(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a value is not that of the scenario, or a parameter of another law is in the file."""
    pytest.importorskip("rclpy")
    assert main(["params", "demo", "--law=smc", "--set=laws.smc.ks=0.3", "--observer=eso"]) == 0
    found = yaml.safe_load(capsys.readouterr().out)
    assert list(found) == ["/**/plant", "/**/observer", "/**/controller"]
    law = found["/**/controller"]["ros__parameters"]
    assert law["law"] == "smc" and law["smc.ks"] == 0.3 and not any(name.startswith("pid.") for name in law)
    observer = found["/**/observer"]["ros__parameters"]
    assert observer["observer"] == "eso" and any(name.startswith("eso.") for name in observer)
    assert main(["params", "demo", "--json"]) == 0
    shipped = yaml.safe_load((ROOT / "config" / "demo.yaml").read_text())
    told = json.loads(capsys.readouterr().out)
    assert {f"/**/{node}": {"ros__parameters": values} for node, values in told.items()} == shipped
