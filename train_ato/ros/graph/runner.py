"""Running the node graph: the environment, one of the two ways, and what came of it, read back from the log."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from train_ato.graph.environment import applied, claim_domain, variables
from train_ato.graph.recorded import outcome_of
from train_ato.graph.run_end import GraphOptions, RunEnd
from train_ato.outcome import Outcome, Progress
from train_ato.run_setup import RunSetup


def run_graph(
    setup: RunSetup,
    folder: Path,
    *,
    way: str,
    progress: Callable[[Progress], None] | None = None,
    realtime: float | None = None,
    pace: float = 0.0,
    domain: int | None = None,
    timeout: float | None = None,
) -> Outcome:
    """Drive one run as ROS nodes, recorded into an existing empty folder.

    Parameters
    ----------
    way
        ``composed``: all nodes in this process; ``processes``: one process for each.
    progress
        Called about ten times a second of wall time.
    realtime
        Simulated seconds per second of wall time; None is lockstep.
    pace
        In lockstep, simulated seconds per second of wall time at most; 0 is as fast as it goes.
    domain
        ROS domain; None takes a free one.
    timeout
        Wall time after which a silent node fails the run [s]; default 10 in lockstep, 1 when paced.

    Raises
    ------
    ValueError
        If another run holds the domain, or a node cannot be made; an empty folder is removed again.
    """
    options = GraphOptions(realtime=realtime, pace=pace, timeout=timeout)
    begin = time.perf_counter()

    def report(ticks: int) -> None:
        if progress is not None:
            progress(Progress(ticks * setup.tick, setup.ticks * setup.tick, time.perf_counter() - begin))

    try:
        with claim_domain(domain) as held:
            end = _run(way, setup, folder, held, options, report)
    except ValueError:
        with suppress(OSError):
            folder.rmdir()
        raise
    _tidy(folder / "log")
    return outcome_of(setup, folder, end)


def _run(
    way: str, setup: RunSetup, folder: Path, domain: int, options: GraphOptions, report: Callable[[int], None]
) -> RunEnd:
    """Import a runner only now: rclpy reads parts of its environment when it is loaded."""
    if way == "processes":
        from train_ato.graph.processes import run_processes

        return run_processes(setup, folder, domain, options, report)
    if way != "composed":
        raise ValueError(f"no way to run called '{way}'; choose composed or processes")
    with applied(variables(domain, folder / "log")):
        from train_ato.graph.composed import run_composed

        return run_composed(setup, folder, domain, options, report)


def _tidy(log_folder: Path) -> None:
    """Remove the empty log files that every node leaves."""
    if log_folder.is_dir():
        for path in log_folder.iterdir():
            if path.is_file() and path.stat().st_size == 0:
                path.unlink()
        with suppress(OSError):
            log_folder.rmdir()
