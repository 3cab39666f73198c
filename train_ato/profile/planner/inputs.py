"""Lines and trains for the planner: by shipped name, or from a file in one of the supported formats."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from plant_sim.consist import Consist
from plant_sim.formats import railtoolkit, ttobench
from plant_sim.formats.fields import read_data
from plant_sim.library import build_model, consist_names, line_names, load_consist, load_line
from plant_sim.line import Line
from train_ato.profile.planner.settings import PlanSettings

FORMATS = "train_ato YAML, railtoolkit YAML, TTOBench JSON"


def find_line(name: str) -> Line:
    """Return a line: by shipped name, or from a train_ato, railtoolkit or TTOBench file.

    Raises
    ------
    ValueError
        One line that names the file, the key, the value and the remedy.
    """
    if name in line_names() or not Path(name).is_file():
        return load_line(name)
    data = read_data(Path(name))
    if railtoolkit.is_railtoolkit(data, "line"):
        return railtoolkit.railtoolkit_line(data, name)
    if ttobench.is_ttobench(data):
        return ttobench.ttobench_line(data, name)
    _refuse_foreign(data, name, "line")
    return build_model(Line, data, name)


def find_train(name: str) -> tuple[Consist, PlanSettings]:
    """Return a train and its default plan settings.

    A railtoolkit file defines braking deceleration and speed; jerk limit, acceleration limit and force margin are then
    switched off, because that schema has none.

    Raises
    ------
    ValueError
        One line that names the file, the key, the value and the remedy.
    """
    if name in consist_names() or not Path(name).is_file():
        return load_consist(name), PlanSettings()
    data = read_data(Path(name))
    if railtoolkit.is_railtoolkit(data, "train"):
        train = railtoolkit.train_from(data, name)
        settings = PlanSettings(
            acceleration=None, deceleration=train.deceleration, jerk=None, force_margin=0.0, speed_max=train.speed_max
        )
        return train.consist, settings
    _refuse_foreign(data, name, "consist")
    return build_model(Consist, data, name), PlanSettings()


def _refuse_foreign(data: dict[str, Any], name: str, what: str) -> None:
    schema = str(data.get("schema", ""))
    if not schema.startswith(f"train_ato/{what}/"):
        raise ValueError(
            f"{name}: schema = '{schema[:60]}': no supported {what} format ({FORMATS}); "
            f"begin a train_ato file with 'schema: train_ato/{what}/1'"
        )
