"""What came of a run of the graph, read back from its log: with a runner's numbers or without a runner."""

from __future__ import annotations

import sys
from pathlib import Path

from train_ato.graph.run_end import RunEnd
from train_ato.history import SERIES, HistoryBuilder
from train_ato.outcome import Outcome
from train_ato.record.layout import LOG
from train_ato.record.reading import iter_raw, read_log
from train_ato.roles.step_times import StepTimes
from train_ato.run_setup import RunSetup
from train_ato.wire import Wire


def outcome_of(setup: RunSetup, folder: Path, end: RunEnd) -> Outcome:
    """Return the outcome of a run whose log is in ``folder``, if there is one."""
    builder = HistoryBuilder(setup)
    if (folder / LOG).is_file():
        for topic, _, message in read_log(folder, Wire(setup.shape).decode, SERIES):
            builder.add(topic, message)
    return Outcome.of(
        setup, builder, end.wall_s, end.ticks, StepTimes(end.step_ns), end.interrupted, end.failure, end.published
    )


def complete_folder(setup: RunSetup, folder: Path, counts: dict[str, int], wall_s: float) -> None:
    """Put beside a log what a runner would have put there: resolved scenario, summary, figure.

    A log that does not begin with the run gets no summary: its figures would be those of another run.

    Parameters
    ----------
    counts
        Messages recorded of every topic.
    wall_s
        Wall time of the recording [s].
    """
    from train_ato.run_folder import RunFolder  # draws figures: only the recorder pays for it

    home = RunFolder(folder)
    home.begin(setup)
    first = next((stamp for topic, stamp, _ in iter_raw(folder, ("train/measurement",))), None)
    if first != 0:
        when = "no step" if first is None else f"nothing before {first * 1e-9:.1f} s"
        sys.stderr.write(f"recorder: {folder}: {when} is recorded, so there is no summary; start the plant last\n")
        return
    ticks = counts["ato/command"]
    end = RunEnd(wall_s=wall_s, ticks=ticks, published=counts, recorded=counts, interrupted=ticks < setup.ticks)
    home.finish(setup, outcome_of(setup, folder, end))
