"""Conversion of a failed validation into one line for each fault, with file, key, value and remedy."""

from __future__ import annotations

import re
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from datetime import date
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, TypeVar, get_args

from plant_sim.units import number_text

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

    from plant_sim.si_model import SiModel


_Model = TypeVar("_Model", bound="SiModel")
_NO_BLOCK = "is no block of keys; write key: value below it"
_PLAIN = {
    "model_type": _NO_BLOCK,
    "model_attributes_type": _NO_BLOCK,
    "dict_type": _NO_BLOCK,
    "tuple_type": "is no list; write [first, second]",
    "list_type": "is no list; write [first, second]",
    "too_short": "needs at least {min_length} entries; add them",
    "too_long": "has {actual_length} entries, at most {max_length}; remove some",
    "string_type": "is no text; write it in quotes",
    "bool_type": "is neither true nor false; write one of them",
    "bool_parsing": "is neither true nor false; write one of them",
    "invalid_key": "a key is no text; write it in quotes",
    "no_scalar": "is no single value; write a number, a text, true or false",
}
"""Errors of pydantic that name classes or patterns, in plain words."""
_ORDER = {"extra_forbidden": 0, "finite_number": 0, "string_type": 2}
"""Order of the errors of one place: infinity is called no wrong truth value, a block that is wrong no missing text."""
MAX_FAULTS = 20
"""Largest number of faults of one input in a message."""
_SHORT = reprlib.Repr()
_SHORT.maxother = _SHORT.maxstring = 60


class InputFaults(ValueError):
    """Faults of one input.

    Parameters
    ----------
    message
        One line for each fault: file, place, problem; fix.

    Examples
    --------
    >>> InputFaults.of(["a.yaml: mass: this key is missing; add it"]).lines
    ('a.yaml: mass: this key is missing; add it',)
    """

    def __init__(self, message: str) -> None:
        super().__init__(message)
        self.lines = tuple(message.split("\n"))

    @classmethod
    def of(cls, faults: Sequence[str], source: str | Path = "") -> InputFaults:
        """Return the faults of one source, at most ``MAX_FAULTS`` of them and the number of the others."""
        lines = [" ".join(line.split("\n")) for line in faults[:MAX_FAULTS]]
        if len(faults) > MAX_FAULTS:
            lines.append(f"{source}: {len(faults) - MAX_FAULTS} more faults; correct these first")
        return cls("\n".join(lines))


def close_match(name: str, known: Iterable[str]) -> str:
    """Return the hint ``; did you mean '...'?`` with the nearest known name; empty if none is near.

    Of near names, one that only adds a unit comes first: ``n_per_kn`` is ``n_per_kn_kmh``, not ``n_per_kg``.
    Capitals do not count, kph is km/h; if no name is near, one that contains the word is taken.
    """
    import difflib

    word, names = re.sub("km?ph", "kmh", str(name).lower()), {str(entry).lower(): str(entry) for entry in known}
    near = difflib.get_close_matches(word, names, n=3, cutoff=0.6)
    near.sort(key=lambda match: not match.startswith(f"{word}_"))
    near = near or sorted((entry for entry in names if word in entry and len(word) > 2), key=len)
    return f"; did you mean '{names[near[0]]}'?" if near else ""


def one_of(count: int) -> str:
    """Return the remedy for a wrong number of one of ``count`` parts, counted from 0."""
    if count < 1:
        return "there is none; remove it"
    return "give 0, the only one" if count == 1 else f"give 0 ... {count - 1}"


def kind_of(value: Any) -> str:
    """Return the kind of a value of a YAML or JSON file, for messages.

    Examples
    --------
    >>> kind_of([1]), kind_of(None), kind_of(2.5)
    ('a list', 'nothing', 'one number')
    """
    for types, kind in ((bool, "true or false"), ((int, float), "one number"), (str, "one text"), (list, "a list")):
        if isinstance(value, types):
            return kind
    return "nothing" if value is None else "no keys and values"


def build_model(model: type[_Model], raw: Any, where: str) -> _Model:
    """Return a model made from plain data.

    Raises
    ------
    InputFaults
        One line for each fault, with file, key, value and remedy.
    """
    from pydantic import ValidationError

    if not isinstance(raw, dict):
        raise ValueError(f"{where}: holds {kind_of(raw)} in place of keys and values; write key: value")
    try:
        return model.model_validate(raw)
    except ValidationError as error:
        raise explain(error, where, model, raw) from None


def explain(error: ValidationError, source: str | Path, model: type[BaseModel], raw: Any = None) -> InputFaults:
    """Return one line for each fault of a validation, unknown keys first.

    Parameters
    ----------
    error
        Error of pydantic.
    source
        File of the data.
    model
        Model of the data; its keys are candidates for a misspelt key.
    raw
        The data, for keys and values in the unit that they are written in.
    """
    found: dict[tuple[str, ...], str] = {}
    of_place: dict[tuple[Any, ...], set[str]] = {}
    for entry in error.errors():
        of_place.setdefault(entry["loc"][:-1], set()).add(entry["type"])
    for entry in sorted(error.errors(), key=lambda entry: _ORDER.get(entry["type"], 1)):
        keys, models = _walk(model, entry["loc"])
        if entry["type"] == "bool_type" and {"float_type", "string_type"} <= of_place[entry["loc"][:-1]]:
            entry["type"] = "no_scalar"
        found.setdefault(tuple(keys), _fault(*_as_written(entry, keys, models, raw), source, models))
    # A value that fits no type of a union has an error for each type; those with longer keys are nearer to the cause.
    whole = {keys[:depth] for keys in found for depth in range(1, len(keys))}
    return InputFaults.of([line for keys, line in found.items() if keys not in whole], source)


_BOUNDS = {"ge": "greater than or equal to", "gt": "greater than", "le": "less than or equal to", "lt": "less than"}


def _as_written(
    entry: Mapping[str, Any], keys: list[str], models: set[type[BaseModel]], raw: Any
) -> tuple[Mapping[str, Any], list[str]]:
    """Return an error with value and bound in the unit of the data, and the keys of its place as they are there."""
    from plant_sim.si_model import SiModel

    last = max((k for k, key in enumerate(keys) if not key.isdigit()), default=0)
    block = _below(raw, keys[:last])
    if not keys or not isinstance(block, dict) or keys[last] in block:
        return entry, keys
    for owner in models:
        for key, (name, divisor) in owner.suffixed_keys().items() if issubclass(owner, SiModel) else ():
            if name == keys[last] and key in block:
                ctx = entry.get("ctx", {})
                bound = next(((words, ctx[kind]) for kind, words in _BOUNDS.items() if kind in ctx), None)
                text = f"input should be {bound[0]} {number_text(bound[1] * divisor)}" if bound else entry["msg"]
                value = _below(block[key], keys[last + 1 :])
                return {**entry, "input": value, "msg": text}, [*keys[:last], key, *keys[last + 1 :]]
    return entry, keys


def _below(data: Any, keys: Sequence[str]) -> Any:
    """Return the value at a place of plain data; None where they have another form."""
    for key in keys:
        if isinstance(data, (list, tuple)) and key.isdigit() and int(key) < len(data):
            data = data[int(key)]
        else:
            data = data.get(key) if isinstance(data, dict) else None
    return data


def _fault(first: Mapping[str, Any], keys: Sequence[str], source: str | Path, models: set[type[BaseModel]]) -> str:
    """Return one error of pydantic as a line; ``models`` have the last key of its place."""
    place = ".".join(keys)
    given = first.get("input")
    value = _SHORT.repr(given)
    if not isinstance(given, (str, int, float, list, tuple, dict, date, NoneType)):
        text = "is an object of Python; write a text or a number, for a class module:Class as text"
    elif first["type"] == "extra_forbidden":
        known = _keys_of(models)
        text = f"unknown key{close_match(str(first['loc'][-1]), known)}"
        if known and "; " not in text:
            text += f" (known: {', '.join(sorted(known))})"
        text += "" if "; " in text else "; correct or remove it"
    elif first["type"] == "missing":
        text, value = "this key is missing; add it", ""
    elif first["type"] == "union_tag_not_found":
        text = f"{first['ctx']['discriminator']} is missing; add it"
    elif first["type"] == "union_tag_invalid":
        key, kinds = (first["ctx"][name].replace("'", "") for name in ("discriminator", "expected_tags"))
        place, value = f"{place}.{key}", repr(first["ctx"]["tag"])
        text = f"is none of {kinds}{close_match(first['ctx']['tag'], kinds.split(', '))}"
    elif first["type"] == "string_pattern_mismatch":
        text = _signs(first["ctx"]["pattern"])
    elif first["type"] in _PLAIN:
        text = _PLAIN[first["type"]].format(**first.get("ctx", {}))
    else:
        text = first["msg"].removeprefix("Value error, ")
        text = text[0].lower() + text[1:]
        text += "" if "; " in text or first["type"] == "value_error" else "; correct it"
    shown = f" = {value}" if value and first["type"] != "value_error" and first["type"] != "extra_forbidden" else ""
    return f"{source}: {place}{shown}: {text}" if place else f"{source}: {text}"


def _signs(pattern: str) -> str:
    """Return in words the signs that the pattern of a name permits.

    Examples
    --------
    >>> _signs("^[A-Za-z][A-Za-z0-9_-]{0,59}$")
    'use letters, digits, _ and - only, at most 60, a letter first'
    """
    form = re.fullmatch(r"\^\[(.+)\]\[A-Za-z0-9(.+)\]\{0,(\d+)\}\$", pattern)
    assert form is not None, f"a name of another form: {pattern}"
    *signs, last = ["letters", "digits", *list(str(form[2]))]
    first = {"A-Za-z": "a letter", "A-Za-z0-9_": "a letter, a digit or _"}[form[1]]
    return f"use {', '.join(signs)} and {last} only, at most {int(form[3]) + 1}, {first} first"


def _branch_of_union(part: Any) -> bool:
    """Return True if a part of the location is the name of a type in a union instead of a key of the file."""
    return isinstance(part, str) and (
        part.removeprefix("constrained-") in ("float", "int", "str", "bool") or "[" in part
    )


def _walk(model: type[BaseModel], path: tuple[int | str, ...]) -> tuple[list[str], set[type[BaseModel]]]:
    """Return the keys of the file on a path of pydantic, and the models that the last key belongs to.

    The path has also the name of the type in a union, or the value of its discriminator, for example ``kill``.
    """
    from plant_sim.si_model import blocks_of

    keys: list[str] = []
    owners = current = {model}
    for part in path:
        below = {
            found
            for entry in current
            if str(part) in entry.model_fields
            for found in blocks_of(entry.model_fields[str(part)].annotation)
        }
        fields = {entry: entry.model_fields.values() for entry in current}  # a discriminator has one value only
        chosen = {entry for entry in current if any(get_args(field.annotation) == (part,) for field in fields[entry])}
        if chosen and not below:
            current = chosen
        elif not _branch_of_union(part):
            keys.append(str(part))
            owners, current = current, below or current
    return keys, owners


def _keys_of(models: set[type[BaseModel]]) -> set[str]:
    """Return the keys of models, including those with unit suffixes."""
    from plant_sim.si_model import SiModel

    keys: set[str] = set()
    for entry in models:
        keys |= {field.alias or name for name, field in entry.model_fields.items()}
        if issubclass(entry, SiModel):
            keys |= set(entry.suffixed_keys())
    return keys
