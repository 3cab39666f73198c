"""Nodes outside of the run on its domain: no recorded data are lost, and their messages are rejected."""

import itertools
import json
import re
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from engine_runs import record_run, setup_of
from programs import begun
from recordings import commands_in

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from foreign_node import ForeignNode
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.duration import Duration
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool
from test_composed_runs import terminals  # noqa: F401
from waiting import LIMIT_S, reserved_domain

from train_ato.log.mcap_records import stream
from train_ato.log.reading import iter_raw
from train_ato.log.run_folder import RunFolder
from train_ato.loop.engine import run_engine
from train_ato.messages.codec import Wire
from train_ato.messages.topics import EPOCH_NS
from train_ato.messages.types import Diagnostic, DisturbanceEstimate, Pipe, Reference, Tick
from train_ato.ros.graph.composed import run_composed
from train_ato.ros.graph.environment import applied, claim_domain, variables
from train_ato.ros.graph.graph_result import GraphOptions, GraphResult
from train_ato.ros.graph.recorded import recorded_result
from train_ato.ros.standalone import discovery

WAYS = pytest.mark.parametrize(
    "way", [[], pytest.param(["--processes"], marks=pytest.mark.graph)], ids=["composed", "processes"]
)
SLOW = "--rate=60"


class Running:
    """``train-ato run`` in a separate process and a foreign node on its domain."""

    def __init__(self, folder: Path, *options: str, duration: int = 600) -> None:
        self.domain = reserved_domain()
        self.out = folder / "run"
        words = ["run", "demo", f"--set=duration={duration}", f"--domain={self.domain}", f"--out={self.out}", "--json"]
        self.process = begun(*words, *options)
        self.foreign = ForeignNode(self.domain)

    def driving(self) -> None:
        """Wait until the train moves."""
        self.foreign.until(lambda: self.process.poll() is not None or commands_in(self.out))
        assert self.process.poll() is None, self.process.communicate()

    def end(self, limit: float = LIMIT_S) -> tuple[int, str]:
        """Return exit status and last line on stderr."""
        _, errors = self.process.communicate(timeout=limit)
        return self.process.returncode, errors.strip().splitlines()[-1] if errors.strip() else ""

    def interrupt(self) -> tuple[int, str]:
        """Stop the run by Ctrl-C."""
        self.process.send_signal(signal.SIGINT)
        return self.end()

    @property
    def summary(self) -> dict[str, object]:
        return json.loads((self.out / "summary.json").read_text())


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Running]]:
    begun: list[Running] = []

    def running(*options: str, **more: int) -> Running:
        begun.append(Running(tmp_path, *options, **more))
        return begun[-1]

    yield running
    for run in begun:
        run.foreign.close()
        if run.process.poll() is None:
            run.process.send_signal(signal.SIGINT)
            run.process.communicate(timeout=LIMIT_S)


def status(name: str) -> DiagnosticStatus:
    return DiagnosticStatus(name=name, message="ok", values=[KeyValue(key="changed", value="no JSON")])


def two_statuses(run: Running) -> None:
    run.foreign.publish("/diagnostics", DiagnosticArray(status=[status("lidar"), status("controller")]))


def unknown_name(run: Running) -> None:
    run.foreign.publish("/diagnostics", DiagnosticArray(status=[status("controller: update rate")]))


def cut_diagnostics(run: Running) -> None:
    run.foreign.publish("/diagnostics", b"\x00\x01\x00\x00\x01\x02")


def parameter_of_no_type(run: Running) -> None:
    """Set three parameters, one of an unknown type; the answer contains the results of all three."""
    values = [
        ParameterMessage(name="pid.kp", value=ParameterValue(type=99)),
        ParameterMessage(name="pid.kq", value=ParameterValue(type=3, double_value=1.0)),
        ParameterMessage(name="pid.kp", value=ParameterValue(type=3, double_value=0.05)),
    ]
    answer = run.foreign.call(SetParameters, "controller/set_parameters", SetParameters.Request(parameters=values))
    assert [result.successful for result in answer.results] == [False, False, True]
    assert "99 is not a valid" in answer.results[0].reason


HARMLESS = (two_statuses, unknown_name, cut_diagnostics, parameter_of_no_type)


@WAYS
def test_messages_of_other_programs_do_not_disturb_the_run(way, start):
    """Fails if an ordinary node of the domain ends the run, is recorded in its log, or deletes it."""
    run = start(SLOW, *way)
    run.driving()
    for act in HARMLESS:
        act(run)
    run.foreign.settle()
    code, said = run.interrupt()
    assert code == 1
    assert re.fullmatch(rf"train-ato: interrupted: .+; recorded data: {run.out}", said)
    assert run.summary["status"] == "interrupted"
    decode = Wire(setup_of("demo").layout).decode
    told = [decode("/diagnostics", m.data) for m in stream(run.out / "run.mcap") if m.channel.topic == "/diagnostics"]
    assert {message.node for message in told} == {"plant", "supervisor", "profile", "observer", "controller"}


def test_a_reader_gets_the_parts_of_the_force(start):
    """Breaks if the parts of a command do not reach a reader, or their sum is not the command."""
    run, heard = start(SLOW, "--set=observer=eso"), []
    run.foreign.node.create_subscription(JointState, "ato/force_parts", heard.append, 1000)
    run.foreign.until(lambda: all(any(message.effort[part] for message in heard) for part in range(3)))
    run.interrupt()
    decode = Wire(setup_of("demo").layout).decode
    sent = {stamp: decode("ato/command", data).force for _, stamp, data in iter_raw(run.out, ("ato/command",))}
    for message in heard:
        assert message.name == ["feed_forward_0", "feedback_0", "estimate_0"]
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec - EPOCH_NS
        assert sum(message.effort) == pytest.approx(sent[stamp].item(), abs=1e-6)


TICK = 100_000_000
TAKEOVERS = [
    pytest.param("ato/reference", lambda stamp: Reference(stamp, 0.0, 0.0, 0.0), [SLOW], id="reference"),
    pytest.param("ato/estimate", lambda stamp: DisturbanceEstimate(stamp, np.array([1e6])), [SLOW], id="estimate"),
    pytest.param("ato/brake_pipe_command", lambda stamp: Pipe(stamp, 0.0), ["--no-lockstep", "--rate=20"],
        id="brake_pipe_realtime"),
    pytest.param("recorder/progress", Tick, [SLOW], id="acknowledgement"),
    pytest.param("/clock", Tick, [SLOW], id="clock", marks=pytest.mark.graph),
    pytest.param("ato/reference", lambda stamp: Reference(stamp, 0.0, 0.0, 0.0), [SLOW, "--processes"],
        id="reference to processes", marks=pytest.mark.graph),
]  # fmt: skip


@pytest.fixture(scope="module")
def true_cars(tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    """Return the states of the train without another program."""
    run = record_run(setup_of("demo", "duration=600"), tmp_path_factory.mktemp("true") / "run")
    return [data for _, _, data in iter_raw(run, ("train/vehicles",))]


@pytest.mark.parametrize(("topic", "message", "options"), TAKEOVERS)
def test_a_second_publisher_ends_the_run_by_its_name(topic, message, options, start, true_cars):
    """Fails if the run continues, names a node of its own, or the foreign commands drive the train."""
    run = start(*options)
    run.driving()
    encode = Wire(setup_of("demo").layout).encode
    now = max(m.publish_ns for m in stream(run.out / "run.mcap.partial", broken=True)) - EPOCH_NS
    for ahead in range(60):
        run.foreign.publish(topic, encode(topic, message(now + ahead * TICK)))
    code, said = run.end()
    assert code == 1 and f"{topic} has more than one publisher: node intruder too; end it" in said
    assert run.summary["status"] == "failed" and str(run.summary["failure"]) in said
    found = [data for _, _, data in iter_raw(run.out, ("train/vehicles",))]
    assert options != [SLOW] or found == true_cars[: len(found)]


@pytest.mark.graph
def test_a_publisher_that_has_left_is_noticed_too(start):
    """Breaks if a node can send one message and leave undetected."""
    run = start(SLOW)
    run.driving()
    wire = Wire(setup_of("demo").layout)
    run.foreign.publish("ato/estimate", wire.encode("ato/estimate", DisturbanceEstimate(0, np.zeros(1))))
    publisher = run.foreign.publisher("ato/estimate")
    assert publisher.wait_for_all_acked(Duration(seconds=LIMIT_S))
    run.foreign.node.destroy_publisher(publisher)
    code, said = run.end()
    assert code == 1 and "ato/estimate has more than one publisher" in said


def test_a_run_does_not_begin_beside_a_second_publisher(tmp_path):
    """Fails if the run ends without the name of the foreign node, or continues after its discovery."""
    # On a loaded machine its discovery may take longer than the start of the run, and any node may name it first;
    # `test_two_controllers_are_refused` has the discovery before the start.
    setup = setup_of("demo", "duration=3600")
    with claim_domain() as domain, applied(variables(domain, tmp_path / "log")), ForeignNode(domain) as foreign:
        foreign.publisher("ato/command")
        foreign.settle(0.1)
        end = run_composed(setup, tmp_path, domain, GraphOptions(start_limit=1.0))
    before = "node plant failed: it waited 1 s for the end of node intruder"
    after = r"node \w+ failed: ato/command has more than one publisher: node intruder too; end it"
    assert end.failure is not None and (end.failure.startswith(before) or re.fullmatch(after, end.failure))
    assert end.ticks < setup.ticks and (end.ticks == 0 or re.fullmatch(after, end.failure))


@pytest.mark.parametrize(
    ("change", "differs"), [("seed=7", "seed"), pytest.param("tick=0.05", "tick", marks=pytest.mark.graph)]
)
def test_nodes_of_unequal_scenarios_do_not_begin(change, differs, terminals):  # noqa: F811
    """Fails if the profile of another run drives the train."""
    terminals.start("profile", "--scenario=demo", f"--set={change}")
    plant = terminals.start("plant", "--scenario=demo")
    said = plant.communicate(timeout=LIMIT_S)[0]
    assert plant.returncode == 1
    text = f"it was started with another scenario than the plant: {differs} differ; give every node the same"
    assert f"node profile failed: {text}" in said


def test_an_answer_that_comes_after_the_next_request_counts(monkeypatch):
    """Fails if a plant waits for ever for nodes of a loaded machine, whose answers come after its next requests."""
    sent = []

    def request(_: SetBool.Request) -> Future:
        sent.append(Future())
        if len(sent) > 2:
            sent[-3].set_result(SetBool.Response(success=True, message="ready; stamp -1; scenario {}"))
        return sent[-1]

    client = SimpleNamespace(service_is_ready=lambda: True, call_async=request)
    ends = SimpleNamespace(
        node=SimpleNamespace(create_client=lambda *_: client),
        wire=Wire(setup_of("demo", "duration=1", "supervision.enabled=false").layout),
        senders=lambda topic: (),
        external=None,
        missing=lambda roles: [],
    )
    clock = itertools.count()
    monkeypatch.setattr(discovery.time, "monotonic", lambda: float(next(clock)))
    found = discovery.Discovery(ends, {}, False, lambda: True)
    assert any(found.complete() for _ in range(20)), found.missing_peers()


@pytest.mark.graph
def test_a_second_observer_started_alone_is_named(terminals):  # noqa: F811
    """Fails if the controller uses the estimates of two observers, or no node of the run names the second one."""
    # On a loaded machine its discovery may take longer than the start of the run: then the controller names it and
    # ends.
    for role in ("supervisor", "profile", "controller"):
        terminals.start(role, "--scenario=demo")
    terminals.start("observer", "--scenario=demo")
    terminals.start("observer", "--scenario=demo")
    plant = terminals.start("plant", "--scenario=demo", "--timeout=60", "--rate=1")
    said = ""
    for line in plant.stdout:
        if "a second node observer" in line:
            return
        said += line
    assert "node controller failed: no answer" in said
    assert "more than one publisher: a second node observer too" in terminals.processes["controller"].communicate()[0]


CUT = b"\x00\x01\x00\x00" + bytes(5)


def _nan(wire: Wire, topic: str) -> bytes:
    """Return a message with NaN as its last number."""
    data = bytearray(wire.encode(topic, DisturbanceEstimate(0, np.array([12345.678]))))
    place = data.find(np.array([12345.678]).tobytes())
    data[place : place + 8] = np.array([np.nan]).tobytes()
    return bytes(data)


@pytest.mark.parametrize(
    ("topic", "bad", "says"),
    [
        ("ato/estimate", lambda wire: _nan(wire, "ato/estimate"), "effort is not finite: nan"),
        ("train/vehicles", lambda wire: CUT, "not a sensor_msgs/msg/JointState"),
        (
            "/diagnostics",
            lambda wire: wire.encode("/diagnostics", Diagnostic(0, "controller", 0, "", {"changed": "{"})),
            "changed '{': not written by this version",
        ),
    ],
)
def test_a_record_that_cannot_be_read_fails_the_run_and_keeps_its_figures(topic, bad, says, tmp_path):
    """Fails if one damaged record counts as bad input, or the records before it are not used."""
    setup = setup_of("demo", "duration=20")
    folder = RunFolder.make(tmp_path / "run", "demo")
    with folder.sink(setup) as sink:
        add = sink.add

        def spoilt(name, message, stamp):
            if name == topic and stamp == 10 * 10**9:
                sink._log.add(name, EPOCH_NS + stamp, EPOCH_NS + stamp, bad(sink._wire))
            else:
                add(name, message, stamp)

        sink.add = spoilt
        run_engine(setup, sink=sink)
    outcome = recorded_result(setup, folder.path, GraphResult(ticks=200))
    assert outcome.failure.startswith(f"node recorder failed: {folder.path / 'run.mcap'}: {topic} for 10.000 s: ")
    assert says in outcome.failure and outcome.summary["status"] == "failed"
    assert outcome.recording.time.size in (100, 101)


def test_a_folder_with_a_log_is_not_discarded(tmp_path):
    for name in ("run.mcap", "run.mcap.partial", "law/run.mcap"):
        folder = RunFolder.make(tmp_path / name.replace("/", "-"), "demo")
        (folder.path / name).parent.mkdir(exist_ok=True)
        (folder.path / name).write_bytes(b"recorded")
        folder.discard()
        assert (folder.path / name).read_bytes() == b"recorded"
    empty = RunFolder.make(tmp_path / "empty", "demo")
    empty.discard()
    assert not empty.path.exists()
