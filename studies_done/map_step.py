"""Difference between a longer plant step and that of 5 ms in a robustness map of `daqin_heavy_haul`.

    python studies_done/map_step.py [--step 0.00625] [--points 5]

Runs of points spread over the map of :mod:`map_cost` with both steps, and with a step of 5 ms of their neighbours: the
next delay and the next error of mass.  The table has the largest difference between the steps, and the median
difference between neighbours, which is the resolution of the map; tracking and verdict are compared for every point.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
from figures import Figure, publish
from map_cost import SPEC

from train_ato.studies.sweep.sweep import sweep_base
from train_ato.studies.sweep.spec import design_points
from train_ato.studies.sweep.row import Row, drive_point
from train_ato.studies.sweep.spec import read_sweep
from train_ato.scenario.scenario_data import PartCache

SIDE = 64
METRICS = {
    "speed_rmse_kmh": "km/h", "speed_error_max_kmh": "km/h", "stop_error_max_m": "m", "coupler_draft_max_kn": "kN",
    "coupler_buff_max_kn": "kN", "command_variation_kn_per_s": "kN/s", "energy_traction_kwh": "kWh",
}  # fmt: skip


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
    parser.add_argument("--step", type=float, default=0.00625, help="plant step in s, beside 0.005 (default: 0.00625)")
    options = parser.parse_args()
    places = np.linspace(0, SIDE - 2, options.points).round().astype(int).tolist()
    fine, coarse = MapRuns(0.005), MapRuns(options.step)
    steps, neighbours, values, outcomes = [], [], [], []
    for delay in places:
        for mass in places:
            row, other = fine.at(delay, mass), coarse.at(delay, mass)
            steps.append((row, other))
            neighbours += [(row, fine.at(delay + 1, mass)), (row, fine.at(delay, mass + 1))]
            values.append(row)
            outcomes.append((row["tracking"], row["verdict"], other["tracking"], other["verdict"]))
    steps_text = f"{1e3 * options.step:g} - 5 ms: largest"
    print(f"{'metric':30} {'median':>10} {steps_text:>22} {'median':>10} {'neighbours: median':>19}")
    for metric, unit in METRICS.items():
        rows = [row["metrics"][metric] for row in values if row["metrics"].get(metric) is not None]
        found = [change(*pair, metric) for pair in steps]
        beside = float(np.nanmedian([change(*pair, metric) for pair in neighbours]))
        size = float(np.median(np.abs(rows)))
        largest = float(np.nanmax(found))
        publish(Figure(f"largest change of {metric} with the plant step", largest, unit, "neighbouring points", beside))
        print(f"{metric:30} {size:10.4g} {largest:22.3g} {np.nanmedian(found):10.3g} {beside:19.3g}")
    same = sum(one[:2] == one[2:] for one in outcomes)
    print(f"tracking and verdict equal in {same} of {len(outcomes)} points:", *sorted({o[:2] for o in outcomes}))
    for one in outcomes:
        if one[:2] != one[2:]:
            print("different:", *one)
    return 0


if __name__ == "__main__":
    sys.exit(main())
