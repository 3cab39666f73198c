"""Messages of variable length as bytes: profiles, speed limits and diagnostics.

The usual ones are put together here, the general serialiser is slow on thousands of small parts; whatever does not
have that layout goes through it.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

from train_ato.cdr import SECOND, header, typestore
from train_ato.topics import EPOCH_NS
from train_ato.types import Array, Diagnostic, Trajectory

_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
_DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
_KNOT = np.dtype(
    [
        ("positions", "<u4"), ("position", "<f8"),
        ("velocities", "<u4"), ("gap_v", "<u4"), ("velocity", "<f8"),
        ("accelerations", "<u4"), ("gap_a", "<u4"), ("acceleration", "<f8"),
        ("efforts", "<u4"), ("second", "<i4"), ("nanosecond", "<u4"),
    ]
)  # fmt: skip
"""One point with one position, speed and acceleration, where it starts 4 bytes behind a multiple of 8."""


def encode_trajectory(message: Trajectory) -> bytes:
    """Return a profile or the speed limits in CDR.

    Raises
    ------
    ValueError
        If a value is not finite or the columns differ in length.
    """
    _check(message)
    start = _start_of_points(message)
    if message.acceleration.size == 0 or len(start) % 8 != 0:
        return _encode_any(message)
    knots = np.zeros(message.time.size, _KNOT)
    knots["positions"] = knots["velocities"] = knots["accelerations"] = 1
    knots["position"], knots["velocity"] = message.position, message.velocity
    knots["acceleration"] = message.acceleration
    knots["second"], knots["nanosecond"] = message.time // SECOND, message.time % SECOND
    return start + knots.tobytes()


def _start_of_points(message: Trajectory) -> bytes:
    """Return the message up to and with the number of points; 4 of its bytes are the encapsulation."""
    empty = typestore().types[_TRAJECTORY](header=header(message.stamp), joint_names=[message.name], points=[])
    data = bytes(typestore().serialize_cdr(empty, _TRAJECTORY))
    return data[:-4] + struct.pack("<I", message.time.size)


def _encode_any(message: Trajectory) -> bytes:
    types = typestore().types
    point, duration = types["trajectory_msgs/msg/JointTrajectoryPoint"], types["builtin_interfaces/msg/Duration"]
    none = np.zeros(0)
    accelerations = message.acceleration.reshape(-1, 1) if message.acceleration.size else [none] * message.time.size
    columns = (message.time.tolist(), message.position.reshape(-1, 1), message.velocity.reshape(-1, 1), accelerations)
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
    whole = types[_TRAJECTORY](header=header(message.stamp), joint_names=[message.name], points=points)
    return bytes(typestore().serialize_cdr(whole, _TRAJECTORY))


def _check(message: Trajectory) -> None:
    k = message.time.size
    for field in ("position", "velocity", "acceleration"):
        column: Array = getattr(message, field)
        if column.size != k and not (field == "acceleration" and column.size == 0):
            raise ValueError(f"trajectory '{message.name}': {column.size} values of {field} for {k} knots")
        if not np.isfinite(column).all():
            raise ValueError(f"trajectory '{message.name}': {field} is not finite")


def decode_trajectory(data: bytes) -> Trajectory:
    """Return the profile or the speed limits that the bytes hold.

    Raises
    ------
    ValueError
        If the bytes are no trajectory of one joint with finite values.
    """
    result = _decode_knots(data)
    if result is None:
        result = _decode_any(data)
    _check(result)
    return result


def _decode_knots(data: bytes) -> Trajectory | None:
    """Read a profile as it is written here; None for any other layout."""
    count, rest = divmod(len(data) - 40, _KNOT.itemsize)
    if rest or count < 1 or data[:2] != b"\x00\x01":
        return None
    knots = np.frombuffer(data, _KNOT, count, 40)
    time = knots["second"].astype(np.int64) * SECOND + knots["nanosecond"]
    name = data[28:33].decode("ascii", "replace")
    stamp = int.from_bytes(data[4:8], "little") * SECOND + int.from_bytes(data[8:12], "little") - EPOCH_NS
    columns = (np.array(knots[field]) for field in ("position", "velocity", "acceleration"))
    found = Trajectory(stamp, name, time, *columns)
    ones = all((knots[field] == 1).all() for field in ("positions", "velocities", "accelerations"))
    if ones and not knots["efforts"].any() and data[:40] == _start_of_points(found):
        return found
    return None


def _decode_any(data: bytes) -> Trajectory:
    message = _deserialise(data, _TRAJECTORY)
    if len(message.joint_names) != 1:
        raise ValueError(f"trajectory of {len(message.joint_names)} joints where one is due")
    points = message.points
    times = [point.time_from_start.sec * SECOND + point.time_from_start.nanosec for point in points]
    return Trajectory(
        int(message.header.stamp.sec) * SECOND + int(message.header.stamp.nanosec) - EPOCH_NS,
        str(message.joint_names[0]),
        np.array(times, dtype=np.int64),
        _column([point.positions for point in points]),
        _column([point.velocities for point in points]),
        _column([point.accelerations for point in points]),
    )


def _column(values: list[Array]) -> Array:
    return np.concatenate(values).astype(np.float64) if values else np.zeros(0)


def _text(out: bytearray, text: str) -> None:
    """Append a string; lengths stand at multiples of 4."""
    out += bytes(-len(out) % 4)
    raw = text.encode()
    out += struct.pack("<I", len(raw) + 1) + raw + b"\x00"


def encode_diagnostic(message: Diagnostic) -> bytes:
    """Return the state of a node in CDR, filled up to a multiple of 4 bytes as every transport does."""
    seconds, nanoseconds = divmod(EPOCH_NS + message.stamp, SECOND)
    out = bytearray(struct.pack("<iII", seconds, nanoseconds, 1) + b"\x00")  # the header's empty frame
    out += bytes(-len(out) % 4) + struct.pack("<IB", 1, message.level)
    for text in (message.node, message.message, ""):
        _text(out, text)
    out += bytes(-len(out) % 4) + struct.pack("<I", len(message.values))
    for key, value in message.values.items():
        _text(out, key)
        _text(out, value)
    return b"\x00\x01\x00\x00" + bytes(out) + bytes(-len(out) % 4)


def decode_diagnostic(data: bytes) -> Diagnostic:
    """Return the state of a node that the bytes hold.

    Raises
    ------
    ValueError
        If the bytes are no diagnostics of one node.
    """
    message = _deserialise(data, _DIAGNOSTICS)
    if len(message.status) != 1:
        raise ValueError(f"/diagnostics: {len(message.status)} nodes in one message where one is due")
    status = message.status[0]
    values = {str(pair.key): str(pair.value) for pair in status.values}
    stamp = int(message.header.stamp.sec) * SECOND + int(message.header.stamp.nanosec) - EPOCH_NS
    return Diagnostic(stamp, str(status.name), int(status.level), str(status.message), values)


def _deserialise(data: bytes, type_name: str) -> Any:
    try:
        return typestore().deserialize_cdr(data, type_name)
    except Exception as error:
        raise ValueError(f"not a {type_name} ({type(error).__name__})") from None
