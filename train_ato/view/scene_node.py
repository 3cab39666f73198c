"""Node ``scene``: publishes the scene of a running graph or of a replay, outside of the lockstep.

In the namespace of a train all its topics are there, also ``/tf``, so that the frames of two trains do not collide.

It reads the states of the vehicles as best effort from a short queue, so that no publisher waits for it, at most 20
times a second of wall time.  A topic whose message package is not installed is left out; ``tf2_msgs`` is not among the
wheels.
"""

import sys
import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from train_ato.ros.graph.assembly import executor_of
from train_ato.ros.graph.wait_note import WaitNote
from train_ato.ros.nodes.endpoints import message_class, placed
from train_ato.view.reader import taker
from train_ato.view.train_scene import VEHICLES, SceneMessages, SceneTopic, TrainScene

TURN_S = 0.05
"""Period of reading the queue [s of wall time]."""
DEPTH = 4
LATCHED_DEPTH = 1


class SceneNode:
    """ROS node that publishes the scene.

    Parameters
    ----------
    node
        rclpy node without an executor.
    scene
        Scene of the run.

    Attributes
    ----------
    counts : dict
        Number of published messages by the name of the topic in the graph.
    left_out : tuple of str
        Topics whose message package is not installed.
    """

    def __init__(self, node: Any, scene: TrainScene) -> None:
        self._node, self._scene = node, scene
        self._take = taker(node, VEHICLES, DEPTH, reliable=False)
        topics = scene.topics
        self._names = {topic.name: str(node.resolve_topic_name(placed(node, topic.name))) for topic in topics}
        self._publishers = {topic.name: _publisher(node, topic) for topic in topics}
        self.left_out = tuple(self._names[name] for name, publisher in self._publishers.items() if publisher is None)
        self.counts = {name: 0 for name in self._names.values() if name not in self.left_out}
        self._met = False
        self._publish(scene.begin())

    def poll(self) -> None:
        """Publish the scene for the newest state in the queue, if its period has none yet."""
        newest = None
        while (found := self._take()) is not None:
            newest = found[0]
        if newest is not None:
            self._publish(self._scene.take(newest))

    def _publish(self, messages: SceneMessages) -> None:
        for topic, data in messages:
            publisher = self._publishers[topic.name]
            if publisher is not None:
                publisher.publish(data)
                self.counts[self._names[topic.name]] += 1

    @property
    def awaited(self) -> str:
        """Topic without a publisher, and the namespaces that have one; "" after the first publisher."""
        if self._met:
            return ""
        found = [name for name, _ in self._node.get_topic_names_and_types() if name.endswith(f"/{VEHICLES}")]
        spaces = [space for name in found if (space := name.removesuffix(f"/{VEHICLES}"))]
        awaited = self._node.resolve_topic_name(VEHICLES)
        others = [space for space in spaces if f"{space}/{VEHICLES}" != awaited]
        return f"a publisher of {awaited}" + "".join(f"; --namespace {space} has one" for space in others)

    @property
    def left(self) -> bool:
        """True if the states of the vehicles had a publisher and have none any more."""
        there = self._node.count_publishers(VEHICLES) > 0
        self._met = self._met or there
        return self._met and not there


def _publisher(node: Any, topic: SceneTopic) -> Any:
    """Return the publisher of a topic, None if its message package is not installed."""
    try:
        kind = message_class(topic.type)
    except ImportError:
        return None
    latched = DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE
    profile = QoSProfile(depth=LATCHED_DEPTH, reliability=ReliabilityPolicy.RELIABLE, durability=latched)
    return node.create_publisher(kind, placed(node, topic.name), profile)


def publish_scene(
    scene: TrainScene, domain: int, interrupted: Callable[[], bool], namespace: str = ""
) -> dict[str, int]:
    """Publish the scene of the train in a namespace until the publisher of its states leaves, or Ctrl-C."""
    with executor_of(domain, []) as (context, _):
        node = Node("scene", context=context, namespace=namespace, enable_rosout=False, start_parameter_services=False)
        try:
            running = SceneNode(node, scene)
            if running.left_out:
                sys.stderr.write(f"scene: without {', '.join(running.left_out)}: tf2_msgs is not installed\n")
            note = WaitNote()
            while not interrupted() and not running.left:
                if awaited := running.awaited:
                    note(awaited)
                running.poll()
                time.sleep(TURN_S)
            return running.counts
        finally:
            node.destroy_node()
