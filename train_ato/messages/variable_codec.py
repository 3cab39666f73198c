"""Codec of messages of variable length: profiles, speed limits, diagnostics, and states and counters by their keys.

The usual layouts are encoded here, because the general serialiser is slow for thousands of small parts; it handles
all other layouts.

Keys and values of diagnostics in a message: one plain number per key, with its unit at the end of the key.

In the program a value has the key without unit, and a list of numbers is one value.
"""

import re
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from itertools import chain, product
from math import isfinite
from typing import Any

import numpy as np

from plant_sim.units import unit_suffix
from train_ato.messages.cdr import SECOND, header, packed_stamp, stamp_of, typestore
from train_ato.messages.topic import FIXED_NAMES
from train_ato.messages.topics import BY_NAME, DIAGNOSTIC_UNITS, LINE_FRAME, Role, Topic
from train_ato.messages.types import Array, AtoState, Diagnostic, Trajectory

LISTED = ("delay", "delay_brake")
"""Values with one number per power unit."""
HARDWARE: dict[str, str] = {
    Role.PLANT.value: "train", Role.PROFILE.value: "ato", Role.OBSERVER.value: "ato", Role.CONTROLLER.value: "ato",
    Role.SUPERVISOR.value: "atp",
}  # fmt: skip
"""Unit of the vehicle with a node, ``hardware_id`` of its diagnostics."""
STATUS_NAMES: dict[str, str] = {
    Role.PLANT.value: "plant: train",
    Role.PROFILE.value: "profile: plan",
    Role.OBSERVER.value: "observer: estimate",
    Role.CONTROLLER.value: "controller: law",
    Role.SUPERVISOR.value: "supervisor: limits",
}
"""Name of the status of a node: node and part, as ``diagnostic_aggregator`` groups them."""
_NODE_OF = {name: node for node, name in STATUS_NAMES.items()}


def node_of(status_name: str) -> str:
    """Return the node of the name of a status; older logs and other programs have the node alone."""
    return _NODE_OF.get(status_name, status_name)


@lru_cache(maxsize=1024)
def message_key(key: str) -> str:
    """Return the key of a value in a message: the key with the suffix of its unit."""
    return key + unit_suffix(DIAGNOSTIC_UNITS.get(key, ""))


_KEYS = {message_key(key): key for key in DIAGNOSTIC_UNITS}
_ENTRIES = re.compile("|".join(rf"({key})_(\d+){unit_suffix(DIAGNOSTIC_UNITS[key])}" for key in LISTED))


def message_values(values: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Yield keys and values of a message."""
    for key, value in values.items():
        if key in LISTED and value.startswith("["):
            unit = unit_suffix(DIAGNOSTIC_UNITS[key])
            entries = value.strip("[]").split(", ")
            yield from ((f"{key}_{number}{unit}", entry) for number, entry in enumerate(entries) if entry)
        else:
            yield message_key(key), value


def program_values(pairs: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Return the values of a message by the keys of the program; keys without unit are kept."""
    found: dict[str, str] = {}
    lists: dict[str, list[str]] = {}
    for key, value in pairs:
        name = _listed(key)
        if name is None:
            found[_KEYS.get(key, key)] = value
        else:
            lists.setdefault(name, []).append(value)
            found[name] = f"[{', '.join(lists[name])}]"
    return found


@lru_cache(maxsize=1024)
def _listed(key: str) -> str | None:
    """Return the name of the list to which a key of a message belongs, None for a single value."""
    match = _ENTRIES.fullmatch(key)
    return None if match is None else next(name for name in match.groups()[::2] if name is not None)


_LENGTH = struct.Struct("<I")
_HEAD = b"\x00\x01\x00\x00"
_KNOT = np.dtype(
    [
        ("positions", "<u4"), ("position", "<f8"),
        ("velocities", "<u4"), ("gap_v", "<u4"), ("velocity", "<f8"),
        ("accelerations", "<u4"), ("gap_a", "<u4"), ("acceleration", "<f8"),
        ("efforts", "<u4"), ("second", "<i4"), ("nanosecond", "<u4"),
    ]
)  # fmt: skip
"""Point with one position, speed and acceleration; it begins and ends 4 bytes behind a multiple of 8."""
STAMP_END, _FRAME = 12, 16
"""Offsets of the end of the stamp and of the text of the frame [bytes]."""
MAX_KNOWN = 64
"""Number of the states whose bytes are kept."""


def encode_trajectory(message: Trajectory) -> bytes:
    """Return the CDR bytes of a profile or of the speed limits.

    Raises
    ------
    ValueError
        If a value is not finite or the columns differ in length.
    """
    _check(message)
    if message.acceleration.size == 0:
        return _encode_any(message)
    knots = np.zeros(message.time.size, _KNOT)
    knots["positions"] = knots["velocities"] = knots["accelerations"] = 1
    knots["position"], knots["velocity"] = message.position, message.velocity
    knots["acceleration"] = message.acceleration
    since = message.time - message.stamp
    knots["second"], knots["nanosecond"] = since // SECOND, since % SECOND
    start, points = _start_of_points(message, LINE_FRAME), knots.view(np.uint8).data
    return b"".join((start, points[:4], bytes(_gap(start)), points[4:]))


def _check(message: Trajectory) -> None:
    k = message.time.size
    for field in ("position", "velocity", "acceleration"):
        column: Array = getattr(message, field)
        if column.size != k and not (field == "acceleration" and column.size == 0):
            raise ValueError(f"trajectory '{message.name}': {column.size} values of {field} for {k} knots")
        if not np.isfinite(column).all():
            raise ValueError(f"trajectory '{message.name}': {field} is not finite")


def decode_trajectory(data: bytes) -> Trajectory:
    """Return the profile or the speed limits of the bytes.

    Raises
    ------
    ValueError
        If the bytes are not a trajectory of one joint with finite values.
    """
    result = _decode_knots(data) or _decode_any(data)
    _check(result)
    return result


def _start_of_points(message: Trajectory, frame: str) -> bytes:
    """Return the begin of the message, including the number of points."""
    joints, points = _LENGTH.pack(1), _LENGTH.pack(message.time.size)
    return b"".join((_HEAD, packed_stamp(message.stamp), _text(frame), joints, _text(message.name), points))


def _gap(start: bytes) -> int:
    """Return the padding between the length and the value of the first position, aligned to 8 [bytes]."""
    return len(start) % 8 and 4  # 4 bytes of encapsulation, 4 of the length: 0 modulo 8 leaves no gap


def _encode_any(message: Trajectory) -> bytes:
    types = typestore().types
    point, duration = types["trajectory_msgs/msg/JointTrajectoryPoint"], types["builtin_interfaces/msg/Duration"]
    none = np.zeros(0)
    accelerations = message.acceleration.reshape(-1, 1) if message.acceleration.size else [none] * message.time.size
    since = (message.time - message.stamp if message.acceleration.size else message.time).tolist()
    columns = (since, message.position.reshape(-1, 1), message.velocity.reshape(-1, 1), accelerations)
    points = [
        point(
            positions=position,
            velocities=velocity,
            accelerations=acceleration,
            effort=none,
            time_from_start=duration(sec=time // SECOND, nanosec=time % SECOND),
        )
        for time, position, velocity, acceleration in zip(*columns, strict=True)
    ]
    kind = "trajectory_msgs/msg/JointTrajectory"
    whole = types[kind](header=header(message.stamp, LINE_FRAME), joint_names=[message.name], points=points)
    return bytes(typestore().serialize_cdr(whole, kind))


def _decode_knots(data: bytes) -> Trajectory | None:
    """Decode a profile with the layout of :func:`encode_trajectory`; None for any other layout."""
    try:
        (frame,), place = _texts(data, _FRAME - 4, 1)
        place += -place % 4 + 4  # the number of joints
        (name,), end = _texts(data, place, 1)
    except (struct.error, UnicodeDecodeError):
        return None
    begin = end + -end % 4 + 4
    gap = _gap(data[:begin])
    count, rest = divmod(len(data) - begin - gap, _KNOT.itemsize)
    if rest or count < 1:
        return None
    knots = np.frombuffer(data[begin : begin + 4] + data[begin + 4 + gap :], _KNOT, count)
    time = knots["second"].astype(np.int64) * SECOND + knots["nanosecond"]
    columns = (np.array(knots[field]) for field in ("position", "velocity", "acceleration"))
    stamp = stamp_of(data)
    found = Trajectory(stamp, name, time + stamp, *columns)
    ones = all((knots[field] == 1).all() for field in ("positions", "velocities", "accelerations"))
    return found if ones and not knots["efforts"].any() and data[:begin] == _start_of_points(found, frame) else None


def _decode_any(data: bytes) -> Trajectory:
    message = _deserialise(data, "trajectory_msgs/msg/JointTrajectory")
    if len(message.joint_names) != 1:
        raise ValueError(f"trajectory of {len(message.joint_names)} joints where one is due")
    points = message.points
    times = [point.time_from_start.sec * SECOND + point.time_from_start.nanosec for point in points]
    stamp, acceleration = stamp_of(data), _column([point.accelerations for point in points])
    return Trajectory(
        stamp,
        str(message.joint_names[0]),
        np.array(times, dtype=np.int64) + (stamp if acceleration.size else 0),
        _column([point.positions for point in points]),
        _column([point.velocities for point in points]),
        acceleration,
    )


def _column(values: list[Array]) -> Array:
    return np.concatenate(values).astype(np.float64) if values else np.zeros(0)


_PADDING = (b"\x00\x00\x00\x00", b"\x00\x00\x00", b"\x00\x00", b"\x00")
"""End of a text and its padding, by the rest of its length."""


def _text(value: str) -> bytes:
    """Return a text with its length, padded to a multiple of 4 bytes."""
    raw = value.encode()
    return _LENGTH.pack(len(raw) + 1) + raw + _PADDING[len(raw) % 4]


_repeated_text = lru_cache(maxsize=1024)(_text)


def encode_diagnostic(message: Diagnostic) -> bytes:
    """Return the CDR bytes of the state of a node, padded to a multiple of 4 bytes as by every transport."""
    names = (STATUS_NAMES.get(message.node, message.node), message.message, HARDWARE.get(message.node, ""))
    parts = [_HEAD, packed_stamp(message.stamp), _repeated_text(""), _LENGTH.pack(1), bytes((message.level, 0, 0, 0))]
    parts += map(_repeated_text, names)
    count = 0
    values: list[bytes] = []
    for key, value in message_values(message.values):
        values += (_repeated_text(key), _text(value))
        count += 1
    return b"".join((*parts, _LENGTH.pack(count), *values))


def decode_diagnostic(data: bytes) -> Diagnostic:
    """Return the state of a node of the bytes; the name is "" for the states of no or several nodes.

    Raises
    ------
    ValueError
        If the bytes are not diagnostics.
    """
    if data[:2] != _HEAD[:2] or data[12:17] != b"\x01\x00\x00\x00\x00" or data[20:24] != b"\x01\x00\x00\x00":
        return _decode_any_diagnostic(data)
    try:
        (name, message, _), place = _texts(data, 25, 3)
        place += -place % 4
        (count,) = _LENGTH.unpack_from(data, place)
        pairs, _ = _texts(data, place + 4, 2 * count)
    except (struct.error, UnicodeDecodeError):
        return _decode_any_diagnostic(data)
    values = program_values(zip(pairs[::2], pairs[1::2], strict=True))
    return Diagnostic(stamp_of(data), node_of(name), data[24], message, values)


def _decode_any_diagnostic(data: bytes) -> Diagnostic:
    """Decode diagnostics of any byte order and frame."""
    message = _deserialise(data, "diagnostic_msgs/msg/DiagnosticArray")
    if len(message.status) != 1:  # from another program; nodes of the graph send one status
        return Diagnostic(stamp_of(data), "", 0, "", {})
    status = message.status[0]
    values = program_values((str(pair.key), str(pair.value)) for pair in status.values)
    return Diagnostic(stamp_of(data), node_of(str(status.name)), int(status.level), str(status.message), values)


def _texts(data: bytes, place: int, count: int) -> tuple[list[str], int]:
    """Return ``count`` consecutive texts and the offset of their end."""
    texts, last = [], len(data)
    for _ in range(count):
        place += -place % 4
        (size,) = _LENGTH.unpack_from(data, place)
        end = place + 4 + size
        if not size or end > last:
            raise struct.error("text beyond the end")
        texts.append(data[place + 4 : end - 1].decode())
        place = end
    return texts, place


_NODES = tuple(role.value for role in BY_NAME["/diagnostics"].publishers)
_NAMED = {
    struct.pack("<I", len(name) + 1) + name.encode() + b"\x00": node
    for node in _NODES
    for name in (STATUS_NAMES[node], node)
}
_ONE = struct.pack("<I", 1)


def status_name(data: bytes) -> str:
    """Return the node of the graph whose name diagnostics have, "" for those of another program."""
    if data[:2] == b"\x00\x01" and data[12:17] == _ONE + b"\x00" and data[20:24] == _ONE:
        for start, name in _NAMED.items():
            if data.startswith(start, 28):
                return name
    try:
        name = decode_diagnostic(data).node
    except ValueError:
        return ""
    return name if name in _NODES else ""


def _deserialise(data: bytes, type_name: str) -> Any:
    try:
        return typestore().deserialize_cdr(data, type_name)
    except Exception as error:
        raise ValueError(f"not a {type_name} ({type(error).__name__})") from None


def _demanded(values: Sequence[float], released: float) -> tuple[int, str]:
    """Return level and text of the strongest of traction cut-off, service brake and emergency brake."""
    strongest = max((number for number, value in enumerate(values, 1) if value != released), default=0)
    return min(strongest, 1), ("released", "traction cut off", "service brake", "emergency brake")[strongest]


def _state_of_ato(values: Sequence[float]) -> tuple[int, str]:
    """Return level and text of a state of the ATO."""
    (value,) = values
    if value not in tuple(AtoState):
        return 2, "unknown"
    state = AtoState(int(value))
    return {AtoState.DISENGAGING: 1, AtoState.FAILURE: 2}.get(state, 0), state.text


class StatusCodec:
    """Codec of the states and counters of one topic: one status, with the columns of the table as keys.

    Level and text of the status repeat its values in words; a reader uses the values only.

    Parameters
    ----------
    topic
        Entry of the topic table.
    part
        Part of the node, second half of the name of the status.
    said
        Field of the dataclass with the state, and function that returns level and text for its values.
    """

    def __init__(self, topic: Topic, part: str, said: tuple[str, Callable[[Sequence[float]], tuple[int, str]]]) -> None:
        node = topic.publishers[0].value
        self._topic, self._name, self._hardware = topic, f"{node}: {part}", HARDWARE[node]
        self._state, self._words = said
        self._keys = {
            place.field: [topic.column(place, name) for name in FIXED_NAMES[place.owner]]
            for place in topic.places
            if place.owner is not None
        }
        self._texts = {field: [_text(key) for key in keys] for field, keys in self._keys.items()}
        self._known: dict[bytes, bytes] = {}
        self._last: tuple[bytes, list[float]] = b"no state yet", []
        permitted = next(topic.description(place).permitted for place in topic.places if place.field == self._state)
        choices = product(permitted, repeat=len(self._keys[self._state]))
        self._starts = sorted({self._start(choice) for choice in choices}, key=len)

    def encode(self, message: Any) -> bytes:
        """Return the CDR bytes of a message; its arrays have the keys of the table, all numbers are finite."""
        parts = [_HEAD, packed_stamp(message.stamp)]
        for field, keys in self._texts.items():
            value = getattr(message, field)
            if field == self._state and (known := self._known.get(value.tobytes())) is not None:
                parts.append(known)
                continue
            numbers = value.tolist()
            texts = (_repeated_text(repr(number).removesuffix(".0")) for number in numbers)
            pairs = b"".join(chain.from_iterable(zip(keys, texts, strict=True)))
            if field == self._state:
                pairs = self._start(numbers) + pairs
                if len(self._known) < MAX_KNOWN:
                    self._known[value.tobytes()] = pairs
            parts.append(pairs)
        return b"".join(parts)

    def _start(self, values: Sequence[float]) -> bytes:
        """Return the bytes between the stamp and the first key, for values of the state."""
        level, text = self._words(values)
        names, count = map(_text, (self._name, text, self._hardware)), sum(map(len, self._keys.values()))
        return b"".join((_text(""), _LENGTH.pack(1), bytes((level, 0, 0, 0)), *names, _LENGTH.pack(count)))

    def decode(self, data: bytes) -> Any:
        """Return the message of the bytes; a missing number is NaN in a topic without finite values.

        Raises
        ------
        ValueError
            For bytes of another type, a missing key, or a value that is no number or not finite.
        """
        fields = self._own_numbers(data) or self._numbers(data)
        if self._topic.finite:
            for field, numbers in fields.items():
                if not all(map(isfinite, numbers)):
                    found = zip(self._keys[field], numbers, strict=True)
                    wrong = ", ".join(key for key, number in found if not isfinite(number))
                    raise ValueError(f"{self._topic.name}: {wrong}: missing or not finite")
        return self._topic.message(stamp_of(data), **{field: np.array(numbers) for field, numbers in fields.items()})

    def _own_numbers(self, data: bytes) -> dict[str, list[float]] | None:
        """Return the numbers by field of a message of this codec, None for one of another program."""
        if data[:2] != _HEAD[:2]:
            return None
        found: dict[str, list[float]] = {}
        begin, state = self._last
        if data.startswith(begin, STAMP_END):
            found[self._state] = state
        else:
            begin = next((start for start in self._starts if data.startswith(start, STAMP_END)), b"")
            if not begin:
                return None
        place = STAMP_END + len(begin)
        for field, keys in self._texts.items():
            if field in found:
                continue
            numbers = found[field] = []
            for key in keys:
                if not data.startswith(key, place):
                    return None
                place += len(key) + 4
                try:
                    end = place + _LENGTH.unpack_from(data, place - 4)[0]
                    numbers.append(float(data[place : end - 1]))
                except (struct.error, ValueError):
                    return None
                place = end + -end % 4
            if field == self._state:
                self._last = data[STAMP_END:place], numbers
        return found

    def _numbers(self, data: bytes) -> dict[str, list[float]]:
        """Return the numbers by field of a message of any program."""
        try:
            said = decode_diagnostic(data).values
            return {field: [float(said.get(key, "nan")) for key in keys] for field, keys in self._keys.items()}
        except ValueError as error:
            raise ValueError(f"{self._topic.name}: {error}") from None


STATES: dict[str, StatusCodec] = {
    "train/protection": StatusCodec(
        BY_NAME["train/protection"], "protection", ("active", partial(_demanded, released=0.0))
    ),
    "atp/brake_release": StatusCodec(
        BY_NAME["atp/brake_release"], "release", ("released", partial(_demanded, released=1.0))
    ),
    "ato/state": StatusCodec(BY_NAME["ato/state"], "state", ("state", _state_of_ato)),
}
"""Codecs of states and counters by topic."""

VARIABLE: dict[type, tuple[Callable[[Any], bytes], Callable[[bytes], Any]]] = {
    Trajectory: (encode_trajectory, decode_trajectory),
    Diagnostic: (encode_diagnostic, decode_diagnostic),
    **{BY_NAME[topic].message: (codec.encode, codec.decode) for topic, codec in STATES.items()},
}
"""Encoder and decoder by the dataclass of the messages."""
