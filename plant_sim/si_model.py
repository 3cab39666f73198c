"""Base of the models of data files: keys with the suffix of another unit, strict types, no unknown keys.

The JSON Schema of a model contains the keys with and without suffix, so that editors complete and check them.
"""

import math
from collections.abc import Iterator
from functools import cache
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, GetJsonSchemaHandler, ValidationError, model_validator
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, ErrorDetails, InitErrorDetails, PydanticCustomError

from plant_sim.units import Unit, Usual, number_text, unit_symbol, without_comma

LARGEST = 1e15
"""Largest magnitude of a number in a file: powers and products of larger ones overflow."""
Value = TypeVar("Value")
Summary = Annotated[str, Field(description="one line for lists", examples=["Metro, six cars, third rail"])]
Source = Annotated[str, Field(description="origin of the data", examples=["data sheet of the operator, 2024"])]


def option(default: Value, text: str, *, example: Any = None, **bounds: Any) -> Value:
    """Declare a key of a data file that may be left out: its default, text, example and bounds."""
    found: Value = Field(default, description=text, examples=None if example is None else [example], **bounds)
    return found


def _unit_of(metadata: list[Any], annotation: Any) -> Unit | None:
    """Return the Unit of a field, also inside list[...], tuple[...] and X | None; None without one."""
    for entry in metadata:
        if isinstance(entry, Unit):
            return entry
    for argument in get_args(annotation):
        found = _unit_of(list(getattr(argument, "__metadata__", ())), argument)
        if found is not None:
            return found
    return None


def _types_in(annotation: Any) -> set[Any]:
    """Return the plain types of an annotation, also inside list[...], tuple[...] and X | None."""
    arguments = get_args(annotation)
    return set().union(*(_types_in(argument) for argument in arguments)) if arguments else {annotation}


def _scalars(value: Any) -> list[Any]:
    """Return the scalars of a value or of nested lists of values."""
    return [scalar for entry in value for scalar in _scalars(entry)] if isinstance(value, (list, tuple)) else [value]


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _type_mismatch(kinds: set[Any], value: Any) -> str | None:
    """Return the error text for a value that pydantic would convert (true to 1, '5' to 5); None for others."""
    scalars = _scalars(value)
    if kinds & {int, float}:
        if bool not in kinds and any(isinstance(scalar, bool) for scalar in scalars):
            return "input should be a number, not true or false"
        if str not in kinds and any(isinstance(scalar, str) for scalar in scalars):
            return f"input should be a number, not text{_decimal_comma(scalars)}"
        if float in kinds and any(LARGEST < abs(scalar) < math.inf for scalar in scalars if _is_number(scalar)):
            return f"input should be between -{LARGEST:g} and {LARGEST:g}"
    elif bool in kinds and not isinstance(value, bool):
        return "input should be true or false"
    elif kinds <= {str, type(None)} and any(isinstance(scalar, (bool, int, float)) for scalar in scalars):
        return "input should be text; write it in quotes"
    return None


def _decimal_comma(scalars: list[Any]) -> str:
    """Return the remedy for a number with a decimal comma; empty for other texts."""
    whole, comma, part = next((scalar for scalar in scalars if isinstance(scalar, str)), "").partition(",")
    number = comma and whole.lstrip("+-").isdigit() and part.isdigit()
    return f"; write {without_comma(whole, part)} with a decimal point" if number else ""


def _divide(value: Any, divisor: float) -> Any:
    if isinstance(value, bool) or not isinstance(value, (int, float, list, tuple)):
        return value
    if isinstance(value, (list, tuple)):
        return [_divide(entry, divisor) for entry in value]
    return value / divisor


def _in_unit(value: Any, divisor: float) -> Any:
    """Return an SI value, or a list of them, in another unit."""
    if isinstance(value, (list, tuple)):
        return [_in_unit(entry, divisor) for entry in value]
    return None if value is None else float(f"{value * divisor:.12g}")


_BOUNDS = frozenset({"minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"})


def _scaled(part: Any, divisor: float) -> Any:
    """Return the JSON Schema of a quantity with bounds in another unit and without default."""
    if isinstance(part, list):
        return [_scaled(entry, divisor) for entry in part]
    if not isinstance(part, dict):
        return part
    return {
        key: _in_unit(value, divisor) if key in _BOUNDS else _scaled(value, divisor)
        for key, value in part.items()
        if key != "default"
    }


def blocks_of(annotation: Any) -> list[type[BaseModel]]:
    """Return the models of an annotation in their order, also inside list[...], tuple[...] and X | None."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [block for argument in get_args(annotation) for block in blocks_of(argument)]


def _choices(annotation: Any) -> list[Any]:
    """Return the values of the Literals of an annotation in their order, and those of bool."""
    if get_origin(annotation) is Literal:
        return list(get_args(annotation))
    found = [choice for argument in get_args(annotation) for choice in _choices(argument)]
    return found or ([True, False] if annotation is bool else [])


def _text_of(field: FieldInfo, owner: type[BaseModel]) -> str:
    """Return the text of a key; of a key of one block, or of the kind of a block, the first line of its docstring."""
    blocks = blocks_of(field.annotation)
    kind = [owner] if get_origin(field.annotation) is Literal and len(get_args(field.annotation)) == 1 else []
    of_block = next(((block.__doc__ or "").partition("\n")[0].rstrip(".:") for block in kind or blocks), "")
    return field.description or (of_block if len(kind or blocks) == 1 else "")


def example_of_key(field: FieldInfo) -> Any:
    """Return the declared example of a key, else another choice than the default, that of its block, or the default."""
    if field.examples:
        return field.examples[0]
    annotation, default = field.annotation, field.default
    choices = [choice for choice in _choices(annotation) if choice != default]
    if choices:
        return choices[0]
    blocks = blocks_of(annotation)
    if blocks:
        listed = tuple in (get_origin(annotation), *map(get_origin, get_args(annotation)))
        return [example_of(blocks[0])] if listed else example_of(blocks[0])
    return None if field.is_required() else (_choices(annotation) or [default])[0] or None


def example_of(model: type[BaseModel]) -> dict[str, Any]:
    """Return an example of a block: all required keys, or the first key of a block without."""
    fields = {field.alias or name: field for name, field in model.model_fields.items()}
    required = [key for key, field in fields.items() if field.is_required()] or list(fields)[:1]
    return {key: example_of_key(fields[key]) for key in required}


def _described(part: dict[str, Any], text: str, unit: str, example: Any) -> dict[str, Any]:
    """Return the JSON Schema of a key with text, unit and example."""
    examples = [] if example is None else [example]
    return {**part, "description": f"{text} [{unit}]".strip() if unit else text, "examples": examples}


@cache
def _suffixed_keys(model: type[BaseModel]) -> dict[str, tuple[str, float]]:
    """Return the field and the divisor of every key with a suffix; every validation of the model needs them."""
    keys: dict[str, tuple[str, float]] = {}
    for name, field in model.model_fields.items():
        unit = _unit_of(list(field.metadata), field.annotation)
        for suffix, divisor in unit.suffixes if unit else ():
            keys[f"{name}_{suffix}"] = (name, divisor)
    return keys


@cache
def _types_by_key(model: type[BaseModel]) -> dict[str, set[Any]]:
    """Return the plain types of every key, with and without a suffix; every validation of the model needs them.

    A number with bounds of its own on both sides has no float: they hold before the largest magnitude.
    """
    types = {name: _types_in(field.annotation) for name, field in model.model_fields.items()}
    for name, field in model.model_fields.items():
        bounds = [hasattr(entry, "ge") or hasattr(entry, "gt") for entry in field.metadata]
        if any(bounds) and any(hasattr(entry, "le") or hasattr(entry, "lt") for entry in field.metadata):
            types[name] = types[name] - {float} | {int}
    found = {field.alias or name: types[name] for name, field in model.model_fields.items()}
    return found | {key: types[name] for key, (name, _) in _suffixed_keys(model).items()}


def unusual_values(value: Any, key: str = "") -> Iterator[str]:
    """Yield key, value and usual magnitudes of every given value of a model that is probably in another unit."""
    if isinstance(value, (list, tuple)):
        for number, entry in enumerate(value):
            yield from unusual_values(entry, f"{key}[{number}]")
    elif isinstance(value, dict):
        for name, entry in value.items():
            yield from unusual_values(entry, f"{key}.{name}")
    elif isinstance(value, BaseModel):
        for name, field in type(value).model_fields.items():
            usual = next((entry for entry in field.metadata if isinstance(entry, Usual)), None)
            given, place = getattr(value, name), f"{key}.{name}".lstrip(".")
            if usual is None:
                yield from unusual_values(given, place)
            elif given is not None and name in value.model_fields_set:
                largest = max((abs(scalar) for scalar in _scalars(given)), default=0.0)
                if largest and not usual.low <= largest <= usual.high:
                    unit = _unit_of(list(field.metadata), field.annotation)
                    symbol = f" {unit.si}" if unit and unit.si != "1" else ""
                    bounds = f"{number_text(usual.low)} to {number_text(usual.high)}{symbol}"
                    yield f"{place} = {number_text(largest)}: usual are {bounds}"


def _repeated(error: ErrorDetails) -> InitErrorDetails:
    """Return an error of a validation for another one; its text is that of the error."""
    kind = PydanticCustomError(error["type"], "{text}", {**error.get("ctx", {}), "text": error["msg"]})
    return {"type": kind, "loc": error["loc"], "input": error["input"]}


class SiModel(BaseModel):
    """Base of the models of data files: no unknown keys, finite numbers, unit suffixes."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True, populate_by_name=True)

    @classmethod
    def suffixed_keys(cls) -> dict[str, tuple[str, float]]:
        """Return the field and the divisor of every key with a suffix."""
        return dict(_suffixed_keys(cls))

    @model_validator(mode="before")
    @classmethod
    def _to_si(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        suffixed = _suffixed_keys(cls)
        result = dict(data)
        for key in data:
            if key in suffixed and key not in cls.model_fields:
                name, divisor = suffixed[key]
                if name in data:
                    raise ValueError(f"{name} and {key} are the same quantity; keep one of them")
                result[name] = _divide(result.pop(key), divisor)
        cls._check_types(data)
        return result

    @classmethod
    def _check_types(cls, data: dict[Any, Any]) -> None:
        """Raise ValidationError for values of another type than that of their key, with all other faults."""
        known = _types_by_key(cls)
        errors: list[InitErrorDetails] = []
        for key, value in data.items():
            wanted = _type_mismatch(known[key], value) if key in known else None
            if wanted:
                errors.append({"type": PydanticCustomError("type_mismatch", wanted), "loc": (key,), "input": value})
        if errors:
            of_another_type = {str(entry["loc"][0]) for entry in errors}
            fields = of_another_type | {_suffixed_keys(cls)[key][0] for key in of_another_type & {*_suffixed_keys(cls)}}
            try:
                cls.model_validate({key: value for key, value in data.items() if key not in of_another_type})
            except ValidationError as others:
                missing = [("missing", (name,)) for name in fields]
                errors += [
                    _repeated(entry) for entry in others.errors() if (entry["type"], entry["loc"]) not in missing
                ]
            raise ValidationError.from_exception_data(cls.__name__, errors)

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Add text, unit and example of every key, and the keys with suffixes.

        A required field accepts one of its keys.
        """
        schema = handler(core_schema)
        target = handler.resolve_ref_schema(schema)
        properties = target.get("properties", {})
        required = list(target.get("required", ()))
        alternatives = []
        for name, field in cls.model_fields.items():
            unit, part = _unit_of(list(field.metadata), field.annotation), properties[field.alias or name]
            text, example = _text_of(field, cls), example_of_key(field)
            kinds = {type(kind) if isinstance(kind, int) else kind for kind in _types_in(field.annotation)}
            si = unit.si if unit else "1" if int in kinds and str not in kinds else ""
            properties[field.alias or name] = _described(part, text, si, example)
            for suffix, divisor in unit.suffixes if unit else ():
                scaled = _in_unit(example, divisor)
                properties[f"{name}_{suffix}"] = _described(_scaled(part, divisor), text, unit_symbol(suffix), scaled)
        for name in list(required):
            spellings = [name, *(key for key, (field, _) in cls.suffixed_keys().items() if field == name)]
            if len(spellings) > 1:
                required.remove(name)
                alternatives.append({"oneOf": [{"required": [key]} for key in spellings]})
        if alternatives:
            target["allOf"] = [*target.get("allOf", ()), *alternatives]
        target["required"] = required
        return schema
