"""Whether two logs say the same: every topic, every message in stamp order, every field by its bits."""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from train_ato.record.reading import iter_raw
from train_ato.wire import Wire

WALL = "wall_"
"""Diagnostics whose key begins like this tell of the wall clock and are not compared."""


def differences(one: Path, other: Path, wire: Wire, most: int = 10) -> list[str]:
    """Compare two logs of the same scenario.

    Parameters
    ----------
    one, other
        Run folders or MCAP files.
    wire
        Decoder for the train of both.
    most
        Stop after so many differences.

    Returns
    -------
    list of str
        One line for each difference; empty when the logs are equal bit for bit.
    """
    left, right = _by_topic(one), _by_topic(other)
    found: list[str] = []
    for topic in sorted({*left, *right}):
        for number, (a, b) in enumerate(zip_longest(left.get(topic, []), right.get(topic, []))):
            if a is None or b is None:
                lengths = f"{len(left.get(topic, []))} messages and {len(right.get(topic, []))}"
                found.append(f"{topic}: {lengths}")
                break
            found += [f"{topic} message {number}: {text}" for text in _unequal(topic, a, b, wire)]
            if len(found) >= most:
                return found[:most]
    return found


def _by_topic(run: Path) -> dict[str, list[tuple[int, bytes]]]:
    """Messages of every topic in stamp order; those of one stamp, from several nodes, by content."""
    messages: dict[str, list[tuple[int, bytes]]] = {}
    for topic, stamp, data in iter_raw(run):
        messages.setdefault(topic, []).append((stamp, data))
    for topic, entries in messages.items():
        entries.sort(key=lambda entry: entry if topic == "/diagnostics" else entry[:1])
    return messages


def _unequal(topic: str, a: tuple[int, bytes], b: tuple[int, bytes], wire: Wire) -> Iterator[str]:
    if a[0] != b[0]:
        yield f"stamp {a[0]} and {b[0]}"
        return
    if a[1] == b[1]:
        return
    left, right = wire.decode(topic, a[1]), wire.decode(topic, b[1])
    for field in dataclasses.fields(left):
        mine, other = getattr(left, field.name), getattr(right, field.name)
        if not _same(mine, other):
            yield f"{field.name} at {a[0] * 1e-9:.3f} s: {_shown(mine)} and {_shown(other)}"


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray):
        return bool(a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes())
    if isinstance(a, float):
        return struct.pack("<d", a) == struct.pack("<d", b)
    if isinstance(a, dict):
        return _without_wall(a) == _without_wall(b)
    return bool(a == b)


def _without_wall(values: dict[str, str]) -> dict[str, str]:
    return {key: value for key, value in values.items() if not key.startswith(WALL)}


def _shown(value: Any) -> str:
    text = np.array2string(value, threshold=4) if isinstance(value, np.ndarray) else repr(value)
    return " ".join(text.split())[:80]
