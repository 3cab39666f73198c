"""Parts of former runs: a run with equal data files, line, train or profile does not build them again."""

from __future__ import annotations

import pickle
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

__all__ = ["PartCache", "file_state"]

Part = TypeVar("Part")
SIZE = 32
"""Number of parts in a cache; the least recently used one is dropped."""


class PartCache:
    """Parts by the values that determine them.

    A part is shared between runs, so it must not be changed after its creation.

    Parameters
    ----------
    size
        Largest number of parts.
    """

    def __init__(self, size: int = SIZE) -> None:
        self._size = size
        self._parts: OrderedDict[bytes, object] = OrderedDict()

    def get(self, key: object, make: Callable[[], Part]) -> Part:
        """Return the part of a key; make it if the cache lacks it.

        Parameters
        ----------
        key
            Every value that determines the part, as a tuple of plain values and models.  Equal bytes of its pickle
            mean equal values, bit for bit; equal values with other bytes only cost a second creation.
        make
            Function that makes the part.
        """
        code = pickle.dumps(key)
        if code in self._parts:
            self._parts.move_to_end(code)
            return self._parts[code]  # type: ignore[return-value]  # the first entry of a key names its kind
        part = self._parts[code] = make()
        if len(self._parts) > self._size:
            self._parts.popitem(last=False)
        return part


def file_state(path: Path) -> tuple[int, int] | None:
    """Return time of the last change [ns] and size [bytes] of a file; None if there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size
