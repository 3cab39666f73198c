"""Processor time of the start: of the command's help, and of a run up to its first tick.

    python bench/startup.py [--rounds N]

Every round runs each command once in a new process, in turns; the best round of each counts, because other load only
adds time.  The floors are an interpreter without a program and one that imports numpy.  A run stops at its first step
of the plant; the kernels are in the cache from a first run.  The goals: help in 0.2 s; the first tick in 1.5 s, with
ROS nodes in one process (default) and in the engine.  The exit status is 1 if one is missed widely (see figures.py).
"""

import argparse
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec

from figures import Figure, Goal, judge


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


HELP_S, TICK_S = 0.2, 1.5
FIRST_TICK = """
import os, sys, time
end = os._exit  # a run replaces it
from importlib.abc import MetaPathFinder
class Stop(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == "train_ato.loop.engine" or name == "train_ato.ros.nodes.plant":
            sys.meta_path.remove(self)
            from train_ato.loop.plant import PlantStage
            act = PlantStage.act
            def first(self, *arguments, **named):
                act(self, *arguments, **named)
                os.write(1, f"first tick {time.process_time()}\\n".encode())
                end(0)
            PlantStage.act = first
        return None
sys.meta_path.insert(0, Stop())
from train_ato.cli.main import main
sys.exit(main(sys.argv[1:]) or 3)
"""
"""Run of a command that ends after the first step of the plant and prints its processor time."""


def first_tick_s(*options: str) -> float:
    """Return the processor time of a run of the demo up to the end of its first tick [s]."""
    with tempfile.TemporaryDirectory(prefix="train_ato_bench_") as folder:
        spent = python_command("-c", FIRST_TICK, "run", "demo", *options, "--out", f"{folder}/run")
    (line,) = [line for line in spent.output.splitlines() if line.startswith("first tick ")]
    return float(line.split()[-1])


def main() -> int:
    """Print the times and the goals; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    measures = {
        "python -c pass": lambda: python_command("-c", "pass").processor_s,
        "import numpy": lambda: python_command("-c", "import numpy").processor_s,
        "import train_ato": lambda: python_command("-c", "import train_ato").processor_s,
        "train-ato --help": lambda: python_command("-m", "train_ato", "--help").processor_s,
        "run demo --engine, first tick": lambda: first_tick_s("--engine"),
    }
    if find_spec("rclpy") is not None:
        measures["run demo, first tick"] = first_tick_s
    for measure in measures.values():
        measure()  # fills the caches of kernels and compiled Python
    best = dict.fromkeys(measures, float("inf"))
    for _ in range(rounds):
        for name, measure in measures.items():
            best[name] = min(best[name], measure())
    bare, arrays = best["python -c pass"], best["import numpy"]
    figures = [
        Figure("import numpy", arrays, "s", "python -c pass", bare),
        Figure("import train_ato", best["import train_ato"], "s", "python -c pass", bare),
        Goal("train-ato --help", best["train-ato --help"], HELP_S, "s", beside="python -c pass", beside_value=bare),
    ]
    figures += [
        Goal(name, seconds, TICK_S, "s", beside="import numpy", beside_value=arrays)
        for name, seconds in best.items()
        if name.startswith("run demo")
    ]
    return judge(figures)


if __name__ == "__main__":
    sys.exit(main())
