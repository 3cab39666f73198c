"""Times of the compiled planner: shipped lines and trains, a timetable, and re-planning.

Run: ``python studies_done/planner.py``; the first line includes the compilation (cached by numba for later runs).  The goals
for plans of least time, after the compilation: 286 km in about 0.5 s, 48 km of the freight line in about 0.1 s.  The
exit status is 1 if one is missed widely (see figures.py).
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
from figures import Figure, Goal, judge, publish

from plant_sim.consist import Consist
from plant_sim.library import load_consist, load_line
from plant_sim.line import Line
from train_ato.profile.planner.plan_from_state import TrainState, replan
from train_ato.profile.planner.planner import Plan, plan_profile
from train_ato.profile.planner.settings import PlanSettings
from train_ato.profile.planner.train_tables import AvailableForce

CASES = (
    ("286 km high-speed line, one mass", "highspeed_286km", "crh380a_one_mass"),
    ("52 km heavy-haul line, 106 vehicles", "daqin_section", "hxd1_c80_105"),
    ("10 km metro line, one mass", "xuzhou_metro_test", "xuzhou_metro_3"),
)
FREIGHT_END = 48e3
MOST_HIGH_SPEED_S, MOST_FREIGHT_S = 0.5, 0.1
REPEATS = 5


def _timed(what: str, call: Callable[[], Plan]) -> tuple[Plan, float]:
    taken = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        result = call()
        taken.append(time.perf_counter() - begin)
    sys.stdout.write(f"{what:58s} {min(taken):8.3f} s   {len(result.profile)} knots, {result.running_time:.1f} s run\n")
    publish(Figure(what, min(taken), "s"))
    return result, min(taken)


def _replanned(line: Line, consist: Consist, first: Plan) -> Plan:
    """Plan the second half again with 85 % of the brake force."""
    knot = len(first.profile) // 2
    x, v, a, _ = first.profile.at(float(first.profile.time[knot]))
    now = TrainState(float(first.profile.time[knot]), x, v, a)
    return replan(now, first.profile, line, consist, PlanSettings(), available=AvailableForce(brake=0.85))


def main() -> int:
    """Print a line for every case and the goals; return the exit status."""
    begin = time.perf_counter()
    plan_profile(load_line("level"), load_consist("xuzhou_metro_3"), PlanSettings(end=1000))
    sys.stdout.write(
        f"{'first plan of this process, kernels loaded or compiled':58s} {time.perf_counter() - begin:8.3f} s\n"
    )
    seconds = {}
    for what, line_name, consist_name in CASES:
        line, consist = load_line(line_name), load_consist(consist_name)
        least, seconds[line_name] = _timed(f"{what}: least time", partial(plan_profile, line, consist))
        slack = PlanSettings(time=1.05 * least.running_time)
        _timed(f"{what}: 5 % more time", partial(plan_profile, line, consist, slack))
        _timed(f"{what}: the rest again", partial(_replanned, line, consist, least))
    line, consist, settings = load_line("daqin_section"), load_consist("hxd1_c80_105"), PlanSettings(end=FREIGHT_END)
    _, freight = _timed("48 km of the heavy-haul line: least time", partial(plan_profile, line, consist, settings))
    return judge(
        (
            Goal("286 km high-speed line", seconds["highspeed_286km"], MOST_HIGH_SPEED_S, "s"),
            Goal("48 km heavy-haul line", freight, MOST_FREIGHT_S, "s"),
        )
    )


if __name__ == "__main__":
    sys.exit(main())
