"""Braking curves of a train on a line: supervision data from a consist, a line and the plant."""

from __future__ import annotations

from dataclasses import dataclass

from plant_sim.consist import Consist
from plant_sim.line import Line
from plant_sim.plant_setup import PlantSetup
from train_ato.apps.curves.table import CurveTable, tabulate
from train_ato.supervision.fixed_values import KMH
from train_ato.supervision.limits import BrakingTarget, TargetLimits
from train_ato.supervision.odometry import EXACT_MOTION, MotionEstimate
from train_ato.supervision.plant_brake import plant_train
from train_ato.supervision.track_supervision import TrackSupervision

DEFAULT_MAX_SPEED = 80.0 / KMH
"""Maximum speed of a train on a line without speed limits [m/s]."""
TABLE_STEP_KMH = 5.0
"""Distance of the speeds of a table [km/h]."""
LINE_CURVES = ("EBD", "EBI", "SBI2", "Warning", "Permitted", "Indication")
"""Curves of the table of an end of authority; SBD and SBI1 are added if the service brake has a curve."""


def grades_permille(line: Line) -> list[tuple[float, float]]:
    """Return start [m] and grade [‰] of the pieces of a line; beyond its end it is level."""
    pieces = [(entry.at, 1e3 * entry.grade) for entry in line.grades if entry.at < line.end]
    return [*pieces, (line.end, 0.0)]


def highest_limit(line: Line) -> float:
    """Return the highest speed limit of a line [m/s]; the default without limits."""
    return max((entry.speed for entry in line.speed_limits), default=DEFAULT_MAX_SPEED)


def line_supervision(
    consist: Consist,
    line: Line,
    setup: PlantSetup,
    target: float,
    max_speed: float | None = None,
    kdry: float = 1.0,
) -> TrackSupervision:
    """Return the supervision of a train up to an end of authority on a line.

    Parameters
    ----------
    consist, line, setup
        Train, line, and plant with its actuators.
    target
        End of authority, which is also the supervised location [m].
    max_speed
        Maximum speed of the train [m/s]; default: the highest limit of the line.
    kdry
        Rolling-stock correction factor of the emergency brake.

    Raises
    ------
    ValueError
        If the train has no brake, or it is weaker than a gradient.
    """
    train = plant_train(consist, setup, highest_limit(line) if max_speed is None else max_speed, kdry)
    limits = [(entry.at, entry.speed) for entry in line.speed_limits]
    return TrackSupervision(train, grades_permille(line), limits, BrakingTarget(target, kind="EOA"))


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
    """Return the curves to the end of authority, every 5 km/h up to the maximum speed.

    Parameters
    ----------
    title
        Train and line.
    supervision
        Supervision with an end of authority.
    motion
        Acceleration and errors of the odometry.
    """
    end = supervision.targets[-1]
    top = round(supervision.train.max_speed * KMH / TABLE_STEP_KMH, 6)
    speeds = [TABLE_STEP_KMH * i for i in range(int(top) + 1)]
    names = [*LINE_CURVES, *(("SBD", "SBI1") if end.sbd is not None else ())]
    return LineCurves(title, supervision, tabulate(end, motion, dict.fromkeys(names, speeds)))
