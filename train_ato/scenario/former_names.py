"""Former names of scenario keys and commands, read with a notice on stderr until version 0.3."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

READ_UNTIL = "0.3"
"""First version that refuses the former names."""
FORMER_KEYS: dict[str, str] = {
    "swaps": "controller_changes",
    "score": "evaluation",
    "profile.then": "append",
    "plant.unlimited": "ideal_actuator",
    "plant.holding": "holding_brake_ratio",
    "brake.trigger.above": "min_speed",
    "brake.trigger.ahead": "lookahead",
    "brake.trigger.steeper": "grade_below",
    "brake.trigger.longer": "min_length",
    "brake.trigger.drop": "release_drop",
    "brake.trigger.margin": "release_margin",
    "replan.sitting": "confirmation_time",
}
"""Present name of a key by its former path; parent keys are written in their present names."""
FORMER_COMMANDS: dict[str, str] = {"do": "inject", "set": "param", "drive": "driver"}
"""Present name of a command by its former name."""
UNIT_SUFFIXES = ("", "_km", "_kmh", "_min", "_mm", "_ms", "_percent", "_permille")
"""Unit suffixes that the keys of the table accept; a suffix is kept."""

_printed: set[str] = set()


def replace_former_keys(data: Mapping[str, Any], source: str | Path, quiet: bool = False) -> dict[str, Any]:
    """Return a raw scenario with every former key replaced, also inside ``variants``; print one notice per key.

    Parameters
    ----------
    data
        Scenario, overlay or part of one, as read from YAML.
    source
        File or option named in the notice.
    quiet
        Print no notice: the scenario of a recorded run is not edited.

    Raises
    ------
    ValueError
        If a block has a key under its former and its present name.
    """
    present: dict[str, Any] = _replace(data, "", source, quiet)
    if isinstance(present.get("variants"), dict):
        present["variants"] = {
            name: _replace(change, "", source, quiet) for name, change in present["variants"].items()
        }
    return present


def print_notice(source: str | Path, kind: str, former: str, present: str) -> None:
    """Print the notice of a former name on stderr, once per process."""
    notice = f"{source}: {kind} '{former}' is now '{present}'; the old name is read until version {READ_UNTIL}"
    if notice not in _printed:
        _printed.add(notice)
        sys.stderr.write(notice + "\n")


def _replace(block: Any, path: str, source: str | Path, quiet: bool) -> Any:
    if isinstance(block, list):
        return [_replace(entry, path, source, quiet) for entry in block]
    if not isinstance(block, Mapping):
        return block
    result: dict[Any, Any] = {}
    for key, value in block.items():
        name = _present_name(path, key)
        if name != key:
            if name in block:
                raise ValueError(f"{source}: {path}{key}: is the former name of '{name}'; keep '{name}' only")
            if not quiet:
                print_notice(source, "key", key, name)
        result[name] = _replace(value, f"{path}{name}.", source, quiet)
    return result


def _present_name(path: str, key: Any) -> Any:
    for suffix in UNIT_SUFFIXES:
        if isinstance(key, str) and key.endswith(suffix):
            stem = key.removesuffix(suffix) if suffix else key
            if path + stem in FORMER_KEYS:
                return FORMER_KEYS[path + stem] + suffix
    return key
