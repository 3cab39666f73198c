"""Nodes in one process: who answers what, what is refused, and how a failure is named."""

from __future__ import annotations

import dataclasses
import time
from contextlib import ExitStack

import numpy as np
import pytest

pytest.importorskip("rclpy")

from rcl_interfaces.srv import DescribeParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from plant_sim.node import LEAD, PlantNode, silent_node
from train_ato.graph.assembly import executor_of, make_node
from train_ato.graph.composed import run_composed
from train_ato.graph.environment import claim_domain
from train_ato.graph.run_end import GraphOptions
from train_ato.graph.runner import run_graph
from train_ato.nodes.barrier import Barrier
from train_ato.nodes.controller import ControllerNode
from train_ato.nodes.shell import ROLES, Shell, Watch, quality_of_service
from train_ato.record.reading import message_counts, read_log
from train_ato.roles.controller import ControllerRole
from train_ato.roles.observer import ObserverRole
from train_ato.roles.plant import PlantRole
from train_ato.roles.profile import ProfileRole
from train_ato.run_setup import prepare
from train_ato.scenario import load
from train_ato.topics import BY_NAME, EPOCH_NS, TOPICS, Role, read_by
from train_ato.types import Command, Tick
from train_ato.wire import Wire

TICK = 100_000_000


@pytest.fixture(scope="module")
def setup():
    return prepare(*load("demo", ("duration=12",)))


@pytest.fixture
def domain():
    with claim_domain() as held:
        yield held


class Bench:
    """One node of the graph on an executor, and a plain node beside it that plays the others."""

    def __init__(self, stack, role, setup, domain, arguments=None, **options):
        self.context, self.executor = stack.enter_context(executor_of(domain, arguments))
        self.watch = Watch()
        self.wire = Wire(setup.shape)
        self.shell = Shell(role, self.wire, self.context, self.watch, ROLES[:-1], arguments)
        recorded = options.pop("recorded", False)
        self.node = make_node(role, setup, self.shell, None, options.get("realtime"), 10.0, recorded)
        self.other = Node("other", context=self.context, enable_rosout=False, start_parameter_services=False)
        self.executor.add_node(self.shell.node)
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

    def until(self, condition, limit=5.0):
        """Turn until a condition holds."""
        last = time.monotonic() + limit
        while not condition():
            assert time.monotonic() < last, f"did not happen within {limit} s; failure: {self.watch.failure}"
            self.executor.spin_once(timeout_sec=0.02)

    def settle(self, turns=10):
        """Turn so often that whatever is under way has come."""
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


def test_barrier_lets_every_stamp_through_once():
    """Fails when a barrier mixes stamps, lets one through twice, or waits for a stamp that was overtaken."""

    def at(stamp):
        return Tick(stamp)

    barrier = Barrier("a", "b")
    assert barrier.put("a", at(0)) is None
    assert barrier.put("b", at(5)) is None
    assert barrier.put("a", at(0)) is None
    assert barrier.put("b", at(0)) == (at(0), at(0))
    assert barrier.put("b", at(0)) is None
    assert barrier.put("a", at(5)) == (at(5), at(5))
    assert barrier.put("b", at(3)) is None
    assert barrier.ignored == 3
    assert barrier.put("a", at(7)) is None
    barrier.put("a", at(8))
    assert barrier.put("b", at(8)) == (at(8), at(8))
    assert barrier.put("b", at(7)) is None


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
    """A node that publishes or reads what the table does not say makes the documentation wrong."""
    bench = make(role)
    own = {
        (name, kind)
        for kind, found in (
            ("out", bench.shell.node.get_publisher_names_and_types_by_node(role.value, "/")),
            ("in", bench.shell.node.get_subscriber_names_and_types_by_node(role.value, "/")),
        )
        for name, _ in found
    }
    table = {(f"/{t.name.lstrip('/')}", "out") for t in TOPICS if role in t.publishers and setup.shape.has(t)}
    table |= {(f"/{t.name.lstrip('/')}", "in") for t in read_by(role) if setup.shape.has(t)}
    assert own - {("/parameter_events", "out")} == table


def test_a_composed_run_records_every_message(setup, tmp_path):
    out = tmp_path / "run"
    out.mkdir()
    seen = []
    outcome = run_graph(setup, out, way="composed", progress=seen.append)
    assert outcome.failure is None
    assert not outcome.interrupted
    recorded = {name.lstrip("/"): count for name, count in message_counts(out).items()}
    published = {name.lstrip("/"): n for name, n in outcome.published.items() if n and BY_NAME[name].recorded}
    assert recorded == published
    assert recorded["train/cars"] == setup.ticks + 1
    assert recorded["ato/command"] == setup.ticks
    assert outcome.published["record/acknowledged"] == (setup.ticks + 1) // 100
    assert sorted(path.name for path in out.iterdir()) == ["metadata.yaml", "run.mcap"]


@pytest.mark.parametrize(
    ("role", "target"), [("profile", ProfileRole), ("observer", ObserverRole), ("controller", ControllerRole)]
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
    outcome = run_graph(setup, tmp_path, way="composed")
    assert outcome.failure == f"node {role} failed: ZeroDivisionError: rail broken"
    assert outcome.summary["ticks"] == 29
    assert message_counts(tmp_path)["/train/measurement"] == 30
    assert "rail broken" in (tmp_path / "log" / f"{role}.traceback.txt").read_text()


@pytest.mark.parametrize(
    ("role", "topic"), [("profile", "ato/reference"), ("observer", "ato/estimate"), ("controller", "ato/command")]
)
def test_a_silent_node_is_named(role, topic, setup, tmp_path, monkeypatch):
    """Fails when the run goes on with old values, hangs, or blames the node at the end of the chain."""
    original = Shell.publish

    def swallows(self, name, message):
        if name != topic or message.stamp < 20 * TICK:
            original(self, name, message)

    monkeypatch.setattr(Shell, "publish", swallows)
    outcome = run_graph(setup, tmp_path, way="composed", timeout=0.3)
    assert outcome.failure == f"node {role} failed: no answer to stamp 2.000 s within 0.3 s"
    assert outcome.summary["ticks"] == 20


def test_a_lost_message_fails_the_run_by_its_topic(setup, tmp_path, domain, monkeypatch):
    """The count says sent, the recorder never got it: as a queue that overflowed would look."""
    original = Shell.publish

    def loses(self, name, message):
        if name == "ato/estimate" and message.stamp == 119 * TICK:
            self.published["train/cars"] = self.published.get("train/cars", 0) + 1
        original(self, name, message)

    monkeypatch.setattr(Shell, "publish", loses)
    end = run_composed(setup, tmp_path, domain, GraphOptions(draining=0.2))
    assert end.failure == "node recorder failed: 121 messages of train/cars are recorded, 122 were published"
    assert (tmp_path / "run.mcap").is_file()


def test_a_full_disk_fails_the_recorder_by_name(setup, tmp_path, monkeypatch):
    from train_ato.record.mcap_writer import McapWriter

    def full(self, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(McapWriter, "close_chunk", lambda self: full(self, b""))
    outcome = run_graph(setup, tmp_path, way="composed")
    assert outcome.failure.startswith("node recorder failed: ")
    assert "No space left on device" in outcome.failure
    assert not (tmp_path / "run.mcap").exists()


def _answer(bench, publisher, stamp, force=0.0):
    publisher.publish(bench.wire.encode("ato/command", Command(stamp, np.array([force]))))
    if bench.wire.shape.air_brake:
        from train_ato.types import Pipe

        bench.pipe.publish(bench.wire.encode("ato/brake_pipe", Pipe(stamp, 600e3)))


@pytest.fixture
def plant(make, setup):
    """Give a plant with a hand-made controller: the bench and the publisher of commands."""
    bench = make(Role.PLANT)
    bench.listen("train/measurement", "/diagnostics", "train/cars")
    command = bench.speaker("ato/command")
    bench.pipe = bench.speaker("ato/brake_pipe")
    bench.until(lambda: bench.shell._publishers["train/cars"].get_subscription_count() == 1)
    return bench, command


def test_the_plant_waits_for_the_command_of_its_stamp(plant):
    """Stale, early and doubled commands are counted and change nothing."""
    bench, command = plant
    node = bench.node
    node.begin()
    bench.until(lambda: len(bench.heard["train/measurement"]) == 1)
    for wrong in (TICK, 3 * TICK):
        _answer(bench, command, wrong)
    bench.until(lambda: node.ignored == 4)
    assert node.role.tick == 0
    _answer(bench, command, 0)
    bench.until(lambda: node.role.tick == 1)
    _answer(bench, command, 0)
    bench.until(lambda: node.ignored == 6)
    assert node.role.tick == 1
    assert [m.stamp for m in bench.heard["train/measurement"]] == [0, TICK]
    assert bench.watch.failure is None


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
    """A controller written with plain rclpy messages drives the plant too."""
    bench, command = plant
    bench.node.begin()
    command.publish(_typed(["unit_0"], [1000.0]))
    _answer(bench, command, 0)
    bench.until(lambda: bench.node.role.tick == 1)


def test_two_controllers_are_refused(plant):
    bench, command = plant
    second = Node("second", context=bench.context, enable_rosout=False)
    bench.executor.add_node(second)
    bench.speaker("ato/command", second)
    bench.until(lambda: bench.shell.senders("ato/command") == 2)
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
    bench.until(lambda: node.role.tick == 1)
    bench.settle()
    assert len(bench.heard["train/measurement"]) == 1
    assert node.silent_for() == 0.0
    assert bench.call(Trigger, "plant/step").success
    bench.until(lambda: len(bench.heard["train/measurement"]) == 2)
    assert not bench.call(Trigger, "plant/step").success
    _answer(bench, command, TICK)
    bench.until(lambda: node.role.tick == 2)
    assert bench.call(Trigger, "plant/start").success
    bench.until(lambda: len(bench.heard["train/measurement"]) == 3)
    assert node.silent_for() > 0.0
    assert bench.call(Trigger, "plant/stop").success
    _answer(bench, command, 2 * TICK)
    bench.until(lambda: node.finished)
    bench.until(lambda: len(bench.heard["train/cars"]) == 4)
    assert len(bench.heard["train/measurement"]) == 3


def test_the_plant_never_runs_away_from_the_recorder(make):
    """With queues of 1000 a lead of 400 ticks can never lose a message, however slow the recorder is."""
    bench = make(Role.PLANT, setup=prepare(*load("demo", ("duration=60",))), recorded=True)
    bench.listen("train/measurement")
    command, bench.pipe = bench.speaker("ato/command"), bench.speaker("ato/brake_pipe")
    written = bench.speaker("record/acknowledged")
    bench.until(lambda: bench.shell._publishers["train/measurement"].get_subscription_count() == 1)
    heard, answered = bench.heard["train/measurement"], 0
    bench.node.begin()
    while not bench.node.blocked:
        bench.until(lambda done=answered: len(heard) > done or bench.node.blocked)
        if len(heard) > answered:
            _answer(bench, command, heard[answered].stamp)
            answered += 1
    assert bench.node.role.tick == LEAD + 1
    written.publish(bench.wire.encode("record/acknowledged", Tick(100 * TICK)))
    bench.until(lambda: len(heard) == LEAD + 2)


def test_paced_runs_hold_the_last_command_and_count_late_ones(make):
    """Nobody answers the second tick: the train goes on, and the silence is seen."""
    bench = make(Role.PLANT, realtime=10.0)
    bench.listen("train/measurement", "/diagnostics")
    command, bench.pipe = bench.speaker("ato/command"), bench.speaker("ato/brake_pipe")
    bench.until(lambda: bench.shell._publishers["train/measurement"].get_subscription_count() == 1)
    node = bench.node
    node.begin()
    bench.until(lambda: node.held >= 3)
    assert node.role.tick == node.held
    silent = node.silent_for()
    assert silent > 0.02
    ticks = node.role.tick
    _answer(bench, command, 0)
    bench.until(lambda: node.late == 1)
    assert node.role.tick > ticks
    assert node.silent_for() < silent
    bench.until(lambda: len(bench.heard["/diagnostics"]) == 2)
    told = bench.heard["/diagnostics"][1].values
    assert int(told["wall_held"]) >= 3
    assert int(told["wall_late"]) == 1
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
    node = bench.shell.node
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
    assert bench.node.role.controller == before["controller"]


def test_parameters_of_all_laws_have_ranges_and_meanings(make):
    """A double without a range takes NaN in rclpy; tools show ranges and descriptions to people."""
    bench = make(Role.CONTROLLER)
    names = [name for name in bench.shell.node._parameters if "." in name and not name.startswith("qos")]
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
    """A misspelt name is ignored silently by rclpy, and the run would go on with the default."""
    with pytest.raises(ValueError, match=r"controller|pid") as caught:
        make(Role.CONTROLLER, arguments=["--ros-args", "-p", given])
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_parameters_at_the_start_are_taken(make):
    bench = make(Role.CONTROLLER, arguments=["--ros-args", "-p", "controller:=smc", "-p", "pid.ki:=0.0"])
    assert bench.node.role.controller == "smc"
    assert bench.shell.node.get_parameter("pid.ki").value == 0.0


def test_the_observer_can_be_chosen_at_its_start_and_not_later(make):
    bench = make(Role.OBSERVER, arguments=["--ros-args", "-p", "observer:=ndo"])
    assert bench.node.role.setup.observer == "ndo"
    assert not _set(bench.shell.node, "observer", "none").successful
    with pytest.raises(ValueError, match=r"unknown observer 'nda'.*ndo"):
        make(Role.OBSERVER, arguments=["--ros-args", "-p", "observer:=nda"])


def test_the_timeout_is_a_parameter_with_a_range(plant):
    bench, _ = plant
    assert not _set(bench.shell.node, "timeout", float("nan")).successful
    assert not _set(bench.shell.node, "timeout", 0.0).successful
    assert not _set(bench.shell.node, "realtime", 2.0).successful
    bench.node.begin()
    assert not bench.node.overdue
    assert _set(bench.shell.node, "timeout", 0.001).successful
    bench.settle()
    assert bench.node.overdue


def test_a_planned_swap_is_shown_by_the_parameter_and_has_no_jump(setup, tmp_path, domain):
    """The first output after a swap equals the last command before it, up to what one tick changes anyway."""
    swapping = prepare(*load("demo", ("duration=40", "swaps=[{at: 30, controller: smc}]")))
    shown = []
    original = ControllerNode._show
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ControllerNode, "_show", lambda self, law: (original(self, law), shown.append(law)))
        end = run_composed(swapping, tmp_path, domain, GraphOptions())
    assert end.failure is None
    assert shown == [{"controller": "smc"}]
    commands = [m for _, _, m in read_log(tmp_path, Wire(setup.shape).decode, ("ato/command",))]
    force = np.array([m.force[0] for m in commands])
    assert abs(force[300] - force[299]) <= 1e-3 * np.abs(force).max()


def test_dataclasses_of_the_table_are_the_roles_messages(setup):
    """A role that sends what its topic cannot carry would fail only in the graph."""
    wire, plant = Wire(setup.shape), PlantRole(setup)
    for topic, message in plant.observe() + ProfileRole(setup).start():
        assert dataclasses.is_dataclass(message)
        assert wire.encode(topic, message)
        assert Role.PLANT in BY_NAME[topic].publishers or Role.PROFILE in BY_NAME[topic].publishers
    assert isinstance(PlantNode, type)
