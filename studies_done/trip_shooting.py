"""Trip plans by direct shooting on the whole train, beside the dynamic programming of `plan --trip`.

    python studies_done/trip_shooting.py [--runs N]

Shooting: CMA-ES over the places of four applications of the air brake (apply, release) and 12 target speeds, 45 km of
`daqin_section`, 106 vehicles; every evaluation drives the whole train with all couplers and cylinders.  Cost in kWh:
traction energy, time with the price of the dynamic programming, and penalties for overspeed and coupler forces above
the limit.  Two starts: the applications of the recorded driver below the speed limits, and the planned journey.  The
number of applications is given to the shooting; the dynamic programming finds it.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
import time

import cma
import numpy as np
sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
from figures import Figure, publish

from plant_sim.library import load_consist, load_line
from train_ato.messages.types import Array
from train_ato.profile.planner.line_tables import SpeedLimits
from train_ato.profile.trip.driven_run import TripRun, follow_journey
from train_ato.profile.trip.journey import Application, Journey
from train_ato.profile.trip.planner import plan_trip
from train_ato.profile.trip.plan import JOULES_PER_KWH, TripPlan
from train_ato.profile.trip.settings import TripSettings

LINE, TRAIN, STOP, RUNNING_TIME = "daqin_section", "hxd1_c80_105", 49_442.0, 3224.0
TARGETS, CELL = 12, 50.0
DRIVER = (20_000.0, 25_200.0, 32_900.0, 36_500.0, 38_900.0, 42_500.0, 47_500.0, 48_500.0)
"""Places near the applications and releases of the recorded driver [m]."""
SPREAD_M, SPREAD_SPEED = 400.0, 1.0
"""First standard deviation of places [m] and target speeds [m/s]."""
OVERSPEED_PRICE, COUPLER_PRICE, LOST = 200.0, 1.0, 1e4
"""Penalties: kWh per m/s above a limit, kWh per kN above the coupler limit, kWh for a run that does not arrive."""


class Shooting:
    """Cost of a run of the whole train from places and target speeds."""

    def __init__(self, plan: TripPlan) -> None:
        self._model, self._settings, self.price = plan.model, plan.settings, plan.price
        self._reduction = plan.applications[0].reduction
        self._limits = SpeedLimits(plan.model.line, float("inf"))
        self._half = plan.model.consist.vehicles[0].length / 2
        begin, end = float(plan.journey.place[0]), float(plan.journey.place[-1])
        self._place = np.linspace(begin, end, round((end - begin) / CELL) + 1)
        self._knots = np.linspace(begin, end, TARGETS)
        permitted = self._limits.at(self._place + self._half, plan.model.consist.length)
        self._highest = permitted - plan.settings.speed_margin
        self._last = np.sqrt(plan.settings.final_speed**2 + 2 * 0.1 * (end - self._place))
        self.runs = 0

    def from_plan(self, plan: TripPlan) -> Array:
        """Return the variables of a plan."""
        places = [place for entry in plan.applications for place in (entry.apply, entry.release)]
        return np.concatenate((places, np.interp(self._knots, plan.journey.place, plan.journey.speed)))

    def of_driver(self) -> Array:
        """Return the variables of the recorded driver."""
        return np.concatenate((DRIVER, np.full(TARGETS, 70 / 3.6)))

    def run(self, variables: Array) -> TripRun:
        """Drive the whole train; raises ValueError if it does not arrive."""
        places, targets = np.sort(variables[: len(DRIVER)]), variables[len(DRIVER) :]
        pairs = zip(places[::2], places[1::2], strict=True)
        applications = tuple(Application(float(a), float(b), self._reduction, 1.0) for a, b in pairs)
        speed = np.minimum(np.minimum(np.interp(self._place, self._knots, targets), self._highest), self._last)
        cells = np.zeros(self._place.size - 1)
        journey = Journey(self._place, np.maximum(speed, 1.0), np.zeros(self._place.size), cells, cells, applications)
        return follow_journey(self._model, self._settings, journey, applications)

    def excess(self, run: TripRun) -> float:
        """Return the largest speed above a limit [m/s]."""
        limits = self._limits.at(run.position + self._half, self._model.consist.length)
        return max(float((run.speed - limits).max()), 0.0)

    def cost(self, variables: Array) -> float:
        """Return the cost [kWh]."""
        self.runs += 1
        try:
            run = self.run(np.asarray(variables))
        except ValueError:
            return LOST
        couplers = max(run.totals.draft_max, -run.totals.buff_max) - self._settings.coupler_max
        penalty = OVERSPEED_PRICE * self.excess(run) + COUPLER_PRICE * max(couplers, 0.0) / 1e3
        return run.totals.traction / JOULES_PER_KWH + self.price * float(run.time[-1]) + penalty


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Trip plans by direct shooting.")
    parser.add_argument("--runs", type=int, default=400, help="runs of the train per start (default: 400)")
    options = parser.parse_args()
    begin = time.process_time()
    settings = TripSettings.model_validate({"time": RUNNING_TIME, "end": STOP})
    plan = plan_trip(load_line(LINE), load_consist(TRAIN), settings, 1.0)
    spent = time.process_time() - begin
    shooting = Shooting(plan)
    print(f"{'method':36} {'runs':>5} {'CPU s':>6} {'cost':>8} {'kWh':>6} {'s':>6} {'kN':>5} {'over km/h':>9}")

    def print_row(method: str, runs: int, seconds: float, run: TripRun) -> float:
        energy, ride = run.totals.traction / JOULES_PER_KWH, float(run.time[-1])
        couplers = max(run.totals.draft_max, -run.totals.buff_max) / 1e3
        cost = energy + shooting.price * ride
        over = 3.6 * shooting.excess(run)
        print(
            f"{method:36} {runs:5d} {seconds:6.0f} {cost:8.0f} {energy:6.0f} {ride:6.0f} {couplers:5.0f} {over:9.1f}",
            flush=True,
        )
        return cost

    planned = print_row("dynamic programming", 0, spent, plan.run)
    scale = np.repeat([SPREAD_M, SPREAD_SPEED], [len(DRIVER), TARGETS])
    for title, first in (("driver", shooting.of_driver()), ("plan", shooting.from_plan(plan))):

        def cost_of(changes: Array, start: Array = first) -> float:
            return shooting.cost(start + scale * changes)

        begin, shooting.runs = time.process_time(), 0
        quiet = {"maxfevals": options.runs, "seed": 1, "verbose": -9}
        found, _ = cma.fmin2(cost_of, np.zeros(first.size), 1.0, quiet)
        best = shooting.run(first + scale * np.asarray(found))
        cost = print_row(f"shooting from the {title}", shooting.runs, time.process_time() - begin, best)
        publish(Figure(f"cost of shooting from the {title}", cost, "kWh", "dynamic programming", planned))
    return 0


if __name__ == "__main__":
    sys.exit(main())
