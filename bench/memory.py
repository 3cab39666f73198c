"""Largest memory of a recorded run of a simulated hour, compared with the same command for ten seconds.

    python bench/memory.py [--hours H]

The command is ``train-ato run daqin_heavy_haul --engine``, 106 vehicles, every topic, with the log, the summary and the
figure.  The memory is the largest resident size of its process.  The floor is a run of ten seconds: interpreter,
packages and compiled kernels.  The goal is at most 400 MB for an hour; the exit status is 1 if it is missed widely (see
figures.py).
"""

import argparse
import sys
import tempfile

from figures import Goal, judge
from startup import python_command

MAX_MB = 400.0
SCENARIO = "daqin_heavy_haul"
SHORT_S = 10.0


def peak_mb(seconds: float) -> float:
    """Return the largest memory of a run of a simulated duration [MB]."""
    with tempfile.TemporaryDirectory(prefix="train_ato_bench_") as folder:
        command = ("-m", "train_ato", "run", SCENARIO, "--engine", "--set", f"duration={seconds:g}")
        return python_command(*command, "--out", f"{folder}/run", "--json").peak_mb


def main() -> int:
    """Print the memory and the goal; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--hours", type=float, default=1.0, help="simulated duration [h]")
    hours = parser.parse_args().hours
    floor, peak = peak_mb(SHORT_S), peak_mb(3600.0 * hours)
    name = f"largest memory of {hours:g} simulated hour"
    return judge((Goal(name, peak, MAX_MB, "MB", beside="run of 10 s", beside_value=floor),))


if __name__ == "__main__":
    sys.exit(main())
