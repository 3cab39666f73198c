"""Nodes in one process: answers and refusals of messages."""

import dataclasses
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from importlib.util import find_spec
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")

from engine_runs import setup_of
from foreign_node import ForeignNode
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from node_bench import Bench, set_parameter
from rcl_interfaces.msg import Log
from rclpy.duration import Duration
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from waiting import LIMIT_S, wait_for

from plant_sim.alignment import Alignment
from train_ato.log.log_writer import RunLog
from train_ato.loop.plant import PlantStage
from train_ato.loop.profile import ProfileStage
from train_ato.loop.stamp_synchronizer import StampSynchronizer
from train_ato.messages.codec import Wire
from train_ato.messages.topics import BY_NAME, EPOCH_NS, TOPICS, Role, read_by, topics_of
from train_ato.messages.types import Command, Diagnostic, DisturbanceEstimate, Reference, Tick, Trajectory
from train_ato.program.errors import FirstFailure, NodeFault
from train_ato.ros.graph import remote
from train_ato.ros.graph.assembly import executor_of
from train_ato.ros.graph.remote import graph_client
from train_ato.ros.nodes.answer_watch import CHECK_S, SUSPENDED_S, silent_node
from train_ato.ros.nodes.endpoints import ROSOUT, NodeEndpoints
from train_ato.ros.nodes.plant import LEAD
from train_ato.ros.nodes.plant_requests import NO_RESET
from train_ato.ros.nodes.recorder import RecorderNode
from train_ato.ros.nodes.simulation_services import ABSENT
from train_ato.ros.nodes.tick_answers import TickAnswers
from train_ato.view.controls import Controls, Tunable

TICK = 100_000_000


def _unsupervised(duration):
    """Return a demo of ``duration`` s whose plant waits for the command alone."""
    return setup_of("demo", f"duration={duration}", "supervision.enabled=false")


@pytest.fixture(scope="module")
def setup():
    return _unsupervised(12)


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
    assert silent_node(last, 5, blocked=blocked) is named


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
    assert own - {("/parameter_events", "out"), ("/rosout", "out")} == table


def test_trains_of_two_namespaces_have_no_topic_in_common(make):
    """Fails if a namespace leaves the clock or the diagnostics of a train where those of another train are."""
    trains = [
        {
            place.topic_name
            for role in (Role.PLANT, Role.CONTROLLER)
            for node in [make(role, arguments=["--ros-args", "-r", f"__ns:=/{name}"]).endpoints.node]
            for place in (*node.publishers, *node.subscriptions)
        }
        - {"/rosout", "/parameter_events"}
        for name in ("a", "b")
    ]
    assert not trains[0] & trains[1]
    assert {"/a/clock", "/a/diagnostics", "/a/train/vehicles"} <= trains[0]


def test_a_request_reaches_the_train_of_its_namespace(make, domain, monkeypatch):
    """Fails if a train in a namespace has no requests, or the refusal does not say where it is."""
    monkeypatch.setattr(remote, "ELSEWHERE_S", 1.0)
    bench = make(Role.PLANT, arguments=["--ros-args", "-r", "__ns:=/a"])

    def gust(namespace):
        with graph_client(domain, namespace) as remote:
            assert remote.set_parameter("plant", "gust.duration", 5.0) is None
            return remote.call("plant/gust")

    def asked(namespace):
        with ThreadPoolExecutor(1) as other:
            future = other.submit(gust, namespace)
            bench.until(future.done)
            return future.result()

    assert asked("/a") == (True, "gust: acceleration -0.02, duration 5, ramp 2; from the tick after 0.000 s")
    there = f"node 'plant' is in /a of domain {domain}, not in /; give --namespace /a"
    with pytest.raises(ValueError, match=there):
        asked("")


def test_a_request_to_an_external_node_names_its_program(make, domain, monkeypatch):
    """Breaks if the refusal of a request to the ATO of a program outside only says that no service is there."""
    monkeypatch.setattr(remote, "ELSEWHERE_S", 1.0)
    bench = make(Role.PLANT)
    bench.speaker("ato/command")

    def reset():
        with graph_client(domain) as client:
            client.call("controller/reset")

    with ThreadPoolExecutor(1) as other:
        future = other.submit(reset)
        bench.until(future.done)
    with pytest.raises(ValueError, match="node controller is the external program other on domain"):
        future.result()


def test_the_page_does_not_wait_for_parameters_of_a_program(make):
    """Breaks if the live page waits for an external controller, which has no parameters, or its buttons say nothing."""
    bench = make(Role.PLANT)
    bench.speaker("ato/command")
    controls, said = Controls(bench.endpoints.node, lambda: None), []
    bench.until(lambda: controls.outside("controller") == "other")
    assert not controls.ready and controls.outside("plant") == ""
    controls.tunables["plant"]["rate"] = Tunable("rate", 1.0)
    assert controls.ready
    controls.call("engage", lambda done, text: said.append((done, text)))
    controls.serve()
    assert said == [(False, "the controller is the program other, which has no such service")]


def _answer(bench, publisher, stamp, force=0.0):
    publisher.publish(bench.wire.encode("ato/command", Command(stamp, np.array([force]))))
    _answer_brake_pipe(bench, stamp)


def _answer_brake_pipe(bench, stamp):
    if bench.wire.layout.air_brake:
        from train_ato.messages.types import Pipe

        bench.pipe.publish(bench.wire.encode("ato/brake_pipe_command", Pipe(stamp, 600e3)))


def _commanding(bench, *topics):
    """Listen to topics; return the publisher of commands, the answers of which the plant waits for."""
    bench.listen("train/measurement", *topics)
    command, bench.pipe = bench.speaker("ato/command"), bench.speaker("ato/brake_pipe_command")
    bench.until(lambda: bench.endpoints._publishers["train/measurement"].get_subscription_count() == 1)
    return command


@pytest.fixture
def plant(make):
    """Give a plant with a hand-made controller: the bench and the publisher of commands."""
    bench = make(Role.PLANT)
    command = _commanding(bench, "/diagnostics", "train/vehicles")
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


@pytest.mark.parametrize("wrong", [False, True])
def test_a_program_without_a_first_answer_is_told_what_to_wait_for(wrong, plant):
    """Breaks if a program whose first answer is lost ends by the time-out alone, or a wrong stamp is not named."""
    bench, command = plant
    bench.endpoints.external = Role.CONTROLLER
    bench.node.begin()
    if wrong:
        _answer(bench, command, TICK)
        bench.until(lambda: bench.node.ignored == 2)
    bench.node.lose_silent({Role.SUPERVISOR: 0, Role.PROFILE: 0, Role.OBSERVER: 0}, {})
    said = bench.watch.failure
    assert said.startswith("node controller failed: no answer to stamp 0.000 s")
    assert ("get_subscription_count()" in said, "stamped 0.100 s came" in said) == (not wrong, wrong)


@pytest.mark.parametrize("rate", [None, 0.001], ids=["lockstep", "without lockstep"])
def test_only_an_answer_that_is_due_feeds_the_watchdog(rate, make):
    """Fails if an unexpected command hides the missing valid one."""
    bench = make(Role.PLANT, rate=rate)
    command = _commanding(bench)
    bench.node.begin()

    def unanswered() -> bool:
        _answer(bench, command, 50 * TICK)
        bench.settle(1)
        return bench.node.ignored >= 10 and bool(bench.node.silent_for() >= 0.5)

    wait_for(unanswered, "the watchdog of an unanswered measurement")
    assert bench.node.stage.tick == 0


def test_the_same_answer_to_the_first_stamp_is_not_counted(make):
    """Breaks if an answer to a first measurement that was sent again is counted, or any other is left uncounted."""
    bench = make(Role.PLANT, setup=_unsupervised(60))
    bench.endpoints.external, bench.endpoints._repeatable = Role.CONTROLLER, {"ato/command"}
    bench.endpoints.on_note = (said := []).append
    bench.listen("train/measurement")
    command, heard = bench.speaker("ato/command"), bench.heard["train/measurement"]
    bench.until(lambda: bench.endpoints._publishers["train/measurement"].get_subscription_count() == 1)
    bench.node.begin()
    for stamp, ticks, count in ((0, 1, 0), (0, 1, 0), (TICK, 2, 0), (TICK, 2, 1)):
        bench.until(lambda due=stamp: heard and heard[-1].stamp >= due)
        command.publish(bench.wire.encode("ato/command", Command(stamp, np.zeros(1))))
        bench.until(lambda due=ticks: bench.node.stage.tick == due)
        bench.settle()
        assert bench.node.ignored == len(said) == count
    assert said[0].startswith("node controller: ato/command stamped 0.100 s came twice, or after its tick; ")


def test_the_recorder_acknowledges_each_stamp_once():
    """Breaks if the recorder sends an acknowledgement again: the plant counts it as a message that came twice."""
    sent = []
    recorder = SimpleNamespace(
        log=SimpleNamespace(counts={"train/measurement": 100}), endpoints=SimpleNamespace(publish=sent.append),
        last_stamp=lambda name: 199 * TICK, _of_plant=["train/measurement"], _next=100, _acknowledged=-1,
    )  # fmt: skip
    for recorder.log.counts["train/measurement"] in (100, 200):  # written later than read
        RecorderNode._acknowledge(recorder)
    assert sent == [("recorder/progress", Tick(199 * TICK))]


def _typed(names, effort):
    message = JointState()
    message.header.stamp.sec = EPOCH_NS // 10**9
    message.name, message.effort = names, effort
    return message


@pytest.mark.parametrize(
    ("message", "says"),
    [
        (_typed(["unit_0"], [float("nan")]), "effort is not finite: nan; sent by other"),
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


def test_a_program_in_place_of_a_node_is_missing_by_its_topics(make):
    """Breaks if the list has the name of the node, which the program need not have."""
    endpoints = make(Role.PLANT).endpoints
    assert {"node controller", "node profile"} <= set(endpoints.missing())
    endpoints.external = Role.CONTROLLER
    absent = endpoints.missing()
    assert "a publisher of ato/command (controller)" in absent and "node controller" not in absent


def test_pause_step_start_and_stop(plant, setup):
    """Breaks if a step in a pause is answered wrongly, or the time since the tick before counts as its lateness."""
    bench, command = plant
    node = bench.node
    node.set_rate(1e3)
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
    assert "wall_ticks_late" not in node._lateness.report()
    refused = bench.call(Trigger, "plant/reset")
    assert (refused.success, refused.message) == (False, NO_RESET)
    assert bench.call(Trigger, "plant/stop").success
    _answer(bench, command, 2 * TICK)
    bench.until(lambda: node.finished)
    bench.until(lambda: len(bench.heard["train/vehicles"]) == 4)
    assert len(bench.heard["train/measurement"]) == 3


@pytest.mark.parametrize(("stamp", "shown"), [(-EPOCH_NS, "0"), (5 * TICK, "0.500 s")])
def test_an_answer_with_a_wrong_stamp_is_named(stamp, shown):
    """Breaks if the message of a missing answer does not name the stamp of the answer that came."""
    answers = TickAnswers(_unsupervised(2))
    assert answers.unused_of(Role.CONTROLLER) == ""
    assert not answers.take(Command(stamp, np.zeros(1)), expected=False)
    said = f"; a command stamped {shown} came; echo the stamp of train/measurement"
    assert (answers.unused_of(Role.CONTROLLER), answers.unused_of(Role.SUPERVISOR)) == (said, "")


@pytest.mark.parametrize(("stamp", "shown"), [(-EPOCH_NS, "0"), (5 * TICK, "0.500 s"), (TICK // 2, "0.050 s")])
def test_a_stamp_that_echoes_no_measurement_is_named_once(stamp, shown):
    """Breaks if the wrong stamp is named after the time-out only, at every message, or for a repeated answer."""
    answers = TickAnswers(_unsupervised(2))
    found = answers.refusal(Command(stamp, np.zeros(1)), 4 * TICK)
    assert found.startswith(f"node controller: a command stamped {shown} came; echo the stamp of train/measurement")
    assert found.endswith("the tick of the scenario is 0.1 s") == (stamp > 0)
    assert answers.refusal(Command(stamp, np.zeros(1)), 4 * TICK) == ""
    assert answers.stamps_wrongly(Role.CONTROLLER) and not answers.stamps_wrongly(Role.SUPERVISOR)
    twice = "ato/command stamped 0.200 s came twice, or after its tick; answer each train/measurement once"
    assert answers.refusal(Command(2 * TICK, np.zeros(1)), 4 * TICK) == f"node controller: {twice}"
    assert answers.refusal(Command(2 * TICK, np.zeros(1)), 4 * TICK) == ""


def test_the_answers_of_a_lost_node_are_not_counted():
    """Breaks if the end of the run counts messages that no line above it names."""
    answers = TickAnswers(_unsupervised(2))
    answers.lose(Role.CONTROLLER)
    assert not answers.take(Command(TICK, np.zeros(1)), expected=True) and answers.ignored == 0


@pytest.mark.parametrize(
    ("stamps", "came", "due"),
    [
        ([0, 2 * TICK], "for 0.200 s", "0.100"),
        ([0, TICK // 2], "for 0.050 s", "0.100"),
        ([-EPOCH_NS + 1], "for -1767225600.000 s", "0.000"),
        ([-EPOCH_NS], "stamped 0", "0.000"),
    ],
)
def test_a_plant_with_another_tick_is_named(make, stamps, came, due):
    """Breaks if a node waits for ever for the measurement of the tick of its scenario, or names itself."""
    bench = make(Role.OBSERVER)
    publisher = bench.speaker("train/measurement")
    model = PlantStage(_unsupervised(2)).observe().measurement
    for stamp in stamps:
        publisher.publish(bench.wire.encode("train/measurement", dataclasses.replace(model, stamp=stamp)))
    bench.until(lambda: bench.watch.failure is not None)
    text = f"node plant failed: measurement {came} came, {due} s was due: the tick of the scenario is 0.1 s"
    assert bench.watch.failure == text + ", the first stamp 1767225600 s (2026-01-01)" * (stamps[0] < 0)


def test_the_state_of_a_node_is_that_of_a_managed_node(make, capsys):
    """Breaks if a lifecycle tool gets no state, a state of before, or a transition."""
    bench = make(Role.OBSERVER)
    assert bench.call(GetState, "observer/get_state").current_state.label == "unconfigured"
    answer = bench.call(ChangeState, "observer/change_state")
    assert not answer.success and "node observer: ~/change_state: refused" in capsys.readouterr().err
    for name in ("get_available_transitions", "get_transition_graph"):  # `ros2 lifecycle set` waits for the first
        assert bench.call(GetAvailableTransitions, f"observer/{name}").available_transitions == []
    publisher = bench.speaker("train/measurement")
    measurement = PlantStage(_unsupervised(2)).observe().measurement
    publisher.publish(bench.wire.encode("train/measurement", measurement))
    bench.until(lambda: bench.endpoints.last_stamp == 0)
    assert bench.call(GetState, "observer/get_state").current_state.label == "active"
    bench.watch.fail("observer", "by this test")
    assert bench.call(GetState, "observer/get_state").current_state.label == "finalized"


@pytest.mark.skipif(find_spec("simulation_interfaces") is not None, reason="simulation_interfaces is installed")
def test_without_simulation_interfaces_a_line_says_what_is_offered(make):
    """Fails if a tool that looks for the services finds neither them nor a word, or the node does not start."""
    bench, lines = make(Role.PLANT), []
    bench.other.create_subscription(Log, "/rosout", lines.append, ROSOUT)
    bench.until(lambda: lines)
    assert [line.msg for line in lines] == [ABSENT]


def test_simulation_interfaces_pause_step_and_show_the_train(plant):
    """Fails if a client of the standard cannot steer the run, or is answered before the last of its steps."""
    msg, srv = (pytest.importorskip(f"simulation_interfaces.{kind}") for kind in ("msg", "srv"))
    bench, command = plant
    stage, state = bench.node.stage, msg.SimulationState

    def call(kind, name, **request):
        return bench.call(getattr(srv, kind), f"plant/{name}", **request)

    def enter(number):
        return call("SetSimulationState", "set_simulation_state", state=state(state=number)).result.result

    features = call("GetSimulatorFeatures", "get_simulator_features").features.features
    assert msg.SimulatorFeatures.STEP_SIMULATION_MULTIPLE in features
    assert msg.SimulatorFeatures.SIMULATION_RESET not in features
    assert call("ResetSimulation", "reset_simulation").result.error_message == NO_RESET
    assert call("GetSimulationState", "get_simulation_state").state.state == state.STATE_STOPPED
    assert call("StepSimulation", "step_simulation", steps=1).result.result == msg.Result.RESULT_OPERATION_FAILED
    assert enter(state.STATE_PLAYING) == srv.SetSimulationState.Response.STATE_TRANSITION_ERROR
    assert enter(state.STATE_PAUSED) == msg.Result.RESULT_OK
    bench.node.begin()
    step = bench.other.create_client(srv.StepSimulation, "plant/step_simulation")
    future = step.call_async(srv.StepSimulation.Request(steps=2))
    for tick in range(2):
        bench.until(lambda tick=tick: len(bench.heard["train/measurement"]) == tick + 1)
        assert not future.done()
        _answer(bench, command, tick * TICK, 1e5)
    bench.until(future.done)
    assert (future.result().result.result, stage.tick) == (msg.Result.RESULT_OK, 2)
    filters = msg.EntityFilters(filter="^vehicle_0$")
    answer = call("GetEntitiesStates", "get_entities_states", filters=filters)
    assert answer.entities == ["vehicle_0"]
    found = call("GetEntityState", "get_entity_state", entity="vehicle_0").state
    assert (found.pose, found.twist.linear) == (answer.states[0].pose, answer.states[0].twist.linear)
    assert np.isnan(found.acceleration.linear.x)
    track = Alignment(stage.setup.line).at(stage.train.position[:1])
    assert (found.pose.position.x, found.header.frame_id) == (track.x[0], "map")
    speed = np.linalg.norm([getattr(found.twist.linear, axis) for axis in "xyz"])
    assert speed == pytest.approx(stage.train.velocity[0])
    assert found.header.stamp.nanosec == 2 * TICK
    wrong = call("GetEntityState", "get_entity_state", entity="train").result
    assert wrong.result == msg.Result.RESULT_NOT_FOUND
    assert call("GetEntities", "get_entities", filters=msg.EntityFilters(filter="(")).result.error_message
    assert enter(state.STATE_QUITTING) == msg.Result.RESULT_OK
    assert call("GetSimulationState", "get_simulation_state").state.state == state.STATE_QUITTING


def test_a_node_that_joins_in_a_pause_knows_the_time(plant):
    """Breaks if a tool with the time of the simulation has the time 0 until the next step."""
    bench, command = plant
    bench.node.begin()
    bench.call(SetBool, "plant/pause", data=True)
    _answer(bench, command, 0)
    bench.until(lambda: bench.node.stage.tick == 1)
    sent = dict(bench.endpoints.published)
    bench.listen("/clock")
    bench.until(lambda: len(bench.heard["/clock"]) == 2)
    assert {tick.stamp for tick in bench.heard["/clock"]} == {0}
    assert bench.endpoints.published == sent, "the recorder does not record the repeated time"


class Recording:
    """Recorder with real subscriptions, polled by the test."""

    def __init__(self, stack, setup, domain, folder, external):
        context, _ = stack.enter_context(executor_of(domain))
        wire = Wire(setup.layout)
        self.endpoints = NodeEndpoints(Role.RECORDER, wire, context, FirstFailure(), external=external)
        self.notes = []
        self.endpoints.on_note = self.notes.append
        self.node = RecorderNode(RunLog(folder, topics_of(setup.layout)), self.endpoints, TICK)

    def poll_until(self, condition):
        wait_for(condition, turn=lambda: self.node.poll(last=True))

    def connect(self, foreign, topic, count=1):
        """Wait for both sides of the discovery: a publisher that has met the recorder may still be unknown to it."""
        foreign.until(foreign.publisher(topic).get_subscription_count)
        foreign.until(lambda: self.endpoints.senders(topic) == count)


@pytest.fixture
def recording(setup, domain, tmp_path):
    with ExitStack() as stack:
        yield lambda external=None: Recording(stack, setup, domain, tmp_path, external)


def test_the_suspension_of_a_recorder_is_known_before_it_reads_again(recording):
    """Breaks if a suspended recorder that finds its plant gone names the plant: it has not read its queues since."""
    node = recording().node
    node.poll()
    node._polled -= 7.0  # as after SIGSTOP
    assert node.suspended >= 7.0
    node.poll()
    assert 7.0 <= node.suspended < 7.0 + LIMIT_S


def _report(wire, node, second):
    return wire.encode("/diagnostics", Diagnostic(second * 10**9, node, 0, "ok", {}))


@pytest.mark.parametrize(("external", "first"), [(None, 3), (Role.CONTROLLER, 3), (Role.CONTROLLER, 0)])
def test_commands_lost_before_the_first_recorded_one_are_said(recording, domain, setup, external, first):
    """Breaks if a log without its first commands is complete, those of an earlier run count, or an early node is it."""
    encode, measured = Wire(setup.layout).encode, PlantStage(setup).observe().measurement
    with ForeignNode(domain, "plant") as plant, ForeignNode(domain, "my_controller") as controller:
        command = controller.publisher("ato/command")
        for tick in range(3):
            command.publish(encode("ato/command", Command(tick * TICK, np.zeros(1))))
        recorder = recording(external)
        recorder.connect(controller, "ato/command")
        recorder.connect(plant, "train/measurement")
        publishers = recorder.endpoints.node.get_publishers_info_by_topic
        wait_for(lambda: "my_controller" in [info.node_name for info in publishers("/ato/command")])
        command.publish(encode("ato/command", Command(first * TICK, np.zeros(1))))
        counts = lambda name: recorder.node.log.counts[name]  # noqa: E731
        recorder.poll_until(lambda: counts("ato/command") == 1)
        plant.publish("train/measurement", encode("train/measurement", measured))
        if first == 0:
            recorder.poll_until(lambda: counts("train/measurement") == 1)
            return
        with pytest.raises(NodeFault, match=r"lost before the first recorded one: ato/command: 3; answer") as found:
            recorder.poll_until(lambda: False)
    assert found.value.node == "my_controller"


def test_a_recorder_that_comes_late_records_the_rest(recording, domain, setup):
    """Breaks if the messages before a recorder that was started late count as lost."""
    encode, measured = Wire(setup.layout).encode, PlantStage(setup).observe().measurement
    with ForeignNode(domain, "plant") as plant:
        publisher = plant.publisher("train/measurement")
        publisher.publish(encode("train/measurement", measured))
        recorder = recording()
        recorder.connect(plant, "train/measurement")
        publisher.publish(encode("train/measurement", dataclasses.replace(measured, stamp=TICK)))
        recorder.poll_until(lambda: recorder.node.log.counts["train/measurement"] == 1)
        recorder.node.poll()


def test_diagnostics_under_the_name_of_a_node_are_those_of_one_publisher(recording, domain):
    """Breaks if a message of another program is recorded as one of the node, or the recorder is named for it."""
    with ForeignNode(domain, "controller") as own, ForeignNode(domain, "intruder") as foreign:
        recorder = recording()
        wire, counts = recorder.endpoints.wire, lambda: recorder.node.log.counts["/diagnostics"]
        recorder.connect(own, "/diagnostics")
        for second in range(3):
            own.publish("/diagnostics", _report(wire, "controller", second))
        recorder.poll_until(lambda: counts() == 3)
        assert recorder.notes == []
        recorder.connect(foreign, "/diagnostics", 2)
        # the recorder may match a publisher after the publisher has matched it; the messages before are lost
        recorder.poll_until(lambda: recorder.notes or foreign.publish("/diagnostics", _report(wire, "lidar", 3)))
        text = "node intruder publishes /diagnostics too; only messages of the run's nodes are recorded"
        assert (recorder.notes, counts()) == ([text], 3)
        for _ in range(4):  # message 4 under the name of the node would follow its message 3
            foreign.publish("/diagnostics", _report(wire, "lidar", 3))
        said = "/diagnostics: it sends under the name of node controller; end it"
        with pytest.raises(NodeFault, match=said) as found:
            recorder.poll_until(lambda: foreign.publish("/diagnostics", _report(wire, "controller", 3)[:60]))
        assert (found.value.node, counts()) == ("intruder", 3)
        own.publish("/diagnostics", _report(wire, "controller", 3))
        with suppress(NodeFault):
            wait_for(lambda: counts() == 4, turn=recorder.node.poll)
        assert recorder.notes == [text]


def test_lost_diagnostics_are_no_false_name(recording, domain):
    """Breaks if the rest of the diagnostics is left out after lost ones, or an innocent program is named for them."""
    with ForeignNode(domain, "controller") as own, ForeignNode(domain, "lidar"):
        recorder = recording()
        senders, wire = recorder.node._senders, recorder.endpoints.wire
        own.publisher("/diagnostics")
        wait_for(senders._subscription.get_publisher_count)
        report = _report(wire, "controller", 0)
        assert senders.take(report, 1)
        assert senders.take(report, 5, lossy=True) and senders.fault is None
        assert senders.take(report, 6)
        assert senders.take(report, 9)
        said = "/diagnostics: message 9 of node controller came after message 6; messages"
        assert str(senders.fault).startswith(said)
        assert senders.take(report, 10)
        assert not senders.take(report, 10)


def test_a_repeated_clock_is_not_recorded(recording, domain):
    """Breaks if the time that a paused plant repeats is in the log, which then differs from that of the engine."""
    with ForeignNode(domain, "plant") as plant:
        recorder = recording()
        recorder.connect(plant, "/clock")
        for stamp in (0, TICK, TICK, TICK, 2 * TICK):
            plant.publish("/clock", recorder.endpoints.wire.encode("/clock", Tick(stamp)))
        recorder.poll_until(lambda: recorder.node.log.counts["/clock"] >= 3)
        recorder.node.poll(last=True)
        assert recorder.node.log.counts["/clock"] == 3


def test_the_plant_never_runs_away_from_the_recorder(make):
    """With queues of 1000 messages a lead of 400 ticks never loses a message, at any speed of the recorder."""
    bench = make(Role.PLANT, setup=_unsupervised(60), recorded=True)
    written, command = bench.speaker("recorder/progress"), _commanding(bench)
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


@pytest.mark.parametrize(("role", "failure"), [(Role.RECORDER, "node recorder failed: left"), (Role.OBSERVER, None)])
def test_a_run_without_its_recorder_fails_at_once(make, role, failure):
    """Breaks if the train brakes to a stop that no log keeps, or does not after the loss of another node."""
    bench = make(Role.PLANT, setup=setup_of("demo", "duration=2"), recorded=True)
    bench.node.lose(role, "left")
    assert bench.watch.failure == failure


def test_paced_runs_hold_the_last_command_and_count_late_ones(make):
    """No response in the second tick: the train continues, and the silence is detected."""
    bench = make(Role.PLANT, setup=_unsupervised(600), rate=10.0)
    command = _commanding(bench, "/diagnostics")
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


def test_the_timeout_is_a_parameter_with_a_range(plant):
    bench, _ = plant
    assert not set_parameter(bench.endpoints.node, "timeout", float("nan")).successful
    assert not set_parameter(bench.endpoints.node, "timeout", 0.0).successful
    assert not set_parameter(bench.endpoints.node, "lockstep", True).successful
    bench.node.begin()
    assert not bench.node.check_overdue()
    assert set_parameter(bench.endpoints.node, "timeout", 0.001).successful
    bench.settle()
    assert bench.node.check_overdue()


@pytest.mark.parametrize("seconds", [0.8, 1.2])
def test_a_suspension_of_the_plant_is_no_silence_of_the_others(seconds, plant):
    """Breaks if the plant fails the run by the name of another node as soon as its process continues."""
    # With the wait before it, the suspension of 0.8 s is longer than the time-out too.
    node = plant[0].node
    assert set_parameter(plant[0].endpoints.node, "timeout", 1.0).successful
    node.begin()
    for _ in range(3):
        time.sleep(CHECK_S)
        assert not node.check_overdue()
    time.sleep(seconds)  # as after SIGSTOP: no check for a while
    assert not node.check_overdue()
    wait_for(node.check_overdue)
    assert node.answer_watch.suspended > SUSPENDED_S


def test_stages_publish_what_their_topics_carry(setup):
    """Breaks if a stage publishes a message that its topic cannot contain, an error only in the graph."""
    wire, plant = Wire(setup.layout), PlantStage(setup)
    for topic, message in plant.observe().published() + ProfileStage(setup).start().published():
        assert dataclasses.is_dataclass(message) and wire.encode(topic, message)
        assert Role.PLANT in BY_NAME[topic].publishers or Role.PROFILE in BY_NAME[topic].publishers


def _speak(bench, name):
    """Send an estimate from a new node, and return it."""
    node = Node(name, context=bench.context, enable_rosout=False, start_parameter_services=False)
    publisher = bench.speaker("ato/estimate", node)
    estimate = DisturbanceEstimate(0, np.zeros(bench.wire.layout.n_units))
    publisher.publish(bench.wire.encode("ato/estimate", estimate))
    assert publisher.wait_for_all_acked(Duration(seconds=LIMIT_S))
    bench.settle()
    return node


@pytest.mark.parametrize(("name", "leaves", "renewed", "text"), [
    ("observer", True, True, ""), ("observer", True, False, ""),
    ("mine", False, False, ": a second node mine too;"),
    ("observer", False, False, ": a second node observer too;"),
])  # fmt: skip
def test_a_new_publisher_is_accepted_only_after_the_notice_of_a_restart(name, leaves, renewed, text, make):
    """Breaks if a restarted node is refused, any other publisher accepted, or a program has the name of its role."""
    bench = make(Role.CONTROLLER)
    nodes = [_speak(bench, name)]
    if leaves:
        nodes.pop().destroy_node()
        bench.until(lambda: bench.endpoints.left(Role.OBSERVER))
    if renewed:
        bench.endpoints.renew(Role.OBSERVER)
        nodes.append(_speak(bench, name))
        assert bench.watch.failure is None
    nodes.append(_speak(bench, name))
    bench.until(lambda: bench.watch.failure is not None)
    assert f"ato/estimate has more than one publisher{text}" in bench.watch.failure
    for node in nodes:
        node.destroy_node()
