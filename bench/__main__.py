"""All benchmarks in one command, with a history.

    python -m bench [--only NAME[,NAME...]] [--quick] [--history FILE] [--json]
    python -m bench --compare COMMIT_A COMMIT_B [--history FILE] [--json]
    python -m bench --list

Every benchmark is a script of this folder in a process of its own (``registry.py``).  Its figures, each beside its
floor or peer, the facts of the machine and the commit are appended to the history (default
``runs/bench_history.jsonl``, not committed).  A missed goal is printed and does not change the exit status; it is 1 if
a script failed.
"""

from __future__ import annotations

import argparse
import datetime
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
from figures import FILE, published  # noqa: E402
from history import append_entry, compare_entries, entry_of, other_machine  # noqa: E402
from machine import commit_facts, git, machine_facts  # noqa: E402
from registry import BENCHMARKS, Benchmark  # noqa: E402
from table import print_comparison, print_entry, print_rows  # noqa: E402

HISTORY = HERE.parent / "runs" / "bench_history.jsonl"
LIMIT_S = 3600.0
LEFT_OUT = "left out: "
"""Begin of the output of a script without figures on a machine that cannot run it."""


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


def run_benchmarks(benchmarks: Sequence[Benchmark], quick: bool, entry: dict[str, Any]) -> None:
    """Run benchmarks and add their figures to an entry of the history, also before an interruption."""
    for number, benchmark in enumerate(benchmarks, 1):
        sys.stderr.write(f"[{number}/{len(benchmarks)}] {benchmark.name}: {benchmark.summary}\n")
        lacking = missing(benchmark)
        if lacking:
            entry["left_out"][benchmark.name] = f"not installed: {', '.join(lacking)}"
            continue
        begin = time.perf_counter()
        try:
            figures, failure, unable = measured(benchmark, quick)
        except subprocess.TimeoutExpired:
            figures, failure, unable = [], f"not finished after {LIMIT_S:g} s", ""
        entry["figures"] += figures
        entry["wall_s"][benchmark.name] = round(time.perf_counter() - begin, 1)
        if failure:
            entry["failed"][benchmark.name] = failure
        if unable:
            entry["left_out"][benchmark.name] = unable


def new_entry(quick: bool) -> dict[str, Any]:
    """Return an entry of the history without figures."""
    now = datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds")
    facts = {"date": now, **commit_facts(), "quick": quick, "machine": machine_facts()}
    return {**facts, "figures": [], "wall_s": {}, "left_out": {}, "failed": {}}


def compare(history: Path, names: Sequence[str], as_json: bool) -> int:
    """Print the figures of two commits side by side; return the exit status."""
    one, other = (entry_of(history, git("rev-parse", "--verify", "--quiet", name) or name) for name in names)
    rows = compare_entries(one, other)
    if as_json:
        sys.stdout.write(json.dumps({"one": one["commit"], "other": other["commit"], "rows": rows}, indent=2) + "\n")
        return 0
    for line in other_machine(one, other):
        sys.stdout.write(f"not the same machine: {line}\n")
    print_comparison(rows, one["commit"][:10], other["commit"][:10])
    return 0


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m bench", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", metavar="NAME[,NAME...]", help="some benchmarks")
    parser.add_argument("--quick", action="store_true", help="shorter runs, and without the longest benchmarks")
    parser.add_argument("--history", type=Path, default=HISTORY, metavar="FILE", help="default: %(default)s")
    parser.add_argument("--compare", nargs=2, metavar=("COMMIT_A", "COMMIT_B"), help="compare two commits")
    parser.add_argument("--list", action="store_true", help="print names and summaries")
    parser.add_argument("--json", action="store_true", help="print one JSON value and nothing else")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run or compare benchmarks; return the exit status: 0 also for missed goals, 1 for a failure, 2 for bad input."""
    options = _options(arguments)
    try:
        if options.list:
            print_rows(("name", "figures"), ((entry.name, entry.summary) for entry in BENCHMARKS))
            return 0
        if options.compare:
            return compare(options.history, options.compare, options.json)
        benchmarks = chosen(options.only, options.quick)
    except ValueError as error:
        sys.stderr.write(f"bench: {error}\n")
        return 2
    entry = new_entry(options.quick)
    interrupted = False
    try:
        run_benchmarks(benchmarks, options.quick, entry)
    except KeyboardInterrupt:
        interrupted = True
        sys.stderr.write("bench: interrupted\n")
    if entry["figures"]:
        append_entry(options.history, entry)
    if options.json:
        sys.stdout.write(json.dumps(entry, indent=2) + "\n")
    else:
        print_entry(entry)
    return int(interrupted or bool(entry["failed"]))


if __name__ == "__main__":
    sys.exit(main())
