"""``train-ato plan LINE CONSIST``: the driving profile alone."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from plant_sim.input_error import explain
from train_ato.given import check_new_file
from train_ato.plan.figure import draw_plan
from train_ato.plan.inputs import find_line, find_train
from train_ato.plan.planner import Plan, plan
from train_ato.plan.settings import PlanSettings
from train_ato.profile.file import write_profile

__all__ = ["add_arguments", "execute", "planned"]

PROFILES, FIGURES = (".csv", ".yaml", ".yml"), (".png", ".pdf", ".svg")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``plan``."""
    least = _number(0.0)
    parser.add_argument("line", metavar="LINE", help="shipped line, or a file (ours, railtoolkit YAML, TTOBench JSON)")
    parser.add_argument("consist", metavar="CONSIST", help="shipped train, or a file (ours, railtoolkit YAML)")
    parser.add_argument("--from", dest="begin_km", type=_number(), metavar="KM", help="where the front starts")
    parser.add_argument("--to", dest="end_km", type=_number(), metavar="KM", help="where the front stops")
    parser.add_argument("--time", type=least, metavar="S", help="running time to keep, stops included; default: least")
    parser.add_argument("--dwell", type=least, metavar="S", help="at every stop on the way; default: that of the line")
    parser.add_argument("--through", action="store_true", help="do not call at the line's stops on the way")
    parser.add_argument("--acceleration", type=_limit, metavar="A", help="service limit in m/s², or none")
    parser.add_argument("--deceleration", type=_limit, metavar="A", help="service limit in m/s², or none")
    parser.add_argument("--jerk", type=_limit, metavar="J", help="service limit in m/s³, or none")
    parser.add_argument("--margin", type=least, metavar="PART", help="of the envelopes, kept for the controller")
    parser.add_argument("--speed-max-kmh", type=least, metavar="V", help="of the train")
    parser.add_argument("--no-air-brake", action="store_true", help="brake electrically alone")
    parser.add_argument("--point-mass", action="store_true", help="all of the train at its front")
    parser.add_argument("--period", type=least, default=0.1, metavar="S", help="time between the profile's knots")
    parser.add_argument(
        "--out", type=Path, action="append", default=[], metavar="FILE",
        help="profile (.csv, .yaml) or figure (.png, .pdf, .svg); may be given several times",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print one JSON value and nothing else")


def planned(options: argparse.Namespace) -> dict[str, Any]:
    """Plan what the options ask for, write the files, and return the figures as plain data.

    Raises
    ------
    ValueError
        One line: what is wrong, where, and what to do.
    """
    for path in options.out:
        check_new_file(path, (*PROFILES, *FIGURES))
    line = find_line(options.line)
    consist, settings = find_train(options.consist)
    settings = _settings(options, settings)
    if not 1e-3 <= options.period <= 10:
        raise ValueError(f"--period {options.period:g}: must lie between 0.001 and 10 s")
    result = plan(line, consist, settings, options.period)
    for path in options.out:
        if path.suffix.lower() in FIGURES:
            draw_plan(result, path)
        else:
            write_profile(result.profile, path, _source(options, result))
    return result.summary() | {
        "settings": settings.model_dump(mode="json", exclude_none=True),
        "files": [str(path) for path in options.out],
    }


def execute(options: argparse.Namespace) -> int:
    """Plan, and print one JSON value or a table."""
    from train_ato.cli.screen import PLANNER_NOTE, noted_when_slow, print_json, shown, table

    with noted_when_slow(PLANNER_NOTE):
        result = planned(options)
    if options.json:
        print_json(result)
        return 0
    rows = [(key, shown(value)) for key, value in result.items() if not isinstance(value, (list, dict))]
    table(("", ""), rows)
    if len(result["stops"]) > 2:
        stops = ([f"{s['place_m'] / 1e3:.3f}", s["arrival_s"], s["departure_s"]] for s in result["stops"])
        table(("stop, km", "arrival, s", "departure, s"), stops)
    for name in result["files"]:
        sys.stdout.write(f"{name}\n")
    return 0


def _settings(options: argparse.Namespace, settings: PlanSettings) -> PlanSettings:
    asked = {
        "begin": None if options.begin_km is None else 1e3 * options.begin_km,
        "end": None if options.end_km is None else 1e3 * options.end_km,
        "time": options.time,
        "dwell": options.dwell,
        "force_margin": options.margin,
        "speed_max": None if options.speed_max_kmh is None else options.speed_max_kmh / 3.6,
        "calling": False if options.through else None,
        "air_brake": False if options.no_air_brake else None,
        "point_mass": True if options.point_mass else None,
    }
    data = settings.model_dump() | {key: value for key, value in asked.items() if value is not None}
    for key in ("acceleration", "deceleration", "jerk"):
        value = getattr(options, key)
        if value is not None:
            data[key] = None if math.isinf(value) else value
    try:
        return PlanSettings.model_validate(data)
    except ValidationError as error:
        raise ValueError(explain(error, "options of plan", PlanSettings)) from None


def _source(options: argparse.Namespace, result: Plan) -> str:
    return (
        f"train-ato plan {options.line} {options.consist}: {result.running_time:.2f} s, force margin "
        f"{result.settings.force_margin:g}, jerk {result.settings.jerk} m/s3"
    )


def _number(low: float = -math.inf) -> Callable[[str], float]:
    def number(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"'{text}' is not a number") from None
        if not math.isfinite(value) or value < low:
            raise argparse.ArgumentTypeError(f"'{text}' must be a finite number" + (f" >= {low:g}" if low == 0 else ""))
        return value

    return number


def _limit(text: str) -> float:
    """Return a limit; infinity for 'none'."""
    return math.inf if text.lower() == "none" else _number(0.0)(text)
