"""``train-ato curves CASE.json | SCENARIO``: braking curves and supervision limits after SUBSET-026, 3.13.

Options::

    case CASE.json | SCENARIO  file of cases, or a scenario for its train and line
    --at-km KM                 end of authority of a scenario [km], or a post as 84+500 (default: last stop of the
                               line, or its end)
    --max-speed-kmh V          maximum speed of the train of a scenario (default: highest limit of the line, 80 without
                               limits)
    --acceleration A           estimated acceleration of the train of a scenario [m/s²] (default: 0)
    --balise-m D               distance since the last balise, for the errors of the odometry (default: exact odometry)
    --deviation                print the largest deviation from the distances in the file, in place of the curves
    --out FILE                 figure (.png, .pdf, .svg)
"""

import argparse
import sys
from typing import Any

from train_ato.cli.plan import kilometre
from train_ato.program.arguments import Options
from train_ato.program.display_units import display_unit

DEVIATION_TITLE = "largest deviation in {}"
WIDTH = 11
"""Characters of a column of distances."""

OPTIONS: Options = {"--at-km": {"type": kilometre}, "--acceleration": {"type": float}}


def execute(options: argparse.Namespace) -> None:
    """Compute the curves, print them and draw the figure."""
    from train_ato.cli.screen import print_json
    from train_ato.studies.curves.curves import curves_by_case

    result, bare = curves_by_case(
        options.case, at_km=options.at_km, max_speed_kmh=options.max_speed_kmh, acceleration=options.acceleration,
        balise_m=options.balise_m, deviation=options.deviation, out=options.out, dash="--",
    )  # fmt: skip
    if options.json:
        print_json(next(iter(result.values())) if bare else result)
        return
    if options.deviation:
        _print_deviations({name: entry["deviation_m"] for name, entry in result.items()})
    else:
        for name, entry in result.items():
            _print_curves(name, entry)
    if options.out is not None:
        sys.stdout.write(f"{options.out}\n")


def _print_curves(name: str, entry: dict[str, Any]) -> None:
    """Print one table: a row for each speed, a column for each curve; in full width also in a narrow terminal."""
    curves: dict[str, list[list[float]]] = entry["curves"]
    speed_unit, place_unit = display_unit("km/h")[0], display_unit("m")[0]
    columns = {curve: {row[0]: row[1] for row in rows} for curve, rows in curves.items()}
    lines = [
        f"{name}: distance before the target in {place_unit}",
        f"{speed_unit:>6}" + "".join(f"{curve:>{WIDTH}}" for curve in columns),
    ]
    for speed in sorted({speed for rows in columns.values() for speed in rows}):
        cells = (f"{rows[speed]:{WIDTH}.2f}" if speed in rows else " " * WIDTH for rows in columns.values())
        lines.append(f"{speed:6g}" + "".join(cells))
    sys.stdout.write("\n".join(line.rstrip() for line in lines) + "\n")
    if release := entry.get("release"):
        sys.stdout.write(
            f"release speed {release['speed_kmh']:.2f} km/h from {release['begin_m']:.2f} m before the target\n"
        )
    if reason := entry["inputs"].get("without_service_curve"):
        sys.stdout.write(f"without service-brake curve: {reason}\n")


def _print_deviations(deviations: dict[str, dict[str, float | None]]) -> None:
    """Print the largest deviation of every case and curve [m]."""
    curves = list(dict.fromkeys(curve for entry in deviations.values() for curve in entry))
    unit, factor = display_unit("m")
    title = DEVIATION_TITLE.format(unit)
    widest = max(len(name) for name in (*deviations, title))
    lines = [f"{title:{widest}}" + "".join(f"{curve:>{WIDTH}}" for curve in curves)]
    for name, entry in deviations.items():
        values = (entry.get(curve) for curve in curves)
        cells = (" " * WIDTH if value is None else f"{value * factor:{WIDTH}.3f}" for value in values)
        lines.append(f"{name:{widest}}" + "".join(cells))
    sys.stdout.write("\n".join(line.rstrip() for line in lines) + "\n")
