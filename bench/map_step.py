"""Difference of the plant steps of 10 ms and 5 ms in a robustness map of `daqin_heavy_haul`.

    python bench/map_step.py [--points 5]

Runs of points spread over the map of :mod:`map_cost` with both steps, and with a step of 5 ms of their neighbours: the
next delay and the next error of mass.  The table has the largest difference between the steps, and the median
difference between neighbours, which is the resolution of the map; tracking and verdict are compared for every point.
"""

from __future__ import annotations

import argparse
import sys
from typing import Any

import numpy as np
from map_cost import SPEC

from train_ato.apps.sweep.check import sweep_base
from train_ato.apps.sweep.design import design_points
from train_ato.apps.sweep.row import Row, drive_point
from train_ato.apps.sweep.spec import read_sweep
from train_ato.loop.part_cache import PartCache

SIDE = 64
METRICS = (
    "speed_rmse_kmh", "speed_error_max_kmh", "stop_error_max_m", "coupler_draft_max_kn", "coupler_buff_max_kn",
    "command_variation_kn_per_s", "energy_traction_kwh", "robustness_min",
)  # fmt: skip


class MapRuns:
    """Runs of the map with one plant step [s]."""

    def __init__(self, step: float) -> None:
        spec = read_sweep({**SPEC, "set": {"step": step}})
        self._base, self._points, self._parts = sweep_base(spec).choice(), list(design_points(spec)), PartCache()

    def at(self, delay: int, mass: int) -> Row:
        """Return the row of a point by the numbers of delay and error of mass."""
        number = delay * SIDE + mass
        row = drive_point(self._base, number + 1, self._points[number], self._parts)
        if row["status"] != "done":
            raise SystemExit(f"run {row['run']}: {row['status']}: {row['reason']}")
        return row


def change(one: Row, other: Row, metric: str) -> float:
    """Return the absolute difference of a metric; NaN if a run lacks it."""
    values: list[Any] = [row["metrics"].get(metric) for row in (one, other)]
    return float("nan") if None in values else abs(values[0] - values[1])


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Difference of plant steps in a map.")
    parser.add_argument("--points", type=int, default=5, help="points in each direction (default: 5)")
    places = np.linspace(0, SIDE - 2, parser.parse_args().points).round().astype(int).tolist()
    fine, coarse = MapRuns(0.005), MapRuns(0.01)
    steps, neighbours, values, outcomes = [], [], [], []
    for delay in places:
        for mass in places:
            row, other = fine.at(delay, mass), coarse.at(delay, mass)
            steps.append((row, other))
            neighbours += [(row, fine.at(delay + 1, mass)), (row, fine.at(delay, mass + 1))]
            values.append(row)
            outcomes.append((row["tracking"], row["verdict"], other["tracking"], other["verdict"]))
    print(f"{'metric':30} {'median':>10} {'10 - 5 ms: largest':>19} {'median':>10} {'neighbours: median':>19}")
    for metric in METRICS:
        rows = [row["metrics"][metric] for row in values if row["metrics"].get(metric) is not None]
        if not rows:
            continue
        found = [change(*pair, metric) for pair in steps]
        beside = float(np.nanmedian([change(*pair, metric) for pair in neighbours]))
        size = float(np.median(np.abs(rows)))
        print(f"{metric:30} {size:10.4g} {np.nanmax(found):19.3g} {np.nanmedian(found):10.3g} {beside:19.3g}")
    same = sum(one[:2] == one[2:] for one in outcomes)
    print(f"tracking and verdict equal in {same} of {len(outcomes)} points:", *sorted({o[:2] for o in outcomes}))
    for one in outcomes:
        if one[:2] != one[2:]:
            print("different:", *one)
    return 0


if __name__ == "__main__":
    sys.exit(main())
