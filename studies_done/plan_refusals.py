"""Random plans without a wrong refusal: every refused line and train is driven by a second, plain calculation.

Run: ``python studies_done/plan_refusals.py [--plans N] [--first SEED]``, or ``--times N``.  The lines and trains of
``test/plan_cases.py`` are planned in the least time.  A refusal is wrong if the plain calculation (speed ceiling by
steps of 0.5 m backward, full traction by the same steps forward, no jerk limit) reaches every stop.  A plan is wrong if
it violates a limit.  With ``--times`` N lines from seed 0 on are planned in five running times each: more time must not
need more energy.
"""

from __future__ import annotations

import argparse
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
sys.path[:0] = [str(Path(__file__).parent.parent / name) for name in ("bench", "test")]
from figures import Figure, publish
from plan_cases import broken_promises, random_case

from plant_sim.consist import Consist
from plant_sim.line import Line
from train_ato.profile.planner.line_tables import LineForce, SpeedLimits
from train_ato.profile.planner.planner import plan_profile
from train_ato.profile.planner.settings import PlanSettings
from train_ato.profile.planner.settings import stops_of
from train_ato.profile.planner.train_tables import TrainTables

STEP, PERIOD = 0.5, 0.1
"""Step of the plain calculation [m], and time between the knots of a plan [s]."""
FACTORS = (1.01, 1.05, 1.12, 1.25, 1.5)
"""Running times of ``--times`` in units of the least one."""
ENERGY_ROUNDING = 1e-4
"""Resolution of an energy [kWh], and relative increase that counts as rounding [1]."""
EARLY, LATE = 1.5, 0.03
"""Permitted differences from a timetable [s]."""


def drivable(line: Line, consist: Consist, settings: PlanSettings) -> bool:
    """Return True if full traction and full braking reach every stop, without a jerk limit."""
    train = TrainTables(consist, settings.speed_max)
    force, limits, keep = LineForce(line, train), SpeedLimits(line, train.speed_max), 1 - settings.force_margin
    service = (settings.acceleration or np.inf, settings.deceleration or np.inf)
    for begin, end in pairwise(stops_of(line, settings).places):
        places = np.linspace(begin, end, max(20, int((end - begin) / STEP)))
        step = float(places[1] - places[0])
        grade = (force.at(0.5 * (places[1:] + places[:-1])) / train.inertia).tolist()
        limit = (limits.at(places, train.length) ** 2 / 2).tolist()
        traction, brake, resistance = (
            np.asarray(table / train.inertia) for table in (keep * train.traction, keep * train.brake, train.resistance)
        )

        def read(table: np.ndarray, energy: float, speeds: np.ndarray = train.speed) -> float:
            return float(np.interp(np.sqrt(2 * max(energy, 0.0)), speeds, table))

        top = limit.copy()
        top[-1] = 0.0
        for k in range(len(grade) - 1, -1, -1):
            rate = min(service[1], read(brake, top[k + 1]) + read(resistance, top[k + 1]) + grade[k])
            top[k] = min(limit[k], top[k + 1] + step * rate)
            if top[k] <= 0.0 and k > 0:
                return False
        energy = 0.0
        for k in range(len(grade)):
            rate = min(service[0], read(traction, energy) - read(resistance, energy) - grade[k])
            energy = min(energy + step * rate, top[k + 1])
            if energy <= 0.0 and k + 1 < len(grade):
                return False
    return True


def missed_times(seed: int) -> list[str] | None:
    """Return the running times that are missed or need more energy than the one before; None for a refused line."""
    line, consist, settings = random_case(seed)
    try:
        least = plan_profile(line, consist, settings).running_time
    except ValueError:
        return None
    found, before = [], np.inf
    for factor in FACTORS:
        try:
            result = plan_profile(line, consist, settings.model_copy(update={"time": factor * least}))
        except ValueError as error:
            found.append(f"{factor}: {error}")
            continue
        energy, late = result.energy / 3.6e6, result.running_time - factor * least
        if energy > before * (1 + ENERGY_ROUNDING) + ENERGY_ROUNDING:
            found.append(f"{factor}: {energy:.4f} kWh, {before:.4f} kWh in less time")
        if not -EARLY <= late <= LATE:
            found.append(f"{factor}: {late:.2f} s late")
        before = energy
    return found


def report_times(count: int) -> int:
    """Print every line whose energy does not decrease with the time; return the exit status."""
    planned, wrong = 0, 0
    for seed in range(count):
        found = missed_times(seed)
        planned += found is not None
        if found:
            wrong += 1
            sys.stdout.write(f"{seed}: {'; '.join(found)}\n")
            sys.stdout.flush()
    sys.stdout.write(f"{planned} lines in {len(FACTORS)} times each, {wrong} with more energy or a missed time\n")
    publish(Figure("lines with more energy in more time", wrong, bound=0))
    return 0


def main() -> int:
    """Print every refusal and the numbers; return the exit status."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--plans", type=int, default=2000)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--times", type=int, metavar="N", help="N lines in growing running times, instead")
    options = parser.parse_args()
    if options.times:
        return report_times(options.times)
    refused, wrong, broken = 0, 0, 0
    for seed in range(options.first, options.first + options.plans):
        line, consist, settings = random_case(seed)
        try:
            result = plan_profile(line, consist, settings, PERIOD)
        except ValueError as error:
            refused += 1
            if drivable(line, consist, settings):
                wrong += 1
                sys.stdout.write(f"{seed}: wrong refusal: {error}\n")
        else:
            if violated := broken_promises(line, consist, settings, result, PERIOD):
                broken += 1
                sys.stdout.write(f"{seed}: {', '.join(violated)}\n")
        sys.stdout.flush()
    sys.stdout.write(f"{options.plans} plans, {refused} refused, {wrong} of them wrong, {broken} with a violation\n")
    publish(Figure("wrong refusals", wrong, bound=0), Figure("plans with a violation", broken, bound=0))
    return 0


if __name__ == "__main__":
    sys.exit(main())
