"""Time of one tick of the composed graph compared with a bare rclpy ring, and its parts.

    python bench/composed.py [--scenario NAME] [--ticks N] [--rounds R]

The ring measures rclpy for the same exchange: five nodes in one process on the same events executor, the same topics
with the same types and sizes, published as ordinary messages with names, empty callbacks, a recorder with raw
subscriptions that discards the messages.  Both run in turns and the best round of each counts, because other load on
the machine only adds time:

    ratio = (time per tick of the graph - time of the plant) / time per tick of the ring

The goals: the ratio is below 1.5, the recorded run is 150 times as fast as the train, and a run with supervision (on a
line with speed limits) takes at most 8 % longer than the same run without, in turns too.  The floor of the last one is
the ring with a supervisor and the five topics of the supervision, compared with the ring without.  Runs with clocks
around the parts give the share of each part in the time without clocks.  The exit status is 1 if a goal is missed
widely (see figures.py).
"""

import argparse
import array
import functools
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from figures import Figure, Goal, judge, publish

from plant_sim.train import compile_kernel
from train_ato.messages.topic import Owner, TrainLayout
from train_ato.messages.topics import BY_NAME, Role
from train_ato.ros.graph.environment import applied, claim_domain, variables
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import RunSetup, prepare

MAX_RATIO = 1.5
MIN_FACTOR = 150.0
MAX_SUPERVISED = 1.08
TICKED: dict[Role, tuple[str, ...]] = {
    Role.PLANT: (
        "/clock", "train/vehicles", "train/brake_pipe", "train/brake_pipe_tail", "train/brake_shoes",
        "train/measurement",
    ),
    Role.PROFILE: ("ato/reference",),
    Role.OBSERVER: ("ato/estimate",),
    Role.CONTROLLER: ("ato/brake_pipe_command", "ato/command"),
}  # fmt: skip
SUPERVISED: dict[Role, tuple[str, ...]] = {
    Role.PLANT: ("train/odometry", "train/protection"),
    Role.SUPERVISOR: ("atp/speeds", "atp/brake_release"),
    Role.CONTROLLER: ("ato/state",),
}


def messages_of(layout: TrainLayout) -> dict[str, Any]:
    """Return one ordinary ROS message for every topic of a tick, with the names and sizes of a run."""
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import FluidPressure, JointState
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    def joints(names: tuple[str, ...], *fields: str) -> Any:
        zeros = array.array("d", np.zeros(len(names)).tobytes())
        return JointState(name=list(names), **dict.fromkeys(fields, zeros))

    state = ("position", "velocity", "effort")
    point = JointTrajectoryPoint(positions=[0.0], velocities=[0.0], accelerations=[0.0])
    return {
        "/clock": Clock(),
        "train/vehicles": joints(layout.names(Owner.VEHICLE), *state),
        "train/measurement": joints(BY_NAME["train/measurement"].names(layout), *state),
        "train/brake_pipe": FluidPressure(),
        "train/brake_pipe_tail": FluidPressure(),
        "train/brake_shoes": joints(layout.names(Owner.VEHICLE), "effort"),
        "ato/reference": JointTrajectory(joint_names=["train"], points=[point]),
        "ato/estimate": joints(layout.names(Owner.UNIT), "effort"),
        "ato/command": joints(layout.names(Owner.UNIT), "effort"),
        "ato/brake_pipe_command": FluidPressure(),
        **{name: _supervised(layout, name) for names in SUPERVISED.values() for name in names},
    }


def _supervised(layout: TrainLayout, name: str) -> Any:
    """Return a message of a topic of the supervisor with numbers 0."""
    from rclpy.serialization import deserialize_message

    from train_ato.messages.codec import Wire
    from train_ato.ros.nodes.endpoints import message_class

    topic = BY_NAME[name]
    zeros = {place.field: np.zeros(len(layout.names(place.owner))) for place in topic.places[::-1] if place.owner}
    return deserialize_message(Wire(layout).encode(name, topic.message(0, **zeros)), message_class(topic.type))


class Ring:
    """Nodes with the exchange of a tick and no content: the publishers, and the order of the messages.

    Parameters
    ----------
    layout
        Names of the train.
    nodes
        ROS node of each role.
    ticks
        Number of ticks.
    period
        Ticks between two steps of the supervisor; 0: no supervisor.
    """

    def __init__(self, layout: TrainLayout, nodes: dict[Role, Any], ticks: int, period: int) -> None:
        from train_ato.ros.nodes.endpoints import quality_of_service

        self.tick = 0
        self._ticks, self._period = ticks, period
        self._due = {"command": 0, "tick": 0}
        self._sent = {role: [name for name in TICKED[role] if BY_NAME[name].exists(layout)] for role in TICKED}
        self._supervised = SUPERVISED if period else {}
        self._send: dict[str, Callable[[], None]] = {}
        self.publishers = []
        messages = messages_of(layout)
        topics = [(role, name) for group in (self._sent, self._supervised) for role in group for name in group[role]]
        for role, name in topics:
            publisher = nodes[role].create_publisher(type(messages[name]), name, quality_of_service(BY_NAME[name]))
            self.publishers.append(publisher)
            self._send[name] = functools.partial(publisher.publish, messages[name])
        for role, name, callback in [*self._callbacks(), *((Role.RECORDER, name, nothing) for _, name in topics)]:
            if name in self._send:
                qos, raw = quality_of_service(BY_NAME[name]), role is Role.RECORDER
                nodes[role].create_subscription(type(messages[name]), name, callback, qos, raw=raw)

    def _callbacks(self) -> list[tuple[Role, str, Callable[[Any], None]]]:
        return [
            (Role.PROFILE, "train/measurement", lambda _: self._publish(Role.PROFILE)),
            (Role.OBSERVER, "train/measurement", lambda _: self._publish(Role.OBSERVER)),
            (Role.CONTROLLER, "train/measurement", nothing),
            (Role.CONTROLLER, "ato/reference", self._on_input),
            (Role.CONTROLLER, "ato/estimate", self._on_input),
            (Role.PLANT, "ato/command", self._on_answer),
            (Role.PLANT, "ato/brake_pipe_command", nothing),
            (Role.SUPERVISOR, "train/odometry", lambda _: self._publish(Role.SUPERVISOR)),
            (Role.CONTROLLER, "train/protection", self._on_input),
            (Role.CONTROLLER, "atp/speeds", self._on_input),
            (Role.PLANT, "atp/brake_release", self._on_answer),
            (Role.PROFILE, "ato/state", nothing),
        ]

    @property
    def _is_supervised(self) -> bool:
        return self._period > 0 and self.tick % self._period == 0

    def _publish(self, role: Role) -> None:
        for name in [*(self._supervised.get(role, ()) if self._is_supervised else ()), *self._sent.get(role, ())]:
            self._send[name]()

    def begin(self) -> None:
        """Send the messages of the plant that begin a tick."""
        self._due = {"command": 4, "tick": 2} if self._is_supervised else {"command": 2, "tick": 1}
        self._publish(Role.PLANT)

    def _on_input(self, _: Any) -> None:
        self._due["command"] -= 1
        if self._due["command"] == 0:
            self._publish(Role.CONTROLLER)

    def _on_answer(self, _: Any) -> None:
        self._due["tick"] -= 1
        if self._due["tick"] == 0:
            self.tick += 1
            if self.tick < self._ticks:
                self.begin()


def nothing(_: Any) -> None:
    """Take a message without any work."""


def ring(layout: TrainLayout, domain: int, ticks: int, period: int = 0) -> float:
    """Return the time of one tick of the bare ring [s]; the parameters are those of :class:`Ring`."""
    from rclpy.node import Node

    from train_ato.ros.graph.assembly import executor_of

    roles = (*TICKED, *(SUPERVISED if period else ()), Role.RECORDER)
    with executor_of(domain) as (context, executor):
        nodes = {role: Node(role.value, context=context, enable_rosout=False) for role in dict.fromkeys(roles)}
        bare = Ring(layout, nodes, ticks, period)
        for node in nodes.values():
            executor.add_node(node)
        while any(publisher.get_subscription_count() == 0 for publisher in bare.publishers):
            executor.spin_once(timeout_sec=0.01)
        begin = time.perf_counter()
        bare.begin()
        while bare.tick < ticks:
            executor.spin_for(0.003)
        return (time.perf_counter() - begin) / ticks


def graph(setup: RunSetup, domain: int) -> float:
    """Return the time of one tick of the recorded graph in lockstep [s]."""
    from train_ato.ros.graph.composed import run_composed
    from train_ato.ros.graph.graph_result import GraphOptions

    with tempfile.TemporaryDirectory() as folder:
        end = run_composed(setup, Path(folder), domain, GraphOptions())
    if end.failure is not None:
        raise RuntimeError(end.failure)
    return end.wall_s / end.ticks


class Clocks:
    """Sum of the time in functions, each without the clocked functions that it calls."""

    def __init__(self) -> None:
        self.seconds: Counter[str] = Counter()
        self._inner = [0.0]
        self._undo: list[tuple[Any, str, Any]] = []

    def on(self, owner: Any, name: str, part: str) -> None:
        """Measure the time of a method under the name of a part."""
        original = getattr(owner, name)

        def clocked(*arguments: Any, **named: Any) -> Any:
            self._inner.append(0.0)
            begin = time.perf_counter()
            try:
                return original(*arguments, **named)
            finally:
                took = time.perf_counter() - begin
                self.seconds[part] += took - self._inner.pop()
                self._inner[-1] += took

        self._undo.append((owner, name, original))
        setattr(owner, name, clocked)

    def off(self) -> None:
        """Restore the methods."""
        for owner, name, original in reversed(self._undo):
            setattr(owner, name, original)


def parts(setup: RunSetup, domain: int) -> dict[str, float]:
    """Return the time of one tick by part [s], the clocks included."""
    from train_ato.loop.controller import ControllerStage
    from train_ato.loop.observer import ObserverStage
    from train_ato.loop.plant import PlantStage
    from train_ato.loop.profile import ProfileStage
    from train_ato.messages.codec import TopicRecord
    from train_ato.messages.variable_codec import StatusCodec
    from train_ato.ros.nodes.endpoints import NodeEndpoints
    from train_ato.ros.nodes.recorder import RecorderNode

    clocks = Clocks()
    clocks.on(PlantStage, "act", "plant")
    clocks.on(PlantStage, "observe", "plant")
    clocks.on(ControllerStage, "receive", "law")
    clocks.on(ControllerStage, "command", "law")
    clocks.on(ObserverStage, "on_measurement", "observer")
    clocks.on(ProfileStage, "on_measurement", "profile")
    for codec in (TopicRecord, StatusCodec):
        clocks.on(codec, "encode", "messages: encode")
    clocks.on(NodeEndpoints, "publish", "messages: publish")
    clocks.on(RecorderNode, "poll", "recorder")
    try:
        whole = graph(setup, domain)
    finally:
        clocks.off()
    found = {part: seconds / setup.ticks for part, seconds in clocks.seconds.items()}
    found["messages: receive, executor"] = whole - sum(found.values())
    return found


def main() -> int:
    """Measure and print; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--scenario", default="daqin_heavy_haul")
    parser.add_argument("--ticks", type=int, default=2500)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    scenario, _ = load_scenario(options.scenario)
    seconds = options.ticks * scenario.tick
    setup = prepare(*load_scenario(options.scenario, (f"duration={seconds!r}",)))
    plain = prepare(*load_scenario(options.scenario, (f"duration={seconds!r}", "supervision.enabled=false")))
    compile_kernel()
    with claim_domain() as domain, tempfile.TemporaryDirectory() as logs, applied(variables(domain, Path(logs))):
        period = setup.supervision_ticks if setup.layout.supervised else 0
        rounds = [
            (
                ring(setup.layout, domain, options.ticks),
                ring(setup.layout, domain, options.ticks, period),
                graph(setup, domain),
                graph(plain, domain),
            )
            for _ in range(options.rounds)
        ]
        shares = min((parts(setup, domain) for _ in range(2)), key=lambda entry: sum(entry.values()))
    bare, supervised, ours, unsupervised = (min(column) for column in zip(*rounds, strict=True))
    clocked = sum(shares.values())
    shares = {part: seconds * ours / clocked for part, seconds in shares.items()}
    publish(
        Figure("tick of the graph", ours * 1e6, "us", "bare rclpy ring", bare * 1e6),
        Figure("tick of the graph without supervision", unsupervised * 1e6, "us", "bare rclpy ring", bare * 1e6),
        Figure("ring with supervision", supervised * 1e6, "us", "bare rclpy ring", bare * 1e6),
        *(Figure(f"tick of the graph, {part}", seconds * 1e6, "us") for part, seconds in shares.items()),
    )
    goals = [
        Goal("graph without the plant over the bare ring", (ours - shares["plant"]) / bare, MAX_RATIO),
        Goal("simulated over wall time", setup.tick / ours, MIN_FACTOR, at_least=True),
    ]
    if setup.layout.supervised:
        goals.append(Goal("graph with supervision over the graph without", ours / unsupervised, MAX_SUPERVISED))
    return judge(goals)


if __name__ == "__main__":
    sys.exit(main())
