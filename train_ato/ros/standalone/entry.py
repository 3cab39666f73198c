"""Entry of one node in a process of its own: ``ros2 run train_ato NODE``, or ``train-ato run --processes``."""

from __future__ import annotations

import argparse
import ctypes
import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from train_ato.log.compression import add_compression
from train_ato.messages.faults import node_faults
from train_ato.messages.topics import EXTERNAL, Role
from train_ato.program import arguments
from train_ato.program.interrupt import Interrupt, no_silent_exit
from train_ato.ros import missing_ros, require_ros
from train_ato.ros.graph.environment import domain_of_environment, middleware, opened_by
from train_ato.ros.graph.graph_result import GraphOptions
from train_ato.ros.standalone.notices import LAST_COUNT, EndOrder, Notices, begin_stamp, read_notices

if TYPE_CHECKING:
    from train_ato.judge.result import RunResult
    from train_ato.ros.nodes.endpoints import NodeEndpoints
    from train_ato.ros.standalone.runner import StandaloneRunner
    from train_ato.scenario.setup import RunSetup

    Completed = Callable[[RunSetup, RunResult, Path], None]

OF_GRAPH = ("lockstep", "timeout", "compression", "followed", "resets")
"""Options of a node that are those of the graph as they are."""
LEAVING_S = 10.0
"""Maximum wall time from the end of a node's work to the end of its process [s]."""


def _arguments(role: Role, words: Sequence[str]) -> argparse.Namespace:
    parser = arguments.OneLineParser(prog=f"{role.value}_node", description=f"Node {role.value} of a train_ato graph.")
    add = partial(arguments.add_option, parser)
    add("--scenario SCENARIO[:VARIANT]", "shipped name or a file", required=True)
    add("--set A.B=V", "change one key of the scenario", action="append")
    # for `run --processes`: end the run when standard input is closed, report on standard output, leave the summary
    add("--attached", argparse.SUPPRESS)
    # for `run --processes --restart`: join the run in progress after the notice `begin`
    add("--restarted", argparse.SUPPRESS)
    besides = () if "--attached" in words else ("plant",)  # only `run` waits for all nodes in place of the plant
    add(
        "--external NODE",
        "a program of yours runs in place of this node; give every node the same",
        choices=[other for other in EXTERNAL if other not in (role.value, *besides)],
    )
    if role is Role.PLANT:
        arguments.add_rate(parser)
        arguments.add_no_lockstep(parser)
        add("--timeout S", "wall time without an answer after which the run fails")
        add("--recorded", "do not begin without a recorder")
        add("--resets", argparse.SUPPRESS)  # `run` begins the run again
        arguments.add_followed(parser)
    if role is Role.RECORDER:
        add("--out DIR", "folder of the log", required=True)
        add_compression(parser)
    own, ros = list(words), list[str]()
    while "--ros-args" in own:
        at = own.index("--ros-args")
        end = own.index("--", at) if "--" in own[at:] else len(own)
        own, ros = own[:at] + own[end + 1 :], ros + own[at:end]
    options = parser.parse_args(own)
    options.ros = ros
    return options


def run_role(role: Role, words: Sequence[str], completed: Completed | None = None) -> int:
    """Run a node until the end of its run, SIGTERM, Ctrl-C or the end of its terminal.

    Parameters
    ----------
    role
        Role of the node.
    words
        Command line without the name of the program.
    completed
        Called by the recorder after a complete run, with setup, result and folder.

    Returns
    -------
    int
        Exit status: 0 done, 1 failed, 2 bad input.
    """
    arguments.prepare_streams()
    options = _arguments(role, words)
    try:
        domain_of_environment()
        opened = opened_by()
        os.environ.update(middleware())
    except ValueError as error:
        sys.stderr.write(f"{role.value}: {error}\n")
        return arguments.BAD_INPUT
    if opened and not options.attached:
        sys.stderr.write(f"{role.value}: other hosts may join this run ({opened})\n")
    os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")
    stopped = EndOrder()
    interrupt = Interrupt()

    def stop(number: int, frame: FrameType | None) -> None:
        stopped.signal = stopped.signal or signal.Signals(number).name
        stopped.set()
        interrupt.ask(number, frame)

    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # ignored under ``nohup``
            signal.signal(number, stop)
    notices = Notices()
    if options.attached:
        threading.Thread(target=read_notices, args=(stopped, notices), daemon=True).start()
    try:
        if not options.attached:
            require_ros()
        with no_silent_exit():
            return _run(role, options, stopped, notices, completed)
    except (ValueError, OSError, ImportError) as error:
        without = missing_ros(error)
        if isinstance(error, ImportError) and without is None:
            raise
        sys.stderr.write(f"{role.value}: {' '.join((without or str(error)).split())}\n")
        return arguments.BAD_INPUT


def _plan_end(role: Role, setup: RunSetup, endpoints: NodeEndpoints, joined: int | None) -> None:
    """Plan the first SIGKILL or SIGSTOP of this process by a fault of the scenario, after a restart the next one."""
    signals = {"kill": signal.SIGKILL, "stop": signal.SIGSTOP}
    faults = [fault for fault in node_faults(setup.scenario.faults) if fault.role is role and fault.do in signals]
    ends = [(round(fault.at * 1e9), signals[fault.do]) for fault in faults]
    if waiting := [end for end in ends if joined is None or end[0] > joined]:
        endpoints.end_process_at(*min(waiting))


def _check_parameters(options: argparse.Namespace, endpoints: NodeEndpoints) -> None:
    """Refuse an option of the plant whose parameter has another value."""
    given = {
        "--rate": None if options.rate is None else arguments.rate_of(options) or 0.0,
        "--timeout": options.timeout,
        "--no-lockstep": None if options.lockstep else False,
        "--scenario": options.scenario,
    }
    for option, value in given.items():
        name = option.removeprefix("--").removeprefix("no-")
        parameter = endpoints.node._parameter_overrides.get(name)
        if None not in (value, parameter) and parameter.value != value:
            raise ValueError(f"parameter {name}: {parameter.value}: {option} has another value; remove one")


def _run(
    role: Role, options: argparse.Namespace, stopped: EndOrder, notices: Notices, completed: Completed | None
) -> int:
    """Create and run the node; imports are late because rclpy reads the environment at import.

    The objects up to the run live until the end of the process: the runner takes them out of the garbage collection.
    """
    gc.disable()
    from train_ato.messages.codec import Wire
    from train_ato.program.errors import FirstFailure
    from train_ato.ros.graph.assembly import check_arguments, executor_of, make_node
    from train_ato.ros.nodes.endpoints import ROLES, NodeEndpoints
    from train_ato.ros.standalone.runner import StandaloneRunner
    from train_ato.scenario.scenario import load_scenario
    from train_ato.scenario.setup import prepare

    setup = prepare(*load_scenario(options.scenario, tuple(options.set)))
    if role is Role.SUPERVISOR and not setup.layout.supervised:
        raise ValueError(f"{options.scenario}: the run has no supervision; set supervision.enabled: true")
    given = {key: value for key, value in vars(options).items() if key in OF_GRAPH}
    rate = (arguments.rate_of(options) if role is Role.PLANT else None) or 0.0
    folder: Path | None = getattr(options, "out", None)
    if folder is not None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ValueError(f"--out {folder}: cannot be made ({error.strerror}); name a writable place") from None
    joined = begin_stamp(stopped, notices) if options.restarted else None
    if options.restarted and joined is None:  # the run has ended before
        sys.stdout.write(f"{LAST_COUNT}:0\n")
        return 0
    if any(word.startswith("__ns:=") for word in options.ros):
        setup = setup.reporting()
    log_folder = Path(os.environ["ROS_LOG_DIR"]) if "ROS_LOG_DIR" in os.environ else None
    watch = FirstFailure(log_folder)
    check_arguments(options.ros, role)
    with executor_of(None, options.ros or None, watch) as (context, executor):
        external = None if options.external is None else Role(options.external)
        endpoints = NodeEndpoints(role, Wire(setup.layout), context, watch, ROLES[:-1], options.ros or None, external)
        if role is Role.PLANT:
            _check_parameters(options, endpoints)
        if role is not Role.RECORDER:
            executor.add_node(endpoints.node)
        node = make_node(role, setup, endpoints, folder, GraphOptions(**given, rate=rate), recorded=False)
        _plan_end(role, setup, endpoints, joined)
        turner = StandaloneRunner(
            role, node, endpoints, executor, stopped=stopped, fingerprint=setup.fingerprint(),
            recorded=getattr(options, "recorded", False), attached=options.attached, notices=notices, restarted=joined,
        )  # fmt: skip
        status = turner.run()
        if folder is not None and not node.log.failure and not options.attached:
            unread = _complete_recording(setup, folder, turner, watch.failure, stopped, completed=completed)
            status = 1 if unread else status
        exit_within(LEAVING_S, status)
        return status


class _TimerEvent(ctypes.Structure):
    """``struct sigevent`` of Linux."""

    _fields_ = (
        ("value", ctypes.c_void_p),
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("attributes", ctypes.c_void_p),
        ("unused", ctypes.c_byte * 32),
    )


def exit_within(seconds: float, status: int) -> None:
    """End this process with ``status`` after ``seconds`` [s], unless it ends before.

    Fast DDS 2.14 can turn in circles for minutes while it destroys a participant, if another one leaves the graph at
    the same moment (its issue 6513). The interpreter's lock is held then, so that only the system can end the process.
    """
    sys.stdout.flush()
    libc = ctypes.CDLL(None)
    if not hasattr(libc, "timer_create"):
        return
    call_function = 2
    event = _TimerEvent(value=status, notify=call_function, function=ctypes.cast(libc._exit, ctypes.c_void_p).value)
    timer = ctypes.c_void_p()
    if libc.timer_create(time.CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)) == 0:
        whole, part = divmod(round(seconds * 1e9), 1_000_000_000)
        libc.timer_settime(timer, 0, (ctypes.c_long * 4)(0, 0, whole, part), None)


def _complete_recording(
    setup: RunSetup,
    folder: Path,
    turner: StandaloneRunner,
    failure: str | None,
    stopped: EndOrder,
    *,
    completed: Completed | None,
) -> bool:
    """Complete the folder of a recorder started by hand; return True if the record fails and nothing else has."""
    from train_ato.judge.run_end import FAILED, RunEnd
    from train_ato.ros.graph.recorded import complete_folder

    endpoints = turner.endpoints
    wall_s = turner.last_heard - turner.first_heard
    announced = RunEnd.of(endpoints.end) if endpoints.end is not None else None
    counts = turner.node.log.counts
    result = complete_folder(
        setup, folder, counts, wall_s, failure=failure, announced=announced, stopped=stopped.signal,
        names=endpoints.publisher_names,
    )  # fmt: skip
    if result is None:
        return False
    if completed is not None:
        completed(setup, result, folder)
    if failure is not None or result.failure is None or (announced is not None and announced.status == FAILED):
        return False
    sys.stderr.write(f"{result.failure}\n")
    return True
