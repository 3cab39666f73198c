"""Lines and trains from a file of any supported format, recognised by its content."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from plant_sim.consist import Consist
from plant_sim.formats import osrd, railtoolkit, ttobench, ttobench_train
from plant_sim.formats.fields import read_data
from plant_sim.formats.not_read import refuse_foreign
from plant_sim.formats.notes import keys_not_carried, print_assumption
from plant_sim.formats.railml import is_railml, railml_line, refuse_railml_train
from plant_sim.formats.read_train import ReadTrain
from plant_sim.input_error import build_model
from plant_sim.line import Line
from plant_sim.line_direction import reversed_line
from plant_sim.number_text import number_text

FAST = 100.0
"""Speed above which a limit is probably in km/h [m/s]."""


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
    """Return the line of a file without a network."""
    if railtoolkit.is_railtoolkit(data, "line"):
        left = keys_not_carried(data, railtoolkit.CARRIED_PATH)
        return ReadLine(railtoolkit.railtoolkit_line(data, place, selection), "railtoolkit", left)
    if selection:
        raise ValueError(f"{place}: selection '{selection}': the file has one line; remove it")
    if ttobench.is_ttobench(data):
        left = keys_not_carried(data, ttobench.CARRIED_LINE)
        return ReadLine(ttobench.ttobench_line(data, place), "TTOBench", left)
    if not str(data.get("schema", "")).startswith("train_ato/line/"):
        refuse_foreign(data, place, "line", _kinds(data))
    line = build_model(Line, data, place)
    _note_traps(line, place)
    return ReadLine(line, "train_ato")


def read_train(path: Path, point_mass: bool = False, selection: str = "") -> ReadConsist:
    """Return the train of a file; as a point mass it needs no length.

    Parameters
    ----------
    selection
        Name or identifier of one of several trains.

    Raises
    ------
    ValueError
        One line with file, key, value and remedy.
    """
    place = str(path)
    if is_railml(path):
        refuse_railml_train(path)
    data = read_data(path)
    if railtoolkit.is_railtoolkit(data, "train"):
        train = railtoolkit.train_from(data, place, selection)
        return ReadConsist(train.consist, "railtoolkit", train, keys_not_carried(data, railtoolkit.CARRIED_TRAIN))
    if selection:
        raise ValueError(f"{place}: selection '{selection}': the file has one train; remove it")
    if ttobench_train.is_ttobench_train(data):
        train = ttobench_train.ttobench_train(data, place, point_mass)
        return ReadConsist(train.consist, "TTOBench", train, keys_not_carried(data, ttobench_train.CARRIED_TRAIN))
    if not str(data.get("schema", "")).startswith("train_ato/consist/"):
        refuse_foreign(data, place, "train", _kinds(data))
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


def _kinds(data: dict[str, Any]) -> dict[str, str]:
    """Return the format of a file, as ``train`` or ``line``; empty for an unknown one."""
    found = {}
    for what, own, bench in (
        ("train", "consist", ttobench_train.is_ttobench_train), ("line", "line", ttobench.is_ttobench),
    ):  # fmt: skip
        if str(data.get("schema", "")).startswith(f"train_ato/{own}/"):
            found[what] = "train_ato"
        elif railtoolkit.is_railtoolkit(data, what):
            found[what] = "railtoolkit"
        elif bench(data):
            found[what] = "TTOBench"
    return found | ({"line": "OSRD"} if osrd.is_osrd(data) else {})
