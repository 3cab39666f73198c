"""Lines and trains from a file of any supported format, recognised by its content."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from plant_sim.consist import Consist
from plant_sim.formats import osrd, railtoolkit, ttobench, ttobench_train
from plant_sim.formats.fields import read_data
from plant_sim.formats.notes import keys_not_carried, print_assumption
from plant_sim.formats.railml import is_railml, railml_line
from plant_sim.formats.read_train import ReadTrain
from plant_sim.input_error import build_model
from plant_sim.line import Line
from plant_sim.line_direction import reversed_line
from plant_sim.number_text import number_text

LINE_FORMATS = "train_ato YAML, railtoolkit YAML, TTOBench JSON, OSRD JSON, railML 3"
FAST = 100.0
"""Speed above which a limit is probably in km/h [m/s]."""
TRAIN_FORMATS = "train_ato YAML, railtoolkit YAML, TTOBench JSON"


@dataclass(frozen=True, slots=True)
class ReadLine:
    """Line of a file, its format, and the keys of the file that the line does not carry."""

    line: Line
    format: str
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ReadConsist:
    """Train of a file with its limits for a plan; None without a foreign format."""

    consist: Consist
    format: str
    train: ReadTrain | None = None
    left_out: tuple[str, ...] = ()


def read_line(path: Path, selection: str = "", against: bool = False) -> ReadLine:
    """Return the line of a file; of a network the path of a selection ``FROM..TO``.

    Parameters
    ----------
    against
        True for the line of a train in the other direction; a path through a network is read anew, because limits may
        differ by direction, another line is mirrored.

    Raises
    ------
    ValueError
        One line with file, key, value and remedy.
    """
    place = str(path)
    if is_railml(path):
        return ReadLine(*railml_line(path, selection, against))
    data = read_data(path)
    if osrd.is_osrd(data):
        line = osrd.osrd_line(data, place, selection, against)
        return ReadLine(line, "OSRD", keys_not_carried(data, osrd.CARRIED_INFRA))
    found = _one_line(data, place, selection)
    return replace(found, line=reversed_line(found.line)) if against else found


def _one_line(data: dict[str, Any], place: str, selection: str) -> ReadLine:
    """Return the line of a file of one line."""
    if selection:
        raise ValueError(f"{place}: selection '{selection}': the file has one line; remove it")
    if railtoolkit.is_railtoolkit(data, "line"):
        left = keys_not_carried(data, railtoolkit.CARRIED_PATH)
        return ReadLine(railtoolkit.railtoolkit_line(data, place), "railtoolkit", left)
    if ttobench.is_ttobench(data):
        left = keys_not_carried(data, ttobench.CARRIED_LINE)
        return ReadLine(ttobench.ttobench_line(data, place), "TTOBench", left)
    _refuse_foreign(data, place, "line", LINE_FORMATS)
    line = build_model(Line, data, place)
    _note_traps(line, place)
    return ReadLine(line, "train_ato")


def read_train(path: Path, point_mass: bool = False) -> ReadConsist:
    """Return the train of a file; as a point mass it needs no length.

    Raises
    ------
    ValueError
        One line with file, key, value and remedy.
    """
    data, place = read_data(path), str(path)
    if railtoolkit.is_railtoolkit(data, "train"):
        train = railtoolkit.train_from(data, place)
        return ReadConsist(train.consist, "railtoolkit", train, keys_not_carried(data, railtoolkit.CARRIED_TRAIN))
    if ttobench_train.is_ttobench_train(data):
        train = ttobench_train.ttobench_train(data, place, point_mass)
        return ReadConsist(train.consist, "TTOBench", train, keys_not_carried(data, ttobench_train.CARRIED_TRAIN))
    _refuse_foreign(data, place, "consist", TRAIN_FORMATS)
    return ReadConsist(build_model(Consist, data, place), "train_ato")


def holds_train(path: Path) -> bool:
    """Return True if a file has a train, False if it has a line or neither."""
    if is_railml(path):
        return False
    data = read_data(path)
    own = str(data.get("schema", "")).startswith("train_ato/consist/")
    return own or railtoolkit.is_railtoolkit(data, "train") or ttobench_train.is_ttobench_train(data)


def _note_traps(line: Line, place: str) -> None:
    """Name speeds that are probably in km/h, and entries beyond the end of the line."""
    speeds = [(f"speed_limits[{k}]", entry.speed) for k, entry in enumerate(line.speed_limits)]
    speeds += [(f"temporary_restrictions[{k}]", entry.speed) for k, entry in enumerate(line.temporary_restrictions)]
    for key, speed in speeds:
        if speed > FAST:
            print_assumption(
                f"{place}: {key}: speed {number_text(speed)} is {number_text(3.6 * speed)} km/h; write speed_kmh for "
                "km/h"
            )
    if line.speed_limits and line.speed_limits[0].at > line.begin:
        print_assumption(
            f"{place}: speed_limits: none from {number_text(line.begin)} to {number_text(line.speed_limits[0].at)} m; "
            "only the train limits the speed there"
        )
    for name in ("grades", "speed_limits", "stops", "curves", "tunnels", "temporary_restrictions", "neutral_sections",
                 "power_limits", "adhesion"):  # fmt: skip
        places = [float(row.begin if hasattr(row, "begin") else row.at) for row in getattr(line, name)]
        beyond = [number for number, at in enumerate(places) if at > line.end]
        if beyond:
            more = f" (and {len(beyond) - 1} more)" if len(beyond) > 1 else ""
            print_assumption(
                f"{place}: {name}[{beyond[0]}]: {number_text(places[beyond[0]])} m lies beyond the end of the line, "
                f"{number_text(line.end)} m{more}"
            )


def _refuse_foreign(data: dict[str, Any], place: str, what: str, formats: str) -> None:
    schema = str(data.get("schema", ""))
    other = "train" if what == "line" else "line"
    of_other = {"train": ttobench_train.is_ttobench_train, "line": ttobench.is_ttobench}[other]
    known = "railtoolkit" if railtoolkit.is_railtoolkit(data, other) else "TTOBench" if of_other(data) else ""
    if "consist" in schema and what == "line":
        known = "train_ato"
    if known:
        raise ValueError(f"{place}: holds a {other} ({known}), no {what if what == 'line' else 'train'}; exchange them")
    if not schema.startswith(f"train_ato/{what}/"):
        raise ValueError(
            f"{place}: schema = '{schema[:60]}': no supported {what} format ({formats}); "
            f"begin a train_ato file with 'schema: train_ato/{what}/1'"
        )
