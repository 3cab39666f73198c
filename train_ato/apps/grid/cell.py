"""Cells of the grid: the axes, and the environment variables of a cell."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import product

from train_ato.apps.grid.interpreters import Interpreter

HOST = "host"
TARGETS = ("generic", "x86-64-v2", "haswell", HOST)
"""CPU targets of the compiled kernels, ``NUMBA_CPU_NAME``; ``host``: this CPU with all its features."""
THREADS = (1, 2)
GRAPH_MODES = ("composed", "processes")
LIBRARIES: dict[str, dict[str, str]] = {
    "numpy baseline": {},
    "libm without FMA": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-AVX,-FMA,-FMA4"},
    "OpenBLAS Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "OpenBLAS Nehalem": {"OPENBLAS_CORETYPE": "Nehalem"},
}
"""Libraries that choose code by processor, with the variables that make them choose that of another one."""
_THREAD_VARIABLES = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_CLEARED = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NPY_DISABLE_CPU_FEATURES", "GLIBC_TUNABLES", "OPENBLAS_CORETYPE")
_OF_WHEELS = ("_ROS_WHEELS_BOOTSTRAP_COMPLETE", "LD_LIBRARY_PATH")
"""Variables that the ROS wheels of one interpreter set for themselves; those of another one set their own."""


@dataclass(frozen=True)
class Axes:
    """Values of every axis of the grid; the first of each is that of the reference cell.

    Attributes
    ----------
    interpreters : tuple of Interpreter
        Python interpreters.
    targets : tuple of str
        CPU targets of the compiled kernels.
    threads : tuple of int
        Numbers of threads of numba and of the linear algebra.
    modes : tuple of str
        Modes of a run.
    libraries : tuple of str
        Names of :data:`LIBRARIES` for more cells beside the reference cell.
    """

    interpreters: tuple[Interpreter, ...]
    targets: tuple[str, ...]
    threads: tuple[int, ...]
    modes: tuple[str, ...]
    libraries: tuple[str, ...] = ()


@dataclass(frozen=True)
class Batch:
    """Cells of one child process: they differ in the mode only."""

    interpreter: Interpreter
    target: str
    threads: int
    modes: tuple[str, ...]
    library: str = ""

    @property
    def cells(self) -> tuple[Cell, ...]:
        """Cells in the order of their runs."""
        return tuple(
            Cell(self.interpreter.version, self.target, self.threads, mode, self.library) for mode in self.modes
        )

    @property
    def kernels(self) -> str:
        """Name of the cache of compiled kernels: equal for batches that may share it."""
        return f"{self.interpreter.version}-{self.target}"


@dataclass(frozen=True)
class Cell:
    """One cell of the grid.

    Attributes
    ----------
    python : str
        Version of the interpreter.
    target, threads, mode
        CPU target, number of threads, mode of the run.
    library : str
        Entry of :data:`LIBRARIES`, or empty.
    """

    python: str
    target: str
    threads: int
    mode: str
    library: str = ""

    def __str__(self) -> str:
        threads = f"{self.threads} thread{'s' if self.threads > 1 else ''}"
        return ", ".join(filter(None, (f"Python {self.python}", self.target, threads, self.mode, self.library)))


def batches(axes: Axes) -> Iterator[Batch]:
    """Yield the child processes of the whole grid; the first one has the reference cell.

    An interpreter without ROS has the engine only.
    """
    for interpreter, target, threads in product(axes.interpreters, axes.targets, axes.threads):
        modes = _possible(interpreter, axes.modes)
        if modes:
            yield Batch(interpreter, target, threads, modes)
    first = axes.interpreters[0]
    for library in axes.libraries:
        yield Batch(first, axes.targets[0], axes.threads[0], axes.modes[:1], library)


def _possible(interpreter: Interpreter, modes: Iterable[str]) -> tuple[str, ...]:
    return tuple(mode for mode in modes if interpreter.ros or mode not in GRAPH_MODES)


def environment(batch: Batch, base: dict[str, str], root: str, caches: str) -> dict[str, str]:
    """Return the environment of the child process of a batch.

    Parameters
    ----------
    base
        Environment of this process.
    root
        Folder with the packages ``train_ato`` and ``plant_sim``.
    caches
        Folder for compiled kernels and compiled Python.
    """
    cleared = (*_CLEARED, *(() if batch.interpreter.own else _OF_WHEELS))
    found = {key: value for key, value in base.items() if key not in cleared}
    found |= dict.fromkeys(_THREAD_VARIABLES, str(batch.threads))
    if batch.target != HOST:
        found |= {"NUMBA_CPU_NAME": batch.target, "NUMBA_CPU_FEATURES": ""}
    if batch.library == "numpy baseline":
        found["NPY_DISABLE_CPU_FEATURES"] = " ".join(batch.interpreter.numpy_features)
    return found | {
        **LIBRARIES.get(batch.library, {}),
        "PYTHONPATH": os.pathsep.join(filter(None, (root, base.get("PYTHONPATH", "")))),
        "PYTHONPYCACHEPREFIX": f"{caches}/python",
        "NUMBA_CACHE_DIR": f"{caches}/{batch.kernels}",
    }
