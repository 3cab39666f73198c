"""Faults in the three modes of a run: equal numbers, and real signals with one process per node."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from msgs_docs.generate.fault_table import BASES
from train_ato.apps.runs.run import Run, open_run
from train_ato.cli import main
from train_ato.log.difference import compare_logs
from train_ato.log.run_folder import read_run_folder
from train_ato.messages.codec.codec import Wire

METRO = [BASES["metro"][0], *(f"--set={text}" for text in BASES["metro"][1:])]
MIXED = (
    "[{do: drop, probability: 0.3, topic: ato/command, begin: 5}, "
    "{do: corrupt, value: bit, probability: 0.5, topic: ato/reference, begin: 8, end: 12}, "
    "{do: reorder, block: 0.3, topic: train/measurement, reader: controller, begin: 12, end: 16}, "
    "{do: delay, delay: 0.6, topic: train/odometry, begin: 30}]"
)
"""Faults of several topics, and a random one."""


def drive(out: Path, faults: str, *options: str) -> int:
    return main(["run", *METRO, f"--set=faults={faults}", f"--out={out}", "--json", *options])


def front(run: Run) -> tuple[float, float]:
    """Return the largest true position of the front [m], and the true speed at the end [m/s]."""
    vehicles = run["train/vehicles"]
    half = run.setup.consist.vehicles[0].length / 2.0
    return float(vehicles["vehicle_0_position_m"].max()) + half, float(vehicles["vehicle_0_speed_m_s"].iloc[-1])


@pytest.fixture(scope="module")
def engine_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("engine") / "run"
    assert drive(out, MIXED, "--engine") == 0
    return out


def equal(run: Path, other: Path) -> bool:
    return compare_logs(run, other, Wire(read_run_folder(run)[0].layout)).first is None


def test_faults_have_equal_numbers_in_one_process(engine_run: Path, tmp_path: Path) -> None:
    """Breaks if a fault acts on the transport of a mode in place of the receiving end, or is not seeded."""
    assert drive(tmp_path / "run", MIXED) == 0
    assert equal(engine_run, tmp_path / "run")


def test_a_killed_node_is_silent_in_one_process(tmp_path: Path) -> None:
    """Breaks if the engine and the composed graph treat the loss of a node differently."""
    kill = "[{do: kill, node: controller, at: 20}]"
    assert [drive(tmp_path / name, kill, *options) for name, options in (("a", ["--engine"]), ("b", []))] == [0, 0]
    assert equal(tmp_path / "a", tmp_path / "b")


@pytest.mark.slow
def test_faults_have_equal_numbers_in_several_processes(engine_run: Path, tmp_path: Path) -> None:
    """Breaks if a fault depends on the process of its reader."""
    assert drive(tmp_path / "run", MIXED, "--processes") == 0
    assert equal(engine_run, tmp_path / "run")


def test_a_run_with_faults_is_verified(engine_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the resolved scenario of a run loses a fault."""
    assert main(["verify", str(engine_run), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["equal"] is True


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "options", "failure"),
    [
        ("do: kill, node: controller", [], "node controller failed: its process was ended by SIGKILL"),
        ("do: kill, node: supervisor", [], "node supervisor failed: its process was ended by SIGKILL"),
        ("do: kill, node: profile", [], "node profile failed: its process was ended by SIGKILL"),
        ("do: stop, node: controller", [], "node controller failed: no answer to stamp 20.000 s"),
        ("do: stop, node: supervisor", [], "node supervisor failed: no answer to stamp 20.000 s"),
        ("do: duplicate, node: controller", ["--pace", "2"], "more than one publisher"),
    ],
    ids=[
        "kill controller",
        "kill supervisor",
        "kill profile",
        "stop controller",
        "stop supervisor",
        "second controller",
    ],
)
def test_a_lost_process_stops_the_train(fault: str, options: list[str], failure: str, tmp_path: Path) -> None:
    """Breaks if the train goes on without a node, the run ends while it moves, or the log is lost."""
    assert drive(tmp_path / "run", f"[{{at: 20, {fault}}}]", "--processes", *options) == 1
    run = open_run(tmp_path / "run")
    assert failure in str(run.metrics["failure"])
    place, speed = front(run)
    assert abs(speed) < 0.05
    stop = float(run.setup.profile.position[-1]) + run.setup.consist.vehicles[0].length / 2.0
    assert place < stop + run.setup.scenario.supervision.overlap
