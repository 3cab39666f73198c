"""Conversion of the dataclasses of messages to CDR bytes, the encoding of ROS 2, and back, without ROS.

Equal messages have equal bytes (rclpy leaves padding uninitialised).  Decoding accepts any padding and byte order.

Messages of fixed length as records: one numpy type for each topic of a run.

The messages of a topic have the same names and lengths. They differ only in stamp and numbers. The type has the places
of stamp and numbers in the CDR bytes. A message, the messages of many ticks and a block of the log are arrays of this
type.
"""

import dataclasses
import struct
from collections.abc import Callable
from contextlib import suppress
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train_ato.messages import cdr
from train_ato.messages.cdr import stamp_of
from train_ato.messages.topic import Place, Topic, TrainLayout
from train_ato.messages.topics import EPOCH_NS, FORMER, Values, topics_of
from train_ato.messages.types import FormerTrainAhead
from train_ato.messages.variable_codec import STAMP_END, VARIABLE

FLOAT64 = np.dtype("<f8")
"""Numbers in the bytes of a message."""
AGAIN = " again"
"""End of the key of a field at its second place."""
_SMALL = 32
"""Count of numbers up to which a loop checks finite values faster than numpy."""
_SHOWN = 6
"""Largest number of names that a refusal shows in full."""


class TopicRecord:
    """Numpy type of the messages of one topic; conversion of its records from and to the dataclass of the messages.

    Names and lengths cost no time per message (``python studies_done/codec.py``).  One thread encodes the messages of a
    topic, because all are written into the same bytes.

    Parameters
    ----------
    topic
        Entry of the topic table, with messages of fixed length.
    layout
        Sizes of the train.

    Attributes
    ----------
    blank : bytes
        Message with stamp and numbers 0.
    dtype : dtype
        Type of a message by the fields of its dataclass; stamps, and durations from the stamp, have ``sec`` and
        ``nanosec``. Bytes without a field are those of ``blank``.

    Raises
    ------
    ValueError
        If the places of the topic do not fit its dataclass or its ROS type.
    """

    def __init__(self, topic: Topic, layout: TrainLayout) -> None:
        self.topic = topic
        self.blank = _blank_of(topic, layout)
        self._names = topic.names(layout)
        self._layout = cdr.layout_of(cdr.typestore(), topic.type, self.blank)
        self._read = dict.fromkeys((self._layout.leaves[0].path, *(place.path for place in topic.places)))
        self._paths = {place.field: place.path for place in topic.places[::-1] if place.field != "stamp"}
        order = [entry.name for entry in dataclasses.fields(topic.message) if entry.name != "stamp"]
        if sorted(order) != sorted(self._paths):
            raise ValueError(f"topic {topic.name}: every field of {topic.message.__name__} needs one place")
        fields = _fields_of(topic, layout, self._layout)
        self.dtype = cdr.structure(fields, len(self.blank))
        self._length, self._unpack_fixed = len(self.blank), _fixed_of(fields, len(self.blank)).unpack
        self._constants = self._unpack_fixed(self.blank)
        self._message = memoryview(bytearray(bytes(cdr.HEAD) + self.blank))[
            cdr.HEAD :
        ]  # numbers at multiples of their size
        self._row = np.frombuffer(self._message, self.dtype)
        self._other: cdr.Layout | None = None

        self._times = [(place, name, fields[name][1]) for place, name in enumerate(order) if fields[name][0].names]
        numbers = {name: field for name, field in fields.items() if not field[0].names}
        self._first = min((start for _, start in numbers.values()), default=STAMP_END)
        end = max((start + kind.itemsize for kind, start in numbers.values()), default=STAMP_END)
        self._numbers, self._size = slice(self._first, end), (end - self._first) // 8
        self._unpack = struct.Struct(f"<{self._size}d").unpack_from
        self._checked = topic.finite and bool(numbers)
        self._arrays = any(kind.shape for kind, _ in numbers.values())
        singles = not all(kind.shape for kind, _ in numbers.values())
        self._listed = singles or self._size <= _SMALL
        self._parts: list[tuple[bool, Any]] = [(self._arrays, slice(0))] * len(order)
        self._writers: list[tuple[str, str, NDArray[Any], int | None]] = []
        for key, (kind, start) in numbers.items():
            first, size, name = (start - self._first) // 8, kind.itemsize // 8, key.removesuffix(AGAIN)
            if key == name:
                self._parts[order.index(name)] = (True, slice(first, first + size)) if kind.shape else (False, first)
            self._writers.append((name, key, self._row[key].reshape(-1), size if kind.shape else None))

    def encode(self, message: Any) -> bytes:
        """Return the CDR bytes of a message.

        Raises
        ------
        ValueError
            For an array of the wrong type or length, or a number that is not finite.
        """
        data, stamp = self._message, message.stamp
        cdr.TIME.pack_into(data, cdr.HEAD, *divmod(EPOCH_NS + stamp, cdr.SECOND))
        for name, _, out, size in self._writers:
            value = getattr(message, name)
            if size is not None and (value.size != size or value.dtype.char != "d"):
                self._refuse(name, value, size)
            out[...] = value
        for _, name, start in self._times:
            cdr.TIME.pack_into(data, start, *divmod(getattr(message, name) - stamp, cdr.SECOND))
        if self._checked:
            self._numbers_of(data)
        return bytes(data)

    def fill(self, rows: NDArray[Any], stamps: NDArray[np.int64], values: Values) -> None:
        """Write stamps and values into copies of the blank message; errors as :meth:`encode`.

        Parameters
        ----------
        rows : Array of :attr:`dtype`, shape (messages,)
            Copies of the blank message.
        stamps : Array of int, shape (messages,)
            Stamps [ns].
        values
            Values by field, shape (messages, n) each; durations [ns] as integers.
        """
        cdr.fill_times(rows["stamp"], EPOCH_NS + stamps)
        for _, name, _ in self._times:
            cdr.fill_times(rows[name], values[name][:, 0] - stamps)
        for name, key, own, size in self._writers:
            column = values[name]
            if column.shape[1] != own.size:
                self._refuse(name, column[0], own.size)
            rows[key] = column[:, 0] if size is None else column
            if self._checked and not np.isfinite(column).all():
                self._refuse_infinite(rows)

    def decode(self, data: bytes) -> Any:
        """Return the message of the bytes; arrays are copies.

        Raises
        ------
        ValueError
            For bytes of another type, other names or lengths, or numbers that are not finite.
        """
        if len(data) != self._length or self._unpack_fixed(data) != self._constants:
            data = self._transcribed(data)
        single = self._numbers_of(data)
        array: Any = np.ndarray((self._size,), FLOAT64, bytearray(data[self._numbers])) if self._arrays else None
        values: list[Any] = [(array if several else single)[part] for several, part in self._parts]
        seconds, nanoseconds = cdr.TIME.unpack_from(data, cdr.HEAD)
        stamp = seconds * cdr.SECOND + nanoseconds - EPOCH_NS
        for number, _, start in self._times:
            seconds, nanoseconds = cdr.TIME.unpack_from(data, start)
            values[number] = seconds * cdr.SECOND + nanoseconds + stamp
        return self.topic.message(stamp, *values)

    def _numbers_of(self, data: bytes | memoryview) -> tuple[Any, ...]:
        """Return all numbers of a message, none of a long one of arrays; refuse those that are not finite.

        The lengths between the numbers are finite as numbers, too.
        """
        found = self._unpack(data, self._first) if self._listed else ()
        if self._checked and not (
            all(map(isfinite, found))
            if self._listed
            else np.isfinite(np.frombuffer(data, FLOAT64, self._size, self._first)).all()
        ):
            self._refuse_infinite(np.frombuffer(data, self.dtype))
        return found

    def _transcribed(self, data: bytes) -> bytes:
        """Return a message with any padding, byte order and frame in the bytes of this program.

        Names and lengths are checked.
        """
        layout = self._other
        if layout is None or layout.length != len(data) or not layout.fits(cdr.rows_of([data], len(data))).all():
            try:
                layout = cdr.layout_of(cdr.typestore(), self.topic.type, data)
                self._check(layout)
            except ValueError as error:
                raise ValueError(f"{self.topic.name}: {error}") from None
            self._other = layout
        own = np.frombuffer(bytearray(self.blank), self._layout.dtype)
        other = np.frombuffer(data, layout.dtype)
        for path in self._read:
            own[path] = other[path]
        return own.tobytes()

    def _check(self, layout: cdr.Layout) -> None:
        """Check names and lengths of the layout of a message."""
        path, due = f"{self.topic.names_path}[", self._names
        names = tuple(leaf.text for leaf in layout.leaves if leaf.path.startswith(path))
        if due and names != due:
            raise ValueError(f"names {_listed(names)} where {_listed(due)} are due; `train-ato list SCENARIO` has them")
        own, other = ({leaf.path: leaf for leaf in found.leaves} for found in (self._layout, layout))
        for path in self._read:
            if path not in other or ("[0]" in path and path.replace("[0]", "[1]") in other):
                raise ValueError(f"{path.partition('[')[0]} does not hold one entry")
            if other[path].count != own[path].count:
                raise ValueError(f"{path} has {other[path].count} values where {own[path].count} are due")

    def _refuse_infinite(self, rows: NDArray[Any]) -> None:
        """Name the first value that is not finite."""
        for name, key, _, _ in self._writers:
            if (wrong := rows[key][~np.isfinite(rows[key])]).size:
                raise ValueError(f"{self.topic.name}: {self._paths[name]} is not finite: {wrong[0]}")

    def _refuse(self, name: str, value: Any, size: int) -> None:
        """Name an array of the wrong type or length."""
        path = f"{self.topic.name}: {self._paths[name]}"
        if value.dtype.char != "d":
            raise ValueError(f"{path} is {value.dtype}, not float64")
        raise ValueError(f"{path} has {value.size} values where {size} are due")


def _blank_of(topic: Topic, layout: TrainLayout) -> bytes:
    """Return the bytes of a message with stamp and numbers 0."""
    message = cdr.blank(topic.type)
    if topic.owners:
        setattr(message, topic.names_path, list(topic.names(layout)))
    if frame := topic.frame_id(layout):
        message.header.frame_id = frame
    for path, texts in topic.texts:
        setattr(message, path, list(texts))
    sizes: dict[str, int] = {}
    for place in topic.places:
        sizes[place.path] = sizes.get(place.path, 0) + _size(place, layout)
    for path, size in sizes.items():
        cdr.resize(topic.type, message, path, size)
    return bytes(cdr.typestore().serialize_cdr(message, topic.type))


def _listed(names: tuple[str, ...]) -> str:
    """Return names as text, of more than six the first three and the last one with their number."""
    if len(names) <= _SHOWN:
        return str(list(names))
    return f"[{', '.join(map(repr, names[:3]))}, ... {names[-1]!r}] ({len(names)})"


def _size(place: Place, layout: TrainLayout) -> int:
    """Return the number of values at a place."""
    return 1 if place.owner is None else len(layout.names(place.owner))


def _fields_of(topic: Topic, layout: TrainLayout, found: cdr.Layout) -> cdr.Fields:
    """Return type and offset of the fields of the dataclass in the bytes of a message."""
    leaves, stamp = {leaf.path: leaf for leaf in found.leaves}, found.leaves[0]
    if stamp.dtype is None or not (stamp.is_time and stamp.start == cdr.HEAD):
        raise ValueError(f"topic {topic.name}: a {topic.type} does not begin with its stamp")
    fields: cdr.Fields = {"stamp": (stamp.dtype, cdr.HEAD)}
    ends: dict[str, int] = {}
    for place in topic.places:
        if place.field == "stamp":
            continue
        leaf = leaves.get(place.path)
        if leaf is None or leaf.dtype is None or not (leaf.is_time or leaf.dtype == FLOAT64):
            raise ValueError(f"topic {topic.name}: {place.path} of a {topic.type} is not float64")
        size, start = _size(place, layout), ends.get(place.path, leaf.start)
        key = f"{place.field}{AGAIN}" if place.field in fields else place.field
        fields[key] = leaf.dtype if place.owner is None else np.dtype((FLOAT64, (size,))), start
        ends[place.path] = start + 8 * size
    return fields


def _fixed_of(fields: cdr.Fields, length: int) -> struct.Struct:
    """Return the format of the bytes of a message without a field."""
    form, place = "<", 0
    for start, size in sorted((start, kind.itemsize) for kind, start in fields.values()):
        form += f"{start - place}s{size}x"
        place = start + size
    return struct.Struct(f"{form}{length - place}s")


def _either(decode: Callable[[bytes], Any], former: Topic, layout: TrainLayout) -> Callable[[bytes], Any]:
    """Return a decoder of the present and of the former messages of a topic; errors are those of the present ones."""
    records: list[TopicRecord] = []

    def decoded(data: bytes) -> Any:
        try:
            return decode(data)
        except ValueError:
            if not records:
                records.append(TopicRecord(former, layout))
            with suppress(ValueError):
                found = records[0].decode(data)
                return found.today() if isinstance(found, FormerTrainAhead) else found
            raise

    return decoded


__all__ = ["Wire", "stamp_of"]

MAX_FRAME = 1024
"""Maximum length of the frame and of padding, which this program leaves empty [bytes]."""
MAX_VARIABLE = 2**29
"""Maximum length of a message of variable length [bytes]."""


class Wire:
    """Encoder and decoder of every topic of a run.

    Attributes
    ----------
    records, encoders : dict
        Records of the topics with messages of fixed length, and function behind :meth:`encode`, by topic.
    known : dict
        Last bytes and their message, by topic of fixed length: of :meth:`decode_shared`, or sent in this process.
    """

    def __init__(self, layout: TrainLayout) -> None:
        self.layout = layout
        self.encoders: dict[str, Callable[[Any], bytes]] = {}
        self._decoders: dict[str, Callable[[bytes], Any]] = {}
        self.records: dict[str, TopicRecord] = {}
        self.known: dict[str, tuple[bytes, Any]] = {}
        for topic in topics_of(layout):
            if topic.of_variable_length:
                self.encoders[topic.name], decode = VARIABLE[topic.message]
            else:
                record = self.records[topic.name] = TopicRecord(topic, layout)
                self.encoders[topic.name], decode = record.encode, record.decode
            former = FORMER.get(topic.name)
            self._decoders[topic.name] = decode if former is None else _either(decode, former, layout)

    def longest(self, topic: str) -> int:
        """Return the maximum length of a valid message [bytes]: twice the present one, for former names."""
        return 2 * len(self.records[topic].blank) + MAX_FRAME if topic in self.records else MAX_VARIABLE

    def encode(self, topic: str, message: Any) -> bytes:
        """Return the CDR bytes of a message.

        Raises
        ------
        ValueError
            For a field of the wrong length or type, or a value that is not finite in a topic with finite values.
        KeyError
            If a run of this train has no such topic.
        """
        return self.encoders[topic](message)

    def decode(self, topic: str, data: bytes) -> Any:
        """Return the message of the bytes; arrays are copies.

        Raises
        ------
        ValueError
            One line with topic and fault: type, names, lengths, or values that are not finite.
        KeyError
            If a run of this train has no such topic.
        """
        return self._decoders[topic](data)

    def decode_shared(self, topic: str, data: bytes) -> Any:
        """Return the message of the bytes for readers that do not change it; errors as :meth:`decode`.

        Equal bytes give the last message that was decoded or sent in this process, as the stages of the engine share
        it: three nodes read every measurement.  One of variable length is not kept: the profile of a day has 100 MB.
        """
        if topic not in self.records:
            return self._decoders[topic](data)
        last = self.known.get(topic)
        if last is not None and last[0] == data:
            return last[1]
        message = self._decoders[topic](data)
        self.known[topic] = data, message
        return message
