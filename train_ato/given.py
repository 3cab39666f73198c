"""What is given on a command line, checked before anything runs: values written as YAML, files to be written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from plant_sim.library import StrictLoader


def given_value(text: str, option: str) -> Any:
    """Return a value written as YAML: ``0.4``, ``1e-3``, ``true``, ``smc``.

    Raises
    ------
    ValueError
        If it is no YAML; the message begins with ``option``.
    """
    try:
        return yaml.load(text, Loader=StrictLoader)
    except (yaml.YAMLError, RecursionError):
        raise ValueError(f"{option}: '{text[:60]}' is not valid YAML") from None


def check_new_file(path: Path, endings: Sequence[str], option: str = "--out") -> None:
    """Refuse a file to be written that is there already, ends wrongly or cannot be made.

    Raises
    ------
    ValueError
        One line that names the option, the file and the remedy.
    """
    if path.suffix.lower() not in endings:
        raise ValueError(f"{option} {path}: end it in {', '.join(endings)}")
    if path.exists():
        raise ValueError(f"{option} {path}: exists already; name a file that does not")
    if not path.parent.is_dir():
        raise ValueError(f"{option} {path}: folder '{path.parent}' does not exist; make it or choose another")
    try:
        path.open("xb").close()
        path.unlink()
    except OSError as error:
        raise ValueError(f"{option} {path}: cannot be written ({error.strerror}); choose another place") from None
