"""Child process of the grid: run scenarios in several modes and record them.

    python -m train_ato.apps.grid.cell_runs OUT JOBS

``JOBS`` is JSON: a list of scenario (name and changes) and mode.  Every finished run writes one line of JSON on
standard output; its log is in ``OUT/NUMBER``.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from train_ato.errors import RunFailed
from train_ato.log.run_folder import RunFolder
from train_ato.loop.engine import run_engine
from train_ato.loop.setup import prepare
from train_ato.scenario.scenario import load_scenario


def record_run(name: str, changes: list[str], mode: str, folder: Path) -> str:
    """Run a scenario in a mode and record it; return the failure, empty for a complete run."""
    setup = prepare(*load_scenario(name, tuple(changes)))
    run = RunFolder.make(folder, name)
    if mode == "engine":
        with run.sink(setup, timed=False) as sink:
            return run_engine(setup, sink=sink).failure or ""
    from train_ato.ros.graph.runner import run_graph

    result = run_graph(setup, run.path, mode=mode)
    return result.failure or ("interrupted" if result.interrupted else "")


def main(out: str, jobs: str) -> int:
    """Run all jobs; return the exit status, 1 after a failure."""
    status = 0
    for number, (name, changes, mode) in enumerate(json.loads(jobs)):
        try:
            failure = record_run(name, changes, mode, Path(out) / str(number))
        except (ValueError, OSError, RunFailed) as error:
            failure = " ".join(str(error).split()) or type(error).__name__
        sys.stdout.write(json.dumps({"number": number, "failure": failure}) + "\n")
        sys.stdout.flush()
        status = status or int(bool(failure))
    return status


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
