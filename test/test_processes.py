"""Nodes in separate processes: a failed process is named or restarted, and no process remains."""

import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")

from engine_runs import setup_of
from programs import begun, python
from recordings import commands_in, message_counts
from remains import processes_of
from waiting import LIMIT_S, reserved_domain, wait_for

import train_ato as ta
from train_ato.judge.result import Progress, RunResult
from train_ato.log.bag_layout import PARTIAL
from train_ato.log.mcap_records import stream
from train_ato.log.reading import iter_raw, read_log
from train_ato.log.recorded import open_recording
from train_ato.log.recover import recover
from train_ato.log.run_folder import RunFolder
from train_ato.messages.codec import Wire
from train_ato.messages.topics import Rate, Role, published_by, tick_topics, topics_of
from train_ato.messages.types import AtoState
from train_ato.program.interrupt import Interrupt
from train_ato.report.events import detect_events
from train_ato.ros.graph import processes, shared_memory
from train_ato.ros.graph.domain_lock import DomainLock
from train_ato.ros.graph.environment import claim_domain
from train_ato.ros.graph.graph_result import GraphResult
from train_ato.ros.graph.node_process import STOPPED_S, NodeProcess, with_stop
from train_ato.ros.graph.restarts import Restarts
from train_ato.ros.graph.runner import run_graph
from train_ato.ros.nodes.answer_watch import LEASE_S
from train_ato.ros.nodes.endpoints import ROLES
from train_ato.scenario.setup import RunSetup

ROOT = Path(__file__).resolve().parents[1]
PACED = 20.0


@pytest.fixture(scope="module")
def setup():
    return setup_of("demo", "duration=600")


DIED = "its process was ended by SIGKILL"


@pytest.mark.graph
@pytest.mark.parametrize(("victim", "number", "goes_on", "limit", "says"), [
    ("observer", signal.SIGKILL, None, LIMIT_S, f"node observer failed: {DIED}"),
    ("plant", signal.SIGKILL, None, LIMIT_S, f"node plant failed: {DIED}"),
    ("controller", signal.SIGSTOP, None, 5.0, "node controller failed: no answer to stamp"),
    ("plant", signal.SIGSTOP, LEASE_S + 2.0, 5.0,
     r"node plant failed: its process was suspended for \d+\.\d s; after 3 s the other "),
    ("plant", signal.SIGSTOP, None, 5.0,
     r"node plant failed: no report for 25 s after tick \d+; its process hangs; its process was stopped "),
])  # fmt: skip
def test_a_node_that_dies_or_hangs_is_named(victim, number, goes_on, limit, says, setup, tmp_path):
    """Fails if the run continues with old values or for ever, names another node, or leaves the stopped process."""
    started = []

    def strike(progress):
        if progress.simulated > 5 and not started:
            started.append(processes_of(tmp_path))
            os.kill(started[0][victim], number)
            if goes_on is not None:
                threading.Timer(goes_on, os.kill, (started[0][victim], signal.SIGCONT)).start()

    outcome = run_graph(setup, tmp_path, mode="processes", progress=strike, timeout=limit, lockstep=False, rate=PACED)
    assert sorted(started[0]) == ["controller", "observer", "plant", "profile", "recorder", "supervisor"]
    assert re.match(says, outcome.failure)
    assert outcome.summary["status"] == "failed"
    assert not processes_of(tmp_path)
    wait_for(lambda: not shared_memory.abandoned())
    assert message_counts(tmp_path)["/train/measurement"] >= 50


@pytest.mark.parametrize(
    ("recorded", "failure"), [(12, None), (11, "node recorder failed: ato/command: 11 of 12 messages are recorded")]
)
def test_a_message_lost_at_the_end_fails_the_run(recorded, failure):
    """Breaks if a run whose log has fewer messages than were published counts as complete."""
    nodes = {role: SimpleNamespace(counts={"ignored": [0]}, tick=12) for role in ROLES}
    nodes[Role.CONTROLLER].counts["published ato/command"] = [12]
    nodes[Role.RECORDER].counts["recorded ato/command"] = [recorded]
    end = GraphResult()
    processes._collect(nodes, end, None)
    assert (end.failure, end.published, end.ticks) == (failure, {"ato/command": 12}, 12)


def test_a_run_that_was_stopped_before_its_first_tick_blames_no_recorder():
    """Breaks if a stop while the processes load fails the run by the profile, which was sent before the recorder."""
    nodes = {role: SimpleNamespace(counts={"ignored": [0]}, tick=0) for role in ROLES}
    nodes[Role.PROFILE].counts["published ato/profile"] = [1]
    nodes[Role.PLANT].counts["published train/measurement"] = [0]
    nodes[Role.RECORDER].counts["recorded ato/profile"] = [0]
    processes._collect(nodes, end := GraphResult(), None)
    assert end.failure is None


@pytest.mark.parametrize(("commands", "status", "done"), [(6000, -9, True), (5999, -9, False), (6000, 1, False)])
def test_a_node_that_is_killed_after_its_last_message_fails_no_run(commands, status, done, setup):
    """Breaks if a kill beside the end fails a run with all its messages, or one without its last command passes."""
    nodes = {role: SimpleNamespace(role=role, counts={"ignored": [0]}, tick=6000, failure=None) for role in ROLES}
    nodes[Role.CONTROLLER].failure, nodes[Role.CONTROLLER].process = "killed", SimpleNamespace(returncode=status)
    counts = {topic.name: 6000 for topic in topics_of(setup.layout)} | {"ato/command": commands}
    nodes[Role.RECORDER].counts |= {f"recorded {topic}": [count] for topic, count in counts.items()}
    assert processes._work_done(nodes, setup) is done
    nodes[Role.CONTROLLER].failure, nodes[Role.RECORDER].failure = None, "killed"
    nodes[Role.RECORDER].process = SimpleNamespace(returncode=-9)
    del nodes[Role.RECORDER].counts["ignored"]
    assert not processes._work_done(nodes, setup)


@pytest.mark.graph
def test_a_killed_recorder_leaves_a_log_that_can_be_recovered(setup, tmp_path):
    """All messages of the chunks closed before the kill are recovered, without a gap."""
    partial = tmp_path / PARTIAL
    struck = []

    def strike(progress):
        if progress.simulated > 2 * PACED and not struck:
            struck.append(list(stream(partial, broken=True)))
            os.kill(processes_of(tmp_path)["recorder"], signal.SIGKILL)

    outcome = run_graph(setup, tmp_path, mode="processes", progress=strike, timeout=LIMIT_S, lockstep=False, rate=PACED)
    assert outcome.failure == "node recorder failed: its process was ended by SIGKILL"
    assert not processes_of(tmp_path)
    assert partial.exists()
    count = recover(tmp_path).messages
    assert count >= len(struck[0]) > 1000
    assert [m.data for m in stream(tmp_path / "run.mcap")][: len(struck[0])] == [m.data for m in struck[0]]
    stamps = [stamp for _, stamp, _ in read_log(tmp_path, Wire(setup.layout).decode, ("train/vehicles",))]
    assert stamps == [k * setup.tick_ns for k in range(len(stamps))]


@pytest.mark.graph
@pytest.mark.parametrize("role", [Role.RECORDER, Role.OBSERVER, Role.PLANT], ids=lambda role: role.value)
def test_a_node_that_cannot_start_is_named(role, setup, tmp_path, monkeypatch):
    """Breaks if a refused parameter of one node is reported with the name of a waiting node."""

    class Misled(NodeProcess):
        def __init__(self, started, arguments, *rest):
            super().__init__(started, [*arguments, *(["--set=observer=nosuch"] if started is role else [])], *rest)

    monkeypatch.setattr(processes, "NodeProcess", Misled)
    outcome = run_graph(setup, tmp_path, mode="processes")
    assert re.fullmatch(rf"node {role.value} failed: \S+: unknown observer 'nosuch'; known: .*", outcome.failure)
    assert outcome.summary["status"] == "failed"
    assert not processes_of(tmp_path)
    wait_for(lambda: not shared_memory.abandoned())


@pytest.mark.graph
def test_ctrl_c_while_the_nodes_load_is_no_failure_of_a_node(setup, tmp_path, monkeypatch):
    """Breaks if the plant, which Python ends while it loads, is named as the reason of an interrupted run."""

    class Struck(NodeProcess):
        def __init__(self, started, *rest):
            super().__init__(started, *rest)
            for process in (self.process.pid, os.getpid()) if started is Role.PLANT else ():
                os.kill(process, signal.SIGINT)

    monkeypatch.setattr(processes, "NodeProcess", Struck)
    outcome = run_graph(setup, tmp_path, mode="processes")
    assert outcome.failure is None and outcome.summary["status"] == "interrupted"


@pytest.fixture
def hanging(tmp_path, monkeypatch):
    """Give the function that starts a node whose process hangs after the counts that it prints."""
    program = tmp_path / "hangs"

    def start(prints, role):
        program.write_text(f"#!/bin/sh\necho {prints}\nexec sleep 600\n")
        program.chmod(0o755)
        monkeypatch.setattr(sys, "executable", str(program))
        node = NodeProcess(role, [], 1, tmp_path)
        wait_for(lambda: node.counts)
        return node

    return start


@pytest.mark.parametrize(
    ("prints", "failure"),
    [
        ("ignored:0", None),
        ("published train/vehicles:3", "node plant failed: its process did not end with the run"),
        ("ignored:0; echo a warning >&2", None),
        ("ignored:0; echo node observer failed: late >&2", "node observer failed: late"),
    ],
)
def test_a_process_that_hangs_after_its_last_count_fails_no_run(prints, failure, hanging):
    """Breaks if a complete run fails for a middleware that does not shut down, or a node without counts passes."""
    node = hanging(prints, Role.PLANT)
    assert node.failure is None
    node.release()
    node.end(0.1)
    assert node.failure == failure
    assert node.process.returncode == -signal.SIGKILL


TRACE = """node: a warning
Traceback (most recent call last):
  File "entry.py", line 1, in _run
    node = make_node(
"""


@pytest.mark.parametrize(
    ("printed", "error"),
    [
        (TRACE, ""),
        (f"{TRACE}ValueError: first\nsecond line\n  third\n", "ValueError: first"),
        (f"{TRACE}E: 1\n\nDuring handling of E:\n\n{TRACE}KeyError: 2\na thread ends\n", "KeyError: 2"),
        (f"node plant failed: late\n{TRACE}KeyError: 2\n", "node plant failed: late"),
        ("plant: a.yaml: no such file\n", "a.yaml: no such file"),
    ],
)
def test_the_last_error_of_a_node_is_that_of_its_traceback(printed, error, hanging):
    """Breaks if a line of the code is the reason of a failure, or keeps a crashed node from its restart."""
    node = hanging("tick:1", Role.PLANT)
    node._errors.write_text(printed)
    assert node.last_error == error
    node.end(0.0)


def test_a_process_that_is_killed_after_its_last_count_fails_no_run(hanging):
    """Breaks if a middleware that crashes at its end, after the work of the node, fails a complete run."""
    node = hanging("ignored:0", Role.CONTROLLER)
    node.process.kill()
    node.process.wait()
    assert not node.failure and not node.crashed


def test_a_stopped_process_is_the_reason_of_a_missing_answer(hanging):
    """Breaks if a node that SIGSTOP or a debugger holds is only said not to answer."""
    node = hanging("tick:1", Role.CONTROLLER)
    os.kill(node.process.pid, signal.SIGSTOP)
    wait_for(lambda: node.look() or node.stopped > STOPPED_S)
    silent = "node controller failed: no answer to stamp 1.000 s within 10 s"
    said = with_stop(silent, {Role.CONTROLLER: node})
    assert re.match(silent + r"; its process was stopped for \d\.\d s .*; a run in one process, without --proc", said)
    node.end(0.0)


def test_a_plant_that_hangs_after_its_last_count_fails_no_run(hanging, monkeypatch):
    """Breaks if the entry waits for the end of the plant's process: a complete run fails by `its process hangs`."""
    monkeypatch.setattr(processes, "_CLOSING_S", 0.1)
    monkeypatch.setattr(processes, "LEAVING_S", 0.1)
    nodes = {role: hanging("ignored:0", role) for role in (Role.RECORDER, Role.PLANT)}
    restarts = Restarts(nodes, lambda role, number: nodes[role], 0)
    assert processes._supervise(nodes, Interrupt(), None, 0.0, 0.0, None, restarts) is None
    assert nodes[Role.PLANT].process.returncode == -signal.SIGKILL


def test_a_node_ends_while_its_middleware_holds_the_lock_of_the_interpreter():
    """Breaks if the exit of a node by hand needs the interpreter: Ctrl-C would not end it either."""
    code = "import ctypes; from train_ato.ros.standalone.entry import exit_within; print('said', end=''); "
    code += "exit_within(0.3, 7); ctypes.PyDLL(None).sleep(600)"
    done = python("-c", code)
    assert (done.returncode, done.stdout, done.stderr) == (7, "said", "")


def _command_line(folder: Path, *options: str) -> subprocess.Popen[str]:
    return begun("run", "demo", "--set=duration=600", f"--out={folder}", *options)


@pytest.mark.parametrize(
    ("way", "number"),
    [
        ("--processes", signal.SIGINT),
        pytest.param("--processes", signal.SIGTERM, marks=pytest.mark.graph),
        ("--composed", signal.SIGINT),
    ],
)
def test_ctrl_c_ends_a_run_cleanly(way, number, tmp_path):
    """One line, exit status 1, a complete log, no remaining process or shared memory."""
    # In lockstep no message is late on a slow machine, which would be a line of its own.
    folder = tmp_path / "run"
    options = [way] if way == "--processes" else []
    process = _command_line(folder, *options, f"--rate={PACED:g}")
    wait_for(lambda: commands_in(folder) > 10)
    process.send_signal(number)
    _, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 1, err
    lines = [line for line in err.splitlines() if line.strip() and not line.startswith(("ROS domain ", "waiting for "))]
    assert len(lines) == 1
    assert "interrupted" in lines[0]
    counts = message_counts(folder)
    assert counts["/ato/command"] == counts["/train/measurement"] == counts["/train/vehicles"] - 1 > 5
    assert not (folder / PARTIAL).exists()
    assert not processes_of(folder)
    wait_for(lambda: not shared_memory.abandoned())


@pytest.mark.graph
def test_a_killed_runner_leaves_no_orphans(setup, tmp_path):
    """The nodes detect the closed pipe and end, and keep the domain; the recorder closes the log with all messages."""
    folder, following = tmp_path / "run", DomainLock(domain := reserved_domain())
    # lockstep: no tick without a command
    process = _command_line(folder, "--processes", f"--domain={domain}", f"--rate={PACED:g}")
    wait_for(lambda: commands_in(folder) > 50)
    assert sorted(processes_of(folder)) == ["controller", "observer", "plant", "profile", "recorder", "supervisor"]
    seen = commands_in(folder)
    process.kill()
    process.communicate(timeout=LIMIT_S)
    free = following.acquire()  # a later node of the killed run would meet those of the next one
    assert processes_of(folder) and not free
    wait_for(lambda: not processes_of(folder))
    wait_for(following.acquire)
    following.release()
    assert not (folder / PARTIAL).exists()
    stamps = {topic.name: [] for topic in topics_of(setup.layout) if topic.rate is Rate.TICK}
    for topic, stamp, _ in iter_raw(folder, stamps):
        stamps[topic].append(stamp)
    for topic, found in stamps.items():
        assert found == [k * setup.tick_ns for k in range(len(found))], topic
        assert len(found) >= seen, topic
    wait_for(lambda: not shared_memory.abandoned())


def test_a_domain_is_held_by_one_run_alone(setup, tmp_path):
    """Breaks if two runs share a domain, or the refused one leaves its folder."""
    folder = tmp_path / "run"
    folder.mkdir()
    with claim_domain() as held:
        with pytest.raises(ValueError, match=f"--domain {held}: another run holds it"), claim_domain(held):
            pass
        with pytest.raises(ValueError, match="another run holds it"):
            run_graph(setup, folder, mode="processes", domain=held)
        with claim_domain() as other:
            assert other != held
    assert not folder.exists()
    with claim_domain(held) as again:
        assert again == held
    for wrong in (233, -1):
        with pytest.raises(ValueError, match="from 0 to 232"), claim_domain(wrong):
            pass


STRUCK_S, BRAKED_S = 30.0, 5.0
"""Simulated time of the kill, and time after the takeover in which the applied force is checked [s]."""
RATE = 20.0
"""Simulated seconds per second: a node that returns late on a loaded machine finds the run in its time."""


def metro(*changes: str) -> RunSetup:
    return setup_of("xuzhou_metro:disturbed", *changes)


def struck(setup: RunSetup, folder: Path, victims: tuple[str, ...], restarts: int = 3) -> RunResult:
    """Return a run whose nodes were killed on the way, one after the other; no process may be left."""
    waiting = list(victims)

    def strike(progress: Progress) -> None:
        if waiting and progress.simulated > STRUCK_S:
            os.kill(processes_of(folder)[waiting.pop(0)], signal.SIGKILL)

    home = RunFolder(folder)
    home.begin(setup)
    outcome = run_graph(setup, folder, mode="processes", progress=strike, restarts=restarts, timeout=LIMIT_S, rate=RATE)
    home.finish(setup, outcome)
    assert not waiting
    assert not processes_of(folder)
    wait_for(lambda: not shared_memory.abandoned())
    return outcome


def messages(folder: Path, setup: RunSetup, topic: str) -> list:
    return [message for _, _, message in read_log(folder, Wire(setup.layout).decode, (topic,))]


def takeover(folder: Path, setup: RunSetup) -> tuple[float, float, float]:
    """Return the largest step of the demand after the takeover, the one from the applied force, and their limit [N]."""
    # The limit is a tick of the largest jerk of the profile. The demand that acts follows from the applied force and
    # the lag. It is that of coasting, 0, until the first command acts. Then it lies between the applied force at the
    # begin and the commands sent so far: a loaded machine delays commands, and their steps act at once. With a node
    # away the commands lack one period or more, because the plant makes few ticks until the node returns.
    measured = messages(folder, setup, "train/measurement")
    commands = messages(folder, setup, "ato/command")
    sent = np.array([command.stamp for command in commands])
    gap = int(np.argmax(np.diff(sent)))
    assert sent[gap + 1] - sent[gap] > 1.5e9 * setup.control_period, "the node was not away"
    first = int(sent[gap + 1] // setup.tick_ns)
    applied = np.array([measurement.applied.sum() for measurement in measured])
    model = setup.model
    limit = float(np.abs(setup.profile.jerk()).max()) * model.inertia * setup.tick
    demand = np.array([command.force.sum() for command in commands])[gap + 1 :]
    ramp = demand[: int(demand.argmin()) + 1]
    assert ramp.size > 10, "the train was at standstill at the takeover"
    assert ramp[-1] < -100e3
    around = applied[first : first + round(BRAKED_S / setup.tick)]
    acting = around[:-1] + np.diff(around) / (1.0 - np.exp(-setup.tick / model.lag))
    latest = np.searchsorted(sent[gap + 1 :], setup.tick_ns * (first + np.arange(acting.size)), side="right") - 1
    lowest = np.minimum.accumulate(np.minimum(demand, around[0]))[latest]
    highest = np.maximum.accumulate(np.maximum(demand, around[0]))[latest]
    acts = int(np.argmax(np.abs(acting) > 1e-3))
    assert (acting[acts:] >= lowest[acts:] - 1e-3).all() and (acting[acts:] <= highest[acts:] + 1e-3).all()
    return float(np.abs(np.diff(ramp)).max()), abs(float(demand[0]) - applied[first]), limit


@pytest.mark.graph
@pytest.mark.parametrize("victims", [("profile",), ("observer", "controller")], ids=" and ".join)
def test_killed_nodes_take_over_without_a_jump(victims: tuple[str, ...], tmp_path: Path) -> None:
    """Breaks if the run fails, the force jumps at the takeover, or the ATO drives on before the request to engage it.

    Two new processes must not wait for ever for each other; no message of the plant may be lost.
    """
    # The train coasts until the nodes return. Their processes have 8 s of wall time to start on a loaded machine.
    coasts = ("supervision.failsafe.coast=600", "supervision.failsafe.service=600")
    setup = metro("duration=210", "ato_requests=[{at: 195, do: engage}]", *coasts)
    outcome = struck(setup, tmp_path, victims)
    assert outcome.failure is None
    assert (outcome.summary["status"], outcome.summary["restarts"]) == ("done", dict.fromkeys(victims, 1))
    names = {topic.name for topic in published_by(Role.PLANT)} & set(tick_topics(setup.layout))
    found: dict[str, list[int]] = {name: [] for name in names}
    for topic, stamp, _ in iter_raw(tmp_path, found):
        found[topic].append(stamp)
    for topic, stamps in found.items():
        count = setup.ticks + (topic != "train/measurement")
        assert stamps == [tick * setup.tick_ns for tick in range(count)], topic
    step, begin, limit = takeover(tmp_path, setup)
    assert max(step, begin) <= limit * (1 + 1e-9)
    told = "; ".join(event.text for event in detect_events(open_recording(tmp_path)))
    assert all(f"node {victim}: its process was ended by SIGKILL" in told for victim in victims)
    assert re.search(rf"ATO engaged → disengaging: node ({'|'.join(victims)}) restarted", told)
    reports = messages(tmp_path, setup, "ato/state")
    engaged = [report.stamp * 1e-9 for report in reports if report.state[0] == AtoState.ENGAGED]
    assert max(engaged) > 195 and not [time for time in engaged if STRUCK_S + RATE < time < 195]
    speed = {truth.stamp * 1e-9: truth.velocity[0] for truth in messages(tmp_path, setup, "train/vehicles")}
    assert max(value for time, value in speed.items() if time > 200) > 1.0


@pytest.mark.graph
def test_a_killed_supervisor_releases_the_brakes_at_standstill(tmp_path: Path) -> None:
    """Breaks if the train is released while it moves, or never."""
    setup = metro("duration=165")
    outcome = struck(setup, tmp_path, ("supervisor",))
    assert outcome.failure is None
    assert outcome.summary["restarts"] == {"supervisor": 1}
    assert outcome.summary["strongest_reaction"] == "emergency brake"
    active = {state.stamp: state.active[2] for state in messages(tmp_path, setup, "train/protection")}
    speeds = {truth.stamp: abs(truth.velocity[0]) for truth in messages(tmp_path, setup, "train/vehicles")}
    braked = [stamp for stamp, emergency in active.items() if emergency]
    released = min(stamp for stamp in active if stamp > max(braked))
    assert speeds[released] < 0.1
    assert min(braked) * 1e-9 < STRUCK_S + RATE


@pytest.mark.graph
def test_a_node_that_ends_again_and_again_fails_the_run(tmp_path: Path) -> None:
    """Breaks if restarts are not bounded, a new process repeats its kill, or the train is not stopped at the end."""
    kills = [{"node": "observer", "do": "kill", "at": at} for at in range(20, 200, 10)]
    expected = "node observer failed: its process was ended by SIGKILL; it was restarted 2 times before"
    changes = {"duration": 200, "faults": kills}
    with pytest.raises(ta.RunFailed, match=f"{expected}$") as caught:
        ta.run("xuzhou_metro:disturbed", mode="processes", restarts=2, rate=RATE, set=changes, out=tmp_path / "run")
    run = caught.value.run
    assert (run.metrics["status"], run.metrics["restarts"]) == ("failed", {"observer": 2})
    assert run["ato/estimate"].index.max() > 39.0  # the third kill is that at 40 s
    assert abs(run.recording.velocity[-1]).max() < 0.1
    assert not processes_of(tmp_path)
