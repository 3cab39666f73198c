"""Distances of the braking curves of a case, before the target."""

from collections.abc import Callable
from dataclasses import dataclass

from plant_sim.units import KMH
from train_ato.studies.curves.case_file import CurveCase
from train_ato.supervision.limits import TargetLimits
from train_ato.supervision.odometry import EXACT_MOTION, MotionEstimate
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
    """Return the distances before the target for the speeds [km/h] of each curve.

    Raises
    ------
    ValueError
        If a curve does not exist at a speed.
    """
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


@dataclass(frozen=True)
class LineCurves:
    """Curves to the end of authority of a supervision, with the speed limits of the line.

    Attributes
    ----------
    title : str
        Train and line.
    supervision : TrackSupervision
        All targets.
    table : CurveTable
        Speeds [km/h] and distances before the end of authority [m].
    """

    title: str
    supervision: TrackSupervision
    table: CurveTable

    @property
    def end(self) -> TargetLimits:
        """Limits of the end of authority."""
        return self.supervision.targets[-1]


def line_curves(title: str, supervision: TrackSupervision, motion: MotionEstimate = EXACT_MOTION) -> LineCurves:
    """Return the curves to the end of authority, every 5 km/h up to the maximum speed."""
    end = supervision.targets[-1]
    top = round(supervision.train.max_speed * KMH / TABLE_STEP_KMH, 6)
    speeds = [TABLE_STEP_KMH * i for i in range(int(top) + 1)]
    names = [*LINE_CURVES, *(("SBD", "SBI1") if end.sbd is not None else ())]
    return LineCurves(title, supervision, tabulate(end, motion, dict.fromkeys(names, speeds)))
