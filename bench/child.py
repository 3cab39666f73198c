"""Processor time and largest memory of a command in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from functools import cache


@dataclass(frozen=True)
class Spent:
    """Resources of a finished command.

    Attributes
    ----------
    processor_s : float
        Processor time of the process and its children [s].
    peak_mb : float
        Largest resident memory [MB].
    output : str
        Standard output.
    """

    processor_s: float
    peak_mb: float
    output: str


@cache
def _bytecode() -> tempfile.TemporaryDirectory[str]:
    """Return a folder for compiled modules, removed at the end of the process."""
    return tempfile.TemporaryDirectory(prefix="train_ato_bench_")


def _with_bytecode() -> dict[str, str]:
    """Return the environment; where it forbids compiled modules, they have a folder, as a start of a user has."""
    variables = dict(os.environ)
    if variables.pop("PYTHONDONTWRITEBYTECODE", ""):
        variables["PYTHONPYCACHEPREFIX"] = _bytecode().name
    return variables


def python_command(*arguments: str) -> Spent:
    """Run this interpreter with arguments; return its resources.

    Raises
    ------
    SystemExit
        If the command fails, with the end of its standard error.
    """
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as errors:
        child = subprocess.Popen([sys.executable, *arguments], stdout=out, stderr=errors, env=_with_bytecode())
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode != 0:
            errors.seek(0)
            raise SystemExit(f"{' '.join(arguments)[:80]}: exit status {child.returncode}: {errors.read()[-400:]}")
        out.seek(0)
        return Spent(usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1e3, out.read())
