"""Every node in a process of its own: whatever dies is named, and nothing stays behind."""

from __future__ import annotations

import os
import queue
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from train_ato.graph import processes, shared_memory
from train_ato.graph.child import Child
from train_ato.graph.environment import claim_domain
from train_ato.graph.run_end import GraphOptions
from train_ato.graph.runner import run_graph
from train_ato.nodes.shell import ROLES
from train_ato.record.reading import iter_raw, message_counts, read_log, stream
from train_ato.record.recover import recover
from train_ato.run_setup import prepare
from train_ato.scenario import load
from train_ato.topics import Rate
from train_ato.wire import Wire

ROOT = Path(__file__).resolve().parents[1]
PACED = 20.0
BREATH = threading.Event()
"""Never set: waiting for it lets a moment pass between two looks."""


@pytest.fixture(scope="module")
def setup():
    return prepare(*load("demo", ("duration=600",)))


def processes_of(folder: Path) -> dict[str, int]:
    """Return the node processes of a run by their role; they carry its scenario in their command line."""
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                words = (entry / "cmdline").read_bytes().decode(errors="replace").split("\0")
            except OSError:
                continue
            if str(folder / "scenario.yaml") in words:
                role = next(word for word in words if word.startswith("train_ato.nodes."))
                found[role.rsplit(".", 1)[1]] = int(entry.name)
    return found


def wait_for(condition, limit=30.0):
    last = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < last, "did not happen in time"
        BREATH.wait(0.02)


def commands_in(log: Path) -> int:
    """Count the commands in the closed chunks of a log that is being written."""
    if not log.exists():
        return 0
    return sum(message.channel.topic == "/ato/command" for message in stream(log, broken=True))


def nothing_left(folder: Path) -> bool:
    return not processes_of(folder)


@pytest.mark.parametrize(
    ("victim", "number", "says"),
    [
        ("observer", signal.SIGKILL, "node observer failed: its process was ended by SIGKILL"),
        pytest.param(
            "plant", signal.SIGKILL, "node plant failed: its process was ended by SIGKILL", marks=pytest.mark.slow
        ),
        pytest.param(
            "controller", signal.SIGSTOP, "node controller failed: no answer to stamp", marks=pytest.mark.slow
        ),
    ],
)
def test_a_node_that_dies_or_hangs_is_named(victim, number, says, setup, tmp_path):
    """Fails when the run goes on with old values, blames another node, or leaves the stopped process behind."""
    started = []

    def strike(progress):
        if progress.simulated > 5 and not started:
            started.append(processes_of(tmp_path))
            os.kill(started[0][victim], number)

    outcome = run_graph(setup, tmp_path, way="processes", progress=strike, timeout=0.5, realtime=PACED)
    assert sorted(started[0]) == ["controller", "observer", "plant", "profile", "recorder"]
    assert outcome.failure.startswith(says)
    assert outcome.summary["status"] == "failed"
    assert nothing_left(tmp_path)
    wait_for(lambda: not shared_memory.abandoned())
    assert message_counts(tmp_path)["/train/measurement"] >= 50


@pytest.mark.slow
def test_a_killed_recorder_leaves_a_log_that_can_be_recovered(setup, tmp_path):
    """Every message whose chunk was closed before the kill comes back, without a gap."""
    partial = tmp_path / "run.mcap.partial"
    struck = []

    def strike(progress):
        if progress.simulated > 2 * PACED and not struck:
            struck.append(list(stream(partial, broken=True)))
            os.kill(processes_of(tmp_path)["recorder"], signal.SIGKILL)

    outcome = run_graph(setup, tmp_path, way="processes", progress=strike, realtime=PACED)
    assert outcome.failure == "node recorder failed: its process was ended by SIGKILL"
    assert nothing_left(tmp_path)
    assert partial.exists()
    count = recover(tmp_path).messages
    assert count >= len(struck[0]) > 1000
    assert [m.data for m in stream(tmp_path / "run.mcap")][: len(struck[0])] == [m.data for m in struck[0]]
    stamps = [stamp for _, stamp, _ in read_log(tmp_path, Wire(setup.shape).decode, ("train/cars",))]
    assert stamps == [k * setup.tick_ns for k in range(len(stamps))]


@pytest.mark.slow
@pytest.mark.parametrize("role", list(ROLES), ids=lambda role: role.value)
def test_a_node_that_cannot_start_is_named(role, setup, tmp_path, monkeypatch):
    """One node alone is told something that it refuses: its name and its reason come, not those of who waits for it."""

    class Misled(Child):
        def __init__(self, started, arguments, *rest):
            super().__init__(started, [*arguments, *(["--set=observer=nosuch"] if started is role else [])], *rest)

    monkeypatch.setattr(processes, "Child", Misled)
    outcome = run_graph(setup, tmp_path, way="processes")
    assert re.fullmatch(rf"node {role.value} failed: \S+: unknown observer 'nosuch'; known: .*", outcome.failure)
    assert outcome.summary["status"] == "failed"
    assert nothing_left(tmp_path)
    wait_for(lambda: not shared_memory.abandoned())


def _command_line(folder: Path, *options: str) -> subprocess.Popen[str]:
    code = "import sys; from train_ato.cli.main import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "run", "demo", "--set=duration=600", f"--out={folder}", *options]
    return subprocess.Popen(
        command,
        cwd=ROOT,
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


@pytest.mark.parametrize(
    ("way", "number"),
    [
        ("--processes", signal.SIGINT),
        pytest.param("--processes", signal.SIGTERM, marks=pytest.mark.slow),
        ("--composed", signal.SIGINT),
    ],
)
def test_ctrl_c_ends_a_run_cleanly(way, number, tmp_path):
    """One line, status 1, a whole log, no process and no shared memory left."""
    folder = tmp_path / "run"
    options = [way] if way == "--processes" else []
    process = _command_line(folder, *options, f"--realtime={PACED:g}")
    log = folder / "run.mcap.partial"
    wait_for(lambda: commands_in(log) > 10)
    process.send_signal(number)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 1, err
    lines = [line for line in err.splitlines() if line.strip()]
    assert len(lines) == 1
    assert "interrupted" in lines[0]
    counts = message_counts(folder)
    assert counts["/ato/command"] == counts["/train/measurement"] == counts["/train/cars"] - 1 > 5
    assert not log.exists()
    assert nothing_left(folder)
    wait_for(lambda: not shared_memory.abandoned())


@pytest.mark.slow
def test_a_killed_runner_leaves_no_orphans(setup, tmp_path):
    """Its nodes notice the closed pipe and end; the recorder closes the log with everything that it had before."""
    folder = tmp_path / "run"
    process = _command_line(folder, "--processes", f"--realtime={PACED:g}")
    log = folder / "run.mcap.partial"
    wait_for(lambda: commands_in(log) > 50)
    assert sorted(processes_of(folder)) == ["controller", "observer", "plant", "profile", "recorder"]
    seen = commands_in(log)
    process.kill()
    process.communicate(timeout=30)
    wait_for(lambda: nothing_left(folder))
    assert not log.exists()
    stamps = {topic.name: [] for topic in setup.shape.topics if topic.rate is Rate.TICK}
    for topic, stamp, _ in iter_raw(folder, stamps):
        stamps[topic].append(stamp)
    for topic, found in stamps.items():
        assert found == [k * setup.tick_ns for k in range(len(found))], topic
        assert len(found) >= seen, topic
    wait_for(lambda: not shared_memory.abandoned())


def test_a_law_is_swapped_from_another_process_without_a_jump(setup, tmp_path):
    """The set call comes over the graph while the train runs; the force goes on from the last command."""
    from rcl_interfaces.srv import SetParameters
    from rclpy.node import Node
    from rclpy.parameter import Parameter

    from train_ato.graph.assembly import executor_of
    from train_ato.graph.environment import applied, variables
    from train_ato.graph.processes import run_processes

    # In lockstep a busy machine cannot make the law late; ten minutes of line give the call time to arrive.
    long = prepare(*load("daqin_heavy_haul", ("duration=900",)))
    ends: queue.Queue = queue.Queue()
    with claim_domain() as domain, applied(variables(domain, tmp_path / "log")):
        run = threading.Thread(target=lambda: ends.put(run_processes(long, tmp_path, domain, GraphOptions())))
        run.start()
        with executor_of(domain) as (context, executor):
            node = Node("driver_desk", context=context, enable_rosout=False)
            executor.add_node(node)
            client = node.create_client(SetParameters, "controller/set_parameters")
            results = {}
            wait_for(lambda: (executor.spin_once(timeout_sec=0.02), client.service_is_ready())[1])
            wait_for(lambda: commands_in(tmp_path / "run.mcap.partial") > 10)
            for law in ("nosuch", "smc"):
                request = SetParameters.Request(parameters=[Parameter("controller", value=law).to_parameter_msg()])
                future = client.call_async(request)
                wait_for(lambda future=future: (executor.spin_once(timeout_sec=0.02), future.done())[1])
                results[law] = future.result().results[0]
        run.join(timeout=60)
    end = ends.get(timeout=1)
    assert end.failure is None
    assert not results["nosuch"].successful
    assert "nosuch" in results["nosuch"].reason
    assert results["smc"].successful
    decode = Wire(long.shape).decode
    laws = [
        m.values["controller"] for _, _, m in read_log(tmp_path, decode, ("/diagnostics",)) if m.node == "controller"
    ]
    assert laws[0] == "pid"
    assert laws[-1] == "smc"
    force = np.array([m.force[0] for _, _, m in read_log(tmp_path, decode, ("ato/command",))])
    first = laws.index("smc") * 10
    steps = np.sort(np.abs(np.diff(force[first - 15 : first + 15])))
    # The difference of the laws is worn off evenly over ten ticks: one step that towers over the tenth is a jump.
    assert steps[-1] < 1.5 * steps[-10] + 0.005 * np.abs(force).max()


def test_a_domain_is_held_by_one_run_alone():
    with claim_domain() as held:
        with pytest.raises(ValueError, match=f"--domain {held}: another run holds it"), claim_domain(held):
            pass
        with claim_domain() as other:
            assert other != held
    with claim_domain(held) as again:
        assert again == held
    for wrong in (0, 102, -1):
        with pytest.raises(ValueError, match="from 1 to 101"), claim_domain(wrong):
            pass


def test_a_held_domain_leaves_no_folder(setup, tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    with claim_domain() as held, pytest.raises(ValueError, match="another run holds it"):
        run_graph(setup, folder, way="processes", domain=held)
    assert not folder.exists()
