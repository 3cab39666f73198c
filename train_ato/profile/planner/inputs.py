"""Lines and trains for the planner: by shipped name, or from a file in one of the supported formats."""

from __future__ import annotations

from plant_sim.consist import Consist
from plant_sim.library import consist_names, load_consist, load_line, named_train
from plant_sim.line import Line
from train_ato.profile.planner.settings import PlanSettings


def find_line(name: str) -> Line:
    """Return a line: by shipped name, or from a file of any supported format; with ``:reverse`` against its direction.

    Raises
    ------
    ValueError
        One line that names the file, the key, the value and the remedy.
    """
    return load_line(name)


def find_train(name: str, point_mass: bool = False) -> tuple[Consist, PlanSettings]:
    """Return a train and its default plan settings.

    A foreign file defines service deceleration and largest speed, perhaps an acceleration, and the efficiencies of
    traction and electric brake; jerk limit and force margin are then switched off, because these formats have none.
    As a point mass the train needs no length.

    Raises
    ------
    ValueError
        One line that names the file, the key, the value and the remedy.
    """
    if name in consist_names():
        return load_consist(name), PlanSettings()
    found = named_train(name, point_mass)
    if found.train is None:
        return found.consist, PlanSettings()
    settings = PlanSettings(
        acceleration=found.train.acceleration,
        deceleration=found.train.deceleration,
        jerk=None,
        force_margin=0.0,
        speed_max=found.train.speed_max,
        efficiency=found.train.traction_efficiency or 1.0,
        recovered=found.train.recovery_efficiency or 0.0,
    )
    return found.consist, settings
