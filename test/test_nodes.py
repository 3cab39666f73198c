"""Nodes in one process: answers, refusals and the text of failures."""

from __future__ import annotations

import dataclasses
import gc
from contextlib import ExitStack

import numpy as np
import pytest

pytest.importorskip("rclpy")

from rcl_interfaces.srv import DescribeParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from recordings import message_counts
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from waiting import LOOK_S, wait_for

from train_ato.log.reading import read_log
from train_ato.loop.controller import ControllerStage
from train_ato.loop.observer import ObserverStage
from train_ato.loop.plant import PlantStage
from train_ato.loop.profile import ProfileStage
from train_ato.loop.setup import prepare
from train_ato.loop.stamp_synchronizer import StampSynchronizer
from train_ato.messages.codec.codec import Wire
from train_ato.messages.topics import BY_NAME, EPOCH_NS, TOPICS, Role, read_by
from train_ato.messages.types import Command, Reference, Tick, Trajectory
from train_ato.ros.graph.assembly import executor_of, make_node
from train_ato.ros.graph.composed import run_composed
from train_ato.ros.graph.environment import claim_domain
from train_ato.ros.graph.graph_result import GraphOptions
from train_ato.ros.graph.runner import run_graph
from train_ato.ros.nodes.controller import ControllerNode
from train_ato.ros.nodes.endpoints import ROLES, FirstFailure, NodeEndpoints, quality_of_service
from train_ato.ros.nodes.plant import LEAD, PlantNode, silent_node
from train_ato.scenario.scenario import load_scenario

TICK = 100_000_000


@pytest.fixture(scope="module")
def setup():
    return prepare(*load_scenario("demo", ("duration=12",)))


@pytest.fixture
def domain():
    with claim_domain() as held:
        yield held


class Bench:
    """Node of the graph on an executor, and a plain node in the role of the others."""

    def __init__(self, stack, role, setup, domain, arguments=None, **options):
        self.context, self.executor = stack.enter_context(executor_of(domain, arguments))
        self.watch = FirstFailure()
        self.wire = Wire(setup.layout)
        self.endpoints = NodeEndpoints(role, self.wire, self.context, self.watch, ROLES[:-1], arguments)
        recorded = options.pop("recorded", False)
        self.node = make_node(role, setup, self.endpoints, None, options.get("realtime"), 10.0, recorded)
        self.other = Node("other", context=self.context, enable_rosout=False, start_parameter_services=False)
        self.executor.add_node(self.endpoints.node)
        self.executor.add_node(self.other)
        self.heard = {}

    def listen(self, *names):
        for name in names:
            self.heard[name] = []
            kind = __import__(BY_NAME[name].type.split("/")[0], fromlist=["msg"])
            message_type = getattr(__import__(f"{kind.__name__}.msg", fromlist=["x"]), BY_NAME[name].type.split("/")[2])
            self.other.create_subscription(
                message_type,
                name,
                lambda data, name=name: self.heard[name].append(self.wire.decode(name, data)),
                quality_of_service(BY_NAME[name]),
                raw=True,
            )

    def speaker(self, name, node=None):
        message_type = getattr(
            __import__(f"{BY_NAME[name].type.split('/')[0]}.msg", fromlist=["x"]), BY_NAME[name].type.split("/")[2]
        )
        publisher = (node or self.other).create_publisher(message_type, name, quality_of_service(BY_NAME[name]))
        self.until(lambda: publisher.get_subscription_count() > 0)
        return publisher

    def until(self, condition):
        """Run callbacks until a condition holds."""
        wait_for(condition, turn=lambda: self.executor.spin_once(timeout_sec=LOOK_S))

    def settle(self, turns=10):
        """Run callbacks until messages in flight have arrived."""
        for _ in range(turns):
            self.executor.spin_once(timeout_sec=0.01)

    def call(self, kind, name, **request):
        client = self.other.create_client(kind, name)
        self.until(client.service_is_ready)
        future = client.call_async(kind.Request(**request))
        self.until(future.done)
        return future.result()


@pytest.fixture
def make(setup, domain):
    with ExitStack() as stack:
        yield lambda role, **options: Bench(stack, role, options.pop("setup", setup), domain, **options)


def test_synchronizer_lets_every_stamp_through_once():
    """Breaks if stamps are mixed, a stamp passes twice, or an overtaken stamp blocks."""
    inputs = StampSynchronizer()
    inputs.put("profile", Trajectory(0, "train", *(np.zeros(2) for _ in range(4))))

    def put(kind, stamp):
        message = Reference(stamp, 0.0, 0.0, 0.0) if kind == "reference" else Tick(stamp)
        ready = inputs.put(kind, message)
        assert all({step.measurement.stamp, step.reference.stamp} == {step.estimate.stamp} for step in ready)
        return [step.estimate.stamp for step in ready]

    assert put("measurement", 0) == put("estimate", 0) == []
    assert put("reference", 5) == []
    assert put("measurement", 0) == []
    assert put("reference", 0) == [0]
    assert put("reference", 0) == []
    assert put("measurement", 5) == []
    assert put("estimate", 5) == [5]
    assert put("estimate", 3) == []
    assert inputs.ignored == 3
    assert put("measurement", 7) == put("reference", 7) == []
    assert put("measurement", 8) == put("reference", 8) == []
    assert put("estimate", 8) == [8]
    assert put("estimate", 7) == []


def test_synchronizer_refuses_answers_beyond_the_step_that_is_due():
    """Fails if an early message replaces the valid one."""
    inputs = StampSynchronizer(ahead=10)
    inputs.put("profile", Trajectory(0, "train", *(np.zeros(2) for _ in range(4))))
    assert inputs.put("estimate", Tick(20)) == []
    assert inputs.put("measurement", Tick(0)) == []
    assert inputs.put("estimate", Tick(20)) == []
    assert inputs.ignored == 2
    assert inputs.put("estimate", Tick(10)) == inputs.put("reference", Reference(0, 0.0, 0.0, 0.0)) == []
    assert len(inputs.put("estimate", Tick(0))) == 1
    assert inputs.ignored == 2


@pytest.mark.parametrize(
    ("last", "blocked", "named"),
    [
        ({Role.PROFILE: 4, Role.OBSERVER: 5, Role.CONTROLLER: 4}, False, Role.PROFILE),
        ({Role.PROFILE: 5, Role.OBSERVER: 4, Role.CONTROLLER: 4}, False, Role.OBSERVER),
        ({Role.PROFILE: 5, Role.OBSERVER: 5, Role.CONTROLLER: 4}, False, Role.CONTROLLER),
        ({Role.PROFILE: 4, Role.OBSERVER: 4, Role.CONTROLLER: 4}, True, Role.RECORDER),
        ({}, False, Role.PROFILE),
    ],
)
def test_the_first_node_without_an_answer_is_named(last, blocked, named):
    assert silent_node(last, 5, blocked) is named


@pytest.mark.parametrize("role", [Role.PLANT, Role.CONTROLLER])
def test_endpoints_are_those_of_the_table(make, role, setup):
    """Fails if a node publishes or reads other topics than those of the table."""
    bench = make(role)
    own = {
        (name, kind)
        for kind, found in (
            ("out", bench.endpoints.node.get_publisher_names_and_types_by_node(role.value, "/")),
            ("in", bench.endpoints.node.get_subscriber_names_and_types_by_node(role.value, "/")),
        )
        for name, _ in found
    }
    table = {(f"/{t.name.lstrip('/')}", "out") for t in TOPICS if role in t.publishers and t.exists(setup.layout)}
    table |= {(f"/{t.name.lstrip('/')}", "in") for t in read_by(role) if t.exists(setup.layout)}
    assert own - {("/parameter_events", "out")} == table


def test_a_composed_run_records_every_message(setup, tmp_path):
    out = tmp_path / "run"
    out.mkdir()
    seen = []
    outcome = run_graph(setup, out, mode="composed", progress=seen.append)
    assert outcome.failure is None
    assert not outcome.interrupted
    recorded = {name.lstrip("/"): count for name, count in message_counts(out).items()}
    published = {name.lstrip("/"): n for name, n in outcome.published.items() if n and BY_NAME[name].recorded}
    assert recorded == published
    assert recorded["train/vehicles"] == setup.ticks + 1
    assert recorded["ato/command"] == setup.ticks
    assert outcome.published["recorder/progress"] == (setup.ticks + 1) // 100
    assert sorted(path.name for path in out.iterdir()) == ["metadata.yaml", "run.mcap"]


@pytest.mark.parametrize(
    ("role", "target"), [("profile", ProfileStage), ("observer", ObserverStage), ("controller", ControllerStage)]
)
def test_a_node_that_fails_is_named_and_the_log_is_closed(role, target, setup, tmp_path, monkeypatch):
    original = target.step
    calls = []

    def fails(self, *arguments):
        calls.append(1)
        if len(calls) == 30:
            raise ZeroDivisionError("rail broken")
        return original(self, *arguments)

    monkeypatch.setattr(target, "step", fails)
    outcome = run_graph(setup, tmp_path, mode="composed")
    assert outcome.failure == f"node {role} failed: ZeroDivisionError: rail broken"
    assert outcome.summary["ticks"] == 29
    assert message_counts(tmp_path)["/train/measurement"] == 30
    assert "rail broken" in (tmp_path / "log" / f"{role}.traceback.txt").read_text()


@pytest.mark.parametrize(
    ("role", "topic"), [("profile", "ato/reference"), ("observer", "ato/estimate"), ("controller", "ato/command")]
)
def test_a_silent_node_is_named(role, topic, setup, tmp_path, monkeypatch):
    """Fails when the run goes on with old values, hangs, or blames the node at the end of the chain."""
    original = NodeEndpoints.publish

    def swallows(self, name, message):
        if name != topic or message.stamp < 20 * TICK:
            original(self, name, message)

    monkeypatch.setattr(NodeEndpoints, "publish", swallows)
    outcome = run_graph(setup, tmp_path, mode="composed", timeout=2.0)
    assert outcome.failure == f"node {role} failed: no answer to stamp 2.000 s within 2 s"
    assert outcome.summary["ticks"] == 20


def test_a_lost_message_fails_the_run_by_its_topic(setup, tmp_path, domain, monkeypatch):
    """The count says sent, the recorder never got it: as a queue that overflowed would look."""
    original = NodeEndpoints.publish

    def loses(self, name, message):
        if name == "ato/estimate" and message.stamp == 119 * TICK:
            self.published["train/vehicles"] = self.published.get("train/vehicles", 0) + 1
        original(self, name, message)

    monkeypatch.setattr(NodeEndpoints, "publish", loses)
    end = run_composed(setup, tmp_path, domain, GraphOptions(draining=3.0))
    assert end.failure == "node recorder failed: 121 messages of train/vehicles are recorded, 122 were published"
    assert (tmp_path / "run.mcap").is_file()


def test_a_full_disk_fails_the_recorder_by_name(setup, tmp_path, monkeypatch):
    from train_ato.log.mcap_writer import McapWriter

    def full(self, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(McapWriter, "write_chunk", full)
    outcome = run_graph(setup, tmp_path, mode="composed")
    assert outcome.failure.startswith("node recorder failed: ")
    assert "No space left on device" in outcome.failure
    assert not (tmp_path / "run.mcap").exists()


def _answer(bench, publisher, stamp, force=0.0):
    publisher.publish(bench.wire.encode("ato/command", Command(stamp, np.array([force]))))
    _answer_brake_pipe(bench, stamp)


def _answer_brake_pipe(bench, stamp):
    if bench.wire.layout.air_brake:
        from train_ato.messages.types import Pipe

        bench.pipe.publish(bench.wire.encode("ato/brake_pipe_command", Pipe(stamp, 600e3)))


@pytest.fixture
def plant(make, setup):
    """Give a plant with a hand-made controller: the bench and the publisher of commands."""
    bench = make(Role.PLANT)
    bench.listen("train/measurement", "/diagnostics", "train/vehicles")
    command = bench.speaker("ato/command")
    bench.pipe = bench.speaker("ato/brake_pipe_command")
    bench.until(lambda: bench.endpoints._publishers["train/vehicles"].get_subscription_count() == 1)
    return bench, command


def test_the_plant_waits_for_the_command_of_its_stamp(plant):
    """Stale, early and repeated commands are counted and have no effect."""
    bench, command = plant
    node = bench.node
    node.begin()
    bench.until(lambda: len(bench.heard["train/measurement"]) == 1)
    for wrong in (TICK, 3 * TICK):
        _answer(bench, command, wrong)
    bench.until(lambda: node.ignored == 4)
    assert node.stage.tick == 0
    _answer(bench, command, 0)
    bench.until(lambda: node.stage.tick == 1)
    _answer(bench, command, 0)
    bench.until(lambda: node.ignored == 6)
    assert node.stage.tick == 1
    assert [m.stamp for m in bench.heard["train/measurement"]] == [0, TICK]
    assert bench.watch.failure is None


@pytest.mark.parametrize("realtime", [None, 0.001], ids=["lockstep", "realtime"])
def test_only_an_answer_that_is_due_feeds_the_watchdog(realtime, make):
    """Fails if an unexpected command hides the missing valid one."""
    bench = make(Role.PLANT, realtime=realtime)
    bench.listen("train/measurement")
    command, bench.pipe = bench.speaker("ato/command"), bench.speaker("ato/brake_pipe_command")
    bench.until(lambda: bench.endpoints._publishers["train/measurement"].get_subscription_count() == 1)
    bench.node.begin()

    def unanswered() -> bool:
        _answer(bench, command, 50 * TICK)
        bench.settle(1)
        return bool(bench.node.silent_for() >= 0.5)

    wait_for(unanswered, "the watchdog of an unanswered measurement")
    assert bench.node.ignored >= 10
    assert bench.node.stage.tick == 0


def _typed(names, effort):
    message = JointState()
    message.header.stamp.sec = EPOCH_NS // 10**9
    message.name, message.effort = names, effort
    return message


@pytest.mark.parametrize(
    ("message", "says"),
    [
        (_typed(["unit_0"], [float("nan")]), "effort is not finite: nan; sent by controller"),
        (_typed(["engine"], [0.0]), "names"),
        (_typed(["unit_0"], [0.0, 1.0]), "effort has 2 values where 1 are due"),
    ],
)
def test_a_wrong_command_of_a_foreign_node_ends_the_run(plant, message, says):
    bench, command = plant
    bench.node.begin()
    command.publish(message)
    bench.until(lambda: bench.watch.failure is not None)
    assert bench.watch.failure.startswith("node plant failed: ato/command: ")
    assert says in bench.watch.failure


def test_a_typed_command_of_a_foreign_node_is_taken(plant):
    """Breaks if the plant ignores a command of plain rclpy messages: no other command reaches it."""
    bench, command = plant
    bench.node.begin()
    command.publish(_typed(["unit_0"], [1000.0]))
    _answer_brake_pipe(bench, 0)
    bench.until(lambda: bench.node.stage.tick == 1)
    assert bench.node.ignored == 0


def test_two_controllers_are_refused(plant):
    """Breaks if a second publisher is not named before the start, or does not end a run that begins beside it."""
    bench, command = plant
    second = Node("second", context=bench.context, enable_rosout=False)
    bench.executor.add_node(second)
    bench.speaker("ato/command", second)
    bench.until(lambda: bench.endpoints.senders("ato/command") == 2)
    absent = [text for text in bench.endpoints.missing() if "a second publisher of ato/command" in text]
    assert len(absent) == 1 and "node second" in absent[0]
    bench.node.begin()
    _answer(bench, command, 0)
    bench.until(lambda: bench.watch.failure is not None)
    assert "more than one publisher" in bench.watch.failure


def test_pause_step_start_and_stop(plant, setup):
    bench, command = plant
    node = bench.node
    node.begin()
    assert bench.call(SetBool, "plant/pause", data=True).success
    _answer(bench, command, 0)
    bench.until(lambda: node.stage.tick == 1)
    bench.settle()
    assert len(bench.heard["train/measurement"]) == 1
    assert node.silent_for() == 0.0
    assert bench.call(Trigger, "plant/step").success
    bench.until(lambda: len(bench.heard["train/measurement"]) == 2)
    assert not bench.call(Trigger, "plant/step").success
    _answer(bench, command, TICK)
    bench.until(lambda: node.stage.tick == 2)
    assert bench.call(Trigger, "plant/start").success
    bench.until(lambda: len(bench.heard["train/measurement"]) == 3)
    assert node.silent_for() > 0.0
    assert bench.call(Trigger, "plant/stop").success
    _answer(bench, command, 2 * TICK)
    bench.until(lambda: node.finished)
    bench.until(lambda: len(bench.heard["train/vehicles"]) == 4)
    assert len(bench.heard["train/measurement"]) == 3


def test_the_plant_never_runs_away_from_the_recorder(make):
    """With queues of 1000 messages a lead of 400 ticks never loses a message, at any speed of the recorder."""
    bench = make(Role.PLANT, setup=prepare(*load_scenario("demo", ("duration=60",))), recorded=True)
    bench.listen("train/measurement")
    command, bench.pipe = bench.speaker("ato/command"), bench.speaker("ato/brake_pipe_command")
    written = bench.speaker("recorder/progress")
    bench.until(lambda: bench.endpoints._publishers["train/measurement"].get_subscription_count() == 1)
    heard, answered = bench.heard["train/measurement"], 0
    bench.node.begin()
    while not bench.node.blocked:
        bench.until(lambda done=answered: len(heard) > done or bench.node.blocked)
        if len(heard) > answered:
            _answer(bench, command, heard[answered].stamp)
            answered += 1
    assert bench.node.stage.tick == LEAD + 1
    for wrong in (10**6 * TICK, -TICK):
        written.publish(bench.wire.encode("recorder/progress", Tick(wrong)))
    bench.until(lambda: bench.node.ignored == 2)
    assert bench.node.blocked
    written.publish(bench.wire.encode("recorder/progress", Tick(100 * TICK)))
    bench.until(lambda: len(heard) == LEAD + 2)


def test_paced_runs_hold_the_last_command_and_count_late_ones(make):
    """No response in the second tick: the train continues, and the silence is detected."""
    bench = make(Role.PLANT, setup=prepare(*load_scenario("demo", ("duration=600",))), realtime=10.0)
    bench.listen("train/measurement", "/diagnostics")
    command, bench.pipe = bench.speaker("ato/command"), bench.speaker("ato/brake_pipe_command")
    bench.until(lambda: bench.endpoints._publishers["train/measurement"].get_subscription_count() == 1)
    node = bench.node
    node.begin()
    bench.until(lambda: node.held >= 3)
    assert node.stage.tick == node.held
    bench.until(lambda: node.silent_for() > 1.0)
    silent, ticks = node.silent_for(), node.stage.tick
    _answer(bench, command, 0)
    bench.until(lambda: node.late == 1)
    assert node.stage.tick > ticks
    assert node.silent_for() < silent
    bench.until(lambda: bench.heard["/diagnostics"][-1].values.get("wall_late") == "1")
    assert int(bench.heard["/diagnostics"][-1].values["wall_held"]) >= 3
    assert bench.watch.failure is None


def _set(node, name, value):
    return node.set_parameters([Parameter(name, value=value)])[0]


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("controller", "pidd", "did you mean 'pid'"),
        ("controller", 3, ""),
        ("pid.kp", float("nan"), ""),
        ("pid.kp", -1e30, ""),
        ("pid.kp", 5, ""),
        ("pid.kq", 5.0, ""),
    ],
)
def test_wrong_parameters_are_refused_and_the_old_law_goes_on(make, name, value, says):
    bench = make(Role.CONTROLLER)
    node = bench.endpoints.node
    before = {p: node.get_parameter(p).value for p in ("controller", "pid.kp")}
    try:
        result = _set(node, name, value)
        refused, reason = not result.successful, result.reason
    except Exception as error:
        refused, reason = True, str(error)
    assert refused
    assert says in reason
    assert reason
    assert {p: node.get_parameter(p).value for p in before} == before
    assert bench.node.stage.controller == before["controller"]


def test_parameters_of_all_laws_have_ranges_and_meanings(make):
    """Fails if a parameter has no range or description: rclpy accepts NaN for a double without a range."""
    bench = make(Role.CONTROLLER)
    names = [name for name in bench.endpoints.node._parameters if "." in name and not name.startswith("qos")]
    assert {name.split(".")[0] for name in names} >= {"pid", "smc"}
    answer = bench.call(DescribeParameters, "controller/describe_parameters", names=names)
    for descriptor in answer.descriptors:
        if descriptor.type == Parameter.Type.DOUBLE.value:
            (limits,) = descriptor.floating_point_range
            assert limits.from_value < limits.to_value
        assert len(descriptor.description) > 5, descriptor.name


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("controler:=smc", "did you mean 'controller'"),
        ("pid.kpp:=1.0", "did you mean 'pid.kp'"),
        ("pid.kp:=-1.0e30", "pid.kp"),
        ("pid.kp:=.nan", "pid.kp"),
        ("pid.kp:=1", "pid.kp"),
        ("controller:=nosuch", "nosuch"),
    ],
)
def test_wrong_parameters_at_the_start_are_refused(make, given, says):
    """Rclpy ignores a misspelt name; the run would continue with the default."""
    with pytest.raises(ValueError, match=r"controller|pid") as caught:
        make(Role.CONTROLLER, arguments=["--ros-args", "-p", given])
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_node_refused_at_its_start_leaves_the_domain(setup, domain):
    """Breaks if it stays until the next garbage collection, as a second controller of the next run."""
    gc.disable()
    try:
        with ExitStack() as stack, pytest.raises(ValueError, match="no_such") as caught:
            Bench(stack, Role.CONTROLLER, setup, domain, arguments=["--ros-args", "-p", "controller:=no_such"])
        with executor_of(domain) as (context, executor):
            watcher = Node("watcher", context=context, enable_rosout=False)
            executor.add_node(watcher)
            wait_for(lambda: "watcher" in watcher.get_node_names(), turn=lambda: executor.spin_once(timeout_sec=LOOK_S))
            for _ in range(10):
                executor.spin_once(timeout_sec=0.1)
            assert watcher.get_node_names() == ["watcher"]
    finally:
        gc.enable()
    assert caught.value.__traceback__ is not None


def test_parameters_at_the_start_are_taken(make):
    bench = make(Role.CONTROLLER, arguments=["--ros-args", "-p", "controller:=smc", "-p", "pid.ki:=0.0"])
    assert bench.node.stage.controller == "smc"
    assert bench.endpoints.node.get_parameter("pid.ki").value == 0.0


def test_the_observer_can_be_chosen_at_its_start_and_not_later(make):
    bench = make(Role.OBSERVER, arguments=["--ros-args", "-p", "observer:=ndo"])
    assert bench.node.stage.setup.observer == "ndo"
    assert not _set(bench.endpoints.node, "observer", "none").successful
    with pytest.raises(ValueError, match=r"unknown observer 'nda'.*ndo"):
        make(Role.OBSERVER, arguments=["--ros-args", "-p", "observer:=nda"])


def test_the_timeout_is_a_parameter_with_a_range(plant):
    bench, _ = plant
    assert not _set(bench.endpoints.node, "timeout", float("nan")).successful
    assert not _set(bench.endpoints.node, "timeout", 0.0).successful
    assert not _set(bench.endpoints.node, "realtime", 2.0).successful
    bench.node.begin()
    assert not bench.node.overdue
    assert _set(bench.endpoints.node, "timeout", 0.001).successful
    bench.settle()
    assert bench.node.overdue


def test_a_planned_swap_is_shown_by_the_parameter_and_has_no_jump(setup, tmp_path, domain):
    """The first output after a swap equals the last command before it, up to the usual change of a tick."""
    swapping = prepare(*load_scenario("demo", ("duration=40", "controller_changes=[{at: 30, controller: smc}]")))
    shown = []
    original = ControllerNode._sync_parameters
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ControllerNode, "_sync_parameters", lambda self, law: (original(self, law), shown.append(law)))
        end = run_composed(swapping, tmp_path, domain, GraphOptions())
    assert end.failure is None
    assert shown == [{"controller": "smc"}]
    commands = [m for _, _, m in read_log(tmp_path, Wire(setup.layout).decode, ("ato/command",))]
    force = np.array([m.force[0] for m in commands])
    assert abs(force[300] - force[299]) <= 1e-3 * np.abs(force).max()


def test_stages_publish_what_their_topics_carry(setup):
    """Breaks if a stage publishes a message that its topic cannot contain, an error only in the graph."""
    wire, plant = Wire(setup.layout), PlantStage(setup)
    for topic, message in plant.observe().published() + ProfileStage(setup).start().published():
        assert dataclasses.is_dataclass(message)
        assert wire.encode(topic, message)
        assert Role.PLANT in BY_NAME[topic].publishers or Role.PROFILE in BY_NAME[topic].publishers
    assert isinstance(PlantNode, type)
