"""``train-ato plan LINE CONSIST``: compute a speed profile."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.cli.plan_trip import add_trip_arguments, execute_trip

if TYPE_CHECKING:
    from train_ato.profile.planner.planner import Plan

__all__ = ["add_arguments", "execute", "plan_from_options"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``plan``."""
    least = _number(0.0)
    parser.add_argument(
        "line",
        metavar="LINE",
        help="shipped line or file, in any format of `train-ato convert`; with :reverse, against its direction",
    )
    parser.add_argument(
        "consist", metavar="CONSIST", help="shipped train, or file (train_ato YAML, railtoolkit YAML, TTOBench JSON)"
    )
    parser.add_argument(
        "--from-km",
        dest="begin_km",
        type=_number(),
        metavar="KM",
        help="start position of the front [km] (default: first stop)",
    )
    parser.add_argument(
        "--to-km",
        dest="end_km",
        type=_number(),
        metavar="KM",
        help="stop position of the front [km] (default: last stop)",
    )
    parser.add_argument(
        "--time", type=least, metavar="S", help="timetable: running time with dwell times (default: minimum time)"
    )
    parser.add_argument(
        "--journey",
        metavar="FILE",
        help="timing points with windows, in place of --time: train_ato YAML or TTOBench 1.5 JSON",
    )
    parser.add_argument(
        "--no-bound",
        action="store_true",
        help="with --time: without the lower bound of the energy, some seconds faster",
    )
    parser.add_argument(
        "--dwell", type=least, metavar="S", help="dwell time at intermediate stops (default: that of the line)"
    )
    parser.add_argument("--through", action="store_true", help="pass the intermediate stops of the line")
    _add_train_arguments(parser, least)
    parser.add_argument(
        "--period", type=least, default=0.1, metavar="S", help="time between the knots of the profile (default: 0.1)"
    )
    parser.add_argument(
        "--out", type=Path, action="append", default=[], metavar="FILE",
        help="profile (.csv, .yaml) or figure (.png, .pdf, .svg); may be repeated",
    )  # fmt: skip
    add_trip_arguments(parser)


def _add_train_arguments(parser: argparse.ArgumentParser, least: Callable[[str], float]) -> None:
    """Declare the options of comfort, forces and energy of the train."""
    parser.add_argument("--acceleration", type=_limit, metavar="A", help="maximum acceleration [m/s²], or none")
    parser.add_argument("--deceleration", type=_limit, metavar="A", help="maximum deceleration [m/s²], or none")
    parser.add_argument("--jerk", type=_limit, metavar="J", help="jerk limit [m/s³], or none")
    parser.add_argument(
        "--margin", type=least, metavar="FRACTION", help="fraction of the maximum forces kept in reserve"
    )
    parser.add_argument(
        "--efficiency",
        type=least,
        metavar="FRACTION",
        help="of traction, in the net energy (default: that of the train's file, else 1)",
    )
    parser.add_argument(
        "--recovered",
        type=least,
        metavar="FRACTION",
        help="share of the electric-brake work that returns to the line (default: that of the train's file, else 0)",
    )
    parser.add_argument("--auxiliary-kw", type=least, metavar="KW", help="auxiliary power in the net energy")
    parser.add_argument("--max-speed-kmh", type=least, metavar="V", help="speed limit of the train")
    parser.add_argument("--no-air-brake", action="store_true", help="use electric brakes only")
    parser.add_argument(
        "--point-mass",
        action="store_true",
        help="point mass at the front: speed limits and grades end where the front leaves them",
    )


def plan_from_options(options: argparse.Namespace) -> dict[str, Any]:
    """Compute the profile of the options, write the files, and return the figures of the plan.

    Raises
    ------
    ValueError
        One line: option, problem; fix.
    """
    from train_ato.apps.runs.planning import plan

    if options.journey is not None:
        _check_journey(options)
    if not 1e-3 <= options.period <= 10:
        raise ValueError(f"--period {options.period:g}: out of range; give 0.001 to 10 s")
    result = plan(
        options.line,
        options.consist,
        journey=options.journey,
        period=options.period,
        out=options.out,
        **_settings(options),
    )
    return (
        result.summary()
        | _certificate(result, options)
        | {
            "settings": result.settings.model_dump(mode="json", exclude_none=True),
            "files": [str(path) for path in options.out],
        }
    )


def execute(options: argparse.Namespace) -> int:
    """Compute the profile and print one JSON value or a table."""
    if options.trip is not None:
        return execute_trip(options)
    from train_ato.apps.runs.progress import PLANNER_NOTE, compilation_noted
    from train_ato.apps.runs.summary_table import format_value
    from train_ato.cli.screen import print_json, print_table

    with compilation_noted(PLANNER_NOTE):
        result = plan_from_options(options)
    if options.json:
        print_json(result)
        return 0
    rows = [(key, format_value(value)) for key, value in result.items() if not isinstance(value, (list, dict))]
    print_table(("", ""), rows)
    if len(result["stops"]) > 2:
        stops = ([f"{s['place_m'] / 1e3:.3f}", s["arrival_s"], s["departure_s"]] for s in result["stops"])
        print_table(("stop, km", "arrival, s", "departure, s"), stops)
    for name in result["files"]:
        sys.stdout.write(f"{name}\n")
    return 0


def _certificate(result: Plan, options: argparse.Namespace) -> dict[str, float]:
    """Return the lower bound of the energy [kWh] and the gap of a timetabled plan to it [%]."""
    from train_ato.apps.runs.progress import activity
    from train_ato.profile.planner.planner import net_energy_bound

    if result.settings.time is None or options.no_bound:
        return {}
    with activity("lower bound of the energy"):
        bound = net_energy_bound(result) / 3.6e6
    energy = result.energy / 3.6e6
    found = {"energy_bound_kwh": round(bound, 4)}
    return found | ({"energy_gap_percent": round(100 * (energy / bound - 1), 2)} if bound > 0 else {})


def _settings(options: argparse.Namespace) -> dict[str, Any]:
    """Return the given settings of the plan [SI]; None is a limit that does not apply."""
    given = {
        "begin": None if options.begin_km is None else 1e3 * options.begin_km,
        "end": None if options.end_km is None else 1e3 * options.end_km,
        "time": options.time,
        "dwell": options.dwell,
        "force_margin": options.margin,
        "efficiency": options.efficiency,
        "recovered": options.recovered,
        "auxiliary": None if options.auxiliary_kw is None else 1e3 * options.auxiliary_kw,
        "speed_max": None if options.max_speed_kmh is None else options.max_speed_kmh / 3.6,
        "calling": False if options.through else None,
        "air_brake": False if options.no_air_brake else None,
        "point_mass": True if options.point_mass else None,
    }
    data = {key: value for key, value in given.items() if value is not None}
    for key in ("acceleration", "deceleration", "jerk"):
        value = getattr(options, key)
        if value is not None:
            data[key] = None if math.isinf(value) else value
    return data


def _check_journey(options: argparse.Namespace) -> None:
    """Refuse options that the timing points of ``--journey`` have."""
    for name in ("time", "from_km", "to_km", "dwell", "through"):
        value = getattr(options, {"from_km": "begin_km", "to_km": "end_km"}.get(name, name))
        if value is not None and value is not False:
            option = "--" + name.replace("_", "-")
            raise ValueError(f"{option} with --journey: the timing points have it; remove {option}")


def _number(low: float = -math.inf) -> Callable[[str], float]:
    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"'{text}' is not a number; correct it") from None
        if not math.isfinite(value) or value < low:
            raise argparse.ArgumentTypeError(
                f"'{text}' is out of range; give a finite number" + (f" >= {low:g}" if low == 0 else "")
            )
        return value

    return parse


def _limit(text: str) -> float:
    """Return a limit [SI]; infinity for 'none'."""
    return math.inf if text.lower() == "none" else _number(0.0)(text)
