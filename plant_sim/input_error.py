"""Conversion of a failed validation into one line with file, key, value and remedy."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from plant_sim.units import SiModel

_SHORT = reprlib.Repr()
_SHORT.maxother = _SHORT.maxstring = 60


def close_match(name: str, known: Iterable[str]) -> str:
    """Return the hint ``; did you mean '...'?`` with the nearest known name; empty if none is near."""
    matches = difflib.get_close_matches(str(name), [str(entry) for entry in known], n=1, cutoff=0.6)
    return f"; did you mean '{matches[0]}'?" if matches else ""


def explain(error: ValidationError, source: str | Path, model: type[BaseModel]) -> str:
    """Return one line for the first error of a validation.

    Parameters
    ----------
    error
        Error of pydantic.
    source
        File of the data.
    model
        Model of the data; its keys are candidates for a misspelt key.
    """
    errors = error.errors()
    first = min(errors, key=lambda entry: entry["type"] != "extra_forbidden")
    place = ".".join(str(part) for part in first["loc"] if not _branch_of_union(part))
    value = _SHORT.repr(first.get("input"))
    if first["type"] == "extra_forbidden":
        known = _keys_at(model, first["loc"][:-1])
        text = f"unknown key{close_match(str(first['loc'][-1]), known)}"
        if known:
            text += f" (known: {', '.join(sorted(known))})"
    elif first["type"] == "missing":
        text, value = "this key is missing; add it", ""
    elif first["type"] == "union_tag_not_found":
        text = f"{first['ctx']['discriminator']} is missing; add it"
    elif first["type"] == "union_tag_invalid":
        key, kinds = (
            first["ctx"]["discriminator"].strip("'"),
            first["ctx"]["expected_tags"].replace("'", "").split(", "),
        )
        place, value = f"{place}.{key}", repr(first["ctx"]["tag"])
        text = f"is none of {', '.join(kinds)}{close_match(first['ctx']['tag'], kinds)}"
    else:
        text = first["msg"].removeprefix("Value error, ")
        text = text[0].lower() + text[1:]
    more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
    shown = f" = {value}" if value and first["type"] != "value_error" and first["type"] != "extra_forbidden" else ""
    return f"{source}: {place}{shown}: {text}{more}" if place else f"{source}: {text}{more}"


def _branch_of_union(part: Any) -> bool:
    """Return True if a part of the location is the name of a type in a union instead of a key of the file."""
    return isinstance(part, str) and (
        part.removeprefix("constrained-") in ("float", "int", "str", "bool") or "[" in part
    )


def _keys_at(model: type[BaseModel], path: tuple[Any, ...]) -> set[str]:
    """Return the keys of a model at a location, including those with unit suffixes."""
    current: set[type[BaseModel]] = {model}
    for part in path:
        below: set[type[BaseModel]] = set()
        for entry in current:
            field = entry.model_fields.get(str(part))
            if field is not None:
                below |= _models_in(field.annotation)
        current = below or current
    keys: set[str] = set()
    for entry in current:
        keys |= {field.alias or name for name, field in entry.model_fields.items()}
        if issubclass(entry, SiModel):
            keys |= set(entry.suffixed_keys())
    return keys


def _models_in(annotation: Any) -> set[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return {annotation}
    found: set[type[BaseModel]] = set()
    for argument in get_args(annotation):
        found |= _models_in(argument)
    return found
