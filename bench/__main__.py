"""All benchmarks in one command.

    python -m bench [--only NAME[,NAME...]] [--quick] [--json]
    python -m bench --list

Every benchmark is a script of this folder in a process of its own.  Its figures are printed, each beside its floor or
peer: the ratio is that of the program, the value also that of the machine.  A missed goal is printed and does not
change the exit status; it is 1 if a script failed.  A new benchmark is a script ``bench/NAME.py`` that gives its
figures to ``figures.publish`` or ``figures.judge``, and a row here.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
from figures import FILE, published  # noqa: E402

LIMIT_S = 3600.0
LEFT_OUT = "left out: "
"""Begin of the output of a script without figures on a machine that cannot run it."""


@dataclass(frozen=True)
class Benchmark:
    """One script.

    Attributes
    ----------
    name : str
        Name of the script, without ``.py``.
    summary : str
        Measured quantity and its floor or peer.
    arguments : tuple of str
        Arguments of a full run.
    quick : tuple of str or None
        Arguments of a run with ``--quick``; None: left out.
    needs : tuple of str
        Python packages and programs without which it is left out; a program has a leading ``/``.
    """

    name: str
    summary: str
    arguments: tuple[str, ...] = ()
    quick: tuple[str, ...] | None = ()
    needs: tuple[str, ...] = ()


BENCHMARKS = (
    Benchmark("startup", "start of the command and of a run; beside an empty Python and numpy"),
    Benchmark("memory", "largest memory of a simulated hour; beside the imports alone", quick=("--hours", "0.1")),
    Benchmark("kernel", "plant; beside plain numpy"),
    Benchmark("kernel_cycles", "cycles and instructions of the kernel; beside bare loops"),
    Benchmark("tick", "tick of the engine by scenario; beside its kernel", quick=("daqin_heavy_haul", "xuzhou_metro")),
    Benchmark("tick_parts", "parts of a tick in Python and in spans; beside the kernel", quick=("xuzhou_metro",)),
    Benchmark("laws", "step of every law; beside a law without computation", quick=("pid", "smc", "funnel")),
    Benchmark("codec", "messages; beside rosbags"),
    Benchmark("curves", "braking curves; beside a pass over the vehicles, and two searches"),
    Benchmark("planner", "planner", quick=None),
    Benchmark("scene", "scene of the train; beside rosbags"),
    Benchmark(
        "composed", "lockstep graph; beside a bare rclpy ring", quick=("--ticks", "500", "--rounds", "2"),
        needs=("rclpy",),
    ),
    Benchmark(
        "recorder", "recorder; beside the mcap package",
        quick=("--seconds", "5", "--ticks", "1000", "--rounds", "1"), needs=("rclpy",),
    ),
    Benchmark("frames", "tables of an hour; beside rosbags", quick=None),
    Benchmark("report", "report of an hour; beside reading alone", quick=None),
    Benchmark(
        "sweep", "sweep on Dask: two workers beside one, overhead of a run, a killed worker",
        quick=("--runs", "30", "--duration", "60"), needs=("distributed",),
    ),
    Benchmark("view", "live page", quick=None, needs=("rclpy", "/chromium")),
)  # fmt: skip
"""Benchmarks in the order of their runs."""


def chosen(only: str | None, quick: bool) -> list[Benchmark]:
    """Return the benchmarks of the options.

    Raises
    ------
    ValueError
        For an unknown name.
    """
    known = {entry.name: entry for entry in BENCHMARKS}
    if only is None:
        return [entry for entry in BENCHMARKS if not quick or entry.quick is not None]
    names = [name.strip() for name in only.split(",") if name.strip()]
    for name in names:
        if name not in known:
            raise ValueError(f"--only {name}: no such benchmark; benchmarks: {', '.join(known)}")
    if not names:
        raise ValueError("--only: no name; give one or remove the option")
    return [known[name] for name in names]


def missing(benchmark: Benchmark) -> list[str]:
    """Return the packages and programs that a benchmark lacks here."""
    return [
        need.lstrip("/")
        for need in benchmark.needs
        if (shutil.which(need[1:]) if need.startswith("/") else importlib.util.find_spec(need)) is None
    ]


def measured(benchmark: Benchmark, quick: bool) -> tuple[list[dict[str, Any]], str, str]:
    """Run a script; return its figures, the reason of a failure, and why the machine cannot run it, or empty texts."""
    arguments = benchmark.quick if quick and benchmark.quick is not None else benchmark.arguments
    with tempfile.TemporaryDirectory(prefix="train_ato_bench_") as folder:
        file = Path(folder) / "figures.jsonl"
        paths = os.pathsep.join(filter(None, (str(HERE.parent), os.environ.get("PYTHONPATH", ""))))
        done = subprocess.run(
            [sys.executable, str(HERE / f"{benchmark.name}.py"), *arguments],
            env={**os.environ, "PYTHONPATH": paths, FILE: str(file)},
            capture_output=True,
            text=True,
            cwd=HERE.parent,
            timeout=LIMIT_S,
            check=False,
        )
        figures = [{"benchmark": benchmark.name, **figure} for figure in published(file)]
    wide = any(figure["verdict"] == "missed widely" for figure in figures)
    if done.returncode != 0 and not wide:
        last = (done.stderr.strip().splitlines() or [""])[-1]
        return figures, f"exit status {done.returncode}: {last}", ""
    first = done.stdout.strip().partition("\n")[0]
    if not figures and first.startswith(LEFT_OUT):
        return figures, "", first.removeprefix(LEFT_OUT)
    return figures, "" if figures else "no figures", ""


def run_benchmarks(benchmarks: Sequence[Benchmark], quick: bool, run: dict[str, Any]) -> None:
    """Run benchmarks and add their figures to those of a run, also before an interruption."""
    for number, benchmark in enumerate(benchmarks, 1):
        sys.stderr.write(f"[{number}/{len(benchmarks)}] {benchmark.name}: {benchmark.summary}\n")
        if lacking := missing(benchmark):
            run["left_out"][benchmark.name] = f"not installed: {', '.join(lacking)}"
            continue
        try:
            figures, failure, unable = measured(benchmark, quick)
        except subprocess.TimeoutExpired:
            figures, failure, unable = [], f"not finished after {LIMIT_S:g} s", ""
        run["figures"] += figures
        for kind, reason in (("failed", failure), ("left_out", unable)):
            if reason:
                run[kind][benchmark.name] = reason


def machine() -> str:
    """Return processor cores, load and versions as text."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "numba", "rosbags"))
    cores, load = len(os.sched_getaffinity(0)), os.getloadavg()[0]
    return f"{platform.platform()}, {cores} cores, load {load:.2f}, Python {platform.python_version()}, {packages}"


def print_rows(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table: the first two columns to the left."""
    table = [list(titles), *(list(row) for row in rows)]
    widths = [max(len(row[column]) for row in table) for column in range(len(titles))]
    for row in table:
        pairs = enumerate(zip(row, widths, strict=True))
        cells = [text.ljust(width) if column < 2 else text.rjust(width) for column, (text, width) in pairs]
        sys.stdout.write("  ".join(cells).rstrip() + "\n")


def _row(figure: dict[str, Any]) -> list[str]:
    beside = "" if figure["beside_value"] is None else f"{figure['beside_value']:.4g} ({figure['beside']})"
    ratio = "" if figure["ratio"] is None else f"{figure['ratio']:.4g}"
    sign = "at least" if figure["at_least"] else "at most"
    goal = "" if figure["bound"] is None else f"{sign} {figure['bound']:.4g}"
    value = f"{figure['value']:.4g} {figure['unit']}".rstrip()
    return [figure["benchmark"], figure["what"], value, beside, ratio, goal, figure["verdict"]]


def print_run(run: dict[str, Any]) -> None:
    """Print the table of a run, then missed goals, left-out and failed benchmarks."""
    sys.stdout.write(run["machine"] + "\n")
    print_rows(("benchmark", "figure", "value", "beside", "ratio", "goal", ""), map(_row, run["figures"]))
    missed = [figure for figure in run["figures"] if figure["verdict"].startswith("missed")]
    goals = sum(figure["bound"] is not None for figure in run["figures"])
    for figure in missed:
        sys.stdout.write(f"{figure['verdict']}: {figure['benchmark']}: {figure['what']}\n")
    for kind in ("left_out", "failed"):
        for name, reason in run[kind].items():
            sys.stdout.write(f"{kind.replace('_', ' ')}: {name}: {reason}\n")
    sys.stdout.write(f"{goals - len(missed)} of {goals} goals met\n")


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m bench", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", metavar="NAME[,NAME...]", help="some benchmarks")
    parser.add_argument("--quick", action="store_true", help="shorter runs, and without the longest benchmarks")
    parser.add_argument("--list", action="store_true", help="print names and summaries")
    parser.add_argument("--json", action="store_true", help="print one JSON value and nothing else")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run benchmarks; return the exit status: 0 also for missed goals, 1 for a failure, 2 for bad input."""
    options = _options(arguments)
    if options.list:
        print_rows(("name", "figures"), ((entry.name, entry.summary) for entry in BENCHMARKS))
        return 0
    try:
        benchmarks = chosen(options.only, options.quick)
    except ValueError as error:
        sys.stderr.write(f"bench: {error}\n")
        return 2
    run: dict[str, Any] = {"machine": machine(), "figures": [], "left_out": {}, "failed": {}}
    interrupted = False
    try:
        run_benchmarks(benchmarks, options.quick, run)
    except KeyboardInterrupt:
        interrupted = True
        sys.stderr.write("bench: interrupted\n")
    if options.json:
        sys.stdout.write(json.dumps(run, indent=2) + "\n")
    else:
        print_run(run)
    return int(interrupted or bool(run["failed"]))


if __name__ == "__main__":
    sys.exit(main())
