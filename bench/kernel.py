"""Time of the plant: compiled kernel compared with the same step in plain numpy, and over the number of vehicles.

    python bench/kernel.py

The figures are milliseconds per simulated second on one core, the best of several runs.  The goals: 106 vehicles with
all effects take about 1 ms per simulated second, the kernel is at least 5 times as fast as plain numpy, and the time
per vehicle with 1000 vehicles is at most twice that with 106.  The exit status is 1 if a goal is missed widely (see
goals.py).
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np
from figures import Figure, publish
from goals import Goal, judge
from plain_numpy_train import PlainTrain

from plant_sim import kernel as k
from plant_sim.consist import Consist
from plant_sim.library import load_consist, load_line
from plant_sim.plant_setup import PlantSetup
from plant_sim.train import Train, compile_kernel

STEP_NS, TICK_NS = 5_000_000, 100_000_000
LEAST_RATIO = 5.0
MOST_MS = 1.0
MOST_GROWTH = 2.0
SPEED = 70 / 3.6


def heavy_train(wagons: int) -> Consist:
    """Return a train of one HXD1 locomotive and C80 wagons."""
    consist = load_consist("hxd1_c80_105")
    front, rear = consist.train
    return consist.model_copy(update={"train": (front, rear.model_copy(update={"count": wagons}))})


def new_train(vehicles: int, brake_on: bool, everything: bool = False) -> Train:
    """Return a train at 70 km/h on the section with the long downhill grades, optionally with the brake applied."""
    wind = {"kind": "turbulence", "acceleration_rms": 0.01}
    extras = {
        "lag": 0.4,
        "rate_limit_kn_per_s": 100,
        "dead_band": 100,
        "adhesion": {"kind": "curtius_kniffler"},
        "disturbances": [{"kind": "eq40", "vehicles": list(range(0, vehicles, 10))}, wind],
    }
    start = {"position_km": 15.0, "speed": SPEED}
    setup = PlantSetup.model_validate({"start": start, **(extras if everything else {})})
    train = Train(heavy_train(vehicles - 1), load_line("daqin_section"), setup, STEP_NS, TICK_NS)
    train.advance(np.zeros((train.substeps, 1)), 550e3 if brake_on else None)
    return train


def milliseconds(advance: Callable[[], None], ticks: int, repeats: int = 5) -> float:
    """Return the wall time of one simulated second [ms], the best of several runs because of other load."""
    for _ in range(5):
        advance()
    costs = []
    for _ in range(repeats):
        begin = time.perf_counter()
        for _ in range(ticks):
            advance()
        costs.append((time.perf_counter() - begin) * 1e3 / (ticks * TICK_NS * 1e-9))
    return min(costs)


def kernel_cost(vehicles: int, brake_on: bool, everything: bool = False) -> float:
    """Return the time of the compiled plant [ms per simulated second]."""
    train = new_train(vehicles, brake_on, everything)
    demand = np.full((train.substeps, 1), 200e3)
    return milliseconds(lambda: train.advance(demand), 40)


def plain_cost(vehicles: int, brake_on: bool) -> float:
    """Return the time of the same step in plain numpy [ms per simulated second]."""
    train = new_train(vehicles, brake_on)
    plain = PlainTrain(train.arrays, STEP_NS * 1e-9)
    demand = np.full((train.substeps, 1), 200e3)
    event, under_way = np.zeros((k.EVENT_ROWS, 1)), 0
    if brake_on:
        event[:, 0] = (0.0, 200.0, 0.17, 0.0, 1.0, 0.0)
        under_way = 1
    plain.arrays.vehicle_index[k.NEWEST] = 0
    return milliseconds(lambda: plain.advance(1.0, event, under_way, demand), 3, 3)


def main() -> int:
    """Print the tables; return the exit status."""
    compiled = compile_kernel()
    print(f"kernel {'compiled now' if compiled else 'from the cache'}; step 5 ms, tick 0.1 s, one core")
    print(f"{'106 vehicles':24} {'kernel ms/s':>12} {'numpy ms/s':>12} {'ratio':>8}")
    worst = float("inf")
    for title, brake_on in (("air brake released", False), ("air brake applied", True)):
        fast, slow = kernel_cost(106, brake_on), plain_cost(106, brake_on)
        worst = min(worst, slow / fast)
        publish(Figure(f"106 vehicles, {title}", fast, "ms per simulated second", "plain numpy", slow))
        print(f"{title:24} {fast:12.3f} {slow:12.1f} {slow / fast:8.1f}")
    full = kernel_cost(106, True, True)
    print(f"{'all effects':24} {full:12.3f}   (lag, rate, dead band, adhesion, disturbances)")
    print(f"\n{'vehicles':>8} {'ms/s':>10} {'us/s per vehicle':>18} {'with air brake':>16}")
    per_vehicle = {}
    for vehicles in (53, 106, 212, 424, 1000):
        cost, braked = kernel_cost(vehicles, False), kernel_cost(vehicles, True)
        per_vehicle[vehicles] = cost / vehicles
        print(f"{vehicles:8d} {cost:10.3f} {1e3 * cost / vehicles:18.2f} {1e3 * braked / vehicles:16.2f}")
    print()
    return judge(
        (
            Goal("106 vehicles, all switched on", full, MOST_MS, "ms per simulated second"),
            Goal("times as fast as plain numpy", worst, LEAST_RATIO, at_least=True),
            Goal("cost of a vehicle, 1000 over 106", per_vehicle[1000] / per_vehicle[106], MOST_GROWTH),
        )
    )


if __name__ == "__main__":
    sys.exit(main())
