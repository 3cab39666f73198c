"""Messages of the train on its line: transforms, poses, markers, track and position fix.

Frames after REP 103 and REP 105: ``map`` is fixed at the begin of the line, x east, y north, z up; ``vehicle_I`` is at
the rail below the centre of a vehicle, x in the direction of rising distance, and ``base_link`` is that of vehicle 0.
``line``, the frame of profile and limits, is the tangent at vehicle 0 with distances along the line as x: a frame of
straight axes cannot have a curved line, and the places near the train are the ones that tools draw.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from plant_sim.alignment import Alignment, TrackPose
from train_ato.messages.cdr import SECOND, blank, layout_of, packed_stamp, stamp_of, typestore
from train_ato.messages.codec import Wire
from train_ato.messages.topics import LINE_FRAME
from train_ato.messages.types import Array, VehicleStates
from train_ato.scenario.setup import RunSetup

DEFAULT_RATE = 5.0
"""Messages per simulated second."""
MAP, BASE = "map", "base_link"
WIDTH, HEIGHT, GAP = 2.9, 3.4, 0.7
"""Size of the drawn vehicles and the gap between them [m]."""
MIN_SCALE = 50e3
"""Smallest coupler force with the full colour [N]."""
DRAFT, BUFF, NEUTRAL = (0.70, 0.09, 0.17), (0.13, 0.40, 0.67), (0.85, 0.85, 0.85)
"""Colours of draft, buff and no force (red, green, blue), distinct for colour-blind readers."""


@dataclass(frozen=True)
class SceneTopic:
    """Topic of the scene: absolute name, type, True if sent once for late subscribers."""

    name: str
    type: str
    latched: bool = False


TRANSFORMS = SceneTopic("/tf", "tf2_msgs/msg/TFMessage")
STATIC = SceneTopic("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
POSES = SceneTopic("/scene/vehicles", "geometry_msgs/msg/PoseArray")
MARKERS = SceneTopic("/scene/markers", "visualization_msgs/msg/MarkerArray")
TRACK = SceneTopic("/scene/track", "nav_msgs/msg/Path", latched=True)
FIX = SceneTopic("/scene/fix", "sensor_msgs/msg/NavSatFix")

SceneMessages = list[tuple[SceneTopic, bytes]]


class TrainScene:
    """Messages of the scene of one run.

    Parameters
    ----------
    setup
        Train and line.
    full_force
        Coupler force with the full colour [N]; None: the largest one so far.
    rate
        Messages per simulated second; states come at most once per tick.
    """

    def __init__(self, setup: RunSetup, full_force: float | None = None, rate: float = DEFAULT_RATE) -> None:
        self._wire = Wire(setup.layout)
        self._period = round(SECOND / check_rate(rate))
        self._last = -1
        self._line, self._lengths = setup.line, [vehicle.length for vehicle in setup.consist.vehicles]
        self._alignment = Alignment(setup.line)
        self._full, self._fixed = max(full_force or 0.0, MIN_SCALE), full_force is not None
        names = [f"vehicle_{number}" for number in range(len(self._lengths))]
        self._transforms = _transforms([*((MAP, name) for name in names), (names[0], LINE_FRAME)])
        self._poses = _poses(len(names))
        self._markers = _markers(self._lengths)
        self._fix = _fix() if setup.line.coordinates else None

    @property
    def topics(self) -> tuple[SceneTopic, ...]:
        """Topics of the scene; a position fix only on a line with coordinates."""
        found = (TRANSFORMS, STATIC, POSES, MARKERS, TRACK)
        return found if self._fix is None else (*found, FIX)

    def begin(self, stamp: int = 0) -> SceneMessages:
        """Return the messages that do not change: frames of the line, and the track."""
        places = {"line_begin": self._line.begin, "line_end": self._line.end}
        places |= {f"stop_{number}": stop.at for number, stop in enumerate(self._line.stops)}
        frames = _transforms([(MAP, name) for name in places] + [("vehicle_0", BASE)])
        pose = self._alignment.at(np.array([*places.values(), 0.0]))
        columns = _pose_columns(pose, "transforms[].transform.translation", "transforms[].transform.rotation")
        for path, column in columns.items():
            column[-1] = 1.0 if path.endswith("rotation.w") else 0.0
        drawn = self._alignment.at(self._alignment.drawn_places())
        path = _framed(TRACK.type, MAP)
        path.poses = [_framed("geometry_msgs/msg/PoseStamped", MAP) for _ in range(drawn.x.size)]
        track = MessageTemplate(TRACK.type, path)
        track_columns = _pose_columns(drawn, "poses[].pose.position", "poses[].pose.orientation")
        return [(STATIC, frames.encode(stamp, columns)), (TRACK, track.encode(stamp, track_columns))]

    def at(self, states: VehicleStates) -> SceneMessages:
        """Return the messages of the vehicles at one stamp."""
        pose, stamp = self._alignment.at(states.position), states.stamp
        axes, line = (pose.x, pose.y, pose.z, pose.heading, pose.slope), (-states.position[0], 0.0, 0.0, 0.0, 0.0)
        frames = TrackPose(*(np.append(column, value) for column, value in zip(axes, line, strict=True)))
        transforms = _pose_columns(frames, "transforms[].transform.translation", "transforms[].transform.rotation")
        found = [
            (TRANSFORMS, self._transforms.encode(stamp, transforms)),
            (POSES, self._poses.encode(stamp, _pose_columns(pose, "poses[].position", "poses[].orientation"))),
            (MARKERS, self._marked(stamp, pose, states.coupler_force)),
        ]
        coordinates = self._alignment.coordinates(states.position[:1])
        if self._fix is not None and coordinates is not None:
            latitude, longitude = coordinates
            found.append((FIX, self._fix.encode(stamp, {"latitude": latitude, "longitude": longitude})))
        return found

    def take(self, data: bytes) -> SceneMessages:
        """Return the messages for a state of the vehicles; none if its period has some already."""
        number = stamp_of(data) // self._period
        if number == self._last:
            return []
        self._last = number
        return self.at(self._wire.decode(VEHICLES, data))

    def _marked(self, stamp: int, pose: TrackPose, force: Array) -> bytes:
        """Return one box per vehicle in the colour of its larger coupler force."""
        if not self._fixed:
            self._full = max(self._full, float(np.abs(force).max(initial=0.0)))
        columns = _pose_columns(pose, "markers[].pose.position", "markers[].pose.orientation")
        columns["markers[].pose.position.z"] = columns["markers[].pose.position.z"] + HEIGHT / 2
        color = force_color(larger_coupler_force(force), self._full)
        floats = {f"markers[].color.{name}": color[:, number] for number, name in enumerate("rgb")}
        return self._markers.encode(stamp, columns, floats)


def larger_coupler_force(force: Array) -> Array:
    """Return for every vehicle the force of its coupler with the larger magnitude [N], from those behind it."""
    before = np.concatenate(([0.0], force[:-1]))
    return np.where(np.abs(before) > np.abs(force), before, force)


def force_color(force: Array, full: float) -> Array:
    """Return red, green and blue of forces [N], shape (n, 3): grey at 0, red for draft, blue for buff."""
    share = np.clip(np.abs(force) / full, 0.0, 1.0)[:, None]
    end = np.where((force > 0)[:, None], np.array(DRAFT), np.array(BUFF))
    return np.asarray((1.0 - share) * np.array(NEUTRAL) + share * end)


def _pose_columns(pose: TrackPose, position: str, orientation: str) -> dict[str, Array]:
    """Return the columns of poses."""
    places = {f"{position}.{axis}": column for axis, column in zip("xyz", (pose.x, pose.y, pose.z), strict=True)}
    return places | {f"{orientation}.{axis}": part for axis, part in zip("xyzw", pose.quaternion, strict=True)}


def _transforms(frames: Sequence[tuple[str, str]]) -> MessageTemplate:
    """Return the template of transforms from frames to their child frames."""
    message = blank(TRANSFORMS.type)
    for parent, child in frames:
        transform = blank("geometry_msgs/msg/TransformStamped")
        transform.header.frame_id, transform.child_frame_id = parent, child
        message.transforms.append(transform)
    return MessageTemplate(TRANSFORMS.type, message)


def _poses(count: int) -> MessageTemplate:
    message = _framed(POSES.type, MAP)
    message.poses = [blank("geometry_msgs/msg/Pose") for _ in range(count)]
    return MessageTemplate(POSES.type, message)


def _markers(lengths: Sequence[float]) -> MessageTemplate:
    """Return the template of one box per vehicle."""
    message = blank(MARKERS.type)
    for number, length in enumerate(lengths):
        marker = _framed("visualization_msgs/msg/Marker", MAP)
        marker.ns, marker.id, marker.type = "vehicles", number, 1  # CUBE
        marker.scale.x, marker.scale.y, marker.scale.z = max(length - GAP, length / 2), WIDTH, HEIGHT
        marker.color.a = 1.0
        message.markers.append(marker)
    return MessageTemplate(MARKERS.type, message)


def _fix() -> MessageTemplate:
    """Return the template of the position of vehicle 0, without altitude."""
    message = _framed(FIX.type, "vehicle_0")
    message.altitude = float("nan")
    message.status.service = 1  # GPS
    return MessageTemplate(FIX.type, message)


def _framed(type_name: str, frame: str) -> Any:
    message = blank(type_name)
    message.header.frame_id = frame
    return message


NUMBERS: dict[str, np.dtype[Any]] = {"f8": np.dtype("<f8"), "f4": np.dtype("<f4")}


class MessageTemplate:
    """Encoder of messages that differ in stamps and numbers only.

    Parameters
    ----------
    type_name
        ROS type.
    message
        Message with all texts, lengths and constants.
    """

    def __init__(self, type_name: str, message: Any) -> None:
        self.type_name = type_name
        data = bytes(typestore().serialize_cdr(message, type_name))
        self._blank = np.frombuffer(data, np.uint8)
        leaves = layout_of(typestore(), type_name, data).leaves
        self._starts = {leaf.path: leaf.start for leaf in leaves}
        stamps = [leaf.start for leaf in leaves if leaf.is_time and leaf.path.endswith("stamp")]
        self._stamps = _places(stamps, 8)
        self._columns: dict[tuple[str, str], Any] = {}

    def encode(self, stamp: int, columns: dict[str, Array], floats: dict[str, Array] | None = None) -> bytes:
        """Return the bytes of a message.

        Parameters
        ----------
        stamp
            Time of every header [ns since the start of the run].
        columns
            float64 values by path; ``[]`` in a path is the number of the entry, shape (n,).
        floats
            The same for float32.
        """
        data = self._blank.copy()
        data[self._stamps] = np.frombuffer(packed_stamp(stamp), np.uint8)
        for kind, values in (("f8", columns), ("f4", floats or {})):
            for path, column in values.items():
                places = self._column(path, kind, np.size(column))
                numbers = np.ascontiguousarray(column, NUMBERS[kind]).reshape(-1)
                data[places] = numbers.view(np.uint8).reshape(places.shape)
        return data.tobytes()

    def _column(self, path: str, kind: str, count: int) -> Any:
        """Return the places of the bytes of a column, shape (n, size)."""
        if (path, kind) not in self._columns:
            paths = [path.replace("[]", f"[{number}]") for number in range(count)] if "[]" in path else [path]
            starts = [self._starts[name] for name in paths]
            self._columns[path, kind] = _places(starts, NUMBERS[kind].itemsize)
        return self._columns[path, kind]


def _places(starts: Sequence[int], size: int) -> Any:
    return np.array(starts, dtype=np.int64)[:, None] + np.arange(size)


VEHICLES = "train/vehicles"


def check_rate(rate: float) -> float:
    """Return a rate of the scene."""
    if not 0 < rate <= 1000:
        raise ValueError(f"rate {rate:g}: is not above 0 and at most 1000; give messages per simulated second")
    return rate
