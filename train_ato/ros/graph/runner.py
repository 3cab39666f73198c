"""Run of the node graph: environment, one of the two modes, and the result from the log."""

import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from train_ato.judge.result import Progress, RunResult
from train_ato.judge.run_end import RESET
from train_ato.messages.topics import Role
from train_ato.ros import missing_ros
from train_ato.ros.graph.environment import applied, claim_domain, domain_of_environment, print_domain, variables
from train_ato.ros.graph.graph_result import IGNORED, GraphOptions, GraphResult
from train_ato.ros.graph.recorded import recorded_result
from train_ato.scenario.setup import RunSetup


def run_graph(
    setup: RunSetup,
    folder: Path,
    *,
    mode: str,
    progress: Callable[[Progress], None] | None = None,
    domain: int | None = None,
    external: str | None = None,
    **options: Any,
) -> RunResult:
    """Run ROS nodes to the end of a scenario, recorded into an existing empty folder.

    Parameters
    ----------
    mode
        ``composed``: all nodes in this process; ``processes``: one process for each.
    progress
        Called about ten times a second of wall time.
    domain
        ROS domain; None takes that of ``ROS_DOMAIN_ID``, without it a free one.
    external
        Node of the graph in whose place another program runs.
    **options
        Other attributes of :class:`~train_ato.ros.graph.graph_result.GraphOptions`.

    Raises
    ------
    ValueError
        If another run holds the domain, or a node cannot be created; an empty folder is removed.
    """
    chosen = GraphOptions(external=None if external is None else Role(external), **options)
    setup = setup.reporting() if chosen.namespace else setup
    begin = time.perf_counter()

    def report(ticks: int) -> None:
        if progress is not None:
            progress(Progress(ticks * setup.tick, setup.ticks * setup.tick, time.perf_counter() - begin))

    try:
        name = "--domain" if domain is not None else "ROS_DOMAIN_ID"
        with claim_domain(domain if domain is not None else domain_of_environment(), name, chosen.namespace) as held:
            print_domain(held, external, chosen.namespace)
            end = _run(mode, setup, folder, held, chosen, report)
            again = held if (end.interruption or "").startswith(RESET) else None
    except (ValueError, ImportError) as error:
        with suppress(OSError):
            folder.rmdir()
        if (without := missing_ros(error)) is not None:
            raise ValueError(without) from None
        raise
    _tidy(folder / "log")
    return replace(_with_notes(recorded_result(setup, folder, end, end.outside), end), domain=again)


def _with_notes(outcome: RunResult, end: GraphResult) -> RunResult:
    """Add restarts and ignored messages to the summary, and write a line about each."""
    summary = dict(outcome.summary)
    if end.restarts:
        times = {name: {1: "once", 2: "twice"}.get(count, f"{count} times") for name, count in end.restarts.items()}
        listed = "; ".join(f"node {name} was restarted {text}" for name, text in times.items())
        sys.stderr.write(f"train-ato: {listed}\n")
        summary["restarts"] = end.restarts
    if end.ignored:
        listed = ", ".join(f"{node} {count}" for node, count in end.ignored.items())
        sys.stderr.write(f"train-ato: {listed} {IGNORED}\n")
        summary["ignored"] = end.ignored
    return replace(outcome, summary=summary)


def _run(
    mode: str, setup: RunSetup, folder: Path, domain: int, options: GraphOptions, report: Callable[[int], None]
) -> GraphResult:
    """Run the nodes in the given mode; the import is late because rclpy reads its environment at import."""
    beside = options.external is Role.PLANT
    if mode == "processes" and not beside:
        from train_ato.ros.graph.processes import run_processes

        return run_processes(setup, folder, domain, options, report)
    with applied(variables(domain, folder / "log")):
        from train_ato.ros.graph.composed import run_composed
        from train_ato.ros.graph.processes import run_beside_plant

        run = run_beside_plant if mode == "processes" else run_composed
        return run(setup, folder, domain, options, report)


def _tidy(log_folder: Path) -> None:
    """Remove the empty log files that every node leaves."""
    if log_folder.is_dir():
        for path in log_folder.iterdir():
            if path.is_file() and path.stat().st_size == 0:
                path.unlink()
        with suppress(OSError):
            log_folder.rmdir()
