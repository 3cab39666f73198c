"""Nodes outside of the run and hosts that can join it: no recorded data are lost, their messages are rejected."""

import itertools
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from engine_runs import record_run, setup_of
from foreign_node import ForeignNode
from programs import begun
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.duration import Duration
from rclpy.task import Future
from recordings import commands_in
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool
from test_composed_runs import terminals  # noqa: F401
from two_hosts import HOSTS, two_hosts  # noqa: F401
from waiting import LIMIT_S, reserved_domain, wait_for

from train_ato.log.mcap_records import stream
from train_ato.log.reading import iter_raw
from train_ato.log.run_folder import RunFolder
from train_ato.loop.engine import run_engine
from train_ato.messages.codec import Wire
from train_ato.messages.topics import EPOCH_NS
from train_ato.messages.types import Diagnostic, DisturbanceEstimate, Pipe, Reference, Tick
from train_ato.ros.graph.composed import run_composed
from train_ato.ros.graph.environment import applied, claim_domain, middleware, opened_by, variables
from train_ato.ros.graph.graph_result import GraphOptions, GraphResult
from train_ato.ros.graph.recorded import recorded_result
from train_ato.ros.standalone import discovery, runner

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
    late = SimpleNamespace(success=False, message="waits for the end of a second node")
    client.call_async = lambda _: SimpleNamespace(done=lambda: True, result=lambda: late)
    assert not all(found.complete() for _ in range(20)), "an answer counts after a second node came"
    ends.awaited, ends.last_stamp, ends.node = lambda: "", -1, SimpleNamespace(count_publishers=lambda topic: 1)
    ends.serve = lambda kind, name, answer: setattr(ends, "answer", answer)
    discovery.answer_ready(ends, {})
    beside = ends.answer(SetBool.Request(), SetBool.Response())
    assert beside.success, "a plant of another program waits for ever beside a recorder"
    client.call_async = lambda _: SimpleNamespace(done=lambda: True, result=lambda: beside)
    assert not any(found.complete() for _ in range(20)), "a run begins before the plant has found the recorder"
    ends.senders = lambda topic: ("recorder",)
    assert any(found.complete() for _ in range(20)), found.missing_peers()
    recorder = SimpleNamespace(node=SimpleNamespace(recorder_heard=float(next(clock))))
    connected = [runner.StandaloneRunner._recorder_connected(recorder) for _ in range(2)]
    assert connected == [True, False], "a message of an ended recorder counts for ever"


def test_a_second_publisher_that_goes_on_does_not_hold_the_recorder():
    """Breaks if a recorder by hand waits for ever for the end of a stranger that has failed the run."""
    for wrong, end in itertools.product((None, ValueError()), (None, "notice")):
        node, ends = SimpleNamespace(poll=lambda: 1, wrong=wrong), SimpleNamespace(end=end)
        recorder = SimpleNamespace(node=node, endpoints=ends, last_heard=0.0, first_heard=0.0)
        runner.StandaloneRunner._poll(recorder)
        assert (recorder.last_heard > 0.0) == (wrong is None or end is None)


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


VARIABLES = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS", "FASTRTPS_DEFAULT_PROFILES_FILE")
BRAKE = """
import sys
from foreign_node import ForeignNode
from std_srvs.srv import SetBool
with ForeignNode(int(sys.argv[1])) as foreign:
    try:
        answer = foreign.call(SetBool, "plant/emergency_brake", SetBool.Request(data=True), limit=float(sys.argv[2]))
        print("answered", answer.success)
    except AssertionError:
        print("not found", sorted(foreign.node.get_node_names()))
"""
"""Program of another host: discover the plant and brake its train."""


def environment(**variables: str) -> dict[str, str]:
    """Return an environment with only these variables of ROS set."""
    return {**{name: value for name, value in os.environ.items() if name not in VARIABLES}, **variables}


class Drive:
    """``train-ato run`` in a separate process, optionally on another host."""

    def __init__(self, folder: Path, *options: str, host: tuple[str, ...] = (), **variables: str) -> None:
        self.domain = reserved_domain()
        self.out = folder / "run"
        words = ["run", "demo", "--set=duration=3600", "--rate=20", f"--domain={self.domain}", f"--out={self.out}"]
        words = [*host, sys.executable, "-m", "train_ato", *words, *options]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        self.process = subprocess.Popen(words, env=environment(**variables), **pipes)

    def wait(self) -> None:
        """Wait until the train moves."""
        wait_for(lambda: self.process.poll() is not None or commands_in(self.out), "the first command")
        assert self.process.poll() is None, self.process.communicate()

    def end(self) -> str:
        """End the run with Ctrl-C and return its stderr."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        return self.process.communicate(timeout=LIMIT_S)[1]


@pytest.fixture
def drive(tmp_path: Path) -> Iterator[type[Drive]]:
    begun = []

    def start(*options, **more):
        begun.append(Drive(tmp_path, *options, **more))
        begun[-1].wait()
        return begun[-1]

    yield start
    for run in begun:
        run.end()


@pytest.mark.parametrize(
    ("options", "variables", "loopback"),
    [
        ([], {}, True),
        ([], {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, True),
        pytest.param(["--processes"], {}, True, marks=pytest.mark.graph),
        ([], {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, False),
    ],
    ids=["composed", "localhost", "processes", "subnet"],
)
def test_sockets_of_a_run(options, variables, loopback, drive):
    """Fails if a socket of a default run is open to a network: one on all interfaces, or in a multicast group."""
    run = drive(*options, **variables)
    parent = str(run.process.pid)
    pids = {parent, *Path(f"/proc/{parent}/task/{parent}/children").read_text().split()}
    listed = subprocess.run(["ss", "-lnupH"], capture_output=True, text=True, check=True).stdout.splitlines()
    sockets = [line.split()[3] for line in listed if pids & set(re.findall(r"pid=(\d+)", line))]
    assert len(sockets) >= (10 if options else 2)
    outside = [address for address in sockets if not address.startswith("127.0.0.1:")]
    assert (outside == []) is loopback, sockets
    said = run.end()
    assert ("other hosts may join this run" in said) is not loopback
    reach = json.loads((run.out / "summary.json").read_text()).get("reach")
    assert reach == (None if loopback else "network")


@pytest.mark.graph
@pytest.mark.parametrize(
    ("variables", "answer"),
    [({}, "not found ['intruder']"), ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, "answered True")],
    ids=["default", "subnet"],
)
def test_another_host_joins_only_where_it_is_asked_for(variables, answer, two_hosts, drive):  # noqa: F811
    """Breaks if another host finds the nodes of a default run, or a permitted second machine does not work."""
    here, there = two_hosts
    run = drive(host=here, **variables)
    foreign = environment(ROS_STATIC_PEERS=HOSTS[0], ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET")
    limit = "20" if variables else "8"
    words = [*there, sys.executable, "-c", BRAKE, str(run.domain), limit]
    found = subprocess.run(words, env=foreign, capture_output=True, text=True, timeout=90)
    assert found.stdout.strip() == answer, found.stderr


@pytest.mark.graph
def test_a_default_program_of_this_machine_meets_a_default_run(drive, monkeypatch):
    """Fails if tools that use the default profile of Fast DDS no longer find the run on this machine."""
    from std_srvs.srv import SetBool

    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)
    run = drive()
    with ForeignNode(run.domain) as foreign:
        request = SetBool.Request(data=True)
        assert foreign.call(SetBool, "plant/pause", request, limit=20.0).success


@pytest.mark.parametrize(
    ("given", "range_", "profile", "opened"),
    [
        ({}, "SYSTEM_DEFAULT", "fastdds.xml", None),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, "SYSTEM_DEFAULT", "fastdds.xml", None),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, "SUBNET", "fastdds_network.xml", "_RANGE=SUBNET"),
        ({"ROS_STATIC_PEERS": "127.0.0.1;::1"}, "LOCALHOST", "fastdds_network.xml", "ROS_STATIC_PEERS=127.0.0.1;::1"),
        ({"FASTRTPS_DEFAULT_PROFILES_FILE": "own.xml"}, "LOCALHOST", "own.xml", "_FILE=own.xml"),
    ],
)
def test_the_middleware_follows_the_user(given, range_, profile, opened, monkeypatch, tmp_path):
    """A process started by a run gets the same settings."""
    monkeypatch.chdir(tmp_path)
    Path("own.xml").write_text("<profiles/>")
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    for _ in range(2):
        found = middleware()
        assert found["ROS_AUTOMATIC_DISCOVERY_RANGE"] == range_
        assert Path(found["FASTRTPS_DEFAULT_PROFILES_FILE"]).name == profile
        assert (opened_by() or "").endswith(opened or "")
        assert (opened_by() is None) is (opened is None)
        for name, value in found.items():
            monkeypatch.setenv(name, value)
