"""Time and size of the report of an hour's run, beside the time of only reading it; of several runs side by side.

    python bench/report.py [RUN]

Without RUN an hour of the heavy-haul train is driven first (36 000 ticks, 106 vehicles, every topic).  Every report is
a whole command in a new process, start and imports included; the best of several.  The goals: under 10 s and under
5 MB.  The exit status is 1 when one is missed widely (see goals.py).
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from frames import hour
from goals import Goal, judge

MOST_S, MOST_MB = 10.0, 5.0
REPEATS = 3
STEPS = """
import json, sys, time
from pathlib import Path
from train_ato.report.recording import read_recording
from train_ato.report.digest import digest
from train_ato.report.writing import write_run
from train_ato.report.plates import write_plates
begin = time.process_time()
recording = read_recording(Path(sys.argv[1]))
read = time.process_time()
reduced = digest(recording)
thinned = time.process_time()
write_run(reduced, Path(sys.argv[2]) / "steps.html")
written = time.process_time()
write_plates(reduced, Path(sys.argv[2]), "png")
drawn = time.process_time()
steps = {"read": read - begin, "work out": thinned - read, "write the page": written - thinned}
print(json.dumps({**steps, "figures for print": drawn - written}))
"""


def command(runs: list[Path], page: Path) -> tuple[float, float]:
    """Write a report in a new process; return its wall time [s] and size [MB]."""
    begin = time.perf_counter()
    arguments = [sys.executable, "-m", "train_ato", "report", *map(str, runs), "--out", str(page), "--json"]
    answer = subprocess.run(arguments, check=True, capture_output=True, text=True)
    taken = time.perf_counter() - begin
    return taken, json.loads(answer.stdout)["bytes"] / 1e6


def steps(run: Path, folder: Path) -> dict[str, float]:
    """Return the processor time of every step, imports apart [s]."""
    answer = subprocess.run(
        [sys.executable, "-c", STEPS, str(run), str(folder)], check=True, capture_output=True, text=True
    )
    result: dict[str, float] = json.loads(answer.stdout)
    return result


def main() -> int:
    """Print times, sizes and goals; return the exit status."""
    parser = argparse.ArgumentParser(description="Time and size of the report of an hour's run.")
    parser.add_argument("run", type=Path, nargs="?", help="run folder (default: an hour is driven)")
    chosen = parser.parse_args().run
    with tempfile.TemporaryDirectory(prefix="train_ato_bench_") as scratch:
        folder = Path(scratch)
        run = chosen or hour(folder)
        size = (run / "run.mcap").stat().st_size
        print(f"{run.name}: {size / 1e6:.0f} MB")
        rounds = [steps(run, folder) for _ in range(REPEATS)]
        for name in rounds[0]:
            print(f"{name + ', processor time':40s} {min(entry[name] for entry in rounds):8.2f} s")
        reports = [command([run], folder / f"report{number}.html") for number in range(REPEATS)]
        taken, mega = min(entry[0] for entry in reports), reports[0][1]
        print(f"{'report, the whole command':40s} {taken:8.2f} s   {mega:.2f} MB")
        twin = folder / "twin"
        twin.mkdir()
        for path in run.iterdir():
            if path.is_file():
                (twin / path.name).symlink_to(path.resolve())
        both, both_mega = command([run, twin], folder / "both.html")
        print(f"{'two such runs side by side':40s} {both:8.2f} s   {both_mega:.2f} MB")
    return judge((Goal("report of an hour's run", taken, MOST_S, "s"), Goal("its size", mega, MOST_MB, "MB")))


if __name__ == "__main__":
    sys.exit(main())
