"""Cost of a robustness map of 64 x 64 runs of `daqin_heavy_haul`, from runs of its points, beside the kernel alone.

    python studies_done/map_cost.py [--step S]

Delay of the command by error of mass, 45 km, law `pid` in compiled ticks, unrecorded, as a worker of `train-ato sweep`
runs them.  Figures are those of the run with the least processor time; a map takes 4096 times this time, over two
cores.  With counters of the processor the table has cycles and instructions, too, and the kernel alone: the cycles of a
released train.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
import time
from functools import partialmethod
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
from figures import Goal, judge
from kernel import RELEASED
from kernel_cycles import tick_cycles
from processor_counters import ProcessorCounters

from train_ato.studies.sweep.row import keep_loaded_objects
from train_ato.studies.sweep.sweep import sweep_base
from train_ato.studies.sweep.spec import design_points
from train_ato.studies.sweep.row import drive_point
from train_ato.studies.sweep.spec import read_sweep
from train_ato.scenario.scenario_data import PartCache
from train_ato.scenario.setup import RunSetup
from train_ato.loop.span import CompiledSpans

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


class Cost(NamedTuple):
    """Processor time [s], cycles and instructions; those are 0 without counters."""

    seconds: float
    cycles: int = 0
    instructions: int = 0

    def since(self, before: Cost) -> Cost:
        """Return the difference to an earlier cost."""
        return Cost(*(now - then for now, then in zip(self, before, strict=True)))


def cost(counters: ProcessorCounters | None) -> Cost:
    """Return the cost of the calling thread so far."""
    return Cost(time.thread_time(), *(() if counters is None else counters.read()))


class CompiledCalls:
    """Cost of the compiled calls of a run."""

    def __init__(self, counters: ProcessorCounters | None) -> None:
        self._counters, self._call = counters, CompiledSpans.call
        self.cost, self.ticks = Cost(0.0), 0

    def __call__(self, *arguments: Any) -> int:
        """Run the ticks of a span and count."""
        before = cost(self._counters)
        ticks: int = self._call(*arguments)
        added = cost(self._counters).since(before)
        self.cost = Cost(*(sum(pair) for pair in zip(self.cost, added, strict=True)))
        self.ticks += ticks
        return ticks


def measured_run(
    counters: ProcessorCounters | None, base: Any, point: tuple[int, Any], parts: PartCache
) -> tuple[Cost, CompiledCalls]:
    """Return the cost of a run and of its compiled calls."""
    calls = CompiledCalls(counters)
    former = CompiledSpans.call
    CompiledSpans.call = partialmethod(calls)  # type: ignore[assignment, method-assign]
    try:
        before = cost(counters)
        row = drive_point(base, *point, parts)
        spent = cost(counters).since(before)
    finally:
        CompiledSpans.call = former  # type: ignore[method-assign]
    if row["status"] != "done":
        raise SystemExit(f"run {row['run']}: {row['status']}: {row['reason']}")
    return spent, calls


def main() -> int:
    """Print the table; return the exit status."""
    parser = argparse.ArgumentParser(description="Cost of a map of 64 x 64 runs.")
    parser.add_argument("--step", type=float, default=0.005, help="plant step in s (default: 0.005)")
    step = parser.parse_args().step
    counters = None
    try:
        counters = ProcessorCounters()
    except OSError as error:
        print(f"without cycles: {error}")
    spec = read_sweep({**SPEC, "set": {"step": step}})
    base, points = sweep_base(spec).choice(), list(enumerate(design_points(spec), 1))
    parts = PartCache()
    drive_point(base, *points[POINTS[0]], parts)
    keep_loaded_objects()
    run, calls = min((measured_run(counters, base, points[index], parts) for index in POINTS[1:]), key=lambda r: r[0])
    setup: RunSetup = base.with_(points[POINTS[0]][1]).prepare(parts=parts)
    compiled = f"compiled calls, {calls.ticks} of {setup.ticks} ticks"
    rows = {"run": run, compiled: calls.cost}
    if counters is not None:
        cycles, instructions = tick_cycles(counters, RELEASED)
        steps = setup.ticks * round(setup.tick / step) * len(setup.consist.vehicles)
        alone = round(cycles * steps)
        rows["kernel alone"] = Cost(run.seconds * alone / run.cycles, alone, round(instructions * steps))
    print(f"{'one run, step ' + format(step, 'g') + ' s':44} {'s':>8} {'Gcycles':>8} {'Ginstr.':>8} {'map, min':>9}")
    minutes = {name: RUNS / CORES / 60 * row.seconds for name, row in rows.items()}
    for name, row in rows.items():
        counted = f"{row.cycles / 1e9:8.2f} {row.instructions / 1e9:8.2f}" if row.cycles else f"{'-':>8} {'-':>8}"
        print(f"{name:44} {row.seconds:8.3f} {counted} {minutes[name]:9.1f}")
    goal = Goal("map of 64 x 64 runs, two cores", minutes["run"], GOAL_MINUTES, "min", beside="compiled calls",
                beside_value=minutes[compiled])  # fmt: skip
    return judge([goal])


if __name__ == "__main__":
    sys.exit(main())
