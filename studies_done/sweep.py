"""Sweep of ``xuzhou_metro`` on one worker, on two, and on two of which one is killed.

    python studies_done/sweep.py [--runs N] [--duration S]

The law is a Python law (pid, smc); lag and seed vary.  Measured after a first run on every worker, which loads the
compiled kernel.  Overhead of a run: preparation, hash and row in the worker, and the time between two runs (scheduler,
transfer, waiting), with one worker.  On a busy machine the wall times contain the other processes, so the overhead is
also given as processor time: of the worker's part in this process, and of this process during the sweep.  Start and
metrics of the engine are part of every run and are given beside it.  Goals for 1 000 runs: two workers at least 1.8
times as fast as one, overhead at most 5 ms of processor time, no run lost or doubled.  The exit status is 1 if a goal
is missed widely (see figures.py).
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
from figures import Goal, judge

from plant_sim.train import compile_kernel
from train_ato.studies.sweep import row
from train_ato.studies.sweep.row import SweepBase, run_batch
from train_ato.studies.sweep.sweep import sweep_base
from train_ato.studies.sweep.cluster import sweep_client
from train_ato.studies.sweep.spec import Point, design_points
from train_ato.studies.sweep.sweep import Execution
from train_ato.studies.sweep.row import Row
from train_ato.studies.sweep.spec import read_sweep
from train_ato.loop.engine import run_engine
from train_ato.scenario.scenario_data import PartCache
from train_ato.scenario.setup import RunSetup

SPEEDUP, OVERHEAD_MS = 1.8, 5.0


def points_of(runs: int, duration: float) -> tuple[SweepBase, list[tuple[int, Point]]]:
    """Return the sweep and its numbered points."""
    spec = read_sweep({
        "scenario": "xuzhou_metro", "design": "random", "runs": runs, "set": {"duration": duration},
        "over": {"law": ["pid", "smc"], "plant.lag": {"from": 0.2, "to": 0.5}, "seed": {"from": 1, "to": 10_000}},
    })  # fmt: skip
    return sweep_base(spec), list(enumerate(design_points(spec), 1))


def prepared_cpu_ms(duration: float, runs: int = 20) -> float:
    """Return the mean processor time of a run in a worker without that of the engine [ms]."""
    base, points = points_of(runs, duration)
    choice, parts, inside = base.choice(), PartCache(), [0.0]

    def timed(setup: RunSetup) -> Any:
        begin = time.thread_time()
        result = run_engine(setup)
        inside[0] += time.thread_time() - begin
        return result

    row.run_engine = timed  # type: ignore[assignment]
    try:
        row.drive_point(choice, *points[0], parts)
        inside[0], begin = 0.0, time.thread_time()
        for number, point in points:
            row.drive_point(choice, number, point, parts)
        return 1e3 * (time.thread_time() - begin - inside[0]) / runs
    finally:
        row.run_engine = run_engine


def swept(workers: int, runs: int, duration: float, *, kill: bool = False) -> tuple[float, float, list[Row]]:
    """Return wall time and processor time of this process [s] and the rows of a sweep on new workers.

    ``kill``: one worker ends at half of the runs.
    """
    base, points = points_of(runs, duration)
    rows: list[Row] = []
    with sweep_client(None, workers) as client:
        client.wait_for_workers(workers)
        warm = client.map(_first_run, [base] * workers, points[:workers], pure=False, workers=None)
        client.gather(warm)
        Execution(client, base, points[: 4 * workers], lambda new: None).run()
        begin, cpu = time.perf_counter(), time.process_time()
        Execution(client, base, points, _taking(client, rows, runs // 2 if kill else 0)).run()
        return time.perf_counter() - begin, time.process_time() - cpu, rows


def _first_run(base: Any, point: tuple[int, Any]) -> None:
    run_batch(base, [point])
    time.sleep(1.0)  # the other workers get one, too


def _taking(client: Any, rows: list[Row], kill_at: int) -> Callable[[list[Row]], None]:
    """Return the function that collects rows, and kills a worker after a number of them."""
    pending = [kill_at] if kill_at else []

    def take(new: list[Row]) -> None:
        rows.extend(new)
        if pending and len(rows) >= pending[0]:
            pending.clear()
            victim = next(iter(client.run(os.getpid).values()))
            threading.Thread(target=os.kill, args=(victim, signal.SIGKILL)).start()
            print(f"killed one of two workers after {len(rows)} runs")

    return take


def mean_ms(rows: list[Row], name: str) -> float:
    """Return the mean of a wall time of the rows [ms]."""
    return 1e3 * sum(entry[name] for entry in rows) / len(rows)


def main() -> int:
    """Print times and ratios; return the exit status."""
    parser = argparse.ArgumentParser(description="Speed and safety of a sweep.")
    parser.add_argument("--runs", type=int, default=1000, help="runs of every sweep (default: 1000)")
    parser.add_argument("--duration", type=float, default=460.0, help="duration of a run in s (default: 460)")
    options = parser.parse_args()
    compile_kernel()
    print(f"{options.runs} runs of {options.duration:g} s, load of the machine before: {os.getloadavg()[0]:.1f}")
    alone, cpu, rows = swept(1, options.runs, options.duration)
    loop, metrics, prepared = (mean_ms(rows, name) for name in ("wall_s", "evaluation_s", "overhead_s"))
    between = 1e3 * alone / len(rows) - loop - metrics - prepared
    print(f"one worker: {alone:.1f} s; a run: loop {loop:.1f} ms, start and metrics {metrics:.1f} ms, preparation, "
          f"hash and row {prepared:.2f} ms, between the runs {between:.2f} ms")  # fmt: skip
    both, _, halves = swept(2, options.runs, options.duration)
    own, ours = prepared_cpu_ms(options.duration), 1e3 * cpu / len(rows)
    print(f"processor time of a run: worker without engine {own:.2f} ms, client and scheduler {ours:.2f} ms")
    busy = sum(entry[name] for entry in halves for name in row.TIMES) / (2 * both)
    print(f"two workers: {both:.1f} s, in runs {100 * busy:.1f} % of it, load of the machine: {os.getloadavg()[0]:.1f}")
    _, _, kept = swept(2, options.runs, options.duration, kill=True)
    same = [(entry["run"], entry["sha256"], entry["metrics"]) for entry in _by_run(rows)]
    whole = same == [(entry["run"], entry["sha256"], entry["metrics"]) for entry in _by_run(kept)]
    print(f"after the kill: {len(kept)} rows, {'equal to' if whole else 'different from'} those of one worker")
    goals = (
        Goal("two workers over one", alone / both, SPEEDUP, at_least=True),
        Goal("overhead of a run, processor time", own + ours, OVERHEAD_MS, "ms"),
    )
    return judge(goals) if whole else 1


def _by_run(rows: list[Row]) -> list[Row]:
    return sorted(rows, key=lambda entry: int(entry["run"]))


if __name__ == "__main__":
    sys.exit(main())
