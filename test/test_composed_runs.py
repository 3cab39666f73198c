"""Runs with all nodes in one process, or each started alone: the log of the other ways, texts of failures."""

import gc
import json
import os
import runpy
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from commands import answer

pytest.importorskip("rclpy")

from engine_runs import compared, no_figure, setup_of
from programs import begun
from rcl_interfaces.msg import Log
from recordings import commands_in, message_counts
from waiting import LIMIT_S, pause, wait_for

from msgs_docs.generate import node_page as node_docs
from train_ato.cli import nodes
from train_ato.cli.main import main
from train_ato.log.mcap_records import stream
from train_ato.log.reading import read_log
from train_ato.log.run_folder import read_run_folder
from train_ato.loop.controller import ControllerStage
from train_ato.loop.observer import ObserverStage
from train_ato.loop.profile import ProfileStage
from train_ato.messages.codec import Wire
from train_ato.messages.topics import BY_NAME, Role
from train_ato.ros.graph import shared_memory
from train_ato.ros.graph.composed import run_composed
from train_ato.ros.graph.environment import claim_domain
from train_ato.ros.graph.graph_result import GraphOptions
from train_ato.ros.graph.runner import run_graph
from train_ato.ros.nodes.answer_watch import LEASE_S
from train_ato.ros.nodes.controller import ControllerNode
from train_ato.ros.nodes.endpoints import NodeEndpoints
from train_ato.ros.nodes.publishers import OnePublisher
from train_ato.ros.standalone.runner import StandaloneRunner

TICK = 100_000_000


@pytest.fixture(scope="module")
def setup():
    return setup_of("demo", "duration=12")


def test_a_composed_run_records_every_message(setup, tmp_path):
    out = tmp_path / "run"
    out.mkdir()
    outcome = run_graph(setup, out, mode="composed", progress=lambda _: None)
    assert outcome.failure is None and not outcome.interrupted
    recorded = {name.lstrip("/"): count for name, count in message_counts(out).items()}
    published = {name.lstrip("/"): n for name, n in outcome.published.items() if n and BY_NAME[name].recorded}
    assert recorded == published and recorded["train/vehicles"] == setup.ticks + 1
    assert recorded["ato/command"] == setup.ticks
    assert outcome.published["recorder/progress"] == (setup.ticks + 1) // 100
    assert sorted(path.name for path in out.iterdir()) == ["metadata.yaml", "run.mcap"]


@pytest.mark.parametrize(
    ("role", "target", "name"),
    [
        ("profile", ProfileStage, "on_measurement"),
        ("observer", ObserverStage, "on_measurement"),
        ("controller", ControllerStage, "command"),
    ],
)
def test_a_node_that_fails_is_named_and_the_log_is_closed(role, target, name, setup, tmp_path, monkeypatch):
    original = getattr(target, name)
    calls = []

    def fails(self, *arguments):
        calls.append(1)
        if len(calls) == 30:
            raise ZeroDivisionError("rail broken")
        return original(self, *arguments)

    monkeypatch.setattr(target, name, fails)
    outcome = run_graph(setup, tmp_path, mode="composed")
    assert outcome.failure == f"node {role} failed: ZeroDivisionError: rail broken"
    assert outcome.summary["ticks"] == 29 and message_counts(tmp_path)["/train/measurement"] == 30
    assert "rail broken" in (tmp_path / "log" / f"{role}.traceback.txt").read_text()


@pytest.mark.parametrize(
    ("role", "topic", "stamp", "chain"),
    [
        ("profile", "ato/reference", "2.000", ""),
        ("controller", "ato/state", "2.400", ": node profile waits for its ato/state"),
        *(
            pytest.param(role, topic, "2.000", "", marks=pytest.mark.graph)
            for role, topic in (
                ("observer", "ato/estimate"),
                ("controller", "ato/command"),
                ("supervisor", "atp/brake_release"),
            )
        ),
        ("supervisor", "atp/speeds", "2.000", ": node controller waits for its atp/speeds"),
    ],
)
def test_a_silent_node_is_named(role, topic, stamp, chain, setup, tmp_path, monkeypatch):
    """Fails when the run goes on with old values, hangs, or blames a node that waits for the silent one."""
    original = NodeEndpoints.publish

    def swallows(self, *messages):
        original(self, *(one for one in messages if one[0] != topic or one[1].stamp < 20 * TICK))

    monkeypatch.setattr(NodeEndpoints, "publish", swallows)
    outcome = run_graph(setup, tmp_path, mode="composed", timeout=2.0)
    assert outcome.failure == f"node {role} failed: no answer to stamp {stamp} s within 2 s{chain}"
    assert outcome.summary["ticks"] >= 20, "the plant goes on until the train is at standstill"


def test_a_lost_message_fails_the_run_by_its_topic(setup, tmp_path, domain, monkeypatch):
    """The count says sent, the recorder never got it: as a queue that overflowed would look."""
    original = NodeEndpoints.publish

    def loses(self, *messages):
        if any(name == "ato/estimate" and message.stamp == 119 * TICK for name, message in messages):
            self.published["train/vehicles"] = self.published.get("train/vehicles", 0) + 1
        original(self, *messages)

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
    assert "No space left on device" in outcome.failure and not (tmp_path / "run.mcap").exists()


def test_a_planned_swap_is_shown_by_the_parameter_and_has_no_jump(setup, tmp_path, domain):
    """The first output after a swap equals the last command before it, up to the usual change of a tick."""
    swapping = setup_of("demo", "duration=40", "law_changes=[{at: 30, law: smc}]")
    shown = []
    original = ControllerNode._sync_parameters
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            ControllerNode,
            "_sync_parameters",
            lambda self, law: (
                original(self, law),
                shown.append((law, self.endpoints.node.get_parameter("law").value)),
            ),
        )
        end = run_composed(swapping, tmp_path, domain, GraphOptions())
    assert end.failure is None
    assert shown == [({}, "pid"), ({"controller": "smc"}, "smc")]  # at the start the gains that are taken
    commands = [m for _, _, m in read_log(tmp_path, Wire(setup.layout).decode, ("ato/command",))]
    force = np.array([m.force[0] for m in commands])
    assert abs(force[300] - force[299]) <= 1e-3 * np.abs(force).max()


def _mapped_by(process: int | str) -> set[Path]:
    """Return the files of Fast DDS in the shared memory of a process; an ended one has none."""
    try:
        lines = Path(f"/proc/{process}/maps").read_text().splitlines()
    except OSError:
        return set()
    return {Path(line.split()[-1]) for line in lines if f"{shared_memory.SHARED}/fastrtps_" in line}


def test_the_memory_of_a_killed_run_is_removed_by_the_next_one(setup, tmp_path):
    """Breaks if the files of a run that was ended by SIGKILL remain, or those of another running run are removed."""
    runs, files = [], []
    for name in ("killed", "running"):
        words = ["run", "demo", "--set=duration=6000", "--rate=20", f"--out={tmp_path / name}"]
        runs.append(begun(*words, stdout=None, stderr=None))
    try:
        for name, process in zip(("killed", "running"), runs, strict=True):
            partial = tmp_path / name / "run.mcap.partial"
            wait_for(lambda partial=partial: partial.exists() and partial.stat().st_size > 0, "a run that records")
            files.append(_mapped_by(process.pid))
            assert files[-1]
        runs[0].kill()
        runs[0].wait()
        (tmp_path / "next").mkdir()
        assert run_graph(setup, tmp_path / "next", mode="composed").failure is None
        left = {path for path in files[0] - files[1] if path.exists()}
        # runs of other tests use some ports again: these files are in use
        assert not left.difference(*(_mapped_by(folder.name) for folder in Path("/proc").glob("[0-9]*")))
        assert runs[1].poll() is None and all(path.exists() for path in files[1])
    finally:
        for process in runs:
            process.terminate()
            process.wait()


ROUGH = [
    "--set=duration=65",
    "--set=links.command={delay: 0.3, varying: {amplitude: 0.2}, jitter: 0.1, loss: 0.05}",
    "--set=plant.sensors={couplers: [0, 52], position_noise: 0.1, velocity_noise: 0.02, force_noise: 1000}",
    "--set=plant.disturbances=[{kind: eq40}]",
    "--set=law_changes=[{at: 30, law: smc}, {at: 45, law: pid}]",
    "--observer=ndo",
]
"""65 s of the 106-vehicle train with varying delay, jitter, loss, noise, a disturbance and two swaps of the law."""
WALL = ("wall_s", "real_time_factor", "step_time_us_median", "step_time_us_p99", "mode")


def drive(folder: Path, name: str, *options: str) -> Path:
    out = folder / name
    assert main(["run", "demo", "--json", f"--out={out}", *options]) == 0
    return out


@pytest.fixture(scope="module")
def engine_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with no_figure():
        return drive(tmp_path_factory.mktemp("engine"), "run", "--engine", *ROUGH)


@pytest.mark.usefixtures("without_figure")
@pytest.mark.parametrize("way", [[], ["--processes"]], ids=["composed", "processes"])
def test_every_message_is_equal_in_all_ways(way: list[str], engine_run: Path, tmp_path: Path) -> None:
    """Breaks if a result depends on the order of arrival, on the process of a random number, or on the encoding."""
    run = drive(tmp_path, "run", *way, *ROUGH)
    _, summary = read_run_folder(run)
    assert compared(engine_run, run).first is None
    of_engine = json.loads((engine_run / "summary.json").read_text())
    assert {k: v for k, v in summary.items() if k not in WALL} == {k: v for k, v in of_engine.items() if k not in WALL}
    assert (run / "scenario.yaml").read_text() == (engine_run / "scenario.yaml").read_text()


@pytest.mark.usefixtures("without_figure")
def test_another_seed_is_seen_and_the_resolved_scenario_is_enough(engine_run: Path, tmp_path: Path, capsys) -> None:
    """Breaks if the comparison above cannot fail, or a file named by the scenario is not in the run folder."""
    run = drive(tmp_path, "run", "--engine", *ROUGH, "--seed=2")
    found = compared(engine_run, run)
    assert {"ato/command", "train/vehicles", "train/measurement"} <= set(found.topics)
    assert answer(capsys, "verify", str(engine_run))["equal"] is True


ROLES = ("recorder", "supervisor", "profile", "observer", "controller", "plant")


class Terminals:
    """One terminal for each node, all on one ROS domain."""

    def __init__(self, folder: Path, domain: int) -> None:
        self.folder = folder
        self.processes: dict[str, subprocess.Popen[str]] = {}
        self._environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_LOG_DIR": str(folder / "log")}
        self._environment.pop("ROS_AUTOMATIC_DISCOVERY_RANGE", None)

    def start(self, role: str, *arguments: str) -> subprocess.Popen[str]:
        """Start the main function that the installed command ``ROLE_node`` calls."""
        process = subprocess.Popen(
            [sys.executable, "-m", "train_ato.cli.nodes", role, *arguments],
            cwd=self.folder,
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),  # ignored if the tests run under nohup
        )
        self.processes[role if role not in self.processes else f"second {role}"] = process
        return process

    def start_all(self, duration: float, plant: tuple[str, ...] = (), ros: Any = None, order: Any = ROLES) -> None:
        """Start all nodes of a recorded run of the demo; its log is in ``alone``."""
        own = {"recorder": ("--out=alone",), "plant": ("--recorded", *plant)}
        for role in order:
            words = () if ros is None else ("--ros-args", "-r", "__ns:=/left", *ros.get(role, ()))
            self.start(role, "--scenario=demo", f"--set=duration={duration:g}", *own.get(role, ()), *words)

    def ends(self) -> dict[str, tuple[int, str]]:
        """Wait for all; return exit status and output without the lines on missing nodes: slow starts print them."""
        said = {role: process.communicate(timeout=LIMIT_S)[0] for role, process in self.processes.items()}
        kept = {role: [line for line in text.splitlines() if "not begun: " not in line] for role, text in said.items()}
        return {role: (self.processes[role].returncode, "\n".join(lines)) for role, lines in kept.items()}


@pytest.fixture
def terminals(tmp_path: Path) -> Iterator[Terminals]:
    with claim_domain() as domain:
        opened = Terminals(tmp_path, domain)
        try:
            yield opened
        finally:
            for process in opened.processes.values():
                process.kill()
                process.communicate(timeout=LIMIT_S)
            shared_memory.clean()


def check_as_composed(folder: Path, *options: str) -> Path:
    """Check that the run of the nodes is that of one process, which is returned; the wall time is left out."""
    one = folder / "composed"
    assert main(["run", "demo", "--json", f"--out={one}", "--set=duration=20", *options]) == 0
    setup, summary = read_run_folder(one)
    again, alone = read_run_folder(folder / "alone")
    assert compared(one, folder / "alone").first is None
    assert again.fingerprint() == setup.fingerprint()
    assert {k: v for k, v in alone.items() if k not in WALL} == {k: v for k, v in summary.items() if k not in WALL}
    return one


PATIENT = f"--timeout={LIMIT_S}"
"""A loaded machine does not make a node silent."""


@pytest.mark.graph
def test_nodes_started_alone_leave_the_folder_of_a_composed_run(terminals, tmp_path):
    """Breaks if the train starts before all nodes are ready, or a node ends before its last message is received."""
    terminals.start_all(20, (PATIENT,))
    assert terminals.ends() == dict.fromkeys(ROLES, (0, ""))
    one = check_as_composed(tmp_path)
    assert all(message.log_ns == message.publish_ns for message in stream(tmp_path / "alone" / "run.mcap"))
    assert {path.name for path in (tmp_path / "alone").iterdir()} == {path.name for path in one.iterdir()}
    wait_for(lambda: not shared_memory.abandoned())


@pytest.mark.graph
def test_ros_parameters_and_a_namespace_reach_nodes_started_alone(terminals: Terminals, tmp_path: Path) -> None:
    """Law, observer and parameters by ``-p``, two trains by ``__ns``: the same as by the scenario, summary included.

    The plant is started first here: the train must not start before all nodes are ready.
    """
    given = {
        "controller": ["-p", "law:=smc", "-p", "smc.ks:=0.3"],
        "observer": ["-p", "observer:=ndo", "-p", "ndo.omega:=5.0"],
        "plant": ["-p", f"timeout:={LIMIT_S}"],
    }
    terminals.start_all(20, ros=given, order=reversed(ROLES))
    assert terminals.ends() == dict.fromkeys(ROLES, (0, ""))
    changes = ("--law=smc", "--observer=ndo", "--set=laws.smc.ks=0.3", "--set=observers.ndo.omega=5.0")
    check_as_composed(tmp_path, *changes)


def driving(terminals: Terminals, tmp_path: Path) -> Path:
    """Start all nodes; return their log of a few commands.  In lockstep no message is late on a busy machine."""
    terminals.start_all(600, ("--rate=20", PATIENT))
    partial = tmp_path / "alone" / "run.mcap.partial"
    wait_for(lambda: commands_in(partial.parent) > 10)
    return partial


LOST = "node plant failed: its messages ended without the notice of the end of the run"


@pytest.mark.graph
@pytest.mark.parametrize(
    ("number", "status", "said"), [(signal.SIGINT, "interrupted", ""), (signal.SIGKILL, "failed", LOST)]
)
def test_the_end_of_the_plant_ends_all_nodes(number, status, said, terminals, tmp_path):
    """Breaks if a node waits for ever, the log is not closed, or a cut link counts as the end of the run."""
    partial = driving(terminals, tmp_path)
    terminals.processes["plant"].send_signal(number)
    ends = terminals.ends()
    for role in ROLES[: -1 if said else None]:
        ended, text = ends[role]
        assert (ended, len(text.splitlines()), text.startswith(said)) == (bool(said), bool(said), True), (role, text)
    summary = json.loads((tmp_path / "alone" / "summary.json").read_text())
    assert summary["status"] == status and 10 < summary["ticks"] < 6000
    assert (summary.get("failure") or "").startswith(said) and not partial.exists()


@pytest.mark.graph
def test_a_node_by_hand_that_was_stopped_says_so(terminals: Terminals, tmp_path: Path) -> None:
    """Breaks if a node that goes on after the others have dropped it names the plant."""
    driving(terminals, tmp_path)
    for number in (signal.SIGSTOP, signal.SIGCONT):
        terminals.processes["controller"].send_signal(number)
        pause(LEASE_S + 2.0)
    assert terminals.ends()["controller"][1].startswith("node controller failed: its process was suspended for ")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP], ids=["Ctrl-C", "closed terminal"])
def test_a_plant_that_waits_says_for_whom(number: signal.Signals, terminals: Terminals, tmp_path: Path) -> None:
    """Breaks if a missing node is not named, or only by its topics, or a signal in the wait kills the node."""
    plant = terminals.start("plant", "--scenario=demo")
    assert plant.stdout is not None
    line = plant.stdout.readline()
    assert "not begun: supervisor is not there" in line
    assert "plant waits for node profile, node observer, node controller, node supervisor; only" in line
    plant.send_signal(number)
    status, rest = terminals.ends()["plant"]
    assert status == 0
    assert "Traceback" not in rest


@pytest.mark.parametrize(("role", "arguments", "says"), [
    ("controller", ["--scenario=demo", "--ros-args", "-p", "pid.kpp:=1.0"], "pid.kpp: node controller has none"),
    ("observer", ["--scenario=demmo"], "unknown scenario 'demmo'; did you mean 'demo'?"),
    ("recorder", ["--scenario=demo", "--out=/proc/nowhere"], "--out /proc/nowhere: cannot be made (No such file"),
    ("plant", ["--scenario=demo", "--rate=-1"], "--rate: -1: not a rate"),
    ("plant", ["--scenario=demo", "--rate=2", "--ros-args", "-p", "rate:=3"], "rate: 3: --rate has another value"),
    ("profile", [], "--scenario"),
    ("supervisor", ["--scenario=xuzhou_metro"], "the run has no supervision; set supervision.enabled: true"),
])  # fmt: skip
def test_bad_input_to_a_node_is_one_line(role: str, arguments: list[str], says: str, domain: int, capsys: Any) -> None:
    """Breaks on a traceback, another exit status than 2, or a vague message."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)}
    words = patch.object(sys, "argv", ["nodes", role, *arguments])
    try:
        with patch.dict(os.environ, ROS_DOMAIN_ID=str(domain)), words, pytest.raises(SystemExit) as ended:
            runpy.run_path(nodes.__file__, run_name="__main__")
    finally:
        gc.enable()
        for number, handler in handlers.items():
            signal.signal(number, handler)
    said = capsys.readouterr()
    assert (ended.value.code, said.out) == (2, "") and says in said.err
    assert len(said.err.strip().splitlines()) == 1, said.err


def test_node_page_is_that_of_the_nodes() -> None:
    """Breaks if a parameter or service changes but its page does not; run python -m msgs_docs.generate."""
    page = Path(__file__).resolve().parents[1] / node_docs.PAGE
    assert page.read_text(encoding="utf-8") == node_docs.page(page)


@pytest.mark.graph
def test_a_law_that_raises_ends_a_run_of_processes_as_in_the_engine(terminals, tmp_path, monkeypatch):
    """Breaks if the failure lacks the line of the law, or the plant brakes a train that the ATO has stopped."""
    (tmp_path / "late.py").write_text(
        "from train_ato.control.laws.pid import Pid\n\n\n"
        "class Late(Pid):\n    def step(self, inputs):\n"
        "        return super().step(inputs) if inputs.t < 5 else 1 / 0\n"
    )
    options = ("--scenario=demo", "--set=duration=60", "--set=law=late:Late")
    more = {"recorder": ["--out=hand"], "plant": ["--recorded"]}
    for role in ROLES:
        terminals.start(role, *options, *more.get(role, ()))
    ended = terminals.ends()
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    for mode in ("engine", "processes"):
        assert main(["run", "demo", f"--{mode}", "--law=late:Late", "--set=duration=60", f"--out={mode}"]) == 1
    names = ("engine", "processes", "hand")
    engine, *others = (json.loads((tmp_path / name / "summary.json").read_text()) for name in names)
    keys = ("status", "failure", "ticks", "strongest_reaction", "tracking")
    assert all(other[key] == engine[key] for other in others for key in keys)
    assert message_counts(tmp_path / "processes") == message_counts(tmp_path / "engine")
    assert "late.py:6" in engine["failure"] and ended["plant"] == (1, engine["failure"]) and engine["ticks"] > 50


@pytest.mark.parametrize(
    ("name", "text", "stored"),
    [
        ("observer", "node observer failed: no estimate", True),
        ("controller", "train stopped: node observer failed: no estimate", True),
        ("controller", "node observer failed: no estimate", False),
        ("observer", "the observer waits", False),
    ],
)
def test_a_plant_stores_the_failure_that_a_node_says_of_itself(name: str, text: str, stored: bool) -> None:
    """Breaks if a node that ends with a reason only left the run, or one node can say the failure of another."""
    plant = SimpleNamespace(role=Role.PLANT, _said={})
    StandaloneRunner._hear(plant, Log(level=Log.ERROR, name=name, msg=text))
    assert (name in plant._said) is stored


def test_a_message_between_the_first_and_the_next_is_refused_after_a_restart() -> None:
    """Breaks if messages of a node that is started again can be lost before its first one."""
    source = OnePublisher(None, BY_NAME["ato/command"])
    source.renew()
    for number in (0, 2, 3):
        with pytest.raises(ValueError, match=f"ato/command: message {number} came first after the restart of contr"):
            source.take(number)
