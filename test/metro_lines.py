"""Overspeed of the metro train on lines that the model of its law lacks.

    python test/metro_lines.py [--set KEY=VALUE ...]

The grades, curves and tunnel of ``xuzhou_metro:disturbed`` are not in the model of the law.  Gains chosen on one line
alone may overspeed on another one.  The lines are the shipped one, the same in the opposite direction (mirrored), and
both moved by 350 m forwards and backwards, a stop at another place of the same grades.  The table has the largest
overspeed, the stop error and the jerk over 1 s of each line.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from plant_sim.library import load_line
from train_ato.loop.engine import run_engine
from train_ato.loop.setup import prepare
from train_ato.scenario.scenario import load_scenario

SCENARIO, LINE = "xuzhou_metro:disturbed", "xuzhou_metro_test"
SECTION = 8500.0
"""Length of the section between the stops [m]."""
MOVES = (0.0, 350.0, -350.0)
"""Distances by which a line is moved [m]."""


def changed_line(mirrored: bool, move: float) -> dict[str, Any]:
    """Return the shipped line as data, mirrored between the stops or not, then moved [m]."""
    data = load_line(LINE).model_dump(mode="json", by_alias=True, exclude_none=True)
    places = [entry["at"] for entry in data["grades"]]
    spans = list(zip(places, [*places[1:], data["end"]], [entry["grade"] for entry in data["grades"]], strict=True))
    if mirrored:
        spans = [(SECTION - end, SECTION - begin, -grade) for begin, end, grade in reversed(spans)]
    first, last = data.get("begin", 0.0), data["end"]
    spans = [(max(first, begin + move), end + move, grade) for begin, end, grade in spans if end + move > first]
    spans[0] = (first, *spans[0][1:])
    data["grades"] = [{"at": begin, "grade": grade} for begin, _, grade in spans if begin < last]
    for kind in ("curves", "tunnels"):
        for entry in data[kind]:
            begin, end = entry["begin"], entry["end"]
            if mirrored:
                begin, end = SECTION - end, SECTION - begin
            entry |= {"begin": max(first, begin + move), "end": end + move}
        data[kind].sort(key=lambda entry: entry["begin"])
    name = f"{LINE}{'_mirrored' if mirrored else ''}{f'_{move:+.0f}' if move else ''}".replace("+", "p").replace(
        "-", "m"
    )
    return {**data, "name": name}


def metrics_on_lines(*assignments: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield name and metrics of a run on every line, after changes of the scenario."""
    for mirrored in (False, True):
        for move in MOVES:
            line = changed_line(mirrored, move)
            scenario, path = load_scenario(SCENARIO, assignments, {"plant": {"line": line}})
            yield line["name"], run_engine(prepare(scenario, path)).summary


def main() -> None:
    """Print one row for every line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="assignments")
    options = parser.parse_args()
    print(f"{'line':36} {'overspeed km/h':>14} {'stop error m':>12} {'jerk 1 s m/s3':>13} {'tracking':>12}")
    for name, found in metrics_on_lines(*options.assignments):
        error = found["stop_error_m"]
        stop = "-" if error is None else f"{error:.3f}"
        print(
            f"{name:36} {found['overspeed_max_kmh']:14.2f} {stop:>12} {found['jerk_1s_max']:13.3f} "
            f"{found['tracking']:>12}"
        )


if __name__ == "__main__":
    main()
