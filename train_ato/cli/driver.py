"""``train-ato drive``: let a smooth driver drive the nominal train, and write the run as a profile."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path

from plant_sim.library import load_consist, load_line
from plant_sim.line import Line
from train_ato.cli.screen import console, print_json
from train_ato.given import check_new_file
from train_ato.profile.driver import Driver, drive, reference
from train_ato.profile.file import write_profile


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``drive``."""
    parser.add_argument("line", metavar="LINE", help="a shipped line or a file")
    parser.add_argument("consist", metavar="CONSIST", help="a shipped train or a file")
    parser.add_argument("--until-km", type=float, required=True, metavar="KM", help="where the run ends, still rolling")
    parser.add_argument("--speed-kmh", type=float, default=70.0, metavar="V", help="speed that the driver holds")
    parser.add_argument("--spacing", type=float, default=0.5, metavar="S", help="time between the knots written")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="profile to write (.csv, .yaml)")
    parser.add_argument("--json", action="store_true", help="print one JSON value and nothing else")


def execute(options: argparse.Namespace) -> int:
    """Drive, write the profile, print the brake events as they go into a scenario."""
    check_new_file(options.out, (".csv", ".yaml", ".yml"))
    consist, line = load_consist(options.consist), load_line(options.line)
    _check(options, line)
    driver = dataclasses.replace(Driver(), speed=options.speed_kmh / 3.6)
    run = drive(consist, line, options.until_km * 1e3, driver, report=_tell)
    profile = reference(run, driver, options.spacing)
    source = (
        f"a smooth driver ({driver.slew / 1e3:g} kN/s, {driver.traction:g} of the traction, {driver.brake:g} of the "
        f"brake, {options.speed_kmh:g} km/h, {driver.gain:g} 1/s) on {consist.name} and {line.name}, speed averaged "
        f"over {driver.average:g} s three times: "
        f"train-ato drive {options.line} {options.consist} --until-km {options.until_km:g}"
    )
    write_profile(profile, options.out, source)
    events = [{"time": round(time, 3), "reduction_kpa": round(reduction / 1e3, 3)} for time, reduction in run.events]
    result = {
        "file": str(options.out),
        "running_time_s": profile.end,
        "distance_m": float(profile.position[-1] - profile.position[0]),
        "speed_max_kmh": 3.6 * float(profile.velocity.max()),
        "speed_end_kmh": 3.6 * float(profile.velocity[-1]),
        "events": events,
    }
    if options.json:
        print_json(result)
        return 0
    sys.stdout.write(
        f"{profile.end:.1f} s, {result['distance_m']:.0f} m, at most {result['speed_max_kmh']:.1f} km/h, written to "
        f"{options.out}\nbrake:\n  policy: planned\n  events:\n"
    )
    sys.stdout.write("".join(f"    - {{time: {e['time']}, reduction_kpa: {e['reduction_kpa']:g}}}\n" for e in events))
    return 0


def _check(options: argparse.Namespace, line: Line) -> None:
    """Refuse numbers with which the driver would never arrive."""
    begin, end = line.begin / 1e3, line.end / 1e3
    if not begin < options.until_km <= end:
        raise ValueError(f"--until-km {options.until_km}: line '{line.name}' runs from km {begin:g} to km {end:g}")
    if not 1 <= options.speed_kmh <= 500:
        raise ValueError(f"--speed-kmh {options.speed_kmh}: give a speed from 1 to 500 km/h")
    if not 0.1 <= options.spacing <= 10:
        raise ValueError(f"--spacing {options.spacing}: give 0.1 to 10 s")


def _tell(place: float) -> None:
    if sys.stderr.isatty():
        console().print(f"km {place / 1e3:.1f}", end="\r")
