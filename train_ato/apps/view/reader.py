"""Newest messages of a running graph, taken out of short queues a few times a second.

Whatever the pace of the run, a look costs the same: queues hold a few messages, readers are best effort so that no
publisher waits for them, and only the messages of one stamp are decoded.
"""

from __future__ import annotations

from collections import deque
from functools import partial
from typing import Any

import numpy as np
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from train_ato.cdr import stamp_of, typestore
from train_ato.nodes.shell import message_class
from train_ato.shape import Shape
from train_ato.topics import BY_NAME, EPOCH_NS
from train_ato.types import Diagnostic, Trajectory
from train_ato.view.moment import Moment
from train_ato.wire import Wire
from train_ato.wire_variable import decode_diagnostic, decode_trajectory

DEPTH = 4
COPIED_DEPTH = 20
TOGETHER = ("train/cars", "train/measurement", "ato/reference", "ato/command")
"""Topics that a moment is made of, all of one stamp."""
BESIDE = ("train/brake_cylinders", "train/brake_pipe", "ato/brake_pipe", "ato/estimate")
"""Topics whose newest message is good enough."""
LATCHED = ("ato/profile", "ato/limits")


class GraphReader:
    """Subscriptions on the topics of a run, without callbacks.

    Parameters
    ----------
    node
        rclpy node that no executor turns.
    shape
        Sizes of the train.

    Attributes
    ----------
    diagnostics : list of Diagnostic
        What the nodes said since the list was last emptied.
    profiles, limits : list of Trajectory
        What came since, likewise.
    newest : int
        Stamp of the newest moment [ns], -1 before the first.
    """

    def __init__(self, node: Any, shape: Shape) -> None:
        self._wire = Wire(shape)
        self._nothing = np.full(shape.n_units, np.nan)
        self._queues: dict[str, deque[tuple[int, bytes]]] = {name: deque(maxlen=DEPTH) for name in TOGETHER}
        self._latest: dict[str, bytes] = {}
        self.diagnostics: list[Diagnostic] = []
        self.profiles: list[Trajectory] = []
        self.limits: list[Trajectory] = []
        self.newest = -1
        names = [name for name in (*TOGETHER, *BESIDE) if shape.has(BY_NAME[name])]
        self._takers = {name: taker(node, name, DEPTH, reliable=False) for name in names}
        self._kept = {name: taker(node, name, 50, reliable=True) for name in (*LATCHED, "/diagnostics")}

    def poll(self) -> Moment | None:
        """Empty the queues; return the newest moment if there is a new one."""
        for name, take in self._takers.items():
            queue = self._queues.get(name)
            while (found := take()) is not None:
                if queue is None:
                    self._latest[name] = found[0]
                else:
                    queue.append((stamp_of(found[0]), found[0]))
        while (found := self._kept["/diagnostics"]()) is not None:
            self.diagnostics.append(decode_diagnostic(found[0]))
        while (found := self._kept["ato/profile"]()) is not None:
            self.profiles.append(decode_trajectory(found[0]))
        while (found := self._kept["ato/limits"]()) is not None:
            self.limits.append(decode_trajectory(found[0]))
        return self._moment()

    def forget(self) -> None:
        """Empty the lists of what came."""
        for entries in (self.diagnostics, self.profiles, self.limits):
            entries.clear()

    def _moment(self) -> Moment | None:
        """Decode the newest stamp that every topic has; where the run outpaces the looks, the newest of each."""
        if not all(self._queues.values()):
            return None
        common = set.intersection(*({stamp for stamp, _ in queue} for queue in self._queues.values()))
        stamp = max(common, default=min(queue[-1][0] for queue in self._queues.values()))
        if stamp <= self.newest:
            return None
        chosen = {
            name: next((data for at, data in queue if at == stamp), queue[-1][1])
            for name, queue in self._queues.items()
        }
        self.newest = stamp
        decode = self._wire.decode
        cars, measured, reference, command = (decode(name, chosen[name]) for name in TOGETHER)
        shoes, pipe, wanted, estimate = (self._beside(name) for name in BESIDE)
        return Moment(
            time=stamp * 1e-9,
            position=cars.position,
            velocity=cars.velocity,
            coupler=cars.coupler_force,
            shoe=None if shoes is None else shoes.shoe_force,
            applied=measured.applied,
            command=command.force,
            estimate=self._nothing if estimate is None else estimate.force,
            reference=(reference.position, reference.velocity, reference.acceleration),
            pipe=np.nan if pipe is None else pipe.pressure,
            pipe_demand=np.nan if wanted is None else wanted.pressure,
        )

    def _beside(self, name: str) -> Any:
        data = self._latest.get(name)
        return None if data is None else self._wire.decode(name, data)


Copied = tuple[str, int, bytes]
"""Topic of the table, stamp in ns since 1970, bytes."""


class Copier:
    """The newest messages of every recorded topic, as the bytes that came."""

    def __init__(self, node: Any, shape: Shape) -> None:
        topics = [topic for topic in shape.topics if topic.recorded]
        self._takers = {topic.name: taker(node, topic.name, COPIED_DEPTH, reliable=topic.latched) for topic in topics}

    def poll(self) -> list[Copied]:
        """Return what came since the last look, in the order of the stamps; at most so many of a topic as wait."""
        found = []
        for name, take in self._takers.items():
            while (message := take()) is not None:
                found.append((name, EPOCH_NS + stamp_of(message[0]), message[0]))
        return sorted(found, key=lambda entry: entry[1])


def taker(node: Any, name: str, depth: int, *, reliable: bool) -> Any:
    """Subscribe to the bytes of a topic; return what takes the next message, as (bytes, times), or None."""
    topic = BY_NAME[name]
    kind = message_class(topic.type)
    profile = QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE,
    )
    subscription = node.create_subscription(kind, name, _never, profile, raw=True)
    return partial(subscription.handle.take_message, kind, True)


def _never(data: bytes) -> None:
    raise AssertionError("the reader's node was given to an executor")


def shape_of(cars: bytes, measurement: bytes, *, air_brake: bool, disturbed: bool) -> Shape:
    """Return the sizes of a train from two messages, for a run whose scenario is not known."""
    kind = "sensor_msgs/msg/JointState"
    vehicles = typestore().deserialize_cdr(cars, kind).name
    measured = list(typestore().deserialize_cdr(measurement, kind).name)
    sensors = tuple(int(name.partition("_")[2]) for name in measured if name.startswith("coupler_"))
    units = sum(name.startswith("unit_") for name in measured)
    return Shape(len(vehicles), units, sensors, air_brake, disturbed)
