"""Trains that report live to the train behind, each a program with a namespace in one ROS domain."""

import json
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import answer, complaint
from programs import begun
from test_following import following_file, report
from waiting import LIMIT_S, reserved_domain, wait_for

import train_ato as ta
from plant_sim.states import Odometry
from train_ato.api.drive import RunMode
from train_ato.api.following import follower_figures, run_following
from train_ato.api.run import Run, RunRecord
from train_ato.api.scenario_choice import choose_scenario
from train_ato.cli.main import main
from train_ato.loop.engine import run_engine
from train_ato.loop.train_ahead import ReportRadio, ReportReceiver, ReportSender
from train_ato.messages.types import TrainAhead
from train_ato.scenario.following import load_following
from train_ato.scenario.setup import RunSetup

CHANGES = (
    "t1.duration=30", "t2.duration=45", "t2.leader.link.delay=0.8", "t2.leader.link.loss=0.3",
    "t2.law=end_law:SeesTheEnd",
)  # fmt: skip
"""The train behind is on its way for longer than the train ahead, and sees its rear; a third of the reports is lost."""


@pytest.fixture(scope="module")
def trains(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Run], dict[str, dict[str, Any]]]:
    """Return two trains that ran one after the other, and their scenarios for live reports."""
    file = load_following(following_file(tmp_path_factory.mktemp("live")), CHANGES)
    scenarios = {train.name: file.scenario_of(number) for number, train in enumerate(file.spec.trains)}
    scenarios["t2"]["leader"]["train"] = "/t1"
    return run_following(file, RunMode("engine"), shown=False).runs, scenarios


def assert_equal(found: Any, due: Run) -> None:
    """Compare all that the train behind has recorded with the run after the train ahead."""
    for topic in ("train/vehicles", "ato/profile", "ato/command", "atp/speeds", "/diagnostics"):
        assert found[topic].equals(due[topic]), topic


def live(setup: RunSetup, odometry: Any) -> RunSetup:
    """Return a run with the live reports of odometry tables."""
    sender = ReportSender(setup)
    columns = [
        f"{name}_{value}" for value in ("position_m", "speed_m_s", "since_balise_m") for name in ("wheel", "radar")
    ]
    rows = zip(odometry.index, odometry[columns].to_numpy().reshape(len(odometry), 3, 2), strict=True)
    return replace(setup, ahead=tuple(sender.message(Odometry(round(time * 1e9), *row)) for time, row in rows))


def test_live_reports_drive_as_those_of_a_run_before(trains: Any) -> None:
    """Breaks if live reports pass another link, another check, or come a step later."""
    runs, scenarios = trains
    setup = live(choose_scenario(scenarios["t2"]).prepare(), runs["t1"]["train/odometry"])
    record = RunRecord(setup, None)
    outcome = run_engine(setup, sink=record)
    assert_equal(Run(outcome.summary, record=record, setup=setup, outcome=outcome), runs["t2"])


@contextmanager
def programs_of(
    scenarios: dict[str, dict[str, Any]], folder: Path, *options: str
) -> Iterator[dict[str, subprocess.Popen[str]]]:
    """Start the train ahead, with options, and the train behind it as programs; none is left."""
    pytest.importorskip("rclpy")

    domain, programs = reserved_domain(), {}
    for name, more in {"t1": ["--followed", *options], "t2": []}.items():
        path = folder / f"{name}.yaml"
        path.write_text(yaml.safe_dump({"schema": "train_ato/scenario/1", **scenarios[name]}))
        words = ["run", str(path), f"--namespace=/{name}", f"--domain={domain}", f"--out={folder / name}", *more]
        programs[name] = begun(*words, "--start-limit=none", stdout=subprocess.DEVNULL)
    try:
        yield programs
    finally:
        for program in programs.values():
            program.kill()
            program.wait()


@pytest.mark.graph
def test_a_train_drives_on_behind_one_that_was_killed(trains: Any, tmp_path: Path) -> None:
    """Breaks if the train behind waits for ever, says nothing, or has a log that cannot be repeated."""
    with programs_of(trains[1], tmp_path, "--rate=1") as programs:
        log = tmp_path / "t2" / "run.mcap.partial"
        wait_for(lambda: log.is_file() and log.stat().st_size > 60_000)  # beyond its head of 40 kB
        programs["t1"].kill()
        said = programs["t2"].communicate(timeout=LIMIT_S)[1]
    assert programs["t2"].returncode == 0, said
    assert "no report on /t1/train/report for 10 s; the run goes on without" in said
    found = ta.load(tmp_path / "t2")
    assert 0.0 < found["train/ahead"]["reported_s"].max() < trains[0]["t1"]["train/odometry"].index.max()
    assert ta.verify(tmp_path / "t2").equal


@pytest.mark.graph
def test_view_and_scene_show_the_train_of_their_namespace(trains: Any, tmp_path: Path, capsys) -> None:
    """Breaks if a page of t2 shows t1 or its parameters, and if no scene finds a train in a namespace."""
    with programs_of(trains[1], tmp_path, "--rate=1") as programs:
        from train_ato.ros.graph.environment import applied, variables
        from train_ato.view.live import LiveFeed

        wait_for((tmp_path / "t2" / "run.mcap.partial").exists)
        given = next(word for word in programs["t2"].args if word.startswith("--domain="))
        domain = int(given.partition("=")[2])
        with applied(variables(domain, tmp_path / "ros")):
            feed = LiveFeed(domain, lambda _: None, None, "/t2")
            try:
                wait_for(lambda: feed.frame is not None)
                for space, law in {"t1": "smc", "t2": "lag_smc"}.items():
                    assert main(["param", f"law={law}", given, f"--namespace=/{space}"]) == 0
                wait_for(lambda: feed.law in ("smc", "lag_smc"))
                assert feed.law == "lag_smc"
                first = trains[0]["t2"]["train/vehicles"]["vehicle_0_position_m"].iloc[0]
                assert abs(feed.frame.moment.position[0] - first) < 300.0  # t1 is 500 m before it
            finally:
                feed.close()
        assert answer(capsys, "scene", given, "--namespace=/t2")["messages"]["/t2/scene/markers"] > 1
        assert programs["t2"].wait(LIMIT_S) == 0


@pytest.mark.graph
def test_one_command_starts_all_trains(trains: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Breaks if a figure of the common summary is not that of the trains one after the other, or a report is lost.

    The train behind must not wait for the last report after the end, and its log must have what `verify` needs.
    """
    pytest.importorskip("rclpy")
    out = tmp_path / "out"
    words = [str(following_file(tmp_path)), "--live", f"--out={out}", *(f"--set={change}" for change in CHANGES)]
    assert main(["run", *words]) == 0
    due, rows = trains[0], json.loads((out / "summary.json").read_text())["trains"]
    assert [row["mode"] for row in rows] == ["composed", "composed"]
    figures = follower_figures(due["t1"].recording, due["t2"].recording, due["t2"].setup)
    assert len(figures) > 3 and {key: rows[1][key] for key in figures} == figures
    assert "goes on without" not in capfd.readouterr().err
    found = ta.load(out / "t2")
    assert_equal(found, due["t2"])
    assert found["train/ahead"]["reported_s"].max() == due["t1"]["train/odometry"].index.max()
    assert ta.verify(out / "t2").equal


@pytest.mark.graph
def test_the_first_train_that_fails_ends_the_others(tmp_path: Path, capsys, monkeypatch) -> None:
    """Breaks if the train ahead runs on, at its rate for an hour here, or if the line does not name the train."""
    pytest.importorskip("rclpy")
    law = Path(__file__).resolve().parents[1].joinpath("examples", "my_law.py").read_text()
    demand = "        speed_error ="
    assert demand in law
    ends = '        import os, sys\n        if "--namespace=/t2" in sys.argv: os.kill(os.getpid(), 9)\n'
    (tmp_path / "dies.py").write_text(law.replace(demand, ends + demand))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    changes = ("t2.law=dies:MyLaw", "all.duration=60")
    words = [str(following_file(tmp_path)), "--live", "--rate=0.02", *(f"--set={change}" for change in changes)]
    assert main(["run", *words, f"--out={tmp_path / 'out'}"]) == 1
    assert "train t2: its program was killed by signal 9" in capsys.readouterr().err


def test_the_newest_report_is_delivered_with_the_stamp_of_its_step(trains: Any) -> None:
    """Breaks if a report acts before it was sent, or if a train drives without any."""
    radio = ReportRadio(choose_scenario(trains[1]["t2"]).prepare())
    with pytest.raises(ValueError, match="no report of the train ahead up to"):
        radio.newest(0)
    for stamp in (0, 400_000_000, 800_000_000):
        radio.put(TrainAhead(stamp, *np.full((2, 3), stamp * 1e-9), stamp))
    assert [radio.newest(stamp).time for stamp in (0, 700_000_000, 900_000_000)] == [0, 400_000_000, 800_000_000]
    assert radio.newest(1_200_000_000).stamp == 1_200_000_000


def test_a_repeated_delivery_is_no_new_report(trains: Any) -> None:
    """Breaks if the report that a train still has is sent over the link again: its age would be that of the last."""
    receiver = ReportReceiver(choose_scenario(trains[1]["t2"]).prepare(), "test")
    last = report(1, 0.0, 500.0)
    for stamp in range(0, 6_000_000_000, 400_000_000):
        receiver.hear(TrainAhead(stamp, np.array([last.front, last.rear, last.stop]), np.full(3, 15.0), 0))
        receiver.receive(stamp)
    assert receiver.newest(6_000_000_000) == last and receiver.age(6_000_000_000) == 6.0


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["--namespace=/t1", "--engine"], "--namespace /t1: the engine has no nodes; remove it or --engine"),
        (["--namespace=t1"], "--namespace t1: give a name such as /t1"),
        (["--namespace=/t1"], "--namespace /t1: several trains share a domain; add --domain or set ROS_DOMAIN_ID"),
        (["--followed"], "--followed: the topic of the reports is in a namespace; add --namespace"),
        (
            ["--engine", "--set=leader.train=/t1"],
            "leader.train: /t1: its reports come in a ROS domain; remove --engine",
        ),
        (["--engine", "--set=leader.train=t1"], "leader.train: t1: give a name such as /t1"),
        (["--live"], "--live: demo has one train; remove it, or name following trains"),
    ],
)
def test_bad_input_is_refused_in_one_line(words: list[str], problem: str, capsys, monkeypatch) -> None:
    """Breaks if a train waits for reports that cannot come, or in a domain without other trains."""
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    (line,) = complaint(capsys, "run", "demo", *words).strip().splitlines()
    assert problem in line
