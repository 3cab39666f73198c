"""``train-ato curves CASE.json | SCENARIO``: braking curves and supervision limits after SUBSET-026, 3.13."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from train_ato.arguments import check_new_file

FIGURES = (".png", ".pdf", ".svg")
MAX_SPEED_KMH = 600.0
DEVIATION_TITLE = "largest deviation in m"
CASE_KEYS = {
    "at_km": "target_location_m",
    "max_speed_kmh": "max_speed_kmh",
    "acceleration": "A_est1",
    "balise_m": "distance_since_balise_m",
}
"""Options of a scenario, and the keys of a case with the same meaning."""
WIDTH = 11
"""Characters of a column of distances."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``curves``."""
    parser.add_argument(
        "case", metavar="CASE.json | SCENARIO", help="file of cases, or a scenario for its train and line"
    )
    parser.add_argument(
        "--at-km", type=float, metavar="KM",
        help="end of authority on the line of a scenario [km] (default: last stop of the line, or its end)",
    )  # fmt: skip
    parser.add_argument(
        "--max-speed-kmh", type=float, metavar="V",
        help="maximum speed of the train of a scenario (default: highest limit of the line, 80 without limits)",
    )  # fmt: skip
    parser.add_argument(
        "--acceleration", type=float, metavar="A",
        help="estimated acceleration of the train of a scenario [m/s²] (default: 0)",
    )  # fmt: skip
    parser.add_argument(
        "--balise-m", type=float, metavar="D",
        help="distance since the last balise, for the errors of the odometry (default: exact odometry)",
    )  # fmt: skip
    parser.add_argument(
        "--deviation", action="store_true",
        help="print the largest deviation from the distances in the file, in place of the curves",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, metavar="FILE", help="figure (.png, .pdf, .svg)")


def execute(options: argparse.Namespace) -> int:
    """Compute the curves, print them and draw the figure."""
    from train_ato.apps.curves.figure import draw_curves
    from train_ato.cli.screen import print_json

    if options.out is not None:
        check_new_file(options.out, FIGURES)
    from_file = options.case.lower().endswith(".json")
    result, bare = _cases(options) if from_file else (_scenario(options), True)
    if options.out is not None:
        draw_curves({name: entry["curves"] for name, entry in result.items()}, options.out)
    if options.json:
        print_json(next(iter(result.values())) if bare else result)
        return 0
    if options.deviation:
        _print_deviations({name: entry["deviation_m"] for name, entry in result.items()})
    else:
        for name, entry in result.items():
            _print_curves(name, entry)
    if options.out is not None:
        sys.stdout.write(f"{options.out}\n")
    return 0


def _cases(options: argparse.Namespace) -> tuple[dict[str, Any], bool]:
    """Return inputs and curves of every case of a file, and True for a file with one case without a name."""
    from train_ato.apps.curves.case_file import read_cases
    from train_ato.apps.curves.table import case_table, largest_deviations

    for option, key in CASE_KEYS.items():
        if getattr(options, option) is not None:
            raise ValueError(f"--{option.replace('_', '-')}: belongs to a scenario; write {key} in {options.case}")
    path = Path(options.case)
    cases, bare = read_cases(path)
    if options.deviation and not any(case.has_distances for case in cases.values()):
        raise ValueError(f"{path}: curves: no distance for --deviation; write [speed, distance] in place of speeds")
    found: dict[str, Any] = {}
    for name, case in cases.items():
        table = case_table(case, f"{path}: {name}")
        found[name] = {"inputs": case.inputs.model_dump(mode="json", exclude_unset=True), "curves": table}
        if (release := case.inputs.release(case.inputs.limits())) is not None:
            found[name]["release"] = release
        if options.deviation:
            found[name]["deviation_m"] = largest_deviations(case, table)
    return found, bare


def _scenario(options: argparse.Namespace) -> dict[str, Any]:
    """Return brake model and curves of the train of a scenario on its line."""
    from plant_sim.units import KMH
    from train_ato.apps.curves.line_curves import line_curves
    from train_ato.loop.scenario_data import scenario_consist, scenario_line
    from train_ato.scenario.scenario import load_scenario
    from train_ato.supervision.plant_line import line_supervision

    if options.deviation:
        raise ValueError("--deviation: needs distances; name a JSON file of cases")
    _refuse_case_file(Path(options.case))
    scenario, path = load_scenario(options.case)
    consist = scenario_consist(scenario.plant.consist, path.parent)
    line = scenario_line(scenario.plant.line, path.parent)
    last = line.stops[-1].at if line.stops else line.end
    at = last if options.at_km is None else 1e3 * options.at_km
    if not line.begin <= at <= line.end:
        raise ValueError(
            f"--at-km {at / 1e3:g}: not on line '{line.name}'; give km {line.begin / 1e3:g} to {line.end / 1e3:g}"
        )
    fastest = options.max_speed_kmh
    if fastest is not None and not 0 < fastest <= MAX_SPEED_KMH:
        raise ValueError(f"--max-speed-kmh {fastest:g}: out of range; give a speed up to {MAX_SPEED_KMH:g} km/h")
    name = f"{consist.name} on {line.name}, end of authority at km {at / 1e3:g}"
    try:
        supervision = line_supervision(consist, line, scenario.plant, at, None if fastest is None else fastest / KMH)
        found = line_curves(name, supervision, _motion(options, supervision.train.max_speed))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return {name: {"inputs": _train_data(found.supervision), "curves": found.table}}


def _refuse_case_file(path: Path) -> None:
    """Raise ValueError for a file that is no scenario but a JSON object: a case file with another name."""
    if path.is_file():
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            begin = file.read(2**16)
        if begin.lstrip().startswith("{") and "schema" not in begin:
            raise ValueError(f"{path}: begins with '{{': cases need a name ending in .json; rename the file")


def _motion(options: argparse.Namespace, speed: float) -> Any:
    """Return the motion estimate of the options, with the speed error at a speed [m/s]."""
    from math import isfinite

    from train_ato.supervision.odometry import MotionEstimate, motion_estimate

    acceleration, distance = options.acceleration or 0.0, options.balise_m
    if not abs(acceleration) <= 5.0:
        raise ValueError(f"--acceleration {acceleration:g}: out of range; give -5 to 5 m/s²")
    if distance is None:
        return MotionEstimate(acceleration)
    if not (isfinite(distance) and 0 <= distance <= 1e5):
        raise ValueError(f"--balise-m {distance:g}: out of range; give 0 to 100000 m")
    return motion_estimate(speed, acceleration, distance)


def _train_data(supervision: Any) -> dict[str, Any]:
    """Return the brake model of the train as plain data."""
    from plant_sim.units import KMH

    train = supervision.train
    brake = train.brake
    starts = [0.0, *(round(bound * KMH, 6) for bound in brake.safe.bounds)]
    return {
        "model": "gamma, from the brakes of the plant",
        "length_m": train.length,
        "max_speed_kmh": round(train.max_speed * KMH, 6),
        "m_rotating_nom_pct": train.m_rotating_nom,
        "t_traction_cutoff_s": train.t_traction_cut_off,
        "A_brake_emergency": [list(step) for step in zip(starts, brake.safe.values, strict=True)],
        "T_brake_emergency": brake.emergency_time.to_standstill,
        "T_brake_service": brake.service_time.to_standstill,
        "without_service_curve": supervision.without_service_curve,
    }


def _print_curves(name: str, entry: dict[str, Any]) -> None:
    """Print one table: a row for each speed, a column for each curve; in full width also in a narrow terminal."""
    curves: dict[str, list[list[float]]] = entry["curves"]
    columns = {curve: {row[0]: row[1] for row in rows} for curve, rows in curves.items()}
    lines = [f"{name}: distance before the target in m", "  km/h" + "".join(f"{curve:>{WIDTH}}" for curve in columns)]
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
    widest = max(len(name) for name in (*deviations, DEVIATION_TITLE))
    lines = [f"{DEVIATION_TITLE:{widest}}" + "".join(f"{curve:>{WIDTH}}" for curve in curves)]
    for name, entry in deviations.items():
        values = (entry.get(curve) for curve in curves)
        cells = (" " * WIDTH if value is None else f"{value:{WIDTH}.3f}" for value in values)
        lines.append(f"{name:{widest}}" + "".join(cells))
    sys.stdout.write("\n".join(line.rstrip() for line in lines) + "\n")
