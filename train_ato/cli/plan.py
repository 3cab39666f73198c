"""``train-ato plan LINE CONSIST``: compute a speed profile.

Options::

    line LINE                shipped line or file, in any format of `train-ato convert`; with :reverse, against its
                             direction
    consist CONSIST          shipped train, or file in any format of `train-ato convert`
    --from-km KM             start position of the front [km], or a post as 84+500 (default: first stop; with --trip
                             begin of the line)
    --to-km KM               stop position of the front [km], or a post as 84+500 (default: last stop)
    --time S                 timetable: running time with dwell times (default: minimum time)
    --allowance TIME         supplement to the least running time between two stops, without --time: 5%, 1.5min/100km,
                             10s/stop, joined by +. :KM..KM after it limits it to a section (kilometres, or posts as
                             84+500). May be repeated
    --journey FILE           timing points with windows, in place of --time: train_ato YAML or TTOBench 1.5 JSON
    --no-bound               with --time: without the lower bound of the energy, some seconds faster
    --dwell S                dwell time at intermediate stops (default: as in the line)
    --through                pass the intermediate stops of the line
    --acceleration A         maximum acceleration [m/s²], or none
    --deceleration A         maximum deceleration [m/s²], or none
    --jerk J                 jerk limit [m/s³], or none
    --force-margin FRACTION  fraction of the maximum forces kept in reserve
    --efficiency FRACTION    of traction, in the net energy (default: as in the train's file, else 1)
    --recovered FRACTION     share of the electric-brake work that returns to the line (default: as in the train's
                             file, else 0)
    --auxiliary-kw KW        auxiliary power in the net energy
    --max-speed-kmh V        speed limit of the train
    --no-air-brake           use electric brakes only
    --point-mass             point mass at the front: speed limits and grades end where the front leaves them
    --period S               time between the knots of the profile (default: 0.1)
    --out FILE               profile (.csv, .yaml) or figure (.png, .pdf, .svg); may be repeated
    --trip FILE              plan a long train with the applications of its air brake. FILE has weights and limits
                             (YAML). The objective in kWh is energy + time_weight T + fatigue_weight D. T is the
                             running time in s; --time replaces time_weight. D is the damage of the couplers: one force
                             cycle of 1 MN of one coupler counts 1 (10 to 20 on 45 km with 10 700 t)
    --base SCENARIO          with --trip: scenario with plant, delays and criteria of the written one
"""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plant_sim.input_error import InputFaults, explain
from train_ato.program.arguments import OPTIONS_OF_PLAN, Options, check_new_file
from train_ato.program.display_units import shown_text
from train_ato.program.errors import RunInterrupted, check_packages

if TYPE_CHECKING:
    from plant_sim.consist import Consist
    from plant_sim.line import Line
    from train_ato.profile.planner.allowance import Allowance
    from train_ato.profile.planner.planner import Plan
    from train_ato.profile.trip.plan import TripPlan


DEFAULTS = "defaults"
"""Value of ``--trip`` without a file."""
SCENARIOS, FIGURES = (".yaml", ".yml"), (".png", ".pdf", ".svg")
OTHER_OPTIONS = (
    "journey", "allowance", "dwell", "through", "acceleration", "deceleration", "jerk", "force_margin",
    "efficiency", "recovered", "auxiliary_kw", "max_speed_kmh", "no_air_brake", "point_mass",
)  # fmt: skip
"""Options of ``plan`` without a meaning for a trip."""
_OPTIONS = {
    "begin": "from-km", "begin_km": "from-km", "end": "to-km", "end_km": "to-km", "speed_max": "max-speed-kmh",
    **{key: key.replace("_", "-") for key in (
        "time", "dwell", "allowance", "force_margin", "efficiency", "recovered", "acceleration", "deceleration", "jerk",
    )},
}  # fmt: skip
"""Option of each setting of a plan that a refusal can name."""


def trip_from_options(options: argparse.Namespace, report: Any = lambda _: None) -> dict[str, Any]:
    """Compute the trip plan of the options, write the files, and return the figures of the plan.

    Raises
    ------
    ValueError
        One line: file or option, key, value, problem; fix.
    RunInterrupted
        After Ctrl-C in the search; the files have the best plan so far.
    """
    from plant_sim.library import load_line
    from plant_sim.line import line_for
    from train_ato.profile.planner.settings import find_train
    from train_ato.profile.trip.planner import TripInterrupted, plan_trip

    _check_options(options)
    consist, _ = find_train(options.consist)
    line = line_for(load_line(options.line), consist.categories, consist.rating)
    try:
        plan = plan_trip(line, consist, _trip_settings(options), options.period, report)
    except TripInterrupted as interruption:
        files = _write_files(options, interruption.plan, line, consist)
        kept = f"the best plan so far, {interruption.plan.running_time:.0f} s, is in {', '.join(map(str, files))}"
        journeys = f"{interruption.journeys} journey{'s' if interruption.journeys > 1 else ''}"
        raise RunInterrupted(f"interrupted after {journeys}{'; ' + kept if files else ''}") from None
    files = _write_files(options, plan, line, consist)
    _note_stops(plan, line, consist)
    return {"train": consist.name, "line": line.name, **plan.summary(), "files": [str(path) for path in files]}


HOLDING = 0.6
"""Part of the running resistance up to which a fall does not move the stop by metres."""


def _note_stops(plan: TripPlan, line: Line, consist: Consist) -> None:
    """Name on stderr stops of the line that a trip passes, and a fall at its end that no brake of the plan holds."""
    begin, end = plan.profile.position[[0, -1]] + consist.vehicles[0].length / 2
    passed = [f"km {stop.at / 1e3:.3f}" for stop in line.stops if begin + 1.0 < stop.at < end - 1.0]
    if passed:
        text = line.with_posts(f"{', '.join(passed)}; --from-km and --to-km have begin and end")
        sys.stderr.write(f"note: the trip passes stops of the line: {shown_text(text)}\n")
    model, stop = plan.model, float(plan.profile.position[-1])
    held = HOLDING * model.running_resistance(0.5) - sum(model.limits_of_units([0.0] * model.n_units)[0])
    if (fall := -model.line_force(stop)) > held:
        permille = 1e3 * fall / (model.mass * consist.gravity)
        sys.stderr.write(
            f"note: the line falls by {permille:.1f} per mille at the end of the trip, and the electric brake fades "
            "there: the train stops some metres beyond, or not at all; move the end (--to-km)\n"
        )


def _write_files(options: argparse.Namespace, plan: TripPlan, line: Line, consist: Consist) -> list[Path]:
    """Write the files of ``--out`` and return their paths; after a failure or Ctrl-C none of them is left."""
    from train_ato.profile.file import write_profile
    from train_ato.report.plan_figure import draw_trip
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


def _print_trip(result: dict[str, Any]) -> None:
    """Print the applications of the air brake of a trip plan."""
    from train_ato.cli.screen import kilometre_cell, print_table

    if result["applications"]:
        entries = (
            [kilometre_cell(e["apply_km"]), kilometre_cell(e["release_km"]), e["reduction_kpa"], e["supply"]]
            for e in result["applications"]
        )
        print_table(("apply, km", "release, km", "reduction, kPa", "reservoirs"), entries)


def _check_options(options: argparse.Namespace) -> None:
    """Check files and combination of the options before the search."""
    for name in OTHER_OPTIONS:
        if getattr(options, name) not in (None, False):
            raise ValueError(f"--{name.replace('_', '-')}: without a meaning for --trip; remove it, or use the file")
    for path in options.out:
        check_new_file(path, (".csv", *SCENARIOS, *FIGURES))
        if path.suffix.lower() in SCENARIOS:
            check_new_file(path.with_suffix(".csv"), (".csv",))
    if options.base is not None:
        if not any(path.suffix.lower() in SCENARIOS for path in options.out):
            raise ValueError("--base: belongs to a written scenario; add --out FILE.yaml, or remove it")
        from train_ato.scenario.scenario import load_scenario

        load_scenario(options.base)


def _trip_settings(options: argparse.Namespace) -> Any:
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
        source = OPTIONS_OF_PLAN if options.trip == DEFAULTS else options.trip
        raise explain(error, source, TripSettings, data) from None


def plan_from_options(options: argparse.Namespace) -> dict[str, Any]:
    """Compute the profile of the options, write the files, and return the figures of the plan."""
    from train_ato.api.planning import plan

    if options.journey is not None:
        _check_journey(options)
    if options.time is not None and not options.no_bound:
        check_packages("plan --time (the lower bound, left out by --no-bound)", "scipy")
    given = {"journey": options.journey, "period": options.period, "out": options.out, **_settings(options)}
    result = plan(options.line, options.consist, **given)
    settings = result.settings.model_dump(mode="json", exclude_none=True)
    files = [str(path) for path in options.out]
    return {**result.summary(), **_certificate(result, options), "settings": settings, "files": files}


def execute(options: argparse.Namespace) -> None:
    """Compute the profile or the trip plan; a refusal names the options in place of the keys of the settings."""
    try:
        _execute(options)
    except ValueError as error:
        text = str(error)
        if not text.startswith((OPTIONS_OF_PLAN, "allowance")):  # of a file
            raise
        keys = rf"\b({'|'.join(_OPTIONS)})(?:\.\d+)?(?= =|:| with )"
        named = re.sub(keys, lambda key: f"--{_OPTIONS[key[1]]}", text.replace(f"{OPTIONS_OF_PLAN}: ", ""))
        raise InputFaults(named) from None


def _execute(options: argparse.Namespace) -> None:
    """Compute the plan and print one JSON value or tables."""
    from train_ato.api.progress import PLANNER_NOTE, activity, compilation_noted
    from train_ato.cli.screen import print_json, print_table
    from train_ato.judge.metric_names import format_value

    if options.base is not None and options.trip is None:
        raise ValueError("--base: only with --trip; remove it")
    if not 1e-3 <= options.period <= 10:
        raise ValueError(f"--period {options.period:g}: out of range; give 0.001 to 10 s")
    with compilation_noted(PLANNER_NOTE), ExitStack() as shown:
        if options.trip is None:
            result = plan_from_options(options)
        else:
            result = trip_from_options(options, shown.enter_context(activity("planning the trip")))
    if options.json:
        print_json(result)
        return
    rows = [(key, format_value(value)) for key, value in result.items() if not isinstance(value, (list, dict))]
    print_table(("", ""), rows)
    (_print_plan if options.trip is None else _print_trip)(result)
    for name in result["files"]:
        sys.stdout.write(f"{name}\n")


def _print_plan(result: dict[str, Any]) -> None:
    """Print the stops and the sections without power of a plan."""
    from train_ato.cli.screen import print_table

    if len(result["stops"]) > 2:
        columns = {"arrival, s": "arrival_s", "departure, s": "departure_s"}
        columns |= {"allowance, s": "allowance_s"} if "allowance_s" in result else {}
        stops = ([_km(stop), *(stop.get(key, "") for key in columns.values())] for stop in result["stops"])
        print_table(("stop, km", *columns), stops)
    if dead := result.get("without_power"):
        names = {"announced_s": "announced, s", "off_s": "power off, s", "on_s": "power on, s", "phase": "phase"}
        names = {key: name for key, name in names.items() if any(key in row for row in dead)}
        cells = ([row.get(key, "") for key in names] for row in dead)
        texts = ([cell if isinstance(cell, str) else f"{cell:.1f}" for cell in row] for row in cells)
        sections = ([_km(row), *text] for row, text in zip(dead, texts, strict=True))
        print_table(("neutral section, km", *names.values()), sections)


def _km(row: dict[str, Any]) -> Any:
    """Return the cell of the post of a place, without one of its kilometre."""
    from train_ato.cli.screen import kilometre_cell

    return row.get("post") or kilometre_cell(row["place_m"] / 1e3)


def _certificate(result: Plan, options: argparse.Namespace) -> dict[str, float]:
    """Return the lower bound of the energy [kWh] and the gap of a timetabled plan to it [%]."""
    from train_ato.api.progress import activity
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
    same = ("time", "dwell", "allowance", "force_margin", "efficiency", "recovered")
    given = {
        "begin": _in_metres(options.begin_km),
        "end": _in_metres(options.end_km),
        **{name: getattr(options, name) for name in same},
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
    for name in ("time", "allowance", "from_km", "to_km", "dwell", "through"):
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


def kilometre(text: str) -> float | str:
    """Return kilometres, or the text of a post such as 84+500."""
    from plant_sim.chainage import parse_post

    return text if parse_post(text) is not None else _number()(text)


def _in_metres(kilometres: float | str | None) -> float | str | None:
    """Return kilometres in metres, and a post as it is."""
    return 1e3 * kilometres if isinstance(kilometres, float) else kilometres


def _allowance(text: str) -> Allowance:
    """Return the supplement of a text."""
    from train_ato.profile.planner.allowance import parse_allowance

    try:
        return parse_allowance(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error).splitlines()[0]) from None


_LEAST = {"type": _number(0.0)}
_LIMIT = {"type": lambda text: math.inf if text.lower() == "none" else _number(0.0)(text)}
OPTIONS: Options = {
    **dict.fromkeys(("--time", "--dwell", "--force-margin", "--efficiency", "--recovered"), _LEAST),
    **dict.fromkeys(("--auxiliary-kw", "--max-speed-kmh"), _LEAST),
    **dict.fromkeys(("--acceleration", "--deceleration", "--jerk"), _LIMIT),
    "--from-km": {"dest": "begin_km", "type": kilometre},
    "--to-km": {"dest": "end_km", "type": kilometre},
    "--allowance": {"type": _allowance, "action": "append", "default": None},
    "--journey": {"type": None},
    "--period": {**_LEAST, "default": 0.1},
    "--out": {"action": "append"},
    "--trip": {"nargs": "?", "const": DEFAULTS, "type": None},
}
