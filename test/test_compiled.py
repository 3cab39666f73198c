"""Compiled kernels without a writable cache, and without compilation."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import LIMIT_S

import plant_sim
from train_ato.apps.runs import progress
from train_ato.apps.runs.progress import COMPILE_NOTE, compilation_noted

KERNEL = """
from plant_sim.compiled import compiled

@compiled
def twice(value):
    return 2 * value
"""
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
        timeout=LIMIT_S,
        check=False,
    )


def test_a_line_is_printed_if_a_kernel_is_compiled_and_none_if_it_is_loaded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Breaks if a slow load counts as a compilation, as it did on a busy machine, or a compilation is silent."""
    (tmp_path / "kernel.py").write_text(KERNEL, encoding="utf-8")
    monkeypatch.setattr(progress, "_printed", set())  # the note is printed once in a process; another test may have
    printed = []
    for _ in range(2):  # two modules of one file: the second finds on disk what the first compiled
        spec = importlib.util.spec_from_file_location("kernel", tmp_path / "kernel.py")
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        with compilation_noted(COMPILE_NOTE):
            spec.loader.exec_module(module)
            assert module.twice(1.5) == 3.0
            assert module.twice(2) == 4
        printed.append(capsys.readouterr().err)
    assert printed == [COMPILE_NOTE + "\n", ""]


@pytest.mark.slow
def test_compiled_kernels_of_an_earlier_installation_do_not_hide_the_package(tmp_path: Path) -> None:
    """Breaks if an editable installation comes on the path after the folder that an upgrade by pip leaves."""
    command = [sys.executable, "-c", "import plant_sim; print(plant_sim.__file__)"]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    if subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, check=False).returncode != 0:
        pytest.skip("train_ato is not installed in this environment; pip install --editable . installs it")
    (tmp_path / "plant_sim" / "__pycache__").mkdir(parents=True)
    found = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert found.stdout.strip() == plant_sim.__file__


def test_a_run_needs_no_folder_for_what_it_compiles(tmp_path: Path) -> None:
    """Numba rejects a cache without a writable folder; the command must compile without one."""
    out = tmp_path / "out"
    done = run(["-c", PROGRAM, "run", "demo", "--engine", "--json", "--set", "duration=5", "--out", str(out)])
    assert done.returncode == 0, done.stderr
    assert "NUMBA_CACHE_DIR" in done.stderr and "once on this machine" not in done.stderr
    assert json.loads(done.stdout)["ticks"] == 50


@pytest.mark.slow
def test_a_run_without_compiler_gives_the_same_numbers(tmp_path: Path) -> None:
    """With NUMBA_DISABLE_JIT=1 the kernel is plain Python: slow, with the same numbers."""
    short = ["-m", "train_ato", "run", "xuzhou_metro", "--engine", "--json", "--set", "duration=4"]
    results = []
    for name, value in (("plain", "1"), ("compiled", "0")):
        done = run([*short, "--out", str(tmp_path / name)], NUMBA_DISABLE_JIT=value)
        assert done.returncode == 0, done.stderr
        results.append(json.loads(done.stdout)["energy_traction_kwh"])
    assert results[0] == pytest.approx(results[1], rel=1e-9) and results[0] > 0
