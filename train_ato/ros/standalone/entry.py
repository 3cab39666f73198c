"""One node in a process of its own: started by the runner over pipes, or alone by ``ros2 run train_ato NODE``."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from pathlib import Path
from typing import Any

from train_ato.arguments import BAD_INPUT, OneLineParser
from train_ato.graph.environment import discovery_profile
from train_ato.graph.run_end import LOCKSTEP_TIMEOUT_S, PACED_TIMEOUT_S
from train_ato.topics import Role


def _arguments(role: Role) -> argparse.Namespace:
    parser = OneLineParser(prog=f"{role.value}_node", description=f"Node {role.value} of a train_ato graph.")
    parser.add_argument("--scenario", required=True, metavar="SCENARIO[:VARIANT]", help="shipped name or a file")
    parser.add_argument("--set", action="append", default=[], metavar="A.B=V", help="change one key of the scenario")
    parser.add_argument("--pipes", action="store_true", help=argparse.SUPPRESS)
    if role is Role.PLANT:
        parser.add_argument("--realtime", type=float, metavar="F", help="pace on the wall clock instead of lockstep")
        parser.add_argument(
            "--pace", type=float, default=0.0, metavar="F", help="hold lockstep back to F times real time"
        )
        parser.add_argument(
            "--timeout", type=float, metavar="S", help="wall time after which a silent node ends the run"
        )
        parser.add_argument("--recorded", action="store_true", help="do not begin without a recorder")
    if role is Role.RECORDER:
        parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the log")
    own, ros = sys.argv[1:], []
    if "--ros-args" in own:
        at = own.index("--ros-args")
        own, ros = own[:at], own[at:]
    options = parser.parse_args(own)
    options.ros = ros
    return options


def run_role(role: Role) -> int:
    """Run a node until its run is over, it is told to end, or Ctrl-C; return the exit status (0, 1 failed, 2 input)."""
    options = _arguments(role)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(discovery_profile()))
    os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")
    number = {"asked": False}

    def ask(*_: Any) -> None:
        number["asked"] = True

    signal.signal(signal.SIGTERM, ask)
    signal.signal(signal.SIGINT, signal.SIG_IGN if options.pipes else ask)
    try:
        return _run(role, options, number)
    except (ValueError, OSError) as error:
        text = " ".join(str(error).split())
        if options.pipes:
            import json

            sys.stdout.write(json.dumps({"event": "failed", "reason": f"node {role.value} failed: {text}"}) + "\n")
        else:
            sys.stderr.write(f"{role.value}: {text}\n")
        return BAD_INPUT


def _run(role: Role, options: argparse.Namespace, stopped: dict[str, bool]) -> int:
    """Make the node and turn it; imports come here, after the environment is set."""
    from train_ato.failure import Watch
    from train_ato.graph.assembly import executor_of, make_node
    from train_ato.nodes.alone import AloneNode
    from train_ato.nodes.piped import PipedNode
    from train_ato.nodes.shell import ROLES, Shell
    from train_ato.run_setup import prepare
    from train_ato.scenario import load
    from train_ato.wire import Wire

    setup = prepare(*load(options.scenario, tuple(options.set)))
    realtime = getattr(options, "realtime", None)
    timeout = getattr(options, "timeout", None)
    if timeout is None:
        timeout = LOCKSTEP_TIMEOUT_S if realtime is None else PACED_TIMEOUT_S
    folder: Path | None = getattr(options, "out", None)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    log_folder = Path(os.environ["ROS_LOG_DIR"]) if "ROS_LOG_DIR" in os.environ else None
    watch = Watch(log_folder)
    roles = ROLES if options.pipes else ROLES[:-1]
    with executor_of(None, options.ros or None) as (context, executor):
        shell = Shell(role, Wire(setup.shape), context, watch, roles, options.ros or None)
        if role is not Role.RECORDER:
            executor.add_node(shell.node)
        pace = getattr(options, "pace", 0.0)
        node = make_node(role, setup, shell, folder, realtime, timeout, recorded=options.pipes, pace=pace)
        if options.pipes:
            return PipedNode(role, node, shell, executor, stopped).run()
        turner = AloneNode(role, node, shell, executor, stopped, getattr(options, "recorded", False))
        status = turner.run()
        if folder is not None and not node.log.failure:
            from train_ato.graph.recorded import complete_folder

            complete_folder(setup, folder, node.log.counts, turner.last_heard - turner.first_heard)
        return status
