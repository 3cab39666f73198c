"""Compiled kernels on disk, without a writable cache, and without compilation."""

import gc
import importlib
import json
import os
import subprocess
import sys
import sysconfig
import types
from pathlib import Path
from typing import Any

import numba
import pytest
from numba.core.codegen import CPUCodegen
from numba.core.registry import CPUDispatcher
from programs import python

import plant_sim
from plant_sim import kernel_cache
from plant_sim.compiled import on_compilation
from train_ato.api import progress
from train_ato.api.progress import COMPILE_NOTE, compilation_noted

PACKAGE = {
    "constants": "FACTOR = 2.0\n",
    "callee": "from plant_sim.compiled import compiled\n\n\n@compiled\ndef plus(value):\n    return value + 1\n",
    "caller": """
from kernel_package import callee
from kernel_package.constants import FACTOR
from plant_sim.compiled import compiled


@compiled
def law(value):
    return FACTOR * callee.plus(value)
""",
}


def law_of(folder: Path, value: float = 1.5, **changed: str) -> tuple[float, bool]:
    """Write the package into a folder, import it anew and call its law; return the result, and True if compiled."""
    (folder / "kernel_package").mkdir(parents=True, exist_ok=True)
    for name, text in (PACKAGE | {"__init__": ""} | changed).items():
        (folder / "kernel_package" / f"{name}.py").write_text(text, encoding="utf-8")
        sys.modules.pop(f"kernel_package.{name}", None)
    sys.modules.pop("kernel_package", None)
    begun: list[bool] = []
    with pytest.MonkeyPatch.context() as patch, on_compilation(lambda: begun.append(True)):
        patch.setattr(sys, "path", [str(folder), *sys.path])
        patch.setattr(sys, "dont_write_bytecode", True)  # its bytecode has whole seconds: an old one could be taken
        importlib.invalidate_caches()
        result = importlib.import_module("kernel_package.caller").law(value)
    return float(result), bool(begun)


@pytest.fixture
def kernels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Set a folder for kernels."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "kernels"))
    return tmp_path / "kernels"


def test_a_kernel_is_found_by_its_content(tmp_path: Path, kernels: Path) -> None:
    """Breaks if a copy of the source compiles again, or if an old kernel is used after a change of its parts."""
    # numba takes the path of the file, and the content of that file only.
    assert law_of(tmp_path / "a") == (5.0, True) and law_of(tmp_path / "a") == (5.0, False)
    assert law_of(tmp_path / "copy") == (5.0, False)
    assert law_of(tmp_path / "a", caller="# a comment\n" + PACKAGE["caller"]) == (5.0, False)
    assert law_of(tmp_path / "a", callee=PACKAGE["callee"].replace("+ 1", "+ 2")) == (7.0, True)
    assert law_of(tmp_path / "a", constants="FACTOR = 3.0\n") == (7.5, True)
    assert law_of(tmp_path / "a", caller=PACKAGE["caller"].replace("FACTOR *", "FACTOR +")) == (4.5, True)
    assert law_of(tmp_path / "a") == (5.0, False)  # the first one is still there
    part = PACKAGE["callee"].replace("compiled\n", "also_compiled\n")  # a function of Python, compiled with its caller
    assert law_of(tmp_path / "a", callee=part) == (5.0, True)
    assert law_of(tmp_path / "a", callee=part.replace("+ 1", "+ 2")) == (7.0, True)
    assert law_of(tmp_path / "a", callee=part) == (5.0, False)
    assert law_of(tmp_path / "a", 1) == (4.0, True)  # other types
    state, caller = "from enum import IntEnum\n\n\nclass FACTOR(IntEnum):\n    A = 2\n", PACKAGE["caller"]
    enumerated = {"caller": caller.replace("FACTOR *", "FACTOR.A.value *")}
    assert law_of(tmp_path / "a", **enumerated, constants=state) == (5.0, True)
    assert law_of(tmp_path / "a", **enumerated, constants=state) == (5.0, False)
    assert law_of(tmp_path / "a", **enumerated, constants=state.replace("= 2", "= 3")) == (7.5, True)


def test_a_type_in_another_module_is_compiled_again(tmp_path: Path, kernels: Path) -> None:
    """Breaks if a kernel of an earlier version is loaded that looks for a type where it is no longer."""
    kind = "from typing import NamedTuple\n\n\nclass Pair(NamedTuple):\n    low: float\n    high: float\n"
    callee = PACKAGE["callee"].replace("return value + 1", "return Pair(value + 1, value)")
    caller = PACKAGE["caller"].replace("callee.plus(value)", "callee.plus(value).low")
    old = f"from kernel_package.constants import Pair\n{callee}"
    assert law_of(tmp_path, constants=f"{kind}\n\nFACTOR = 2.0\n", callee=old, caller=caller) == (5.0, True)
    new = f"from kernel_package.places import Pair\n{callee}"
    assert law_of(tmp_path, places=kind, callee=new, caller=caller) == (5.0, True)


@pytest.mark.parametrize(("value", "part"), [(1.5, "value + 1"), ("brake", "hash(value)")])
def test_a_kernel_that_is_loaded_needs_no_compiler(tmp_path: Path, kernels: Path, value: Any, part: str) -> None:
    """Breaks if a process that finds its kernels loads the modules that compile them (0.2 s), or cannot hash a text."""
    law_of(tmp_path, value, callee=PACKAGE["callee"].replace("value + 1", part))
    code = f"""
import sys
sys.path.insert(0, {str(tmp_path)!r})
from kernel_package.caller import law
value = {value!r}
print(law(value) == 2.0 * ({part}), *{{"numba.np.arraymath", "scipy.linalg"}} & sys.modules.keys())
"""
    found = python("-c", code, NUMBA_CACHE_DIR=str(kernels)).stdout.split()
    assert found[:1] == ["True"] and (found == ["True"] or value == "brake")


STEPS = "\n".join(f"    x = {k} - x / (own.value + {k})" for k in range(1, 60))
"""Code of a function that is too long for a copy in its callers."""
RECORDS = f"""
import sys
import numpy as np
from plant_sim.compiled import compiled

@compiled
def value(own):
    x = own.value
{STEPS}
    return x

@compiled
def of_first(records):
    return value(records[0])

@compiled
def of_second(records):
    return value(records[0])

first = np.array([(2.0, 3.0)], dtype=[("value", float), ("other", float)])
second = np.array([(5.0, 2.0)], dtype=[("other", float), ("value", float)])
given = dict(first=lambda: of_first(first), second=lambda: of_second(second))
print(*(given[name]() for name in sys.argv[1:]))
"""


@pytest.mark.parametrize("order", [["first", "second"], ["second", "first"]])
def test_kernels_of_two_processes_are_told_apart(tmp_path: Path, order: list[str]) -> None:
    """Breaks if a function of one record runs on another: wrong numbers, as its machine code has the same name."""
    (tmp_path / "records.py").write_text(RECORDS, encoding="utf-8")
    own = types.SimpleNamespace(value=2.0)
    scope: dict[str, Any] = {}
    exec(f"def value(own):\n    x = own.value\n{STEPS}\n    return x", scope)
    for names in ([order[0]], [order[1]], order):
        done = python(str(tmp_path / "records.py"), *names, NUMBA_CACHE_DIR=str(tmp_path / "kernels"))
        assert [float(text) for text in done.stdout.split()] == [scope["value"](own)] * len(names), done.stderr


def test_a_damaged_or_foreign_kernel_is_compiled_again(tmp_path: Path, kernels: Path, monkeypatch) -> None:
    """Breaks if a cut or empty file ends the run or stays, or a shared folder gives the code of another machine."""
    assert law_of(tmp_path) == (5.0, True)
    for content in (b"", b"cut", lambda whole: whole[:-1], lambda whole: whole[:40] + b"?" + whole[41:]):
        for file in kernels.iterdir():
            file.write_bytes(content(file.read_bytes()) if callable(content) else content)
        assert law_of(tmp_path) == (5.0, True) and law_of(tmp_path) == (5.0, False)
    with monkeypatch.context() as patch:
        patch.setattr(numba, "__version__", "0.1")
        assert law_of(tmp_path) == (5.0, True)
    monkeypatch.setattr(CPUCodegen, "magic_tuple", lambda self: ("another",))
    assert law_of(tmp_path) == (5.0, True)


def test_a_folder_that_cannot_be_written_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the users of an installation by another user compile the kernels it has, or if that fails."""
    shared = tmp_path / "shared"
    monkeypatch.setattr(kernel_cache, "SHARED", shared)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file" / "cache"))
    (tmp_path / "file").write_text("not a folder", encoding="utf-8")
    assert not kernel_cache.kernels_are_kept() and law_of(tmp_path) == (5.0, True)
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(shared))
    assert law_of(tmp_path) == (5.0, True)
    before = {file: file.read_bytes() for file in shared.iterdir()}
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    assert law_of(tmp_path) == (5.0, False)
    assert law_of(tmp_path, 1) == (4.0, True)  # not among the shared ones
    assert {file: file.read_bytes() for file in shared.iterdir()} == before


def test_no_kernel_is_beside_the_package() -> None:
    """Breaks if a removed package leaves kernels in its folder, so that its import succeeds without content."""
    package = Path(plant_sim.__file__).parent
    for folder in (*kernel_cache.cache_folders(), kernel_cache.SHARED):
        assert not folder.is_relative_to(package.parent / "plant_sim")
        assert not folder.is_relative_to(package.parent / "train_ato")
    assert not kernel_cache.SHARED.is_relative_to(sysconfig.get_path("purelib"))


def test_every_kernel_of_the_program_can_be_kept() -> None:
    """Breaks if a compiled function reads a value without a stamp: every process would compile it again."""
    root = Path(plant_sim.__file__).parents[1]
    for file in (path for package in ("plant_sim", "train_ato") for path in (root / package).rglob("*.py")):
        if "import compiled\n" in file.read_text(encoding="utf-8"):
            importlib.import_module(".".join(file.relative_to(root).with_suffix("").parts))
    gc.unfreeze()  # a run in this process may have frozen them, and the list leaves frozen objects out
    existing = [value for value in gc.get_objects() if type(value) is CPUDispatcher]  # also those in a class
    # numba keeps no parts of its own, which a compilation in this process leaves; they have this mark
    made = [kernel for kernel in existing if "no_cpython_wrapper" not in kernel.targetoptions]
    kernels = {kernel for kernel in made if kernel.py_func.__module__.startswith(("plant_sim.", "train_ato."))}
    assert any("<locals>" in kernel.py_func.__qualname__ for kernel in kernels)
    assert len(kernels) > 200
    assert [kernel for kernel in kernels if kernel._cache._stamp is None] == []
    assert len({kernel._cache._stamp for kernel in kernels}) == len(kernels)


def test_an_unused_kernel_of_an_earlier_source_is_removed(tmp_path: Path, kernels: Path) -> None:
    law_of(tmp_path)
    law_of(tmp_path, constants="FACTOR = 3.0\n")
    files = sorted(kernels.glob("kernel_package.caller.law-*.nbc"))
    for file in files:
        os.utime(file, (0.0, 0.0))
    assert law_of(tmp_path) == (5.0, False)  # a use
    assert law_of(tmp_path, constants="FACTOR = 4.0\n") == (10.0, True)
    assert len([file for file in files if file.exists()]) == 1


def test_a_line_is_printed_if_a_kernel_is_compiled_and_none_if_it_is_loaded(tmp_path, kernels, capsys, monkeypatch):
    """Breaks if a slow load counts as a compilation, as it did on a busy machine, or a compilation is silent."""
    monkeypatch.setattr(progress, "_printed", set())  # the note is printed once in a process; another test may have
    printed = []
    for _ in range(2):
        with compilation_noted(COMPILE_NOTE):
            law_of(tmp_path)
        printed.append(capsys.readouterr().err)
    assert printed == [COMPILE_NOTE + "\n", ""]


def test_compiled_kernels_of_an_earlier_installation_do_not_hide_the_package(tmp_path: Path) -> None:
    """Breaks if an editable installation comes on the path after the folder that an upgrade by pip leaves."""
    command = [sys.executable, "-c", "import plant_sim; print(plant_sim.__file__)"]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    installed = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False)
    if installed.returncode != 0:
        pytest.skip("train_ato is not installed in this environment; pip install --editable . installs it")
    (tmp_path / "plant_sim" / "__pycache__").mkdir(parents=True)
    found = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert found.stdout == installed.stdout


@pytest.mark.campaign
def test_a_run_needs_no_folder_for_what_it_compiles(tmp_path: Path) -> None:
    """Breaks if a run without a writable folder ends, or says that later ones start at once."""
    out = tmp_path / "out"
    command = ["-m", "train_ato", "run", "demo", "--engine", "--json", "--set", "duration=5", "--out", str(out)]
    done = python(*command, NUMBA_CACHE_DIR="/dev/null/kernels")
    assert done.returncode == 0, done.stderr
    assert "NUMBA_CACHE_DIR" in done.stderr and "once on this machine" not in done.stderr
    assert json.loads(done.stdout)["ticks"] == 50


DRIVE_DEMO = f"""
import sys
sys.path[:0] = [{str(Path(__file__).parent)!r}, {str(Path(__file__).parent / "golden")!r}]
from bits import bits_of
from span_runs import setup_of
from train_ato.loop.engine import run_engine
print(*(bits_of(run_engine(setup_of("demo", {{"duration": 20}}), compiled=form)) for form in (False, True)))
"""


@pytest.mark.graph
def test_a_run_without_compiler_has_the_same_bits() -> None:
    """With NUMBA_DISABLE_JIT=1 all compiled functions are plain Python: law, loop and train have the same bits."""
    found = set()
    for value in ("1", "0"):
        done = python("-c", DRIVE_DEMO, NUMBA_DISABLE_JIT=value)
        assert done.returncode == 0, done.stderr
        found |= set(done.stdout.split())
    assert len(found) == 1, found
