"""Trains and lines by the name of a shipped file or by path; a reader of other formats loads with a file of a user."""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plant_sim.data_text import parse_yaml
from plant_sim.formats.fields import note_lost_keys
from plant_sim.input_error import build_model, close_match

if TYPE_CHECKING:
    from plant_sim.consist import Consist
    from plant_sim.formats.reading import ReadConsist, ReadLine
    from plant_sim.line import Line

EVERY = ", see `train-ato convert`"
"""Remedy of a note with a part of the lost keys."""


def _folder(kind: str) -> Path:
    return Path(str(files("plant_sim"))) / "data" / kind


def _names(kind: str) -> tuple[str, ...]:
    return tuple(sorted(path.stem for path in _folder(kind).glob("*.yaml")))


def consist_names() -> tuple[str, ...]:
    """Return the names of the shipped trains."""
    return _names("consists")


def line_names() -> tuple[str, ...]:
    """Return the names of the shipped lines."""
    return _names("lines")


def consist_path(name: str) -> Path:
    """Return the file of a train by name or path."""
    return _path("consists", "train", name)


def line_path(name: str) -> Path:
    """Return the file of a line by name or path."""
    return _path("lines", "line", name)


def _path(kind: str, what: str, name: str) -> Path:
    """Return the path of a shipped file or of a file of the user."""
    if name in _names(kind):
        return _folder(kind) / f"{name}.yaml"
    own = Path(name)
    if own.is_file():
        return own
    shipped = _names(kind)
    near = [file for file in map(own.with_suffix, (".yaml", ".yml")) if file.is_file()] if own.name else []
    hint = f"; did you mean the file '{near[0]}'?" if near else close_match(name, shipped)
    raise ValueError(f"{what} '{name}' is neither shipped nor a file; give a path or one of {', '.join(shipped)}{hint}")


def read_yaml(path: Path) -> Any:
    """Read a YAML file safely."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror}; check the path and its permissions") from None
    except UnicodeDecodeError:
        raise ValueError(f"{path}: not UTF-8 text; save it as UTF-8 YAML") from None
    try:
        return parse_yaml(text)
    except ValueError as error:
        raise ValueError(f"{path}: {error}; correct the YAML there") from None


def load_consist(name: str, *, point_mass: bool = False) -> Consist:
    """Return a train by name or path, from a file of any supported format; lost keys are noted on stderr.

    Parameters
    ----------
    name, point_mass
        See :func:`named_train`.
    """
    if name in consist_names():
        from plant_sim.consist import Consist

        path = consist_path(name)
        return build_model(Consist, read_yaml(path), str(path))
    found = named_train(name, point_mass=point_mass)
    note_lost_keys(name, found.format, found.left_out, EVERY)
    return found.consist


def split_name(name: str) -> tuple[str, str]:
    """Return a shipped name or file, and the selection in it with the colon before it.

    The name of a file may have colons: the longest one that exists is the file.
    """
    if Path(name).is_file():
        return name, ""
    for place in sorted((match.start() for match in re.finditer(":", name)), reverse=True):
        if Path(name[:place]).is_file():
            return name[:place], name[place:]
    stem, colon, selection = name.partition(":")
    return stem, colon + selection


def named_train(name: str, *, point_mass: bool = False) -> ReadConsist:
    """Return a train by name or path with its format and the keys that it does not carry.

    Parameters
    ----------
    name
        Shipped name or file; of a file with several trains with ``:NAME`` after it.
    point_mass
        Accept a train without a length.
    """
    from plant_sim.formats.reading import read_train

    stem, selection = split_name(name)
    return read_train(consist_path(stem), point_mass=point_mass, selection=selection.removeprefix(":"))


def named_line(name: str) -> ReadLine:
    """Return a line by name or path with its format and the keys that it does not carry.

    Parameters
    ----------
    name
        Shipped name or file. ``:FROM..TO`` after a network selects the path between two tracks or stations. ``:NAME``
        selects a path of a file with several paths. ``:reverse`` at the end gives the line for a train in the other
        direction.
    """
    from plant_sim.formats.reading import read_line
    from plant_sim.line import AGAINST

    stem, selection = split_name(name)
    against = selection.endswith(f":{AGAINST}")
    selection = selection.removesuffix(f":{AGAINST}").removeprefix(":")
    return read_line(line_path(stem), selection, against=against)


def load_line(name: str) -> Line:
    """Return a line by name or path, see :func:`named_line`; lost keys are noted on stderr."""
    if name in line_names():
        from plant_sim.line import Line

        path = line_path(name)
        return build_model(Line, read_yaml(path), str(path))
    found = named_line(name)
    note_lost_keys(name, found.format, found.left_out, EVERY)
    return found.line
