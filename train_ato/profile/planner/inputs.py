"""Lines and trains by name or from a file in any of the formats that are read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from plant_sim.consist import Consist
from plant_sim.library import check, consist_names, line_names, load_consist, load_line
from plant_sim.line import Line
from train_ato.plan.settings import PlanSettings
from train_ato.readers import railtoolkit, ttobench
from train_ato.readers.fields import read_data

__all__ = ["find_line", "find_train"]

FORMATS = "train_ato YAML, railtoolkit YAML, TTOBench JSON"


def find_line(name: str) -> Line:
    """Return a line: a shipped one by name, or a file in our own, the railtoolkit or the TTOBench format.

    Raises
    ------
    ValueError
        One line that names the file, the key, the value and the remedy.
    """
    if name in line_names() or not Path(name).is_file():
        return load_line(name)
    data = read_data(Path(name))
    if railtoolkit.is_railtoolkit(data, "line"):
        return railtoolkit.line_from(data, name)
    if ttobench.is_ttobench(data):
        return ttobench.line_from(data, name)
    _refuse_foreign(data, name, "line")
    return check(Line, data, name)


def find_train(name: str) -> tuple[Consist, PlanSettings]:
    """Return a train and the settings it is planned with unless others are asked for.

    Trains of the railtoolkit schema bring their braking deceleration and speed; that schema knows no jerk, no other
    limit on the acceleration and no margin.

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
    return check(Consist, data, name), PlanSettings()


def _refuse_foreign(data: dict[str, Any], name: str, what: str) -> None:
    schema = str(data.get("schema", ""))
    if not schema.startswith(f"train_ato/{what}/"):
        raise ValueError(
            f"{name}: schema = '{schema[:60]}': not a {what} in a format that is read ({FORMATS}); "
            f"our own files begin with 'schema: train_ato/{what}/1'"
        )
