"""``train-ato plan LINE CONSIST --trip``: plan the journey of a long train with its air-brake applications."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plant_sim.input_error import explain
from train_ato.arguments import check_new_file
from train_ato.errors import RunInterrupted

if TYPE_CHECKING:
    from plant_sim.consist import Consist
    from plant_sim.line import Line
    from train_ato.profile.trip.plan import TripPlan

DEFAULTS = "defaults"
"""Value of ``--trip`` without a file."""
SCENARIOS, FIGURES = (".yaml", ".yml"), (".png", ".pdf", ".svg")
OTHER_OPTIONS = (
    "dwell", "through", "acceleration", "deceleration", "jerk", "margin", "max_speed_kmh", "no_air_brake", "point_mass",
)  # fmt: skip
"""Options of ``plan`` without a meaning for a trip."""


def add_trip_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of a trip plan."""
    parser.add_argument(
        "--trip",
        nargs="?",
        const=DEFAULTS,
        metavar="FILE",
        help="plan a long train with the applications of its air brake; FILE: weights and limits (YAML). Objective in "
        "kWh: energy + time_weight T + fatigue_weight D; T: running time in s, with --time instead of time_weight; D: "
        "damage of the couplers, 1 per force cycle of 1 MN of one coupler (10 to 20 on 45 km with 10 700 t)",
    )
    parser.add_argument(
        "--base", metavar="SCENARIO", help="with --trip: scenario with plant, delays and criteria of the written one"
    )


def trip_from_options(options: argparse.Namespace, report: Any = lambda _: None) -> dict[str, Any]:
    """Compute the trip plan of the options, write the files, and return the figures of the plan.

    Raises
    ------
    ValueError
        One line: file or option, key, value, problem; fix.
    RunInterrupted
        After Ctrl-C in the search; the files have the best plan so far.
    """
    from train_ato.profile.planner.inputs import find_line, find_train
    from train_ato.profile.trip.objective import TripInterrupted, plan_trip

    _check_options(options)
    line, (consist, _) = find_line(options.line), find_train(options.consist)
    try:
        plan = plan_trip(line, consist, _settings(options), options.period, report)
    except TripInterrupted as interruption:
        files = _write_files(options, interruption.plan, line, consist)
        kept = f"the best plan so far, {interruption.plan.running_time:.0f} s, is in {', '.join(map(str, files))}"
        journeys = f"{interruption.journeys} journey{'s' if interruption.journeys > 1 else ''}"
        raise RunInterrupted(f"interrupted after {journeys}{'; ' + kept if files else ''}") from None
    files = _write_files(options, plan, line, consist)
    return {"train": consist.name, "line": line.name, **plan.summary(), "files": [str(path) for path in files]}


def _write_files(options: argparse.Namespace, plan: TripPlan, line: Line, consist: Consist) -> list[Path]:
    """Write the files of ``--out`` and return their paths; after a failure or Ctrl-C none of them is left."""
    from train_ato.apps.report.trip_figure import draw_trip
    from train_ato.profile.file import write_profile
    from train_ato.scenario.trip_scenario import plant_data, write_trip

    source = f"train-ato plan {options.line} {options.consist} --trip: {plan.running_time:.1f} s"
    files: list[Path] = []
    try:
        for path in options.out:
            files.append(path)
            if path.suffix.lower() in SCENARIOS:
                files.append(path.with_suffix(".csv"))
                plant = plant_data(options.consist, consist, options.line, line)
                write_trip(plan, path, options.base, plant, source)
            elif path.suffix.lower() in FIGURES:
                draw_trip(plan, line, consist, path)
            else:
                write_profile(plan.profile, path, source)
    except BaseException:
        for path in files:
            path.unlink(missing_ok=True)
        raise
    return files


def execute_trip(options: argparse.Namespace) -> int:
    """Compute the trip plan and print one JSON value or a table."""
    from train_ato.apps.runs.progress import PLANNER_NOTE, activity, compilation_noted
    from train_ato.apps.runs.summary_table import format_value
    from train_ato.cli.screen import print_json, print_table

    with compilation_noted(PLANNER_NOTE), activity("planning the trip") as report:
        result = trip_from_options(options, report)
    if options.json:
        print_json(result)
        return 0
    rows = [(key, format_value(value)) for key, value in result.items() if not isinstance(value, (list, dict))]
    print_table(("", ""), rows)
    if result["applications"]:
        entries = (
            [f"{e['apply_km']:.3f}", f"{e['release_km']:.3f}", e["reduction_kpa"], e["supply"]]
            for e in result["applications"]
        )
        print_table(("apply, km", "release, km", "reduction, kPa", "reservoirs"), entries)
    for name in result["files"]:
        sys.stdout.write(f"{name}\n")
    return 0


def _check_options(options: argparse.Namespace) -> None:
    """Check files and combination of the options before the search."""
    for name in OTHER_OPTIONS:
        if getattr(options, name) not in (None, False):
            raise ValueError(f"--{name.replace('_', '-')}: without a meaning for --trip; remove it, or use the file")
    for path in options.out:
        check_new_file(path, (".csv", *SCENARIOS, *FIGURES))
        if path.suffix.lower() in SCENARIOS:
            check_new_file(path.with_suffix(".csv"), (".csv",))
    if not 1e-3 <= options.period <= 10:
        raise ValueError(f"--period {options.period:g}: out of range; give 0.001 to 10 s")
    if options.base is not None:
        from train_ato.scenario.scenario import load_scenario

        load_scenario(options.base)


def _settings(options: argparse.Namespace) -> Any:
    """Return the settings of the file, changed by the options."""
    from pydantic import ValidationError

    from plant_sim.library import read_yaml
    from train_ato.profile.trip.settings import TripSettings

    data = {} if options.trip == DEFAULTS else read_yaml(Path(options.trip))
    if not isinstance(data, dict):
        raise ValueError(f"{options.trip}: holds no keys; write key: value")
    for key, value in (("begin_km", options.begin_km), ("end_km", options.end_km), ("time", options.time)):
        if value is not None:
            data = {name: old for name, old in data.items() if name not in (key, key.removesuffix("_km"))}
            data[key] = value
    try:
        return TripSettings.model_validate(data)
    except ValidationError as error:
        source = "options of plan" if options.trip == DEFAULTS else options.trip
        raise explain(error, source, TripSettings) from None
