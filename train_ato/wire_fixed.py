"""Messages of fixed layout as bytes: everything that is sent every tick."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from train_ato.cdr import SECOND, Template, header, time_message, typestore
from train_ato.shape import Shape
from train_ato.topics import EPOCH_NS
from train_ato.types import (
    Array,
    BrakeCylinders,
    CarStates,
    Command,
    Disturbance,
    DisturbanceEstimate,
    Measurement,
    Pipe,
    Reference,
    Tick,
)

_SMALL = 16
_DURATION = struct.Struct("<iI")


def _joint_state(names: Sequence[str], fields: Sequence[str]) -> Callable[[int, Sequence[Array]], Any]:
    """Return a maker of JointState messages whose ``fields`` are filled, the others empty."""

    def make(stamp: int, blocks: Sequence[Array]) -> Any:
        filled = dict(zip(fields, blocks, strict=True))
        arrays = {field: filled.get(field, np.zeros(0)) for field in ("position", "velocity", "effort")}
        return typestore().types["sensor_msgs/msg/JointState"](header=header(stamp), name=list(names), **arrays)

    return make


def _fluid_pressure(stamp: int, blocks: Sequence[Array]) -> Any:
    kind = typestore().types["sensor_msgs/msg/FluidPressure"]
    return kind(header=header(stamp), fluid_pressure=float(blocks[0][0]), variance=0.0)


def _clock(stamp: int, blocks: Sequence[Array]) -> Any:
    return typestore().types["rosgraph_msgs/msg/Clock"](clock=time_message(stamp))


def _one_point(stamp: int, blocks: Sequence[Array]) -> Any:
    types = typestore().types
    point = types["trajectory_msgs/msg/JointTrajectoryPoint"](
        positions=blocks[0],
        velocities=blocks[1],
        accelerations=blocks[2],
        effort=np.zeros(0),
        time_from_start=types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0),
    )
    return types["trajectory_msgs/msg/JointTrajectory"](header=header(stamp), joint_names=["train"], points=[point])


def _foreign(template: Template, fields: Sequence[str], names: Sequence[str], data: bytes) -> tuple[int, list[Array]]:
    """Read a message of another publisher: any padding and byte order, but the right names and lengths."""
    try:
        message = typestore().deserialize_cdr(data, template.type_name)
    except Exception as error:
        raise ValueError(f"not a {template.type_name} ({type(error).__name__})") from None
    holder = message
    if template.type_name.endswith("JointTrajectory"):
        if len(message.points) != 1:
            raise ValueError(f"{len(message.points)} points where one is due")
        holder = message.points[0]
    elif template.type_name.endswith("JointState") and list(message.name) != list(names):
        raise ValueError(f"names {list(message.name)[:3]}... where {list(names)[:3]}... ({len(names)}) are due")
    time = message.clock if hasattr(message, "clock") else message.header.stamp
    blocks = [np.atleast_1d(np.asarray(getattr(holder, field), dtype=np.float64)) for field in fields]
    for field, block, size in zip(fields, blocks, template.sizes, strict=True):
        if block.size != size:
            raise ValueError(f"{field} has {block.size} values where {size} are due")
    return time.sec * SECOND + time.nanosec - EPOCH_NS, blocks


def _finite(block: Array) -> bool:
    if block.size <= _SMALL:
        return all(map(math.isfinite, block.tolist()))
    return bool(np.isfinite(block).all())


@dataclass(frozen=True)
class ArrayCodec:
    """One fixed-layout topic: how its dataclass is split into blocks and put together again."""

    topic: str
    template: Template
    fields: tuple[str, ...]
    names: tuple[str, ...]
    split: Callable[[Any], Sequence[Array]]
    join: Callable[[int, list[Array]], Any]
    checked: bool = True

    def encode(self, message: Any) -> bytes:
        """Return the CDR bytes of a message."""
        blocks = self.split(message)
        for field, block in zip(self.fields, blocks, strict=True):
            if block.dtype.char != "d":
                raise ValueError(f"{self.topic}: {field} is {block.dtype}, not float64")
            if self.checked and not _finite(block):
                raise ValueError(f"{self.topic}: {field} is not finite: {block[~np.isfinite(block)][0]}")
        try:
            return self.template.fill(message.stamp, blocks)
        except ValueError as error:
            raise ValueError(f"{self.topic}: {error}") from None

    def decode(self, data: bytes) -> Any:
        """Return the message that the bytes hold."""
        found = self.template.read(data)
        if found is None:
            try:
                found = _foreign(self.template, self.fields, self.names, data)
            except ValueError as error:
                raise ValueError(f"{self.topic}: {error}") from None
        stamp, blocks = found
        if self.checked:
            for field, block in zip(self.fields, blocks, strict=True):
                if not _finite(block):
                    raise ValueError(f"{self.topic}: {field} is not finite: {block[~np.isfinite(block)][0]}")
        return self.join(stamp, blocks)


@dataclass(frozen=True)
class ScalarCodec:
    """One topic of single values: the same without arrays, in half the time."""

    topic: str
    template: Template
    fields: tuple[str, ...]
    split: Callable[[Any], Sequence[float]]
    join: Callable[[int, list[float]], Any]

    def encode(self, message: Any) -> bytes:
        """Return the CDR bytes of a message."""
        values = self.split(message)
        self.check(values)
        return self.template.fill_floats(message.stamp, values)

    def decode(self, data: bytes) -> Any:
        """Return the message that the bytes hold."""
        found = self.template.read_floats(data)
        if found is None:
            try:
                stamp, blocks = _foreign(self.template, self.fields, (), data)
            except ValueError as error:
                raise ValueError(f"{self.topic}: {error}") from None
            found = stamp, [float(block[0]) for block in blocks]
        self.check(found[1])
        return self.join(*found)

    def check(self, values: Sequence[float]) -> None:
        """Refuse values that are not finite."""
        for field, value in zip(self.fields, values, strict=True):
            if not math.isfinite(value):
                raise ValueError(f"{self.topic}: {field} is not finite: {value}")


@dataclass(frozen=True)
class ReferenceCodec:
    """The reference: single values, and behind them when its profile was planned, the last 8 bytes of the message."""

    point: ScalarCodec

    @property
    def topic(self) -> str:
        """Name of the topic."""
        return self.point.topic

    def encode(self, message: Reference) -> bytes:
        """Return the CDR bytes of a message."""
        return self.point.encode(message)[:-8] + _DURATION.pack(*divmod(message.planned, SECOND))

    def decode(self, data: bytes) -> Reference:
        """Return the message that the bytes hold."""
        found = self.point.template.read_floats(data[:-8] + _DURATION.pack(0, 0))
        if found is None:  # another publisher's padding or byte order
            message: Reference = self.point.decode(data)
            planned = typestore().deserialize_cdr(data, self.point.template.type_name).points[0].time_from_start
            return replace(message, planned=planned.sec * SECOND + planned.nanosec)
        self.point.check(found[1])
        seconds, nanoseconds = _DURATION.unpack_from(data, len(data) - 8)
        stamp, (position, velocity, acceleration) = found
        return Reference(stamp, position, velocity, acceleration, seconds * SECOND + nanoseconds)


def _both(first: Array, second: Array) -> Array:
    return np.concatenate((first, second)) if second.size else first


def _force(message: DisturbanceEstimate | Command) -> Sequence[Array]:
    return (message.force,)


def scalar_codecs() -> list[ScalarCodec | ReferenceCodec]:
    """Return the codecs of the topics with single values."""
    pipe = Template("sensor_msgs/msg/FluidPressure", _fluid_pressure, (1,))
    tick = Template("rosgraph_msgs/msg/Clock", _clock, ())
    point = Template("trajectory_msgs/msg/JointTrajectory", _one_point, (1, 1, 1))
    moves = ("positions", "velocities", "accelerations")
    codecs: list[ScalarCodec | ReferenceCodec] = [
        ReferenceCodec(
            ScalarCodec(
                "ato/reference",
                point,
                moves,
                lambda m: (m.position, m.velocity, m.acceleration),
                lambda t, v: Reference(t, v[0], v[1], v[2]),
            )
        )
    ]
    pipes = ("train/brake_pipe", "ato/brake_pipe")
    codecs += [ScalarCodec(name, pipe, ("fluid_pressure",), _pressure, _pipe) for name in pipes]
    codecs += [ScalarCodec(name, tick, (), _nothing, _tick) for name in ("/clock", "record/acknowledged")]
    return codecs


def _pressure(message: Pipe) -> Sequence[float]:
    return (message.pressure,)


def _pipe(stamp: int, values: list[float]) -> Pipe:
    return Pipe(stamp, values[0])


def _nothing(message: Tick) -> Sequence[float]:
    return ()


def _tick(stamp: int, values: list[float]) -> Tick:
    return Tick(stamp)


def array_codecs(shape: Shape) -> list[ArrayCodec]:
    """Return the codecs of the topics with arrays, for a train of this shape."""
    n, u, s = shape.n_vehicles, shape.n_units, len(shape.sensors)
    state, js = ("position", "velocity", "effort"), "sensor_msgs/msg/JointState"
    force = Template(js, _joint_state(shape.units, ("effort",)), (u,))
    seen = shape.units + shape.couplers
    codecs = [
        ArrayCodec(
            "train/cars", Template(js, _joint_state(shape.cars, state), (n, n, n)), state, shape.cars,
            lambda m: (m.position, m.velocity, m.coupler_force), lambda t, b: CarStates(t, *b), checked=False,
        ),
        ArrayCodec(
            "train/measurement", Template(js, _joint_state(seen, state), (u + s,) * 3), state, seen,
            lambda m: (_both(m.position, m.deflection), _both(m.velocity, m.rate), _both(m.applied, m.force)),
            lambda t, b: Measurement(t, b[0][:u], b[1][:u], b[2][:u], b[0][u:], b[1][u:], b[2][u:]),
        ),
        ArrayCodec(
            "train/disturbance", Template(js, _joint_state(shape.cars, ("effort",)), (n,)), ("effort",),
            shape.cars, lambda m: (m.force,), lambda t, b: Disturbance(t, b[0]), checked=False,
        ),
        ArrayCodec(
            "train/brake_cylinders", Template(js, _joint_state(shape.cars, ("effort",)), (n,)), ("effort",),
            shape.cars, lambda m: (m.shoe_force,), lambda t, b: BrakeCylinders(t, b[0]), checked=False,
        ),
    ]  # fmt: skip
    codecs += [
        ArrayCodec("ato/estimate", force, ("effort",), shape.units, _force, lambda t, b: DisturbanceEstimate(t, b[0])),
        ArrayCodec("ato/command", force, ("effort",), shape.units, _force, lambda t, b: Command(t, b[0])),
    ]
    return codecs
