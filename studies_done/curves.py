"""Time of the braking curves of a 106-vehicle train: computation once, and evaluation at every tick of a supervisor.

    python studies_done/curves.py

The curves are those of the HXD1 + 105 C80 train on the section with the long downhill grades, with its speed limits and
an end of authority.  The evaluation moves the train through the braking area with another acceleration and odometry
error at every tick.  Floors in the same run: a pass over the vehicles for the computation; two searches in the speed
limits and a new record for the tick.  The exit status is 1 if a goal is missed widely (see figures.py).
"""

from __future__ import annotations

import sys
import time
from bisect import bisect_right
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
from figures import Figure, Goal, judge

from plant_sim.library import load_consist, load_line
from plant_sim.plant_setup import PlantSetup
from train_ato.supervision.odometry import motion_estimate
from train_ato.supervision.plant_line import line_supervision
from train_ato.supervision.step_function import SupervisionSpeeds

ONCE_MS, TICK_US = 20.0, 20.0
END, BRAKING_AREA = 45e3, 1500.0
REPEATS, TICKS = 9, 2000


def best(call: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the shortest time of a call [s]; other load on the machine only adds time."""
    taken = []
    for _ in range(repeats):
        begin = time.perf_counter()
        call()
        taken.append(time.perf_counter() - begin)
    return min(taken)


def main() -> int:
    """Print the times and the goals; return the exit status."""
    consist, line, setup = load_consist("hxd1_c80_105"), load_line("daqin_section"), PlantSetup(lag=0.4)
    begin = time.perf_counter()
    supervision = line_supervision(consist, line, setup, END)
    first = time.perf_counter() - begin
    once = best(lambda: line_supervision(consist, line, setup, END))
    vehicles = best(lambda: sum(vehicle.mass * vehicle.rotating_mass_factor for vehicle in consist.vehicles))

    places = [END - BRAKING_AREA + BRAKING_AREA * i / TICKS for i in range(TICKS)]
    motions = [motion_estimate(10.0 + 0.005 * i, 0.4 * (i % 7) / 7, i % 1000) for i in range(TICKS)]
    starts = [float(entry.at) for entry in line.speed_limits]

    def evaluate() -> None:
        for place, motion in zip(places, motions, strict=True):
            supervision.evaluate(place, motion)

    def floor() -> None:
        for place, motion in zip(places, motions, strict=True):
            bisect_right(starts, place - motion.over_reading)
            bisect_right(starts, place + motion.under_reading)
            SupervisionSpeeds(place, place, place, place)

    tick, lowest = best(evaluate) / TICKS, best(floor) / TICKS
    print(f"{'':34}{'time':>12}{'floor':>12}{'ratio':>8}")
    print(f"{'curves once, first call':34}{1e3 * first:9.3f} ms")
    print(f"{'curves once, 106 vehicles':34}{1e3 * once:9.3f} ms{1e3 * vehicles:9.4f} ms{once / vehicles:8.1f}")
    print(f"{'evaluation of a tick':34}{1e6 * tick:9.2f} us{1e6 * lowest:9.2f} us{tick / lowest:8.1f}")
    return judge(
        (
            Goal("curves of a 106-vehicle train, first call", 1e3 * first, ONCE_MS, "ms"),
            Figure("curves of a 106-vehicle train", 1e3 * once, "ms", "pass over the vehicles", 1e3 * vehicles),
            Goal(
                "evaluation of a tick",
                1e6 * tick,
                TICK_US,
                "us",
                beside="two searches and a record",
                beside_value=1e6 * lowest,
            ),
        )
    )


if __name__ == "__main__":
    sys.exit(main())
