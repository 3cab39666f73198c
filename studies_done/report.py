"""Time and size of the report of the run of an hour, of reading alone, and of a report of several runs.

    python studies_done/report.py [RUN]

Without RUN an hour of the heavy-haul train is simulated first (36 000 ticks, 106 vehicles, every topic).  The time of a
report is that of the command in a new process with its imports; the best of several counts.  The goals: below 6 s and
below 3 MB.  The exit status is 1 if one is missed widely (see figures.py).
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
from figures import Figure, Goal, judge, publish
from frames import measured, run_of_an_hour

MOST_S, MOST_MB = 6.0, 3.0
REPEATS = 3
STEPS = """
import json, sys, time
from pathlib import Path
from train_ato.log.recorded import open_recording
from train_ato.report.page_data import page_data
from train_ato.report.writing import write_page
from train_ato.report.print_figures import write_print_figures
begin = time.process_time()
recording = open_recording(Path(sys.argv[1]))
read = time.process_time()
reduced = page_data(recording)
downsampled = time.process_time()
write_page([reduced], Path(sys.argv[2]) / "steps.html", compared=False)
written = time.process_time()
write_print_figures(reduced, Path(sys.argv[2]), "png")
drawn = time.process_time()
steps = {"read": read - begin, "work out": downsampled - read, "write the page": written - downsampled}
print(json.dumps({**steps, "figures for print": drawn - written}))
"""


def command(runs: list[Path], page: Path) -> tuple[float, float]:
    """Write a report in a new process; return its wall time [s] and size [MB]."""
    begin = time.perf_counter()
    arguments = [sys.executable, "-m", "train_ato", "report", *map(str, runs), "--out", str(page), "--json"]
    answer = subprocess.run(arguments, check=True, capture_output=True, text=True)
    taken = time.perf_counter() - begin
    return taken, json.loads(answer.stdout)["bytes"] / 1e6


def main() -> int:
    """Print times, sizes and goals; return the exit status."""
    with run_of_an_hour("Time and size of the report of an hour's run.") as (run, folder):
        rounds = [measured(STEPS, run, folder) for _ in range(REPEATS)]
        for name in rounds[0]:
            print(f"{name + ', processor time':40s} {min(entry[name] for entry in rounds):8.2f} s")
        reading = min(entry["read"] for entry in rounds)
        reports = [command([run], folder / f"report{number}.html") for number in range(REPEATS)]
        taken, mega = min(entry[0] for entry in reports), reports[0][1]
        print(f"{'report, command':40s} {taken:8.2f} s   {mega:.2f} MB")
        twin = folder / "twin"
        twin.mkdir()
        for path in run.iterdir():
            if path.is_file():
                (twin / path.name).symlink_to(path.resolve())
        both, both_mega = command([run, twin], folder / "both.html")
        print(f"{'report of two such runs':40s} {both:8.2f} s   {both_mega:.2f} MB")
    publish(Figure("report of two such runs", both, "s", "reading of one run", reading))
    return judge(
        (
            Goal("report of an hour's run", taken, MOST_S, "s", beside="reading alone", beside_value=reading),
            Goal("its size", mega, MOST_MB, "MB"),
        )
    )


if __name__ == "__main__":
    sys.exit(main())
