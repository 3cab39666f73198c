"""CDR, the encoding of ROS 2: message types, stamps and blank messages of any type.

Offsets of the numbers of a message in its CDR bytes.

The layout of one message follows from the definition of its type and its bytes.  Messages with the same lengths and
texts have the same layout, so that thousands of messages of any type are read as one array.
"""

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
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


def with_stamp(data: bytes, stamp: int) -> bytes:
    """Return a message of the topic table with another stamp [ns since the start of the run]."""
    form = TIME if data[1] & 1 else BIG_ENDIAN_TIME
    return data[:4] + form.pack(*divmod(EPOCH_NS + stamp, SECOND)) + data[12:]


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


Typestore = Any
HEAD = 4
"""Length of the encapsulation [bytes]; alignment is relative to its end."""
TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
MAX_LEAVES = 20_000
"""Maximum number of parts of a message; a table with more columns has no use."""
_DTYPES = {
    "bool": "?", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
Fields = dict[str, tuple[np.dtype[Any], int]]
"""Type and offset [bytes] of the fields of a message by name."""


def structure(fields: Fields, length: int) -> np.dtype[Any]:
    """Return the type of a message with some fields and a length [bytes]."""
    kinds, starts = [kind for kind, _ in fields.values()], [start for _, start in fields.values()]
    return np.dtype({"names": list(fields), "formats": kinds, "offsets": starts, "itemsize": length})


@dataclass(frozen=True)
class Leaf:
    """Elementary part of a message: a number, an array of numbers, a text or a time.

    Attributes
    ----------
    path
        Field names: ``points[0].positions``, ``name[3]``.
    dtype
        Type of a number or of the numbers of an array; None for a text; (i4, u4) for stamps and durations.
    start, count
        Offset in the message [bytes]; number of elements, None for a single one.
    text
        Content of a text.
    """

    path: str
    dtype: np.dtype[Any] | None
    start: int
    count: int | None = None
    text: str = ""

    @property
    def is_time(self) -> bool:
        """True for a stamp or a duration."""
        return self.dtype is not None and self.dtype.names is not None


@dataclass(frozen=True)
class Layout:
    """Layout of one message.

    Attributes
    ----------
    length
        Length of the message [bytes].
    leaves
        Parts in the order of the message.
    fixed : ndarray of uint8, shape (length,)
        255 for the bytes that define the layout: encapsulation, lengths and texts.
    between
        Ranges of bytes between the numbers: those bytes and the padding.
    sample
        Message from which the layout was derived.
    """

    length: int
    leaves: tuple[Leaf, ...]
    fixed: NDArray[np.uint8]
    between: tuple[tuple[int, int], ...]
    sample: NDArray[np.uint8]

    def fits(self, rows: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Return a mask of the messages, shape (n, length), with this layout; padding is ignored."""
        same = np.ones(len(rows), dtype=np.bool_)
        for begin, end in self.between:
            same &= (rows[:, begin:end] == self.sample[begin:end]).all(axis=1)
        if not same.all():
            others = np.flatnonzero(~same)
            same[others] = (((rows[others] ^ self.sample) & self.fixed) == 0).all(axis=1)
        return same

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        """Type of a message by the paths of its numbers and times."""
        fields: Fields = {}
        for leaf in self.leaves:
            if leaf.dtype is not None:
                kind = leaf.dtype if leaf.count is None else np.dtype((leaf.dtype, (leaf.count,)))
                fields[leaf.path] = kind, leaf.start
        return structure(fields, self.length)

    @property
    def names(self) -> tuple[str, ...]:
        """Paths of the numbers and times."""
        return self.dtype.names or ()


def layout_of(types: Typestore, type_name: str, data: bytes) -> Layout:
    """Return the layout of a message.

    Parameters
    ----------
    types
        Type store of ``rosbags`` with the type.
    type_name
        Message type, for example ``sensor_msgs/msg/JointState``.
    data
        CDR bytes.

    Raises
    ------
    ValueError
        If the bytes are not a message of that type.
    """
    if len(data) < HEAD or data[0] != 0 or data[1] > 1:
        raise ValueError(f"not a {type_name} (no CDR)")
    walk = _Walk(types, data)
    try:
        walk.message(type_name, "")
    except (struct.error, KeyError, UnicodeDecodeError) as error:
        raise ValueError(f"not a {type_name} ({type(error).__name__})") from None
    if len(data) - walk.place >= 8:  # some writers pad the end
        raise ValueError(f"not a {type_name} ({len(data) - walk.place} bytes too long)")
    edges = np.flatnonzero(np.diff(np.concatenate(([0], ~walk.numbers, [0]))))
    between = tuple(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
    fixed = np.where(walk.fixed, np.uint8(255), np.uint8(0))
    return Layout(len(data), tuple(walk.leaves), fixed, between, np.frombuffer(data, np.uint8))


class _Walk:
    """Derivation of the layout from the bytes of one message."""

    def __init__(self, types: Typestore, data: bytes) -> None:
        self.place = HEAD
        self.leaves: list[Leaf] = []
        self.fixed: NDArray[np.bool_] = np.zeros(len(data), dtype=np.bool_)
        self.fixed[:2] = True
        self.numbers: NDArray[np.bool_] = np.zeros(len(data), dtype=np.bool_)
        self._types = types
        self._data = data
        self._order = "<" if data[1] & 1 else ">"
        self._length = struct.Struct(f"{self._order}I")
        self._time = np.dtype([("sec", f"{self._order}i4"), ("nanosec", f"{self._order}u4")])

    def message(self, type_name: str, path: str) -> None:
        """Add the parts of a nested message."""
        if type_name in TIMES and path:
            self._number(self._time, 4, path, None)
            return
        for name, described in self._types.fielddefs[type_name][1]:
            self._field(described, f"{path}.{name}" if path else name)

    def _field(self, described: tuple[Any, Any], path: str) -> None:
        kind, detail = described
        if kind == Nodetype.BASE:
            self._base(detail[0], path)
        elif kind == Nodetype.NAME:
            self.message(detail, path)
        else:
            element, size = detail
            count = size if kind == Nodetype.ARRAY else self._count()
            if element[0] == Nodetype.BASE and element[1][0] in _DTYPES:
                dtype = np.dtype(self._order + _DTYPES[element[1][0]])
                self._number(dtype, dtype.itemsize, path, count)
                return
            if count > MAX_LEAVES:
                raise ValueError(f"{path} has {count} entries, more than the maximum of {MAX_LEAVES}")
            for index in range(count):
                self._field(element, f"{path}[{index}]")

    def _base(self, name: str, path: str) -> None:
        if name in _DTYPES:
            dtype = np.dtype(self._order + _DTYPES[name])
            self._number(dtype, dtype.itemsize, path, None)
            return
        if name != "string":
            raise ValueError(f"{path}: type {name} is not supported")
        size = self._count()
        begin, self.place = self.place, self.place + size
        self._check()
        self.fixed[begin : self.place] = True
        text = self._data[begin : self.place].rstrip(b"\0").decode()
        self.leaves.append(Leaf(path, None, begin, None, text))

    def _number(self, dtype: np.dtype[Any], alignment: int, path: str, count: int | None) -> None:
        if count != 0:  # an empty array has no bytes and no alignment
            self._align(alignment)
        self.leaves.append(Leaf(path, dtype, self.place, count))
        begin, self.place = self.place, self.place + dtype.itemsize * (1 if count is None else count)
        self._check()
        self.numbers[begin : self.place] = True
        if len(self.leaves) > MAX_LEAVES:
            raise ValueError(f"more than {MAX_LEAVES} parts in one message")

    def _count(self) -> int:
        """Read a length, a part of the layout."""
        self._align(4)
        (count,) = self._length.unpack_from(self._data, self.place)
        self.fixed[self.place : self.place + 4] = True
        self.place += 4
        return int(count)

    def _align(self, size: int) -> None:
        self.place += -(self.place - HEAD) % size

    def _check(self) -> None:
        if self.place > len(self._data):
            raise struct.error("too short")


def rows_of(payloads: Sequence[Any], length: int) -> NDArray[np.uint8]:
    """Return messages of one length as rows of bytes, shape (n, length)."""
    return np.frombuffer(b"".join(payloads), np.uint8).reshape(len(payloads), length)
