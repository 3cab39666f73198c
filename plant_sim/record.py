"""Records: named numbers in one block of memory, for Python and compiled code.

A record is a dataclass that declares every field once, with type, unit and meaning. A model of pydantic with numbers is
a record, too. :func:`zeros` makes an array of records. In compiled code an entry has the fields as attributes:
``units[u].position``. mypy checks a compiled function that is annotated with :class:`Records`, and refuses a wrong
field name. In Python the fields are columns: ``units["position"]``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, Generic, TypeVar, cast, overload

import numpy as np
from numba import config
from numpy.typing import NDArray
from pydantic import BaseModel

Fields = TypeVar("Fields")
KINDS: dict[Any, Any] = {
    "float": np.float64, "bool": np.bool_, "int": np.int64, "Array": np.float64,
    float: np.float64, bool: np.bool_, int: np.int64, NDArray[np.float64]: np.float64,
}  # fmt: skip
"""Kinds of fields by the text of a postponed annotation, and by the type itself."""


class Records(Generic[Fields]):
    """Type of an array of records; at run time it is a structured array of numpy."""

    size: int

    @overload
    def __getitem__(self, index: int) -> Fields: ...

    @overload
    def __getitem__(self, index: slice) -> Records[Fields]: ...

    def __getitem__(self, index: int | slice) -> Any:
        raise TypeError("a type, not an array; use zeros()")

    def __setitem__(self, index: int | slice, records: Fields | Records[Fields]) -> None:
        raise TypeError("a type, not an array; use zeros()")

    def __iter__(self) -> Iterator[Fields]:
        raise TypeError("a type, not an array; use zeros()")


def quantity(unit: str, meaning: str, count: int = 0) -> Any:
    """Declare one field of a record.

    Parameters
    ----------
    unit
        SI unit; empty for a flag.
    meaning
        One line of description.
    count
        Number of entries of an array; 0 for a single number.
    """
    return dataclasses.field(default=0, metadata={"unit": unit, "meaning": meaning, "count": count})


@cache
def dtype_of(record: type) -> np.dtype[np.void]:
    """Return the type of an entry: all fields of a record that are numbers, flags or arrays of numbers, in order.

    It is one object for all records of a class: numba compares other equal ones field by field in every call (1.6 us).
    """
    if issubclass(record, BaseModel):
        kinds = {name: str(getattr(entry.annotation, "__name__", "")) for name, entry in record.model_fields.items()}
        return np.dtype([(name, KINDS[kind]) for name, kind in kinds.items() if kind in KINDS], align=True)
    fields = [
        (entry.name, KINDS[entry.type], (count,) if (count := entry.metadata.get("count")) else ())
        for entry in dataclasses.fields(cast(Any, record))
        if entry.type in KINDS
    ]
    return np.dtype(fields, align=True)


def zeros(record: type[Fields], count: int) -> Any:
    """Return an array of records with zeros and false flags, shape (count,)."""
    found = np.zeros(count, dtype_of(cast(type, record)))
    return found.view(np.recarray) if config.DISABLE_JIT else found  # without the compiler an entry has no attributes


def records_of(record: type, values: Sequence[Any]) -> Any:
    """Return an array of records with the attributes of the same names of some objects."""
    found = zeros(record, len(values))
    for name in found.dtype.names:
        found[name] = [getattr(value, name) for value in values]
    return found


def fill(records: Any, values: Any, **more: float) -> None:
    """Set the fields of all records to those of a dataclass or model with the same names, and to others by name."""
    known = {**(dict(values) if isinstance(values, BaseModel) else dataclasses.asdict(values)), **more}
    for name in records.dtype.names:
        records[name] = known[name]
