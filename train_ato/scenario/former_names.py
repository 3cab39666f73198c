"""Former names of scenario keys and commands, read with a notice on stderr until version 0.3."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

READ_UNTIL = "0.3"
"""First version that refuses the former names."""
FORMER_KEYS: dict[str, str] = {
    "controller": "law",
    "controllers": "laws",
    "controller_changes": "law_changes",
    "swaps": "law_changes",
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
FORMER_ENTRY_KEYS: dict[str, str] = {"law_changes.controller": "law", "law_changes.controllers": "laws"}
"""The same for keys of the entries of a list."""
FORMER_COMMANDS: dict[str, str] = {"do": "inject", "set": "param", "drive": "driver"}
"""Present name of a command by its former name."""
FORMER_OPTIONS: dict[str, str] = {
    "--controller": "--law",
    "--controllers": "--laws",
    "--pace": "--rate",
    "--realtime": "--rate",
    "--from": "--from-km",
    "--to": "--to-km",
    "--speed-max-kmh": "--max-speed-kmh",
}
"""Present name of an option by its former name, in the commands that have the present one."""
FREE_RUNNING = "--realtime"
"""Former option that was also the present ``--no-lockstep``; the engine was in lockstep with it."""
FORMER_PARAMETERS: dict[tuple[str, str], str] = {("controller", "controller"): "law", ("plant", "pace"): "rate"}
"""Present name of a ROS parameter by its node and its former name."""
FORMER_ARGUMENTS: dict[str, str] = {"controller": "law", "controllers": "laws", "realtime": "rate"}
"""Present name of an argument of the Python interface by its former name."""
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


def present_options(parser: argparse.ArgumentParser, arguments: Sequence[str], program: str = "") -> list[str]:
    """Return arguments with former options under their present names; print one notice per option.

    Parameters
    ----------
    parser
        Parser of the arguments; only options that it lacks are replaced, by options that it has.
    arguments
        Command line after the name of the command.
    program
        Name in the notice; default: that of the parser.
    """
    known = {name for action in parser._actions for name in action.option_strings}
    found: list[str] = []
    for argument in arguments:
        name, equals, value = argument.partition("=")
        present = FORMER_OPTIONS.get(name, name)
        if name in known or present not in known:
            found.append(argument)
            continue
        free = name == FREE_RUNNING and "--engine" not in arguments
        print_notice(program or parser.prog, "option", name, f"{present}{' with --no-lockstep' if free else ''}")
        found += ["--no-lockstep"] if free else []
        found.append(f"{present}{equals}{value}")
    return found


def present_arguments(former: Mapping[str, Any], function: str, present: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a function of the Python interface, the former ones under their present names.

    Parameters
    ----------
    former
        Arguments that the function does not declare.
    function
        Name of the function, for notices and errors.
    present
        Declared arguments with their values.

    Raises
    ------
    TypeError
        For an argument that is neither present nor former.
    """
    found = dict(present)
    for name, value in former.items():
        now = FORMER_ARGUMENTS.get(name)
        if now is None or now not in present:
            raise TypeError(f"{function}() got an unexpected keyword argument '{name}'")
        print_notice(function, "argument", name, now)
        if value is not None:
            found[now] = value
            if name == "realtime":
                found["lockstep"] = False
    return found


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


@lru_cache(maxsize=4096)  # the scenarios of a study have their keys in common
def _present_name(path: str, key: Any) -> Any:
    for suffix in UNIT_SUFFIXES:
        if isinstance(key, str) and key.endswith(suffix):
            stem = key.removesuffix(suffix) if suffix else key
            if (present := FORMER_KEYS.get(path + stem) or FORMER_ENTRY_KEYS.get(path + stem)) is not None:
                return present + suffix
    return key
