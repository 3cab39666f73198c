"""``verify --grid``: hash of a run, environment of a cell, and the first difference by name."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from train_ato.apps.grid.cell import HOST, TARGETS, Axes, Batch, batches, environment
from train_ato.apps.grid.grid import Grid, GridScenario
from train_ato.apps.grid.interpreters import Interpreter, find_interpreters
from train_ato.cli import main
from train_ato.log import difference
from train_ato.log.difference import compare_logs
from train_ato.log.run_folder import RunFolder
from train_ato.log.run_hash import _without_wall_clock, run_hash
from train_ato.loop.engine import run_engine
from train_ato.messages.codec.codec import Wire
from train_ato.messages.types import Diagnostic, Tick

SHORT = GridScenario("demo", ("duration=3",))
OWN = Interpreter(sys.executable, "3.11.7", "2", "0", True, ("X86_V3",), own=True)
OTHER = Interpreter("/usr/bin/python3.12", "3.12.1", "2", "0", False)


def recorded(folder: Path, name: str, scenario: GridScenario) -> tuple[Path, Wire]:
    """Record a run in the engine."""
    setup = scenario.prepare()
    run = RunFolder.make(folder / name, name)
    with run.sink(setup) as sink:
        run_engine(setup, sink=sink)
    return run.path, Wire(setup.layout)


def test_hash_covers_every_message_and_no_wall_clock(tmp_path: Path) -> None:
    """Breaks if step times are hashed, or a change of one number in one message leaves the hash as it was."""
    one, wire = recorded(tmp_path, "one", SHORT)
    again, _ = recorded(tmp_path, "again", SHORT)
    assert run_hash(one, wire) == run_hash(again, wire)
    seed, _ = recorded(tmp_path, "seed", GridScenario("demo", ("duration=3", "laws.pid.kp=0.0300000001")))
    assert run_hash(seed, wire) != run_hash(one, wire)
    shorter, _ = recorded(tmp_path, "shorter", GridScenario("demo", ("duration=2.9",)))
    assert run_hash(shorter, wire) != run_hash(one, wire)
    found = [compare_logs(*pair, wire) for pair in ((one, again), (one, shorter), (shorter, one))]
    assert len({entry.messages for entry in found}) == 1  # those of the longer log
    assert [entry.equal for entry in found] == [True, False, False]
    slow, fast = (
        wire.encode("/diagnostics", Diagnostic(0, "controller", 0, "", {"wall_step_ms": took, "late": "1"}))
        for took in ("2", "1")
    )
    assert _without_wall_clock(wire, slow) == _without_wall_clock(wire, fast)
    assert b"late" in _without_wall_clock(wire, slow)


def test_equal_hashes_are_equal_logs(tmp_path: Path) -> None:
    """Breaks if hash and comparison disagree: 0.0 and -0.0 are different bits for both."""
    from train_ato.log.difference import _Scale, _unequal

    one, wire = recorded(tmp_path, "one", SHORT)
    again, _ = recorded(tmp_path, "again", SHORT)
    assert compare_logs(one, again, wire).equal
    strict, tolerant = (_Scale("ato/command", one, wire, relative) for relative in (0.0, 1e-9))
    assert _unequal("force", 0.0, -0.0, strict) == ("force", "0.0", "-0.0")
    assert _unequal("force", 0.0, -0.0, tolerant) is None


def test_late_messages_are_compared_with_those_of_their_stamp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a message behind the others, or a foreign one far ahead, counts as missing."""
    messages: list[tuple[str, object, int]] = []

    class Kept:
        def add(self, topic: str, message: object, stamp: int) -> None:
            messages.append((topic, message, stamp))

    setup = SHORT.prepare()
    run_engine(setup, sink=Kept())
    late = messages.pop(len(messages) // 2)
    far = ("/clock", Tick(stamp=10**17), 10**17)
    monkeypatch.setattr(difference, "PORTION", 1)
    wire, one, other = Wire(setup.layout), tmp_path / "one", tmp_path / "other"
    for run, found in ((one, [far, *messages, late]), (other, [late, *messages[::-1], far])):
        with RunFolder.make(run, "late").sink(setup) as sink:
            for topic, message, stamp in found:
                sink.add(topic, message, stamp)
    monkeypatch.setattr(difference, "WINDOW_NS", 1_000_000_000)
    assert compare_logs(one, other, wire) == difference.LogComparison(len(messages) + 2)
    shorter, _ = recorded(tmp_path, "shorter", GridScenario("demo", ("duration=2.9",)))
    found = compare_logs(one, shorter, wire)
    assert found.first is not None and found.first.stamp == 2_900_000_000 and found.topics["/clock"] == 2
    assert found.messages == len(messages) + 2


def test_grid_has_every_combination_and_its_environment() -> None:
    """Breaks if a combination is left out, an axis does not reach the child, or a variable of the shell does."""
    axes = Axes((OWN, OTHER), TARGETS, (1, 2), ("engine", "composed", "processes"), ("libm without FMA",))
    planned = list(batches(axes))
    cells = [cell for batch in planned for cell in batch.cells]
    assert len({str(cell) for cell in cells}) == len(cells) == 4 * 2 * 3 + 4 * 2 * 1 + 1
    assert {cell.mode for cell in cells if cell.python == "3.12.1"} == {"engine"}
    shell = {"NUMBA_CPU_NAME": "znver3", "OPENBLAS_CORETYPE": "Zen", "LD_LIBRARY_PATH": "/ros", "HOME": "/home"}
    found = environment(Batch(OTHER, "haswell", 2, ("engine",)), shell, "/root", "/caches")
    assert found["NUMBA_CPU_NAME"] == "haswell"
    assert found["NUMBA_CPU_FEATURES"] == ""
    assert found["OPENBLAS_NUM_THREADS"] == found["NUMBA_NUM_THREADS"] == "2"
    assert found["PYTHONPATH"] == "/root"
    assert found["HOME"] == "/home"
    assert not {"OPENBLAS_CORETYPE", "LD_LIBRARY_PATH"} & found.keys()
    host = environment(Batch(OWN, HOST, 1, ("engine",)), shell, "/root", "/caches")
    assert "NUMBA_CPU_NAME" not in host
    assert host["NUMBA_CACHE_DIR"] != found["NUMBA_CACHE_DIR"]
    plain = environment(Batch(OWN, HOST, 1, ("engine",), "numpy baseline"), shell, "/root", "/caches")
    assert plain["NPY_DISABLE_CPU_FEATURES"] == "X86_V3"


def test_interpreter_without_packages_is_refused_by_name(tmp_path: Path) -> None:
    """Breaks if an interpreter that cannot run a scenario is left out silently."""
    bare = tmp_path / "python"
    bare.write_text(f'#!/bin/sh\nexec "{sys.executable}" -S -E -c "import numpy_is_not_here"\n')
    bare.chmod(0o755)
    with pytest.raises(ValueError, match=r"--python .*/python: ModuleNotFoundError: .*; name an interpreter"):
        find_interpreters([str(bare)], tmp_path)
    with pytest.raises(ValueError, match="No such file"):
        find_interpreters([str(tmp_path / "none")], tmp_path)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["run", "--grid"], "RUN run: not used with --grid"),
        (["--grid", "--relative=1e-6"], "--relative: not used with --grid"),
        (["--grid", "demoo", "--python", sys.executable], "unknown scenario 'demoo'; did you mean 'demo'?"),
        ([], "RUN: is missing; name a run folder or a log, or use --grid"),
    ],
)
def test_bad_input_is_refused_before_a_run(arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a bad option starts a run or has a traceback."""
    assert main(["verify", *arguments]) == 2
    assert says in capsys.readouterr().err


def test_a_difference_is_named(tmp_path: Path) -> None:
    """Breaks if a cell with other numbers counts as equal, or its first difference has no name."""
    grid = Grid([SHORT])
    from train_ato.apps.grid.grid import CellResult

    (batch,) = batches(Axes((OWN,), (HOST,), (1,), ("engine",)))
    grid.results = [CellResult(batch.cells[0]), CellResult(batch.cells[0])]
    recorded(tmp_path, "batch0/0", SHORT)
    grid._take(grid.results[0], 0, "", tmp_path / "batch0" / "0")
    recorded(tmp_path, "batch1/0", GridScenario("demo", ("duration=3", "laws.pid.kp=0.03")))
    grid._take(grid.results[1], 0, "", tmp_path / "batch1" / "0")
    assert grid.one_hash is None
    scenario, difference = grid.results[1].first or ("", None)
    assert scenario == "demo --set duration=3"
    assert difference is not None
    assert difference.topic == "/diagnostics" or difference.field.startswith("force")


@pytest.mark.campaign
def test_grid_of_two_targets_has_one_hash(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the kernel has other bits without AVX and FMA, or the command leaves folders or exits wrongly."""
    own = ["--python", sys.executable, "--threads", "1", "--mode", "engine", "--target", "generic", "--target", "host"]
    scenario = tmp_path / "short.yaml"
    scenario.write_text(SHORT.prepare().resolved_yaml())
    assert main(["verify", "--grid", str(scenario), *own, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert len(found["one_hash"]) == 64
    assert {cell["hash"] for cell in found["cells"]} == {found["one_hash"]}
    assert [cell["target"] for cell in found["cells"]] == ["host", "generic"]
