"""Notes on foreign files: keys that the own format does not carry, and assumed figures, one line each on stderr."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import Any

_printed: set[str] = set()


def print_assumption(text: str) -> None:
    """Print an assumed figure, or data without effect, as one line on stderr, once per process."""
    line = " ".join(f"note: {text}".split())
    if line not in _printed:
        _printed.add(line)
        sys.stderr.write(line + "\n")


def keys_not_carried(data: Any, carried: Iterable[str]) -> tuple[str, ...]:
    """Return the keys of a file that a reader does not carry, in the order of the file.

    Parameters
    ----------
    data
        Data of the file.
    carried
        Carried keys, as ``vehicles[].mass``; a key carries all that is below it.

    Examples
    --------
    >>> keys_not_carried({"a": 1, "b": [{"c": 2, "d": 3}]}, ["a", "b[].c"])
    ('b[].d',)
    """
    known = tuple(carried)
    return tuple(dict.fromkeys(_not_carried(data, "", known)))


def _not_carried(data: Any, place: str, known: tuple[str, ...]) -> Iterator[str]:
    if place in known:
        return
    if place and not any(entry.startswith((f"{place}.", f"{place}[")) for entry in known):
        yield place
    elif isinstance(data, dict):
        for key, value in data.items():
            yield from _not_carried(value, f"{place}.{key}" if place else str(key), known)
    elif isinstance(data, list):
        for value in data:
            yield from _not_carried(value, f"{place}[]", known)
