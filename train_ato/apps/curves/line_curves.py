"""Table of the braking curves of a train on a line."""

from __future__ import annotations

from dataclasses import dataclass

from plant_sim.units import KMH
from train_ato.apps.curves.table import CurveTable, tabulate
from train_ato.supervision.limits import TargetLimits
from train_ato.supervision.odometry import EXACT_MOTION, MotionEstimate
from train_ato.supervision.track_supervision import TrackSupervision

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
