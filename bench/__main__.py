"""All benchmarks in one command.

    python -m bench [--only NAME[,NAME...]] [--quick] [--json]

Every benchmark is a script of this folder in a process of its own.  It prints its figures, each beside its floor or
peer: the ratio is that of the program, the value also that of the machine.  A missed goal does not change the exit
status; it is 1 if a script failed.  A new benchmark is a script ``bench/NAME.py`` that gives its figures to
``figures.publish`` or ``figures.judge``, and a row here.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
from figures import FILE  # noqa: E402

BENCHMARKS: dict[str, tuple[str, ...]] = {
    "startup": (),
    "memory": ("--hours", "0.1"),
    "kernel": (),
    "tick": ("daqin_heavy_haul", "xuzhou_metro"),
    "laws": ("pid", "smc", "funnel"),
    "composed": ("--ticks", "500", "--rounds", "2"),
}
"""Scripts in the order of their runs, and the arguments of a run with ``--quick``."""


def machine() -> str:
    """Return processor cores, load and versions as text."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "numba", "rosbags"))
    cores, load = len(os.sched_getaffinity(0)), os.getloadavg()[0]
    return f"{platform.platform()}, {cores} cores, load {load:.2f}, Python {platform.python_version()}, {packages}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run benchmarks; return the exit status: 0 also for missed goals, 1 for a failure, 2 for bad input."""
    parser = argparse.ArgumentParser(
        prog="python -m bench", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", metavar="NAME[,NAME...]", help=f"some of {', '.join(BENCHMARKS)}")
    parser.add_argument("--quick", action="store_true", help="shorter runs")
    parser.add_argument("--json", action="store_true", help="print one JSON value and nothing else")
    options = parser.parse_args(arguments)
    chosen = list(BENCHMARKS) if options.only is None else options.only.split(",")
    if unknown := [name for name in chosen if name not in BENCHMARKS]:
        sys.stderr.write(f"bench: --only {unknown[0]}: no such benchmark; benchmarks: {', '.join(BENCHMARKS)}\n")
        return 2
    out = sys.stderr if options.json else sys.stdout
    print(machine(), file=out, flush=True)
    figures, failed = [], []
    for name in chosen:
        print(f"\n{name}", file=out, flush=True)
        with tempfile.NamedTemporaryFile("r", prefix="train_ato_bench_", encoding="utf-8") as file:
            paths = os.pathsep.join(filter(None, (str(HERE.parent), os.environ.get("PYTHONPATH", ""))))
            command = [sys.executable, str(HERE / f"{name}.py"), *(BENCHMARKS[name] if options.quick else ())]
            variables = {**os.environ, "PYTHONPATH": paths, FILE: file.name}
            status = subprocess.call(command, stdout=2 if options.json else None, env=variables)
            found = [{"benchmark": name, **json.loads(line)} for line in file]
        figures += found
        if status != int(any(figure["verdict"] == "missed widely" for figure in found)) or not found:
            failed.append(name)
            print(f"{name}: failed with exit status {status}", file=out)
    if options.json:
        print(json.dumps({"machine": machine(), "figures": figures, "failed": failed}, indent=2))
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
