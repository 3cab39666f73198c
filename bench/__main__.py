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


@dataclass(frozen=True)
class Benchmark:
    """One script.

    Attributes
    ----------
    name : str
        Name of the script, without ``.py``.
    summary : str
        Measured quantity and its floor or peer.
    quick : tuple of str
        Arguments of a run with ``--quick``; a full run has none.
    needs : tuple of str
        Python packages without which it is left out.
    """

    name: str
    summary: str
    quick: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()


BENCHMARKS = (
    Benchmark("startup", "start of the command and of a run; beside an empty Python and numpy"),
    Benchmark("memory", "largest memory of a simulated hour; beside the imports alone", quick=("--hours", "0.1")),
    Benchmark("kernel", "plant; beside plain numpy"),
    Benchmark("tick", "tick of the engine by scenario; beside its kernel", quick=("daqin_heavy_haul", "xuzhou_metro")),
    Benchmark("laws", "step of every law; beside a law without computation", quick=("pid", "smc", "funnel")),
    Benchmark(
        "composed", "lockstep graph; beside a bare rclpy ring", quick=("--ticks", "500", "--rounds", "2"),
        needs=("rclpy",),
    ),
)  # fmt: skip
"""Benchmarks in the order of their runs."""


def chosen(only: str | None) -> list[Benchmark]:
    """Return the benchmarks of the option ``--only``.

    Raises
    ------
    ValueError
        For an unknown name.
    """
    known = {entry.name: entry for entry in BENCHMARKS}
    if only is None:
        return list(BENCHMARKS)
    names = [name.strip() for name in only.split(",") if name.strip()]
    for name in names:
        if name not in known:
            raise ValueError(f"--only {name}: no such benchmark; benchmarks: {', '.join(known)}")
    if not names:
        raise ValueError("--only: no name; give one or remove the option")
    return [known[name] for name in names]


def missing(benchmark: Benchmark) -> list[str]:
    """Return the packages that a benchmark lacks here."""
    return [need for need in benchmark.needs if importlib.util.find_spec(need) is None]


def measured(benchmark: Benchmark, *, quick: bool) -> tuple[list[dict[str, Any]], str]:
    """Run a script; return its figures and the reason of a failure, or an empty text."""
    with tempfile.TemporaryDirectory(prefix="train_ato_bench_") as folder:
        file = Path(folder) / "figures.jsonl"
        paths = os.pathsep.join(filter(None, (str(HERE.parent), os.environ.get("PYTHONPATH", ""))))
        done = subprocess.run(
            [sys.executable, str(HERE / f"{benchmark.name}.py"), *(benchmark.quick if quick else ())],
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
        return figures, f"exit status {done.returncode}: {last}"
    return figures, "" if figures else "no figures"


def run_benchmarks(benchmarks: Sequence[Benchmark], *, quick: bool, run: dict[str, Any]) -> None:
    """Run benchmarks and add their figures to those of a run, also before an interruption."""
    for number, benchmark in enumerate(benchmarks, 1):
        sys.stderr.write(f"[{number}/{len(benchmarks)}] {benchmark.name}: {benchmark.summary}\n")
        if lacking := missing(benchmark):
            run["left_out"][benchmark.name] = f"not installed: {', '.join(lacking)}"
            continue
        try:
            figures, failure = measured(benchmark, quick=quick)
        except subprocess.TimeoutExpired:
            figures, failure = [], f"not finished after {LIMIT_S:g} s"
        run["figures"] += figures
        if failure:
            run["failed"][benchmark.name] = failure


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
    parser.add_argument("--quick", action="store_true", help="shorter runs")
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
        benchmarks = chosen(options.only)
    except ValueError as error:
        sys.stderr.write(f"bench: {error}\n")
        return 2
    run: dict[str, Any] = {"machine": machine(), "figures": [], "left_out": {}, "failed": {}}
    interrupted = False
    try:
        run_benchmarks(benchmarks, quick=options.quick, run=run)
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
