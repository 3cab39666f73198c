"""Timetabled plans beside an independent optimum: direct transcription, solved by linear programs in sequence.

Run: ``python studies_done/plan_optimum.py [--cases N] [--first SEED] [--net]``, or ``--delays N``; needs scipy.  Lines and
trains are those of ``test/plan_cases.py`` with one section and no jerk limit.  With ``--net`` the electric brake has a
third of the brake force and an air brake the rest, the efficiency is 0.85 and 0.7 of the electric-brake work returns.

The optimum has its own grid of places, E = v²/2 at its nodes and the forces of its cells as variables.  Each linear
program has the dynamics and the running time linearised at the last solution, within a trust region; a step that does
not reduce the merit (net energy + price x lateness + missing force) halves the region.  The result is the energy of
the nonlinear dynamics, corrected by the price of time for the last fraction of a second.  It is solved from the fastest
run and from the plan itself, on a coarse and on a fine grid: the lower result of the fine grid is the reference, and
the difference of the two grids is printed as its uncertainty, beside the distance of the bound of ``plan --time``.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_matrix, diags, hstack, vstack

sys.path[:0] = [str(Path(__file__).parent.parent / folder) for folder in ("bench", "test")]
from figures import Figure, publish
from plan_cases import random_case
from test_plan_properties import CAR, FREE, obstacles, train_of

from plant_sim.consist import Consist
from plant_sim.line import Line
from train_ato.messages.types import Array
from train_ato.profile.planner.plan_from_state import catch_up, timetable_points
from train_ato.profile.planner.line_tables import LineForce, SpeedLimits
from train_ato.profile.planner.plan_from_state import TrainState
from train_ato.profile.planner.planner import Plan, net_energy_bound, plan_profile
from train_ato.profile.planner.settings import PlanSettings
from train_ato.profile.planner.timing_points import TimeWindow
from train_ato.profile.planner.train_tables import TrainTables

GRIDS, END_CELLS, ITERATIONS = (250, 500), 40, 80
"""Cells of the coarse and of the fine grid, additional cells at each end, and most linear programs in sequence."""
OBSTACLE_CELLS = 1000
"""Cells of a line with tunnels and dead sections."""
LATENESS, MISSING = 30.0, 30.0
"""Price of lateness in units of the mean power, and of missing force x distance [1]."""
NET = {"efficiency": 0.85, "recovered": 0.7}


@dataclass
class Transcription:
    """Variables of one section: E at the nodes, then traction, electric brake and friction of every cell [m/s²]."""

    places: Array
    line: Array
    limit: Array
    train: TrainTables
    settings: PlanSettings
    begin: float = 0.0
    air: Array | float = 0.0
    alive: Array | float = 1.0

    def forces(self, energy: Array) -> tuple[Array, Array, Array, Array]:
        """Return resistance, largest traction, electric brake and whole brake at E, over the inertia [m/s²].

        ``air`` of tunnels over v² and inertia [1/m] and ``alive``, the part of the cars with power, are those of cells.
        """
        train, speed = self.train, np.sqrt(2 * np.maximum(energy, 1e-9))
        keep = 1 - self.settings.force_margin
        tables = (train.resistance, keep * train.traction, np.minimum(train.electric, keep * train.brake))
        found = [np.interp(speed, train.speed, table) / train.inertia for table in (*tables, keep * train.brake)]
        return found[0] + 2 * self.air * energy, self.alive * found[1], self.alive * found[2], self.alive * found[3]

    def figures(self, energy: Array) -> tuple[float, float, float]:
        """Return net energy [J/kg], running time [s] and missing force x distance [J/kg] of the E at the nodes."""
        steps = np.diff(self.places)
        middle = 0.5 * (energy[1:] + energy[:-1])
        resistance, pull, electric, brake = self.forces(middle)
        force = np.diff(energy) / steps + resistance + self.line
        speed = np.sqrt(2 * np.maximum(energy, 0.0))
        time = float((2 * steps / (speed[1:] + speed[:-1])).sum())
        braked = np.minimum(np.maximum(-force, 0), electric)
        weights = 1 / self.settings.efficiency, self.settings.recovered
        net = float(((weights[0] * np.maximum(force, 0) - weights[1] * braked) * steps).sum())
        missing = float(((np.maximum(force - pull, 0) + np.maximum(-force - brake, 0)) * steps).sum())
        return net, time, missing

    def solve(self, energy: Array, time: float) -> tuple[float, float]:
        """Return the least net energy [J/kg] in a running time [s], and the price of time [W/kg]."""
        radius, price = 0.3, 0.0
        mean_power = float(self.forces(0.5 * (energy[1:] + energy[:-1]))[0].mean() * (self.places[-1] - self.places[0]) / time)
        unit = LATENESS * max(mean_power, 0.05)

        def merit(state: Array) -> float:
            net, needed, missing = self.figures(state)
            return net + unit * max(needed - time, 0.0) + MISSING * missing

        best = merit(energy)
        for _ in range(ITERATIONS):
            step, price = self._program(energy, time, radius, unit)
            found = merit(step)
            gain = best - found
            if gain > 0:
                energy, best = step, found
                radius = min(radius * (1.5 if gain > 1e-3 * abs(best) else 1.0), 0.5)
            else:
                radius *= 0.5
            if radius < 1e-4 or 0 < gain < 1e-6 * abs(best):
                break
        net, needed, _ = self.figures(energy)
        return net + price * (needed - time), price

    def _program(self, energy: Array, time: float, radius: float, unit: float) -> tuple[Array, float]:
        """Return E of the linear program around E, and the multiplier of the running time [W/kg]."""
        steps, n = np.diff(self.places), self.line.size
        middle = 0.5 * (energy[1:] + energy[:-1])
        base, change = self.forces(middle), 1e-3 * np.maximum(middle, 1e-2)
        slopes = [(b - a) / change for a, b in zip(base, self.forces(middle + change), strict=True)]
        mean = diags([0.5, 0.5], [0, 1], shape=(n, n + 1)).tocsr()
        rise = diags([-1.0, 1.0], [0, 1], shape=(n, n + 1)).tocsr()
        one, none = diags([1.0], shape=(n, n)).tocsr(), csr_matrix((n, n))
        thin = csr_matrix((n, 1))
        scale = diags(1 / steps)
        drag = scale @ rise + diags(slopes[0]) @ mean  # dE/ds + r(E) = u - b - f - line
        equal = hstack([drag, -one, one, one, thin])
        right = slopes[0] * middle - base[0] - self.line
        rows = [
            hstack([-diags(slopes[1]) @ mean, one, none, none, thin]),
            hstack([-diags(slopes[2]) @ mean, none, one, none, thin]),
            hstack([-diags(slopes[3]) @ mean, none, one, one, thin]),
            hstack([scale @ rise, none, none, none, thin]),
            hstack([-scale @ rise, none, none, none, thin]),
        ]
        service = (self.settings.acceleration or 1e3, self.settings.deceleration or 1e3)
        limits = [base[k] - slopes[k] * middle for k in (1, 2, 3)] + [np.full(n, value) for value in service]
        speed = np.sqrt(2 * np.maximum(energy, 1e-9))
        total = speed[1:] + speed[:-1]
        durations = 2 * steps / total
        slope = np.zeros(n + 1)
        slope[:-1] -= durations / total / speed[:-1]
        slope[1:] -= durations / total / speed[1:]
        slope[energy < 1e-8] = 0.0
        rows.append(hstack([csr_matrix(slope), csr_matrix((1, 3 * n)), csr_matrix([[-1.0]])]))
        limits.append(np.array([time - durations.sum() + slope @ energy]))
        weights = 1 / self.settings.efficiency, self.settings.recovered
        cost = np.concatenate((np.zeros(n + 1), weights[0] * steps, -weights[1] * steps, 1e-6 * steps, [unit]))
        low = np.maximum(energy * (1 - radius), 1e-4)
        high = np.minimum(np.maximum(energy * (1 + radius) + 0.02 * radius, low), self.limit)
        low = np.minimum(low, high)
        low[[0, -1]] = high[[0, -1]] = (self.begin, 0.0)
        bounds = np.concatenate((np.stack((low, high), 1), np.tile([0.0, np.inf], (3 * n + 1, 1))))
        result = linprog(cost, vstack(rows), np.concatenate(limits), equal, right, bounds, method="highs")
        if result.x is None:
            raise RuntimeError(result.message)
        return np.maximum(result.x[: n + 1], 0.0), -float(result.ineqlin.marginals[-1])


def transcribed(line: Line, result: Plan, cells: int = GRIDS[-1]) -> Transcription:
    """Return the transcription of a plan's only section on a grid of its own."""
    train, settings = result.train, result.settings
    begin, end = result.arrivals[0][0], result.arrivals[-1][0]
    ramp = np.geomspace(0.02, (end - begin) / cells, END_CELLS).cumsum()
    limits = SpeedLimits(line, train.speed_max)
    borders = np.concatenate([limits.begin[1:], limits.begin[1:] + train.length])
    places = np.concatenate((np.linspace(begin, end, cells + 1), begin + ramp, end - ramp, borders))
    places = np.unique(np.round(places[(places >= begin) & (places <= end)], 3))
    force = LineForce(line, train, over_length=settings.grade_over_length)
    fine = np.unique(np.concatenate([np.linspace(a, b, 9) for a, b in pairwise(places)]))
    work = np.concatenate(([0.0], np.cumsum(force.at(0.5 * (fine[1:] + fine[:-1])) * np.diff(fine))))
    mean = np.diff(np.interp(places, fine, work)) / np.diff(places) / train.inertia
    cell = limits.at(0.5 * (places[1:] + places[:-1]), train.length) ** 2 / 2
    node = np.minimum(np.concatenate((cell[:1], cell)), np.concatenate((cell, cell[-1:])))
    return Transcription(places, mean, node, train, settings, float(result.profile.velocity[0]) ** 2 / 2)


def reference(line: Line, result: Plan, fastest: Plan) -> tuple[float, float]:
    """Return the least net energy in the running time of a plan [J], and the difference of both grids to it [%]."""
    found = []
    for cells in GRIDS:
        problem = transcribed(line, result, cells)
        least = []
        for start in (fastest, result):
            energy = np.interp(problem.places, start.front, start.profile.velocity**2 / 2)
            energy[0] = problem.begin
            least.append(problem.solve(np.minimum(energy, problem.limit), result.running_time)[0])
        found.append(min(least) * result.train.inertia)
    return found[-1], 100 * abs(found[0] / found[-1] - 1)


def with_air_brake(consist: Consist) -> Consist:
    """Return the train with a third of its electric brake, and with an air brake."""
    data = consist.model_dump(mode="json", exclude_none=True)
    for kind in data["vehicle_types"].values():
        for segment in kind.get("brake") or []:
            for key in ("force", "slope", "power"):
                if key in segment:
                    segment[key] /= 3.0
        kind["shoes"] = {"count": 8, "force": 0.6 * kind["mass"], "friction": 0.48}
    data["air_brake"] = {
        "charged_kpa": 600, "apply_wave": 200, "release_wave": 36, "apply_time": 4, "release_time": 6,
        "reduction_kpa": [0, 50], "braking_factor": [0, 0.17],
    }  # fmt: skip
    return Consist.model_validate(data)


def with_obstacles(seed: int, factor: float, net: bool, cells: int) -> tuple[float, float]:
    """Return the optimum [kWh] with tunnels and dead sections car by car, and the excess of the plan [%]."""
    line, car = obstacles(seed)
    consist = train_of({"car": car}, 4)
    settings = FREE.model_copy(update=NET if net else {})
    time = factor * plan_profile(line, consist, settings).running_time
    result = plan_profile(line, consist, settings.model_copy(update={"time": time}))
    rough = transcribed(line, result, cells).places
    edges = [edge for entry in (*line.neutral_sections, *line.tunnels) for edge in (entry.begin, entry.end)]
    borders = np.array([edge + CAR * (k + 0.5) for edge in edges for k in range(4)])
    inside = (borders > rough[0]) & (borders < rough[-1])
    places = np.unique(np.round(np.concatenate((rough, borders[inside])), 3))
    centres = 0.5 * (places[1:] + places[:-1])[:, None] - CAR * (np.arange(4) + 0.5)

    def cars_in(entries: Any) -> Array:  # a car in two that overlap counts once
        inside = [(centres >= entry.begin) & (centres < entry.end) for entry in entries]
        return np.asarray(np.sum(np.any(inside, axis=0), axis=1, dtype=float))

    train = result.train
    limit = np.full(places.size, min(line.speed_limits[0].speed, train.speed_max) ** 2 / 2)
    narrow = car["tunnel_resistance"][0]["coefficient"] * cars_in(line.tunnels) / train.inertia
    alive = 1 - cars_in(line.neutral_sections) / 4
    problem = Transcription(places, np.zeros(alive.size), limit, train, settings, 0.0, narrow, alive)
    energy = np.minimum(np.interp(places, result.front, result.profile.velocity**2 / 2), limit)
    energy[[0, -1]] = 0.0
    optimum = problem.solve(energy, result.running_time)[0] * train.inertia
    return optimum / 3.6e6, 100 * (result.energy / optimum - 1)


def report_obstacles(count: int) -> int:
    """Print the optimum of lines with tunnels and dead sections and the excess of the plan; return the exit status."""
    found = []
    for seed in range(count):
        factor, net = (1.05, 1.1, 1.2, 1.3)[seed % 4], seed % 3 == 2
        optimum, excess = with_obstacles(seed, factor, net, OBSTACLE_CELLS)
        found.append(excess)
        kind = "net energy" if net else "traction work"
        sys.stdout.write(f"{seed:4d} time {factor:.2f} x least: {kind} {optimum:.3f} kWh, plan {excess:.3f} % above\n")
        sys.stdout.flush()
    publish(Figure("plan with tunnels and dead sections above the optimum, largest", max(found), "%", bound=0.3))
    return 0


@dataclass(frozen=True)
class Comparison:
    """Excess of a plan over the optimum, its uncertainty, distance of the bound below it [%]; number of limits."""

    excess: float
    uncertainty: float
    slack: float
    limits: int


def compared(seed: int, factor: float, net: bool) -> Comparison | None:
    """Return the comparison of a plan with the optimum; None without plan."""
    line, consist, settings = random_case(seed)
    if net:
        consist = with_air_brake(consist)
    settings = settings.model_copy(update={"jerk": None, "calling": False} | (NET if net else {}))
    try:
        least = plan_profile(line, consist, settings)
        result = plan_profile(line, consist, settings.model_copy(update={"time": factor * least.running_time}))
    except ValueError as error:
        sys.stdout.write(f"{seed}: {str(error)[:100]}\n")
        return None
    optimum, uncertainty = reference(line, result, least)
    if optimum < 1e3:
        return None
    slack = 100 * (1 - net_energy_bound(result) / optimum)
    return Comparison(100 * (result.energy / optimum - 1), uncertainty, slack, len(line.speed_limits))


def caught_up(seed: int) -> tuple[float, float, float, str] | None:
    """Return delay [s], excess of the rest over its optimum [%], uncertainty of this [%] and report of a late train."""
    rng = np.random.default_rng(seed)
    line, consist, settings = random_case(seed)
    settings = settings.model_copy(update={"jerk": None, "calling": False})
    try:
        least = plan_profile(line, consist, settings)
        time = 1.25 * least.running_time
        timetabled = settings.model_copy(update={"time": time})
        first = plan_profile(line, consist, timetabled)
    except ValueError:
        return None
    if least.running_time < 400.0:  # no reserve for such a delay
        return None
    delay, knot = float(rng.uniform(30, 120)), int(rng.uniform(0.1, 0.5) * len(first.profile))
    x, v, a, _ = first.profile.at(float(first.profile.time[knot]))
    state = TrainState(round(float(first.profile.time[knot]) + delay, 1), x, v, a)
    points = timetable_points(line, timetabled)
    rest, late = catch_up(state, points, line, consist, timetabled, period=first.profile.period)
    at_once = points[-1].model_copy(update={"arrival": TimeWindow(latest=state.time + 1.0)})
    fastest, _ = catch_up(state, (points[0], at_once), line, consist, timetabled, period=first.profile.period)
    optimum, uncertainty = reference(line, rest, fastest)
    excess = 100 * (rest.energy / optimum - 1)
    return delay, excess, uncertainty, str(late or f"arrives {time - rest.arrivals[-1][1]:.2f} s early")


def report_delays(count: int) -> int:
    """Print random delays and the energy of the rest of the run; return the exit status."""
    found: list[tuple[float, float]] = []
    seed = 0
    while len(found) < count:
        case = caught_up(seed)
        if case is not None:
            delay, above, uncertainty, report = case
            found.append((above, uncertainty))
            text = f"rest {above:7.3f} % above the optimum (+-{uncertainty:.3f} %)"
            sys.stdout.write(f"{seed:4d} {delay:6.1f} s late: {text}; {report}\n")
            sys.stdout.flush()
        seed += 1
    largest, uncertain = (max(values) for values in zip(*found, strict=True))
    sys.stdout.write(f"{count} delays, largest {largest:.3f} %; reference within {uncertain:.3f} %\n")
    publish(
        Figure("rest of a late run above the optimum, largest", largest, "%", bound=2.0),
        Figure("reference of a late run, largest difference of two grids", uncertain, "%", bound=0.5),
    )
    return 0


def main() -> int:
    """Print the excess of every case and the median; return the exit status."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--net", action="store_true")
    parser.add_argument("--delays", type=int, metavar="N", help="N late trains that catch up, instead")
    parser.add_argument("--obstacles", type=int, metavar="N", help="N lines with tunnels and dead sections, instead")
    options = parser.parse_args()
    if options.obstacles:
        return report_obstacles(options.obstacles)
    if options.delays:
        return report_delays(options.delays)
    found = []
    for seed in range(options.first, options.first + options.cases):
        factor = 1.05 + 0.05 * (seed % 5)
        case = compared(seed, factor, options.net)
        if case is not None:
            found.append(case)
            text = f"{case.excess:7.3f} % (+-{case.uncertainty:.3f} %), bound {case.slack:.3f} % below the optimum"
            sys.stdout.write(f"{seed:4d} time {factor:.2f} x least, {case.limits:2d} limits: {text}\n")
            sys.stdout.flush()
    median, uncertain, slack = (
        float(np.median([getattr(case, key) for case in found])) for key in ("excess", "uncertainty", "slack")
    )
    largest = max(case.excess for case in found)
    sys.stdout.write(f"{len(found)} cases, median {median:.3f} %, largest {largest:.3f} %; ")
    sys.stdout.write(
        f"bound {slack:.3f} % below the optimum (median, least {min(case.slack for case in found):.3f} %); "
    )
    sys.stdout.write(f"reference within {uncertain:.3f} % (median)\n")
    kind = "net energy" if options.net else "traction work"
    publish(
        Figure(f"{kind} of a plan above the optimum, median", median, "%", bound=1.0 if options.net else 0.5),
        Figure(f"lower bound of the {kind} below the optimum, median", slack, "%"),
        Figure("reference, median difference of two grids", uncertain, "%", bound=0.5),
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
