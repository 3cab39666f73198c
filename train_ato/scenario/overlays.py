"""Changes of a raw scenario: overlays of variants and assignments of single keys."""

import copy
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from plant_sim.input_error import InputFaults
from plant_sim.library import split_name
from train_ato.program.arguments import parse_yaml_value
from train_ato.program.errors import InputError

FILE_KEYS = (
    ("profile", "file"), ("plant", "consist"), ("plant", "line"), ("model", "consist"), ("model", "line"),
    ("model", "learned"),
)  # fmt: skip
"""Keys with the name of a file in the folder of their scenario."""


def overlay(base: dict[str, Any], change: dict[str, Any]) -> dict[str, Any]:
    """Return a mapping with a change applied: mappings merge, ``null`` removes a key, other values replace."""
    result = dict(base)
    for key, value in change.items():
        if value is None:
            result.pop(key, None)
        elif isinstance(value, dict) and isinstance(result.get(key), dict):
            result[key] = overlay(result[key], value)
        else:
            result[key] = copy.deepcopy(value)
    return result


def with_absolute_files(data: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return a raw scenario, its variants included, for another folder: names of files in ``folder`` are absolute."""
    result = dict(data)
    for block, key in FILE_KEYS:
        name = result[block].get(key) if isinstance(result.get(block), dict) else None
        stem, selection = split_name(name) if isinstance(name, str) else ("", "")
        if stem and (folder / stem).is_file():
            result[block] = {**result[block], key: f"{(folder / stem).absolute()}{selection}"}
    variants = result.get("variants")
    if isinstance(variants, dict):
        result["variants"] = {
            name: with_absolute_files(change, folder) if isinstance(change, dict) else change
            for name, change in variants.items()
        }
    return result


def assign(data: dict[str, Any], text: str) -> None:
    """Apply one ``--set a.b=value`` to a raw scenario, the value written as YAML."""
    key, equals, value = text.partition("=")
    if not equals or not key:
        raise ValueError(f"--set {text}: not an assignment; write key.key=value, for example --set plant.lag=0.4")
    put(data, key, parse_yaml_value(value, f"--set {key}"), f"--set {text}")


def put(data: dict[str, Any], key: str, value: Any, option: str) -> None:
    """Set one key ``a.b.c`` of a raw scenario; messages begin with ``option``.

    An entry of a list has its number from 0 as key: ``interventions.0.at``.
    """
    keys = keys_of(key)
    place: Any = data
    for depth, part in enumerate(keys[:-1]):
        place = place.get(part) if isinstance(place, dict) else None
        if isinstance(place, list) and keys[depth + 1].isdigit():
            _put_entry(place, keys[depth + 1 :], value, option)
            return
    change: dict[str, Any] = value
    for part in reversed(keys):
        change = {part: change}
    target = data
    for _ in keys[1:]:
        part, change = next(iter(change.items()))
        target = target.setdefault(part, {})
        if not isinstance(target, dict):
            raise ValueError(f"{option}: '{part}' is a value, not a block of keys; correct the key")
    target.update(change)


def _put_entry(entries: list[Any], keys: list[str], value: Any, option: str) -> None:
    """Set a key of an entry of a list: its number, and the keys below it."""
    number = int(keys[0])
    if number >= len(entries):
        raise ValueError(f"{option}: the list has {len(entries)} entries, numbered from 0; correct the key")
    if len(keys) == 1:
        entries[number] = value
    elif isinstance(entries[number], dict):
        put(entries[number], ".".join(keys[1:]), value, option)
    else:
        raise ValueError(f"{option}: '{keys[0]}' is a value, not a block of keys; correct the key")


class RefusedScenario(InputFaults, InputError):
    """Refusal of a scenario; ``problem`` is the message without the file or the changes that it names first."""

    def __init__(self, message: str, problem: str = "") -> None:
        super().__init__(message)
        self.problem = problem or message


def caused_by(error: ValueError, file: Path, changes: Sequence[tuple[str, str]]) -> RefusedScenario:
    """Return the refusal of a scenario with the changes that caused it in place of its file.

    Parameters
    ----------
    file
        File of the scenario without the changes.
    changes
        Key and spelling of each change, as ``("seed", "--seed -1")``.

    Examples
    --------
    >>> caused_by(ValueError("a.yaml: seed = -1: too small"), Path("a.yaml"), [("seed", "--seed -1")])
    RefusedScenario('--seed -1: seed = -1: too small')
    """
    found = [_line_caused_by(line, file, changes) for line in str(error).split("\n")]
    return RefusedScenario(*("\n".join(dict.fromkeys(texts)) for texts in zip(*found, strict=True)))


def _line_caused_by(message: str, file: Path, changes: Sequence[tuple[str, str]]) -> tuple[str, str]:
    """Return a fault with the changes that caused it in place of its file, and without both."""
    problem = message.removeprefix(f"{file}: ")
    said = re.split(r"; | \(known", problem)[0].replace(": ", ".")  # `plant: jumps lists ...` names the key plant.jumps
    # `line: unknown key` is of a change of line.speed_limit, and `unknown law 'x'` of one of laws.x.gain
    unknown = re.sub(r"^unknown (\w+) '([^']+)'.*", r"\1s.\2.", said.removesuffix("unknown key"))
    found = [
        (key, spelling)
        for key, spelling in changes
        if re.search(rf"(?<![\w.]){re.escape(key)}(?!\w)", said)
        or _names_value(problem, _value_of(spelling))
        or (unknown != said and key.startswith(unknown))
    ]
    if not found and file.parent.name == "shipped":  # the file alone is right
        found = list(changes)
    if not found or problem == message:
        return message, problem
    spelled = dict.fromkeys(text if len(text) <= 100 else f"{text[:100]}..." for _, text in found)
    value = _value_of(found[-1][1])
    short = problem.removeprefix(f"{value}: ") if found[-1][1].endswith(value) else problem
    return f"{', '.join(spelled)}: {short}", problem


def _value_of(spelling: str) -> str:
    """Return the value of a change, of a block of one key the value of this key."""
    value = spelling.partition("=" if "=" in spelling else " ")[2]
    return value.strip("{} ").rpartition(": ")[2].strip("'\"")


def _names_value(problem: str, value: str) -> bool:
    """Return True if a message has a value: a file, or a name in quotes."""
    return bool(value) and (f"'{value}'" in problem or (("." in value or "/" in value) and value in problem))


def keys_of(key: str) -> list[str]:
    """Return the keys of ``a.b.c``; a law name ``package.module:Class`` with its dots is one key.

    Examples
    --------
    >>> keys_of("laws.my_package.my_law:MyLaw.gain")
    ['laws', 'my_package.my_law:MyLaw', 'gain']
    """
    block, _, rest = key.partition(".")
    if ":" not in rest:
        return key.split(".")
    name, dot, parameter = rest.rpartition(".")
    return [block, name, parameter] if dot else [block, rest]
