"""Run with one process per node: standalone nodes, as started by ``ros2 run``, with one process that ends them."""

import signal
import time
from collections.abc import Callable
from pathlib import Path

from train_ato.log.whole_file import write_whole
from train_ato.messages.faults import node_faults
from train_ato.messages.topics import Rate, Role, topics_of
from train_ato.program.interrupt import Interrupt, interruptible
from train_ato.ros import REMEDY
from train_ato.ros.graph import shared_memory
from train_ato.ros.graph.graph_result import GraphOptions, GraphResult, Report
from train_ato.ros.graph.node_process import LEAVING_S, NodeProcess, with_stop
from train_ato.ros.graph.restarts import Restarts
from train_ato.ros.graph.wait_note import WaitNote
from train_ato.ros.nodes.answer_watch import SUSPENDED_S
from train_ato.ros.standalone.notices import LAST_COUNT, TRAIN_STOPPED, Notice, NoticeKind
from train_ato.scenario.setup import RunSetup

ROLES = (Role.RECORDER, Role.CONTROLLER, Role.OBSERVER, Role.PROFILE, Role.SUPERVISOR, Role.PLANT)
"""Start order of the processes."""
START_LIMIT_S = 180.0
"""Maximum wall time from the start of the processes to the first tick [s]."""
_REPORTING_S = 20.0
"""Wall time added to the time-out after which a plant without reports hangs [s]; at the end 10 s pass without one."""
_CLOSING_S = 30.0
"""Wall time for a node to end after the plant, and for the recorder to close the log [s]."""
_TURN_S = 0.1
_PLANT_FAILED = f"node {Role.PLANT.value} failed: "


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
        If ROS 2 does not load.
    """
    start = _starter(setup, folder, domain, options)
    with interruptible() as interrupt:
        nodes: dict[Role, NodeProcess] = {}
        twins = _Twins(setup, lambda role: start(role, "-2"))
        restarts = Restarts(
            nodes, lambda role, number: start(role, f"-restart-{number}", "--restarted"), options.restarts
        )
        try:
            nodes |= {role: start(role) for role in _started(setup, options)}
            silence = _REPORTING_S + options.patience
            start_limit = options.starting(START_LIMIT_S)
            end = GraphResult(failure=_supervise(nodes, interrupt, report, silence, start_limit, twins, restarts))
        finally:
            twins.end()
            _end_all(nodes, failed=True)
            shared_memory.clean()
    if (end.failure or "").endswith(REMEDY):
        raise ValueError((end.failure or "").partition(" failed: ")[2])
    unborn = interrupt.asked and not nodes[Role.PLANT].counts  # Python itself ends a node that loads
    done = _work_done(nodes, setup) or (unborn and any(n.process.returncode == -signal.SIGINT for n in nodes.values()))
    end.failure = None if done else end.failure and with_stop(end.failure, nodes)
    _collect(nodes, end, options.external)
    by_node = nodes[Role.PLANT].interruption
    end.interruption = interrupt.reason(end.ticks, setup.ticks) if interrupt.asked else by_node
    end.restarts = {role.value: count for role, count in restarts.begun.items()}
    return end


def run_beside_plant(
    setup: RunSetup, folder: Path, domain: int, options: GraphOptions, report: Report | None = None
) -> GraphResult:
    """Run the recorder in this process and each other node in one of its own, beside an external plant.

    Result and errors as of :func:`run_processes`.
    """
    from train_ato.ros.graph.composed import run_composed

    start = _starter(setup, folder, domain, options)
    twins = _Twins(setup, lambda role: start(role, "-2"))
    nodes: dict[Role, NodeProcess] = {}

    def turned(tick: int) -> None:
        twins.start(tick)
        if report is not None:
            report(tick)

    try:
        nodes |= {role: start(role) for role in _started(setup, options) if role is not Role.RECORDER}
        end = run_composed(setup, folder, domain, options, turned, nodes)
    finally:
        twins.end()
        for node in nodes.values():
            node.release()
        for node in nodes.values():
            node.end(_CLOSING_S)
    end.step_ns = nodes[Role.CONTROLLER].counts.get("step_ns", [])
    found = {role.value: sum(node.counts.get(LAST_COUNT, ())) for role, node in nodes.items()}
    end.ignored |= {name: count for name, count in found.items() if count}
    return end


def _starter(setup: RunSetup, folder: Path, domain: int, options: GraphOptions) -> Callable[..., NodeProcess]:
    """Write the resolved scenario, and return the start of the process of a node with its further options."""
    scenario = folder / "scenario.yaml"
    write_whole(scenario, setup.resolved_yaml())
    (folder / "log").mkdir(exist_ok=True)

    def start(role: Role, suffix: str = "", *more: str) -> NodeProcess:
        words = [*_arguments(role, scenario, folder, options), *more]
        return NodeProcess(role, words, domain, folder / "log", suffix)

    return start


def _started(setup: RunSetup, options: GraphOptions) -> list[Role]:
    """Return the nodes of the run besides the external one, in the order of their start."""
    supervised = setup.layout.supervised
    return [role for role in ROLES if role is not options.external and (supervised or role is not Role.SUPERVISOR)]


class _Twins:
    """Second processes of nodes, which faults of the scenario start."""

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
            process.end(LEAVING_S)


def _arguments(role: Role, scenario: Path, folder: Path, options: GraphOptions) -> list[str]:
    """Return the options of a node."""
    arguments = ["--scenario", str(scenario.resolve())]
    arguments += [] if options.external is None else ["--external", options.external.value]
    if role is Role.RECORDER:
        arguments += ["--out", str(folder.resolve()), "--compression", options.compression]
    if role is Role.PLANT:
        arguments += ["--recorded", "--timeout", repr(options.patience)]
        arguments += ["--rate", repr(options.rate)] if options.rate else []
        arguments += [] if options.lockstep else ["--no-lockstep"]
        arguments += ["--followed"] if options.followed else []
        arguments += ["--resets"] if options.resets else []
    return [*arguments, *options.arguments]


def _supervise(
    nodes: dict[Role, NodeProcess],
    interrupt: Interrupt,
    report: Report | None,
    silence: float,
    start_limit: float,
    twins: _Twins,
    restarts: Restarts,
) -> str | None:
    """Wait until all nodes have ended after the plant; return the first failure.

    A plant without a first tick for ``start_limit`` [s], or later without a report for ``silence`` [s], fails the run.
    """
    plant = nodes[Role.PLANT]
    last, note = time.monotonic() + start_limit, WaitNote()
    stopped = False
    while plant.process.poll() is None and LAST_COUNT not in plant.counts:
        before = time.monotonic()
        time.sleep(_TURN_S)
        if time.monotonic() - before > SUSPENDED_S:  # this process was suspended; the reports wait in the pipes
            continue
        for node in nodes.values():
            node.look()
        if plant.counts and not interrupt.asked:
            restarts.step()
        if failure := _failure(nodes):
            if not plant.counts or plant.failure or nodes[Role.RECORDER].failure:
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
        elif not stopped:
            note(f"the first tick of the plant: {plant.last_error or 'its process is loading'}")
        if time.monotonic() > last:
            if stopped:
                return f"node plant failed: it did not end within {_CLOSING_S:g} s"
            if plant.counts:
                return f"node plant failed: no report for {silence:g} s after tick {plant.tick}; its process hangs"
            return f"node plant failed: no first tick within {start_limit:g} s: {plant.last_error or 'no reason given'}"
    restarts.end()
    plant.ends_within(LEAVING_S)
    _end_all(nodes, failed=bool(failure := _failure(nodes)))
    return failure or _failure(nodes)


def _report_lost(nodes: dict[Role, NodeProcess]) -> None:
    """Send the failed nodes to the plant, which stops its train unless the controller has done it."""
    for node in nodes.values():
        if node.failure and not node.lost:
            node.lost = True
            name, _, reason = node.failure.removeprefix("node ").partition(" failed: ")
            if TRAIN_STOPPED in node.counts:
                notice = Notice(NoticeKind.FAILED, Role(name), reason)
            else:
                notice = Notice(NoticeKind.LOST, node.role, reason)
            nodes[Role.PLANT].send(notice)


def _failure(nodes: dict[Role, NodeProcess]) -> str | None:
    """Return the failure of a node, that of the plant last: it may follow from another one.

    A plant that the other nodes have lost has a reason of its own, or it hangs; theirs counts after its regular end.
    """
    failures = [text for role in ROLES if role in nodes and (text := nodes[role].failure)]
    plant = nodes[Role.PLANT]
    missed = [text for text in failures if text.startswith(_PLANT_FAILED) and text != plant.failure]
    own = [text for text in failures if text not in missed]
    return next(iter(own if plant.process.poll() is None else own + missed), None)


def _work_done(nodes: dict[Role, NodeProcess], setup: RunSetup) -> bool:
    """Return True if the failed nodes were killed after their last message: every tick is recorded."""
    failed = [node for node in nodes.values() if node.failure]
    plant, recorded = nodes[Role.PLANT], nodes[Role.RECORDER].counts
    ended = LAST_COUNT in plant.counts and plant.tick == setup.ticks and LAST_COUNT in recorded
    if not ended or any(node.process.returncode >= 0 for node in failed):
        return False
    periods = {Rate.TICK: 1, Rate.SUPERVISION: setup.supervision_ticks}
    own = [topic for topic in topics_of(setup.layout) if topic.recorded and topic.rate in periods]
    return all(
        recorded.get(f"recorded {topic.name}", [0])[0] * periods[topic.rate] >= setup.ticks
        for topic in own
        if any(node.role in topic.publishers for node in failed)
    )


def _end_all(nodes: dict[Role, NodeProcess], *, failed: bool) -> None:
    """End every process; after a failure, nodes other than the recorder get little time."""
    if failed:
        for node in nodes.values():
            node.release()
    for role in reversed(ROLES):
        if role in nodes:
            # every message has been delivered; other programs may publish /diagnostics on, and a node on a busy machine
            # can miss the end of the plant
            if role is Role.RECORDER or not (failed or nodes[role].ends_within(LEAVING_S)):
                nodes[role].release()
            nodes[role].end(LEAVING_S if failed and role is not Role.RECORDER else _CLOSING_S)
            nodes[role].release()


def _collect(nodes: dict[Role, NodeProcess], end: GraphResult, external: Role | None) -> None:
    """Read the reports of the nodes; fewer messages recorded than published are a failure of a run that has begun."""
    for role, node in nodes.items():
        for name, values in node.counts.items():
            kind, _, topic = name.partition(" ")
            if kind == "published":
                end.published[topic] = end.published.get(topic, 0) + values[0]
        if any(node.counts.get(LAST_COUNT, ())):
            end.ignored[role.value] = node.counts[LAST_COUNT][0]
    recorded = nodes[Role.RECORDER].counts
    end.ticks = nodes[Role.PLANT].tick
    if LAST_COUNT not in nodes[Role.PLANT].counts:  # killed: its last report is older than its last message
        end.ticks = max(end.ticks, recorded.get("recorded train/vehicles", [0])[0] - 1)
    end.wall_s = nodes[Role.PLANT].counts.get("wall_ns", [0])[0] * 1e-9
    if external is not None:
        end.outside = {external.value: nodes[Role.RECORDER].outside or external.value}
    if Role.CONTROLLER in nodes:
        end.step_ns = nodes[Role.CONTROLLER].counts.get("step_ns", [])
    begun = end.ticks or end.published.get("train/measurement")  # before it nothing waits for the recorder
    for topic, count in end.published.items() if begun else ():
        found = recorded.get(f"recorded {topic}", [count])[0]
        if end.failure is None and found < count:
            end.failure = f"node recorder failed: {topic}: {found} of {count} messages are recorded"
