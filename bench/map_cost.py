"""Cost of a robustness map of 64 x 64 runs of `daqin_heavy_haul`, from runs of its points, beside the kernel alone.

    python bench/map_cost.py [--step S]

Delay of the command by error of mass, 45 km, law `pid` in compiled ticks, unrecorded, as a worker of `train-ato sweep`
runs them.  Cycles and instructions are those of the run with the fewest cycles; a map takes 4096 times its processor
time, over two cores.  The kernel alone has the cycles of a released train.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any

from goals import Goal, judge
from kernel import RELEASED
from kernel_cycles import tick_cycles
from processor_counters import ProcessorCounters

from train_ato.apps.sweep.check import sweep_base
from train_ato.apps.sweep.design import design_points
from train_ato.apps.sweep.row import drive_point
from train_ato.apps.sweep.spec import read_sweep
from train_ato.loop.part_cache import PartCache
from train_ato.loop.setup import RunSetup
from train_ato.loop.spans import kernel

RUNS, CORES, GOAL_MINUTES = 64 * 64, 2, 10.0
SPEC: dict[str, Any] = {
    "scenario": "daqin_heavy_haul",
    "over": {
        "links.command.delay": {"from": 0.2, "to": 1.6, "steps": 64},
        "plant.mismatch.mass_scale": {"from": 0.9, "to": 1.1, "steps": 64},
    },
}
POINTS = (2080, 2081, 2100, 2145, 2015)
"""Points near the middle of the map; the first run is not measured."""


class CompiledCalls:
    """Cycles and instructions of the compiled calls of a run."""

    def __init__(self, counters: ProcessorCounters) -> None:
        self._counters, self._call = counters, kernel.run_span
        self.cycles = self.instructions = self.ticks = 0

    def __call__(self, *arguments: Any) -> int:
        """Run the ticks of a span and count."""
        before = self._counters.read()
        ticks: int = self._call(*arguments)
        after = self._counters.read()
        self.cycles += after[0] - before[0]
        self.instructions += after[1] - before[1]
        self.ticks += ticks
        return ticks


def measured_run(
    counters: ProcessorCounters, base: Any, point: tuple[int, Any], parts: PartCache
) -> tuple[int, int, float, CompiledCalls]:
    """Return cycles, instructions, processor time [s] and compiled calls of a run."""
    calls = CompiledCalls(counters)
    kernel.run_span, former = calls, kernel.run_span
    try:
        begin, before = time.thread_time(), counters.read()
        row = drive_point(base, *point, parts)
        after, seconds = counters.read(), time.thread_time() - begin
    finally:
        kernel.run_span = former
    if row["status"] != "done":
        raise SystemExit(f"run {row['run']}: {row['status']}: {row['reason']}")
    return after[0] - before[0], after[1] - before[1], seconds, calls


def main() -> int:
    """Print the table; return the exit status."""
    parser = argparse.ArgumentParser(description="Cost of a map of 64 x 64 runs.")
    parser.add_argument("--step", type=float, default=0.005, help="plant step in s (default: 0.005)")
    step = parser.parse_args().step
    try:
        counters = ProcessorCounters()
    except OSError as error:
        print(f"left out: {error}")
        return 0
    spec = read_sweep({**SPEC, "set": {"step": step}})
    base, points = sweep_base(spec).choice(), list(enumerate(design_points(spec), 1))
    parts = PartCache()
    drive_point(base, *points[POINTS[0]], parts)
    runs = [measured_run(counters, base, points[index], parts) for index in POINTS[1:]]
    cycles, instructions, seconds, calls = min(runs, key=lambda run: run[0])
    setup: RunSetup = base.with_(points[POINTS[0]][1]).prepare(parts=parts)
    alone = tick_cycles(counters, RELEASED)
    steps = setup.ticks * round(setup.tick / step) * len(setup.consist.vehicles)
    rows = {
        "run": (cycles, instructions),
        f"compiled calls, {calls.ticks} of {setup.ticks} ticks": (calls.cycles, calls.instructions),
        "kernel alone": (alone[0] * steps, alone[1] * steps),
    }
    print(f"{'one run, step ' + format(step, 'g') + ' s':44} {'Gcycles':>8} {'Ginstr.':>8} {'map, min':>9}")
    minutes = {}
    for name, (count, executed) in rows.items():
        minutes[name] = RUNS / CORES / 60 * seconds * count / cycles
        print(f"{name:44} {count / 1e9:8.2f} {executed / 1e9:8.2f} {minutes[name]:9.1f}")
    goal = Goal("map of 64 x 64 runs, two cores", minutes["run"], GOAL_MINUTES, "min", beside="kernel alone",
                beside_value=minutes["kernel alone"])  # fmt: skip
    return judge([goal])


if __name__ == "__main__":
    sys.exit(main())
