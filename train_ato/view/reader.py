"""Newest messages of a running graph, read from short queues 20 times a second.

The cost does not depend on the rate of the run: queues hold a few messages, readers are best effort so that no
publisher waits for them, and only the messages of one stamp are decoded.
"""

from collections import deque
from functools import partial
from typing import Any

import numpy as np
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from train_ato.judge import recording as rec
from train_ato.messages.cdr import stamp_of, typestore
from train_ato.messages.codec import Wire
from train_ato.messages.topic import TrainLayout
from train_ato.messages.topics import BY_NAME, EPOCH_NS, topics_of
from train_ato.messages.types import Diagnostic, Trajectory
from train_ato.ros.nodes.endpoints import message_class, placed
from train_ato.view.snapshot import Snapshot

DEPTH = 4
COPIED_DEPTH = 20
TOGETHER = (rec.TRUTH, rec.MEASUREMENT, rec.REFERENCE, rec.COMMAND)
"""Topics of a snapshot with a common stamp."""
BESIDE = (rec.BRAKE_SHOES, rec.BRAKE_PIPE, rec.BRAKE_PIPE_COMMAND, rec.ESTIMATE, rec.SUPERVISED_SPEEDS)
"""Topics of a snapshot with their newest message."""


class GraphReader:
    """Subscriptions on the topics of a run, without callbacks.

    Parameters
    ----------
    node
        rclpy node without an executor.
    layout
        Layout of the train.

    Attributes
    ----------
    diagnostics : list of Diagnostic
        Diagnostics since the last :meth:`clear`.
    profiles, limits : list of Trajectory
        Profiles and speed limits since then.
    newest : int
        Stamp of the newest snapshot [ns], -1 before the first.
    """

    def __init__(self, node: Any, layout: TrainLayout) -> None:
        self._wire = Wire(layout)
        self._nothing = np.full(layout.n_units, np.nan)
        self._queues: dict[str, deque[tuple[int, bytes]]] = {name: deque(maxlen=DEPTH) for name in TOGETHER}
        self._latest: dict[str, bytes] = {}
        self.diagnostics: list[Diagnostic] = []
        self.profiles: list[Trajectory] = []
        self.limits: list[Trajectory] = []
        self.newest = -1
        names = [name for name in (*TOGETHER, *BESIDE) if BY_NAME[name].exists(layout)]
        self._takers = {name: taker(node, name, DEPTH, reliable=False) for name in names}
        self._arrived: dict[str, list[Any]] = {
            rec.DIAGNOSTICS: self.diagnostics,
            rec.PROFILE: self.profiles,
            rec.LIMITS: self.limits,
        }
        self._kept = {name: taker(node, name, 50, reliable=True) for name in self._arrived}

    def poll(self) -> Snapshot | None:
        """Read all queues; return the newest snapshot, None if it is not new."""
        for name, take in self._takers.items():
            queue = self._queues.get(name)
            while (found := take()) is not None:
                if queue is None:
                    self._latest[name] = found[0]
                else:
                    queue.append((stamp_of(found[0]), found[0]))
        for name, take in self._kept.items():
            while (found := take()) is not None:
                self._arrived[name].append(self._wire.decode(name, found[0]))
        return self._moment()

    def clear(self) -> None:
        """Clear the lists of diagnostics, profiles and limits."""
        for entries in (self.diagnostics, self.profiles, self.limits):
            entries.clear()

    def _moment(self) -> Snapshot | None:
        """Decode the newest common stamp, or the newest message of each topic if a fast run leaves none in common."""
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
        shoes, pipe, wanted, estimate, speeds = (
            decode(name, self._latest[name]) if name in self._latest else None for name in BESIDE
        )
        return Snapshot(
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
            limits=None if speeds is None else speeds.speed[1:],
        )


Copied = tuple[str, int, bytes]
"""Topic of the table, stamp in ns since 1970, bytes."""


class Copier:
    """Reader of the serialized messages of all recorded topics."""

    def __init__(self, node: Any, layout: TrainLayout) -> None:
        topics = [topic for topic in topics_of(layout) if topic.recorded]
        self._takers = {topic.name: taker(node, topic.name, COPIED_DEPTH, reliable=topic.latched) for topic in topics}

    def poll(self) -> list[Copied]:
        """Return the messages since the last call in the order of their stamps, at most a queue of every topic."""
        found = []
        for name, take in self._takers.items():
            while (message := take()) is not None:
                found.append((name, EPOCH_NS + stamp_of(message[0]), message[0]))
        return sorted(found, key=lambda entry: entry[1])


def taker(node: Any, name: str, depth: int, *, reliable: bool) -> Any:
    """Subscribe to a topic; return a function that returns the next serialized message and its times, or None."""
    topic = BY_NAME[name]
    kind = message_class(topic.type)
    profile = QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE,
    )
    subscription = node.create_subscription(kind, placed(node, name), _never, profile, raw=True)
    return partial(subscription.handle.take_message, kind, True)


def _never(data: bytes) -> None:
    raise AssertionError("the reader's node was given to an executor")


def train_layout(cars: bytes, measurement: bytes, *, air_brake: bool, disturbed: bool, supervised: bool) -> TrainLayout:
    """Return the layout of a train from two messages, for a run with an unknown scenario."""
    kind = "sensor_msgs/msg/JointState"
    vehicles = typestore().deserialize_cdr(cars, kind).name
    measured = list(typestore().deserialize_cdr(measurement, kind).name)
    sensors = tuple(int(name.partition("_")[2]) for name in measured if name.startswith("coupler_"))
    units = sum(name.startswith("unit_") for name in measured)
    return TrainLayout(len(vehicles), units, sensors, air_brake, disturbed, supervised)
