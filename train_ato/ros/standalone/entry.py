"""Entry of one node in a process of its own: ``ros2 run train_ato NODE``, or ``train-ato run --processes``."""

from __future__ import annotations

import argparse
import math
import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from train_ato.arguments import BAD_INPUT, OneLineParser, add_no_lockstep, add_rate, prepare_streams
from train_ato.interrupt import Interrupt
from train_ato.log.compression import DEFAULT, add_compression
from train_ato.messages.faults import node_faults
from train_ato.messages.topics import Role
from train_ato.ros import require_ros
from train_ato.ros.graph.environment import domain_of_environment, middleware, opened_by
from train_ato.ros.graph.graph_result import FREE_TIMEOUT_S, LOCKSTEP_TIMEOUT_S
from train_ato.ros.standalone.notices import LAST_COUNT, EndOrder, Notices, begin_stamp, read_notices

if TYPE_CHECKING:
    from train_ato.loop.result import RunResult
    from train_ato.loop.setup import RunSetup
    from train_ato.ros.nodes.endpoints import NodeEndpoints

    Completed = Callable[[RunSetup, RunResult, Path], None]


def _arguments(role: Role, words: Sequence[str]) -> argparse.Namespace:
    parser = OneLineParser(prog=f"{role.value}_node", description=f"Node {role.value} of a train_ato graph.")
    parser.add_argument("--scenario", required=True, metavar="SCENARIO[:VARIANT]", help="shipped name or a file")
    parser.add_argument("--set", action="append", default=[], metavar="A.B=V", help="change one key of the scenario")
    # for `run --processes`: end the run when standard input is closed, report on standard output, leave the summary
    parser.add_argument("--attached", action="store_true", help=argparse.SUPPRESS)
    # for `run --processes --restart`: join the run in progress after the notice `begin`
    parser.add_argument("--restarted", action="store_true", help=argparse.SUPPRESS)
    if role is Role.PLANT:
        add_rate(parser)
        add_no_lockstep(parser)
        parser.add_argument(
            "--timeout", type=float, metavar="S", help="wall time without an answer after which the run fails"
        )
        parser.add_argument("--recorded", action="store_true", help="do not begin without a recorder")
    if role is Role.RECORDER:
        parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the log")
        add_compression(parser)
    own, ros = list(words), []
    if "--ros-args" in own:
        at = own.index("--ros-args")
        end = own.index("--", at) if "--" in own[at:] else len(own)
        own, ros = own[:at] + own[end + 1 :], own[at:end]
    options = parser.parse_args(own)
    options.ros = ros
    return options


def run_role(role: Role, words: Sequence[str], completed: Completed | None = None) -> int:
    """Run a node until the end of its run, SIGTERM or Ctrl-C.

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
    prepare_streams()
    options = _arguments(role, words)
    try:
        domain_of_environment()
        opened = opened_by()
        os.environ.update(middleware())
    except ValueError as error:
        sys.stderr.write(f"{role.value}: {error}\n")
        return BAD_INPUT
    if opened and not options.attached:
        sys.stderr.write(f"{role.value}: other hosts may join this run ({opened})\n")
    os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")
    stopped = EndOrder()
    interrupt = Interrupt()

    def stop(number: int, frame: FrameType | None) -> None:
        stopped.signal = stopped.signal or signal.Signals(number).name
        stopped.set()
        interrupt.ask(number, frame)

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop)
    notices = Notices()
    if options.attached:
        threading.Thread(target=read_notices, args=(stopped, notices), daemon=True).start()
    try:
        if not options.attached:
            require_ros()
        return _run(role, options, stopped, notices, completed)
    except (ValueError, OSError) as error:
        sys.stderr.write(f"{role.value}: {' '.join(str(error).split())}\n")
        return BAD_INPUT


def _plan_end(role: Role, setup: RunSetup, endpoints: NodeEndpoints, joined: int | None) -> None:
    """Plan the first SIGKILL or SIGSTOP of this process by a fault of the scenario, after a restart the next one."""
    signals = {"kill": signal.SIGKILL, "stop": signal.SIGSTOP}
    faults = [fault for fault in node_faults(setup.scenario.faults) if fault.role is role and fault.do in signals]
    ends = [(round(fault.at * 1e9), signals[fault.do]) for fault in faults]
    if waiting := [end for end in ends if joined is None or end[0] > joined]:
        endpoints.end_process_at(*min(waiting))


def _run(
    role: Role, options: argparse.Namespace, stopped: EndOrder, notices: Notices, completed: Completed | None
) -> int:
    """Create and run the node; imports are late because rclpy reads the environment at import."""
    from train_ato.errors import FirstFailure
    from train_ato.loop.run_end import FAILED, RunEnd
    from train_ato.loop.setup import prepare
    from train_ato.messages.codec.codec import Wire
    from train_ato.ros.graph.assembly import check_arguments, executor_of, make_node
    from train_ato.ros.nodes.endpoints import ROLES, NodeEndpoints
    from train_ato.ros.standalone.runner import StandaloneRunner
    from train_ato.scenario.scenario import load_scenario

    setup = prepare(*load_scenario(options.scenario, tuple(options.set)))
    lockstep = getattr(options, "lockstep", True)
    timeout = getattr(options, "timeout", None)
    if timeout is None:
        timeout = LOCKSTEP_TIMEOUT_S if lockstep else FREE_TIMEOUT_S
    folder: Path | None = getattr(options, "out", None)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    joined = begin_stamp(stopped, notices) if options.restarted else None
    if options.restarted and joined is None:  # the run has ended before
        sys.stdout.write(f"{LAST_COUNT}:0\n")
        return 0
    log_folder = Path(os.environ["ROS_LOG_DIR"]) if "ROS_LOG_DIR" in os.environ else None
    watch = FirstFailure(log_folder)
    check_arguments(options.ros)
    with executor_of(None, options.ros or None, watch) as (context, executor):
        endpoints = NodeEndpoints(role, Wire(setup.layout), context, watch, ROLES[:-1], options.ros or None)
        if role is not Role.RECORDER:
            executor.add_node(endpoints.node)
        limit = getattr(options, "rate", math.inf)
        rate = 0.0 if math.isinf(limit) else limit
        compression = getattr(options, "compression", DEFAULT)
        node = make_node(role, setup, endpoints, folder, lockstep, timeout, False, rate, compression)
        _plan_end(role, setup, endpoints, joined)
        recorded = getattr(options, "recorded", False)
        turner = StandaloneRunner(
            role,
            node,
            endpoints,
            executor,
            stopped,
            setup.fingerprint(),
            recorded,
            options.attached,
            notices,
            joined,
        )
        status = turner.run()
        if folder is not None and not node.log.failure and not options.attached:
            from train_ato.ros.graph.recorded import complete_folder

            wall_s = turner.last_heard - turner.first_heard
            announced = RunEnd.of(endpoints.end) if endpoints.end is not None else None
            counts = node.log.counts
            result = complete_folder(
                setup, folder, counts, wall_s, watch.failure, announced, stopped.signal, endpoints.publisher_names
            )
            if completed is not None and result is not None:
                completed(setup, result, folder)
            unread = result.failure if result is not None and watch.failure is None else None
            if unread is not None and (announced is None or announced.status != FAILED):
                sys.stderr.write(f"{unread}\n")
                return 1
        return status
