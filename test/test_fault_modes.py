"""Random faults of several topics in the three modes of a run: equal numbers."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from msgs_docs.generate.fault_table import BASES
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


@pytest.mark.campaign
def test_faults_have_equal_numbers_in_several_processes(engine_run: Path, tmp_path: Path) -> None:
    """Breaks if a fault depends on the process of its reader."""
    assert drive(tmp_path / "run", MIXED, "--processes") == 0
    assert equal(engine_run, tmp_path / "run")


def test_a_run_with_faults_is_verified(engine_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the resolved scenario of a run loses a fault."""
    assert main(["verify", str(engine_run), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["equal"] is True
