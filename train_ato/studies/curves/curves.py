"""Braking curves and supervision limits of the cases of a file, or of the train of a scenario on its line."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from plant_sim.formats.fields import print_assumption
from plant_sim.line import line_for
from plant_sim.units import KMH
from train_ato.api.scenario_choice import GivenScenario, choose_scenario
from train_ato.program.arguments import check_new_file, option_name
from train_ato.program.display_units import display_unit
from train_ato.report.print_figures import SHEET_SIZE, styled, write_figure
from train_ato.report.quantities import BLACK, BLUE, BROWN, GREEN, GREY, ORANGE, PURPLE, VERMILION
from train_ato.scenario.scenario_data import scenario_consist, scenario_line
from train_ato.studies.curves.case_file import CurveCase, read_cases
from train_ato.supervision.limits import TargetLimits
from train_ato.supervision.odometry import MotionEstimate, motion_estimate
from train_ato.supervision.plant_line import line_supervision
from train_ato.supervision.track_supervision import TrackSupervision

CurveTable = dict[str, list[list[float]]]
"""Pairs of speed [km/h] and distance before the target [m], by name of the curve."""


def curve_location(limits: TargetLimits, name: str, motion: MotionEstimate) -> Callable[[float], float]:
    """Return the function from the speed [m/s] to the location [m] of a curve.

    The limits from the EBD are locations of the max safe front; the function returns those of the estimated front.

    Raises
    ------
    ValueError
        If the curve needs a service deceleration that the train does not have.
    """
    behind = motion.under_reading
    functions: dict[str, Callable[[float], float]] = {
        "EBD": limits.ebd.location,
        "EBI": lambda speed: limits.emergency(speed, motion) - behind,
        "SBI1": limits.service_from_sbd,
        "SBI2": lambda speed: limits.service_from_ebd(speed, motion) - behind,
        "SBI": lambda speed: limits.service(speed, motion) - behind,
        "Warning": lambda speed: limits.warning(speed, motion) - behind,
        "Permitted": lambda speed: limits.permitted(speed, motion) - behind,
        "Indication": lambda speed: limits.indication(speed, motion) - behind,
    }
    return limits.service_curve().location if name == "SBD" else functions[name]


def tabulate(limits: TargetLimits, motion: MotionEstimate, speeds: dict[str, list[float]]) -> CurveTable:
    """Return the distances before the target for the speeds [km/h] of each curve."""
    table: CurveTable = {}
    for name, wanted in speeds.items():
        location = curve_location(limits, name, motion)
        table[name] = [[speed, limits.target.location - location(speed / KMH)] for speed in wanted]
    return table


def case_table(case: CurveCase, place: str) -> CurveTable:
    """Return the table of a case."""
    try:
        return tabulate(case.inputs.limits(), case.inputs.motion(), {name: case.speeds(name) for name in case.curves})
    except ValueError as error:
        raise ValueError(f"{place}: {error}") from None


def largest_deviations(case: CurveCase, table: CurveTable) -> dict[str, float | None]:
    """Return the largest deviation from the distances of the file [m], by curve; None for a curve without distances."""
    found: dict[str, float | None] = {}
    for name, rows in table.items():
        pairs = zip(rows, case.distances(name), strict=True)
        found[name] = max((abs(row[1] - given) for row, given in pairs if given is not None), default=None)
    return found


TABLE_STEP_KMH = 5.0
"""Distance of the speeds of a table [km/h]."""
LINE_CURVES = ("EBD", "EBI", "SBI2", "Warning", "Permitted", "Indication")
"""Curves of the table of an end of authority; SBD and SBI1 are added if the service brake has a curve."""

CURVE_COLOURS = {
    "EBD": BLACK, "SBD": GREY, "EBI": VERMILION, "SBI": PURPLE, "SBI1": BROWN, "SBI2": PURPLE,
    "Warning": ORANGE, "Permitted": GREEN, "Indication": BLUE,
}  # fmt: skip
DASHED = ("EBD", "SBD")
"""Curves of the braking train; the others are limits of a train at constant speed."""
PANEL_HEIGHT = 4.6
"""Height of the panel of one case [in]."""


@styled(SHEET_SIZE)
def draw_curves(tables: dict[str, CurveTable], path: Path) -> None:
    """Draw the curves of every case as PNG, PDF or SVG."""
    figure = Figure(figsize=(11, PANEL_HEIGHT * len(tables)), dpi=110, layout="constrained")
    panels = figure.subplots(len(tables), 1, squeeze=False)[:, 0]
    for panel, (name, table) in zip(panels, tables.items(), strict=True):
        _draw_table(panel, name, table)
    write_figure(figure, path)


def _draw_table(panel: Axes, name: str, table: CurveTable) -> None:
    for curve, rows in table.items():
        style = "--" if curve in DASHED else "-"
        panel.plot(
            [row[1] for row in rows], [row[0] for row in rows], style, color=CURVE_COLOURS[curve], lw=1.5, label=curve
        )
    panel.axvline(0.0, color=CURVE_COLOURS["EBD"], lw=0.8, ls=":")
    panel.invert_xaxis()
    panel.set_xlabel(f"distance before the target in {display_unit('m')[0]}")
    panel.set_ylabel(f"speed in {display_unit('km/h')[0]}")
    panel.set_ylim(bottom=0)
    panel.margins(x=0.01)
    panel.set_title(name, loc="left", fontsize="medium", pad=24.0)
    panel.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=len(table), frameon=False, fontsize="small")


FIGURES = (".png", ".pdf", ".svg")
MAX_SPEED_KMH = 600.0
CASE_KEYS = {
    "at_km": "target_location_m",
    "max_speed_kmh": "max_speed_kmh",
    "acceleration": "A_est1",
    "balise_m": "distance_since_balise_m",
}
"""Options of a scenario, and the keys of a case with the same meaning."""


def curves(
    case: GivenScenario,
    *,
    at_km: float | str | None = None,
    max_speed_kmh: float | None = None,
    acceleration: float | None = None,
    balise_m: float | None = None,
    deviation: bool = False,
    out: str | Path | None = None,
) -> dict[str, dict[str, Any]]:
    """Compute braking curves and supervision limits after SUBSET-026, 3.13, as ``train-ato curves`` does.

    Parameters
    ----------
    case
        JSON file of cases, or a scenario for its train and line.
    at_km
        End of authority on the line of a scenario [km], or a post as ``"84+500"``; default: last stop of the line,
        or its end.
    max_speed_kmh
        Maximum speed of the train of a scenario; default: highest limit of the line, 80 without limits.
    acceleration
        Estimated acceleration of the train of a scenario [m/s²]; default: 0.
    balise_m
        Distance since the last balise [m], for the errors of the odometry; default: exact odometry.
    deviation
        Add the largest deviation from the distances in the file of cases.
    out
        New figure (.png, .pdf, .svg).

    Returns
    -------
    dict
        By case: ``inputs``; ``curves`` by name, a list of speed [km/h] and distance before the target [m];
        ``release`` and ``deviation_m`` if there are any.

    Raises
    ------
    ValueError
        Bad input, in one line with the remedy.

    Examples
    --------
    >>> import train_ato as ta
    >>> (found,) = ta.curves("demo", at_km=3.5).values()
    >>> sorted(found["curves"])[:2], found["curves"]["EBD"][0]
    (['EBD', 'EBI'], [0.0, 0.0])
    """
    found, _ = curves_by_case(
        case, at_km=at_km, max_speed_kmh=max_speed_kmh, acceleration=acceleration, balise_m=balise_m,
        deviation=deviation, out=out,
    )  # fmt: skip
    return found


def curves_by_case(
    case: GivenScenario, *, deviation: bool = False, out: str | Path | None = None, dash: str = "", **given: Any
) -> tuple[dict[str, dict[str, Any]], bool]:
    """Return the curves by case, and False for a file of cases with names; ``dash`` precedes options in messages."""
    if out is not None:
        check_new_file(Path(out), FIGURES, f"{dash}out")
    from_file = isinstance(case, (str, Path)) and str(case).lower().endswith(".json")
    if from_file:
        result, bare = _of_cases(Path(str(case)), given, dash, deviation=deviation)
    elif deviation:
        raise ValueError(f"{dash}deviation: needs distances; name a JSON file of cases")
    else:
        result, bare = _of_scenario(case, given, dash), True
    (_, speed), (_, place) = display_unit("km/h"), display_unit("m")
    for entry in result.values():
        tables = entry["curves"].items()
        entry["curves"] = {curve: [[row[0] * speed, row[1] * place] for row in rows] for curve, rows in tables}
    if out is not None:
        draw_curves({name: entry["curves"] for name, entry in result.items()}, Path(out))
    return result, bare


def _of_cases(path: Path, given: Mapping[str, Any], dash: str, *, deviation: bool) -> tuple[dict[str, Any], bool]:
    """Return inputs and curves of every case of a file, and True for a file with one case without a name."""
    for option, key in CASE_KEYS.items():
        if given.get(option) is not None:
            raise ValueError(f"{option_name(option, dash)}: belongs to a scenario; write {key} in {path}")
    cases, bare = read_cases(path)
    if deviation and not any(case.has_distances for case in cases.values()):
        raise ValueError(f"{path}: curves: no distance for {dash}deviation; write [speed, distance] in place of speeds")
    found: dict[str, Any] = {}
    for name, case in cases.items():
        table = case_table(case, f"{path}: {name}")
        found[name] = {"inputs": case.inputs.model_dump(mode="json", exclude_unset=True), "curves": table}
        if (release := case.inputs.release(case.inputs.limits())) is not None:
            found[name]["release"] = release
        if deviation:
            found[name]["deviation_m"] = largest_deviations(case, table)
    return found, bare


def _of_scenario(case: GivenScenario, given: Mapping[str, Any], dash: str) -> dict[str, Any]:
    """Return brake model and curves of the train of a scenario on its line."""
    if isinstance(case, (str, Path)):
        _refuse_case_file(Path(case))
    choice = choose_scenario(case)
    scenario, path = choice.checked, choice.path
    consist = scenario_consist(scenario.plant.consist, path.parent)
    line = line_for(scenario_line(scenario.plant.line, path.parent), consist.categories, consist.rating)
    last = line.stops[-1].at if line.stops else line.end
    asked = given.get("at_km")
    try:
        at = last if asked is None else line.place_of(asked) if isinstance(asked, str) else 1e3 * asked
    except ValueError as error:
        raise ValueError(f"{option_name('at_km', dash)} = {error}") from None
    if not line.begin <= at <= line.end:
        bounds = f"km {line.begin / 1e3:g} to {line.end / 1e3:g}"
        raise ValueError(f"{option_name('at_km', dash)} {at / 1e3:g}: not on line '{line.name}'; give {bounds}")
    fastest = given.get("max_speed_kmh")
    if fastest is not None and not 0 < fastest <= MAX_SPEED_KMH:
        option = option_name("max_speed_kmh", dash)
        raise ValueError(f"{option} {fastest:g}: out of range; give a speed up to {MAX_SPEED_KMH:g} km/h")
    acceleration, distance = given.get("acceleration") or 0.0, given.get("balise_m")
    if not abs(acceleration) <= 5.0:
        raise ValueError(f"{dash}acceleration {acceleration:g}: out of range; give -5 to 5 m/s²")
    if distance is not None and not 0 <= distance <= 1e5:
        raise ValueError(f"{option_name('balise_m', dash)} {distance:g}: out of range; give 0 to 100000 m")
    shown = line.post_at(at) if line.chainage else f"{at / 1e3:g}"
    name = f"{consist.name} on {line.name}, end of authority at km {shown}"
    try:
        supervision = line_supervision(
            consist, line, scenario.plant, at, max_speed=None if fastest is None else fastest / KMH
        )
        end = supervision.targets[-1]
        top = round(supervision.train.max_speed * KMH / TABLE_STEP_KMH, 6)
        speeds = [TABLE_STEP_KMH * i for i in range(int(top) + 1)]
        names = [*LINE_CURVES, *(("SBD", "SBI1") if end.sbd is not None else ())]
        motion = MotionEstimate(acceleration)
        if distance is not None:
            motion = motion_estimate(supervision.train.max_speed, acceleration, distance)
        found = tabulate(end, motion, dict.fromkeys(names, speeds))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    if scenario.supervision.enabled is not False:
        print_assumption(
            f"{path}: curves of the train alone, with Kdry_rst = 1; the supervisor of a run has supervision.kdry = "
            f"{scenario.supervision.kdry:g} and a reaction time, and intervenes earlier"
        )
    return {name: {"inputs": _train_data(supervision), "curves": found}}


def _refuse_case_file(path: Path) -> None:
    """Raise ValueError for a file that is no scenario but a JSON object: a case file with another name."""
    if path.is_file():
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            begin = file.read(2**16)
        if begin.lstrip().startswith("{") and "schema" not in begin:
            raise ValueError(f"{path}: begins with '{{': cases need a name ending in .json; rename the file")


def _train_data(supervision: TrackSupervision) -> dict[str, Any]:
    """Return the brake model of the train as plain data."""
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
