"""Time of the plant per vehicle and step: trains, loops beside bare loops, batch and environments over threads.

    python bench/kernel.py

The figures are nanoseconds per vehicle and plant step (5 ms, ticks of 0.1 s), the best of several runs.  `tick` calls
`Train.advance` for every tick; `batch` calls `advance_trains` for 100 ticks of one train in one thread.  A bare loop
has the loads, stores and divisions of a loop of the kernel and no other work than sums.  The exit status is 1 if a goal
is missed widely (see figures.py).
"""

import os
import sys
import time
from collections.abc import Callable

import numpy as np
from figures import Figure, Goal, judge, publish
from plain_numpy_train import PlainTrain

import train_ato as ta
from plant_sim import kernel as k
from plant_sim.batch import advance_trains
from plant_sim.compiled import compiled
from plant_sim.kernel import ONE, uint64
from plant_sim.library import load_consist, load_line
from plant_sim.plant_setup import PlantSetup
from plant_sim.train import Train, compile_kernel


@compiled
def couplers(repeats, state, vehicle, gear):
    """Repeat the loop of equal draft gears of the kind clip."""
    n, x, v = vehicle.shape[1], state[k.X], state[k.V]
    for _ in range(repeats):
        k._clip(1, n - 1, True, x, v, state, vehicle, gear)


@compiled
def speeds(repeats, state, vehicle, gear):
    """Repeat the loop of speeds, works and positions of a released train."""
    for _ in range(repeats):
        k._speeds(0.0, state, vehicle)


@compiled
def bare_couplers(repeats, state, vehicle, gear):
    """Load 9 values, divide once and store 5 values per vehicle, as :func:`couplers`."""
    for _ in range(repeats):
        for i in range(uint64(1), uint64(vehicle.shape[1] - 1)):
            s = state[0, i] + state[0, i + ONE] + state[1, i] + state[1, i + ONE] + vehicle[k.GAP, i]
            s += gear[12, i] + gear[13, i] + gear[14, i] + gear[15, i]
            gear[12, i] = gear[13, i] = gear[14, i] = s
            gear[15, i] = state[4, i + ONE] = s / (state[0, i] + 1e9)


@compiled
def bare_speeds(repeats, state, vehicle, gear):
    """Load 13 and 15 values and store 3 and 6 values per vehicle in two loops, as :func:`speeds`."""
    for _ in range(repeats):
        for i in range(uint64(vehicle.shape[1])):
            s = state[0, i] + state[1, i] + state[4, i] + state[4, i + ONE] + state[5, i] + state[6, i] + state[7, i]
            s += state[8, i] + state[9, i] + vehicle[0, i] + vehicle[3, i] + vehicle[4, i] + vehicle[5, i]
            state[26, i] = state[27, i] = state[28, i] = s
        for i in range(uint64(vehicle.shape[1])):
            s = state[0, i] + state[1, i] + state[4, i] + state[4, i + ONE] + state[9, i] + state[10, i] + state[11, i]
            s += state[26, i] + state[27, i] + state[28, i] + vehicle[3, i]
            s += state[19, i] + state[20, i] + state[21, i] + state[22, i]
            state[0, i] = state[1, i] = state[19, i] = state[20, i] = state[21, i] = state[22, i] = s


LOOPS = {
    "couplers: force, extremes": (couplers, bare_couplers),
    "vehicles: speed, works, position": (speeds, bare_speeds),
}
"""Name: loop of the kernel, bare loop; the bare loops destroy the state, so they need arrays of their own."""

STEP_NS, TICK_NS = 5_000_000, 100_000_000
MIN_RATIO = 5.0
MAX_NS, MAX_FULL_NS = 4.0, 15.0
MAX_GROWTH = 1.1
MIN_SPEED_UP = 1.8
ENVIRONMENTS = (("xuzhou_metro", 64, 150_000.0), ("daqin_heavy_haul", 1, 40_000.0))
"""Scenario, number of trains in one vector of environments, and least ticks of a train per second on one core."""
MIN_ENV_SPEED_UP = 1.7
SPEED = 70 / 3.6
UNIT = "ns per vehicle-step"
RELEASED, APPLIED, FULL = (False, False), (True, False), (True, True)
"""Air brake applied or not, and all effects of the plant or not."""


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
    consist = load_consist("hxd1_c80_105")
    front, rear = consist.train
    consist = consist.model_copy(update={"train": (front, rear.model_copy(update={"count": vehicles - 1}))})
    train = Train(consist, load_line("daqin_section"), setup, step_ns=STEP_NS, tick_ns=TICK_NS)
    train.advance(np.zeros((train.substeps, 1)), 550e3 if brake_on else None)
    while not train.is_quiet:  # the wave has reached the last vehicle
        train.advance(np.zeros((train.substeps, 1)))
    return train


def nanoseconds(advance: Callable[[], None], vehicle_steps: int, calls: int, repeats: int = 7) -> float:
    """Return the wall time per vehicle-step [ns], the best of several repetitions because of other load."""
    advance()
    costs = []
    for _ in range(repeats):
        begin = time.perf_counter()
        for _ in range(calls):
            advance()
        costs.append((time.perf_counter() - begin) * 1e9 / (calls * vehicle_steps))
    return min(costs)


def tick_cost(vehicles: int, state: tuple[bool, bool]) -> float:
    """Return the time of the plant tick by tick [ns per vehicle-step]."""
    train = new_train(vehicles, *state)
    demand = np.full((train.substeps, 1), 200e3)
    return nanoseconds(lambda: train.advance(demand), vehicles * train.substeps, 40)


def batch_cost(vehicles: int, state: tuple[bool, bool], trains: int = 1, threads: int = 1) -> float:
    """Return the time of 100 ticks of trains in one call [ns per vehicle-step]."""
    batch = [new_train(vehicles, *state) for _ in range(trains)]
    demands = [np.full((100, train.substeps, 1), 200e3) for train in batch]
    vehicle_steps = trains * vehicles * demands[0].shape[0] * demands[0].shape[1]
    return nanoseconds(lambda: advance_trains(batch, demands, threads), vehicle_steps, 1)


def plain_cost(vehicles: int, *, brake_on: bool) -> float:
    """Return the time of the same step in plain numpy [ns per vehicle-step]."""
    train = new_train(vehicles, brake_on)
    plain = PlainTrain(train.arrays, STEP_NS * 1e-9)
    demand = np.full((train.substeps, 1), 200e3)
    event, under_way = np.zeros((k.EVENT_ROWS, 1)), 0
    if brake_on:
        event[:, 0] = (0.0, 200.0, 0.17, 0.0, 1.0, 0.0)
        under_way = 1
    plain.arrays.vehicle_index[k.NEWEST] = 0
    advance = lambda: plain.advance(1.0, event, under_way, demand)  # noqa: E731
    return nanoseconds(advance, vehicles * train.substeps, 3, 3)


def loop_cost(loop: Callable[..., None]) -> float:
    """Return the time of a loop over 106 vehicles [ns per vehicle]."""
    a = new_train(106, False).arrays
    return nanoseconds(lambda: loop(200, a.state, a.vehicle, a.gear), 200 * 106, 5)


def train_costs() -> dict[tuple[int, tuple[bool, bool]], tuple[float, float]]:
    """Publish the costs of trains, tick by tick and in a batch; return them [ns per vehicle-step]."""
    costs = {}
    for vehicles in (53, 106, 212, 424, 1000):
        for title, state in (("released", RELEASED), ("air brake applied", APPLIED), ("all effects", FULL)):
            cost, batch = costs[vehicles, state] = tick_cost(vehicles, state), batch_cost(vehicles, state)
            publish(Figure(f"{vehicles} vehicles, {title}, tick by tick", cost, UNIT, "in a batch", batch))
    return costs


def environment_rates(name: str, trains: int, threads: int) -> tuple[float, float]:
    """Return the rates of the trains of a vector of environments and of their plants alone [ticks per second]."""
    with ta.vector_env(name, trains, threads=threads) as envs:
        envs.reset()
        forces = np.full((trains, envs.n_units), 5e4)
        whole = nanoseconds(lambda: envs.step(forces), trains * envs._ticks, 40)
    batch = [ta.scenario(name).prepare().train() for _ in range(min(trains, 16))]
    demands = [np.full((100, train.substeps, len(train.units)), 5e4) for train in batch]
    alone = nanoseconds(lambda: advance_trains(batch, demands, threads), len(batch) * 100, 1)
    return 1e9 / whole, 1e9 / alone


def environment_goals() -> list[Figure]:
    """Return the rates of environments beside those of their plants, and two threads over one."""
    goals, unit, plants = [], "ticks of a train per second", "plants alone"
    for name, trains, least in ENVIRONMENTS:
        what, (rate, alone) = f"environment, {trains} of {name}", environment_rates(name, trains, 1)
        goals.append(Figure(what, rate, unit, plants, alone, least, at_least=True))
        if trains > 1 < (os.cpu_count() or 1):
            double, alone = environment_rates(name, trains, 2)
            publish(Figure(f"{what}, two threads", double, unit, plants, alone))
            goals.append(Goal(f"{what}, two threads over one", double / rate, MIN_ENV_SPEED_UP, at_least=True))
    return goals


def main() -> int:
    """Publish the figures; return the exit status."""
    compile_kernel()
    costs = train_costs()
    worst = float("inf")
    for title, state in (("released", RELEASED), ("applied", APPLIED)):
        slow = plain_cost(106, brake_on=state[0])
        worst = min(worst, slow / costs[106, state][0])
        publish(Figure(f"106 vehicles, air brake {title}", costs[106, state][0], UNIT, "plain numpy", slow))
    for name, (loop, bare) in LOOPS.items():
        publish(Figure(f"loop, {name}", loop_cost(loop), UNIT, "bare loop", loop_cost(bare)))
    one, two = (batch_cost(106, RELEASED, 16, threads) for threads in (1, 2))
    publish(Figure("batch of 16 trains, two threads", two, UNIT, "one thread", one))
    growth = costs[1000, RELEASED][1] / costs[106, RELEASED][1]
    goals = [
        Goal("106 vehicles, released, in a batch", costs[106, RELEASED][1], MAX_NS, UNIT),
        Goal("106 vehicles, all effects, in a batch", costs[106, FULL][1], MAX_FULL_NS, UNIT),
        Goal("106 vehicles, released, tick by tick", costs[106, RELEASED][0], MAX_NS, UNIT),
        Goal("106 vehicles, all effects, tick by tick", costs[106, FULL][0], MAX_FULL_NS, UNIT),
        Goal("times as fast as plain numpy", worst, MIN_RATIO, at_least=True),
        Goal("cost of a vehicle, 1000 over 106", growth, MAX_GROWTH),
        *environment_goals(),
    ]
    if (os.cpu_count() or 1) > 1:
        goals.append(Goal("batch, two threads over one", one / two, MIN_SPEED_UP, at_least=True))
    return judge(goals)


if __name__ == "__main__":
    sys.exit(main())
