"""CDR, the encoding of ROS 2: message types, stamps and blank messages of any type."""

from __future__ import annotations

import re
import struct
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from train_ato.messages.topics import EPOCH_NS

SECOND = 1_000_000_000
TIME = struct.Struct("<iI")
"""Stamp or duration, little-endian."""
BIG_ENDIAN_TIME = struct.Struct(">iI")


@lru_cache(maxsize=1)
def typestore() -> Any:
    """Return the message types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def stamp_of(data: bytes) -> int:
    """Return the stamp of a message of the topic table, its first field [ns since the start of the run].

    Raises
    ------
    ValueError
        If the bytes are too short to hold a stamp.
    """
    if len(data) < 12:
        raise ValueError(f"{len(data)} bytes hold no stamp")
    time: tuple[int, int] = (TIME if data[1] & 1 else BIG_ENDIAN_TIME).unpack_from(data, 4)
    return time[0] * SECOND + time[1] - EPOCH_NS


def packed_stamp(stamp: int) -> bytes:
    """Return the 8 CDR bytes of a stamp [ns since the start of the run]."""
    return TIME.pack(*divmod(EPOCH_NS + stamp, SECOND))


def fill_times(out: NDArray[Any], times: NDArray[np.int64]) -> None:
    """Write times or durations [ns] into stamps (sec, nanosec)."""
    out["sec"], out["nanosec"] = np.divmod(times, SECOND)


def nanoseconds(times: NDArray[Any]) -> NDArray[np.int64]:
    """Return stamps or durations (sec, nanosec) in ns."""
    return np.asarray(times["sec"].astype(np.int64) * SECOND + times["nanosec"])


def header(stamp: int, frame: str) -> Any:
    """Return a header with a stamp [ns since the start of the run]."""
    seconds, nanoseconds = divmod(EPOCH_NS + stamp, SECOND)
    types = typestore().types
    time = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    return types["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def blank(type_name: str) -> Any:
    """Return a message with numbers 0 and empty texts and sequences."""
    store = typestore()
    fields = {name: _blank_field(described) for name, described in store.fielddefs[type_name][1]}
    return store.types[type_name](**fields)


def _blank_field(described: tuple[Any, Any]) -> Any:
    kind, detail = described
    if kind == Nodetype.NAME:
        return blank(detail)
    if kind == Nodetype.BASE:
        name = detail[0]
        return "" if name.endswith("string") else False if name == "bool" else 0.0 if "float" in name else 0
    element, size = detail
    count = size if kind == Nodetype.ARRAY else 0
    if element[0] == Nodetype.BASE and not element[1][0].endswith("string"):
        return np.zeros(count, np.uint8 if element[1][0] in ("byte", "char") else element[1][0])
    return [_blank_field(element) for _ in range(count)]


def resize(type_name: str, message: Any, path: str, size: int) -> None:
    """Add the entries of a path such as ``points[0].positions`` to a blank message, with ``size`` zeros at its end.

    Raises
    ------
    ValueError
        If the type has no such field.
    """
    *way, last = path.split(".")
    for part in way:
        name, index = re.fullmatch(r"(\w+)(?:\[(\d+)\])?", part).groups()  # type: ignore[union-attr]
        described = dict(typestore().fielddefs[type_name][1]).get(name)
        if described is None:
            raise ValueError(f"{type_name} has no field '{name}'")
        type_name = described[1] if index is None else described[1][0][1]
        message = getattr(message, name)
        if index is not None:
            message.extend(blank(type_name) for _ in range(int(index) + 1 - len(message)))
            message = message[int(index)]
    if not hasattr(message, last):
        raise ValueError(f"{type_name} has no field '{last}'")
    if isinstance(found := getattr(message, last), np.ndarray) and not found.size:
        setattr(message, last, np.zeros(size, found.dtype))
