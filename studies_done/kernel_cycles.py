"""Cycles and instructions of the kernel per vehicle and step, 106 vehicles: the same on a busy machine.

    python studies_done/kernel_cycles.py

A call has 10 ticks of 20 steps; the figures are those of the call with the fewest cycles.  The disturbances of `all
effects` are computed before the calls.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
import numpy as np
from figures import Figure, publish
from kernel import APPLIED, FULL, LOOPS as PAIRS, RELEASED, new_train
from processor_counters import ProcessorCounters

from plant_sim import kernel as k

VEHICLES, TICKS, REPEATS, LOOPS = 106, 10, 6000, 50
STATES = {"released": RELEASED, "air brake applied": APPLIED, "all effects": FULL}


def tick_cycles(counters: ProcessorCounters, state: tuple[bool, bool]) -> tuple[float, float]:
    """Return cycles and instructions of a train per vehicle and step."""
    train = new_train(VEHICLES, *state)
    outside = np.ascontiguousarray(train.outside.rest_of_block(train.stamp, TICKS))
    demand, a = np.full((len(outside), train.substeps, 1), 200e3), train.arrays

    def advance() -> None:
        k.advance_ticks(
            train.stamp, train.tick_ns, train.step, a.state, a.vehicle, a.vehicle_index, a.gear, a.table, a.run,
            a.body, a.unit, a.unit_index, a.envelope, a.piece, train.brake.array, demand, outside,
            train.outside.vehicles, a.setting,
        )  # fmt: skip

    cycles, instructions = counters.least(advance, REPEATS)
    steps = VEHICLES * demand.shape[0] * demand.shape[1]
    return cycles / steps, instructions / steps


def main() -> int:
    """Print the tables; return the exit status."""
    try:
        counters = ProcessorCounters()
    except OSError as error:
        print(f"left out: {error}")
        return 0
    print(f"{'106 vehicles, per vehicle and step':36} {'cycles':>8} {'instructions':>13}")
    for title, state in STATES.items():
        cycles, instructions = tick_cycles(counters, state)
        publish(Figure(f"kernel, {title}", cycles, "cycles per vehicle-step"))
        print(f"{title:36} {cycles:8.1f} {instructions:13.1f}")
    print(f"\n{'loop, released':36} {'cycles':>8} {'bare loop':>13}")
    for name, loops in PAIRS.items():
        costs = []
        for loop in loops:
            a = new_train(VEHICLES, False).arrays
            cycles, _ = counters.least(lambda loop=loop, a=a: loop(LOOPS, a.state, a.vehicle, a.gear), REPEATS)
            costs.append(cycles / (LOOPS * VEHICLES))
        publish(Figure(f"loop, {name}", costs[0], "cycles per vehicle", "bare loop", costs[1]))
        print(f"{name:36} {costs[0]:8.1f} {costs[1]:13.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
