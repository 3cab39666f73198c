"""Run with one process per node: standalone nodes, as started by ``ros2 run``, with one process that ends them."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from train_ato.interrupt import Interrupt, interruptible
from train_ato.log.bag_layout import LOG, PARTIAL
from train_ato.log.whole_file import write_whole
from train_ato.loop.setup import RunSetup
from train_ato.messages.faults import node_faults
from train_ato.messages.topics import Role
from train_ato.ros.graph import shared_memory
from train_ato.ros.graph.environment import variables
from train_ato.ros.graph.graph_result import GraphOptions, GraphResult, Report
from train_ato.ros.nodes.plant import SUSPENDED_S

ROLES = (Role.RECORDER, Role.CONTROLLER, Role.OBSERVER, Role.PROFILE, Role.SUPERVISOR, Role.PLANT)
"""Start order of the processes."""
_STARTING_S = 180.0
"""Maximum wall time from the start of the processes to the first tick [s]."""
_REPORTING_S = 20.0
"""Wall time added to the time-out after which a plant without reports hangs [s]; at the end 10 s pass without one."""
_LEAVING_S = 5.0
"""Wall time for a node to end after a failure of the run [s]."""
_CLOSING_S = 30.0
"""Wall time for a node to end after the plant, and for the recorder to close the log [s]."""
_TURN_S = 0.1
_PACKAGE_ROOT = str(Path(__file__).resolve().parents[3])


def run_processes(
    setup: RunSetup, folder: Path, domain: int, options: GraphOptions, report: Report | None = None
) -> GraphResult:
    """Run one process per node to the end of a scenario, recorded into ``folder``.

    The nodes read the resolved scenario in that folder. All processes and their shared memory are removed at the end.

    Returns
    -------
    GraphResult
        Its ``failure`` names the failed node; the log is closed unless the recorder was killed.

    Raises
    ------
    ValueError
        If the log cannot be created.
    """
    for taken in (LOG, PARTIAL):
        if (folder / taken).exists():
            raise ValueError(f"{folder / taken}: exists already; name another output folder")
    scenario = folder / "scenario.yaml"
    write_whole(scenario, setup.resolved_yaml())
    (folder / "log").mkdir(exist_ok=True)

    def start(role: Role, suffix: str = "") -> NodeProcess:
        return NodeProcess(role, _arguments(role, scenario, folder, options), domain, folder / "log", suffix)

    with interruptible() as interrupt:
        nodes: dict[Role, NodeProcess] = {}
        twins = _Twins(setup, lambda role: start(role, "-2"))
        try:
            for role in ROLES:
                if role is Role.SUPERVISOR and not setup.layout.supervised:
                    continue
                nodes[role] = start(role)
            end = GraphResult(failure=_supervise(nodes, interrupt, report, _REPORTING_S + options.patience, twins))
        finally:
            twins.end()
            _end_all(nodes, failed=True)
            shared_memory.clean()
    _collect(nodes, end)
    end.interrupted = interrupt.asked
    return end


class NodeProcess:
    """Process of a standalone node, and the thread that reads its report.

    Parameters
    ----------
    role
        Node in the process.
    arguments
        Options of the node.
    domain
        ROS domain.
    log_folder
        Folder of its standard error.
    suffix
        End of the name of this file.

    Attributes
    ----------
    counts : dict
        Integers that the node has printed, by name.
    reported : float
        Monotonic wall time of the last report [s].
    lost : bool
        True after the report of its failure to the plant.
    """

    def __init__(self, role: Role, arguments: list[str], domain: int, log_folder: Path, suffix: str = "") -> None:
        self.role = role
        self.counts: dict[str, list[int]] = {}
        self.reported = time.monotonic()
        self.lost = False
        self._errors = log_folder / f"{role.value}{suffix}.stderr.txt"
        environment = {**os.environ, **variables(domain, log_folder)}
        paths = [_PACKAGE_ROOT, *filter(None, environment.get("PYTHONPATH", "").split(os.pathsep))]
        environment["PYTHONPATH"] = os.pathsep.join(paths)
        command = [sys.executable, "-m", "train_ato.ros.standalone", role.value, *arguments, "--attached"]
        with self._errors.open("wb") as errors:
            # a separate session, so that Ctrl-C of the terminal reaches only this process
            self.process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                env=environment,
                start_new_session=True,
                text=True,
            )
        self._reader = threading.Thread(target=self._read, name=f"report of {role.value}", daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            name, _, values = line.rpartition(":")
            with contextlib.suppress(ValueError):  # a print of a law or a library
                self.counts[name] = [int(value) for value in values.split()]
                self.reported = time.monotonic()

    @property
    def tick(self) -> int:
        """Number of complete ticks of the plant."""
        return self.counts.get("tick", [0])[0]

    @property
    def last_error(self) -> str:
        """Last line of standard error, the failure if there is one, without the name of the node before it."""
        lines = [line.strip() for line in self._errors.read_text(errors="replace").splitlines() if line.strip()]
        named = [line for line in lines if line.startswith("node ")]
        return (named or lines or [""])[-1].removeprefix(f"{self.role.value}: ")

    @property
    def failure(self) -> str | None:
        """Failure of the node with its reason; None while it runs and after a regular end."""
        status = self.process.poll()
        if not status:
            return None
        if status < 0:
            return f"node {self.role.value} failed: its process was ended by {signal.Signals(-status).name}"
        text = self.last_error
        if text.startswith("node "):
            return text
        return f"node {self.role.value} failed: {text or f'its process ended with status {status}'}"

    def send(self, line: str) -> None:
        """Write a line to the standard input of the node."""
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):
            self.process.stdin.write(f"{line}\n")
            self.process.stdin.flush()

    def release(self) -> None:
        """Close the standard input of the node; the node then ends the run."""
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):
            self.process.stdin.close()

    def end(self, patience: float) -> None:
        """Wait for the end of the process; after ``patience`` [s] end it by SIGKILL."""
        try:
            self.process.wait(timeout=patience)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._reader.join(timeout=_LEAVING_S)
        assert self.process.stdout is not None
        self.process.stdout.close()


class _Twins:
    """Second processes of nodes, which faults of the scenario start.

    Parameters
    ----------
    setup
        Prepared run.
    start
        Starts a node.
    """

    def __init__(self, setup: RunSetup, start: Callable[[Role], NodeProcess]) -> None:
        self._start = start
        self._waiting = [
            (round(fault.at / setup.tick), fault.role)
            for fault in node_faults(setup.scenario.faults)
            if fault.do == "duplicate"
        ]
        self._running: list[NodeProcess] = []

    def start(self, tick: int) -> None:
        """Start the processes that are due at a tick of the plant."""
        due = [role for at, role in self._waiting if at <= tick]
        self._waiting = [(at, role) for at, role in self._waiting if at > tick]
        self._running += [self._start(role) for role in due]

    def end(self) -> None:
        """End the processes."""
        for process in self._running:
            process.release()
            process.end(_LEAVING_S)


def _arguments(role: Role, scenario: Path, folder: Path, options: GraphOptions) -> list[str]:
    """Return the options of a node."""
    arguments = ["--scenario", str(scenario.resolve())]
    if role is Role.RECORDER:
        arguments += ["--out", str(folder.resolve()), "--compression", options.compression]
    if role is Role.PLANT:
        arguments += ["--recorded", "--timeout", repr(options.patience), "--pace", repr(options.pace)]
        if options.realtime is not None:
            arguments += ["--realtime", repr(options.realtime)]
    return arguments


def _supervise(
    nodes: dict[Role, NodeProcess], interrupt: Interrupt, report: Report | None, silence: float, twins: _Twins
) -> str | None:
    """Wait until all nodes have ended after the plant; return the first failure.

    A plant without a report for ``silence`` [s] fails the run.
    """
    plant = nodes[Role.PLANT]
    last = time.monotonic() + _STARTING_S
    stopped = False
    while plant.process.poll() is None:
        before = time.monotonic()
        time.sleep(_TURN_S)
        if time.monotonic() - before > SUSPENDED_S:  # this process was suspended; the reports wait in the pipes
            continue
        if failure := _failure(nodes):
            if not _stops_train(nodes):
                return failure
            _report_lost(nodes)
        if interrupt.asked and not stopped:
            stopped = True
            plant.process.send_signal(signal.SIGINT)
            last = time.monotonic() + _CLOSING_S
        if plant.counts and not stopped:
            last = plant.reported + silence
            twins.start(plant.tick)
            if report is not None:
                report(plant.tick)
        if time.monotonic() > last:
            if stopped:
                return f"node plant failed: it did not end within {_CLOSING_S:g} s"
            if plant.counts:
                return f"node plant failed: no report for {silence:g} s after tick {plant.tick}; its process hangs"
            return f"node plant failed: no first tick within {_STARTING_S:g} s: {plant.last_error or 'no reason given'}"
    _end_all(nodes, failed=bool(failure := _failure(nodes)))
    return failure or _failure(nodes)


def _stops_train(nodes: dict[Role, NodeProcess]) -> bool:
    """Return True if the plant goes on without the failed nodes until its train is at standstill."""
    needed = (nodes[Role.PLANT], nodes[Role.RECORDER])
    return Role.SUPERVISOR in nodes and not any(node.failure for node in needed)


def _report_lost(nodes: dict[Role, NodeProcess]) -> None:
    """Send the failed nodes to the plant, which goes on until its train is at standstill."""
    for node in nodes.values():
        if node.failure and not node.lost:
            node.lost = True
            nodes[Role.PLANT].send(f"{node.role.value} {node.failure.partition(' failed: ')[2]}")


def _failure(nodes: dict[Role, NodeProcess]) -> str | None:
    """Return the failure of a node, that of the plant last: it may follow from another one."""
    return next(filter(None, (nodes[role].failure for role in ROLES if role in nodes)), None)


def _end_all(nodes: dict[Role, NodeProcess], failed: bool) -> None:
    """End every process; after a failure, nodes other than the recorder get little time."""
    if failed:
        for node in nodes.values():
            node.release()
    for role in reversed(ROLES):
        if role in nodes:
            if role is Role.RECORDER:
                nodes[role].release()  # every message has been delivered; other programs may publish /diagnostics on
            nodes[role].end(_LEAVING_S if failed and role is not Role.RECORDER else _CLOSING_S)
            nodes[role].release()


def _collect(nodes: dict[Role, NodeProcess], end: GraphResult) -> None:
    """Read the reports of the nodes; fewer messages recorded than published are a failure."""
    for role, node in nodes.items():
        for name, values in node.counts.items():
            kind, _, topic = name.partition(" ")
            if kind == "published":
                end.published[topic] = end.published.get(topic, 0) + values[0]
        if any(node.counts.get("ignored", ())):
            end.ignored[role.value] = node.counts["ignored"][0]
    end.ticks = nodes[Role.PLANT].tick
    end.wall_s = nodes[Role.PLANT].counts.get("wall_ns", [0])[0] * 1e-9
    end.step_ns = nodes[Role.CONTROLLER].counts.get("step_ns", [])
    recorded = nodes[Role.RECORDER].counts
    for topic, count in end.published.items():
        found = recorded.get(f"recorded {topic}", [count])[0]
        if end.failure is None and found < count:
            end.failure = f"node recorder failed: {topic}: {found} of {count} messages are recorded"
