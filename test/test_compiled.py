"""The compiled kernels where nothing can be kept, and where nothing is compiled."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import plant_sim

PROGRAM = """
import sys
sys.dont_write_bytecode = True
import numba.core.caching as caching
caching.CacheImpl._locator_classes = []                        # as where neither package nor home can be written
from train_ato.cli.main import main
sys.exit(main(sys.argv[1:]))
"""


def run(arguments: list[str], **environment: str) -> subprocess.CompletedProcess[str]:
    source = str(Path(plant_sim.__file__).parents[1])
    return subprocess.run(
        [sys.executable, *arguments],
        env={**os.environ, "PYTHONPATH": source, **environment},
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )


@pytest.mark.slow
def test_a_run_needs_no_folder_for_what_it_compiles(tmp_path: Path) -> None:
    """Numba refuses to compile with a cache where no folder can be written: the command must compile without one."""
    out = tmp_path / "out"
    done = run(["-c", PROGRAM, "run", "demo", "--engine", "--json", "--set", "duration=5", "--out", str(out)])
    assert done.returncode == 0, done.stderr
    assert "NUMBA_CACHE_DIR" in done.stderr and "once on this machine" not in done.stderr
    assert json.loads(done.stdout)["ticks"] == 50


@pytest.mark.slow
def test_a_run_without_compiler_gives_the_same_numbers(tmp_path: Path) -> None:
    """With NUMBA_DISABLE_JIT=1, as people debug, the kernel is plain Python: slow, but the same train."""
    short = ["-m", "train_ato", "run", "xuzhou_metro", "--engine", "--json", "--set", "duration=4"]
    results = []
    for name, value in (("plain", "1"), ("compiled", "0")):
        done = run([*short, "--out", str(tmp_path / name)], NUMBA_DISABLE_JIT=value)
        assert done.returncode == 0, done.stderr
        results.append(json.loads(done.stdout)["energy_traction_kwh"])
    assert results[0] == pytest.approx(results[1], rel=1e-9) and results[0] > 0
