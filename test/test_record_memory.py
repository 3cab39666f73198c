"""Memory of the readers of a log: that of a window or a part, not that of the log."""

from __future__ import annotations

import shutil
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest
from engine_runs import record_run

from train_ato.log.difference import compare_logs
from train_ato.log.overview import log_overview
from train_ato.log.recover import recover
from train_ato.loop.setup import prepare
from train_ato.messages.codec.codec import Wire
from train_ato.scenario.scenario import load_scenario

SHORT, LONG = 120, 480
"""Durations of two runs [s]; the train is at rest at the end of both."""
TICKS = (LONG - SHORT) * 10
BYTES_PER_TICK = 300.0
"""Bound: half of what a day of ticks of 0.05 s may need within 1 GB."""
SETUP = prepare(*load_scenario("demo", (f"duration={SHORT}",)))


def info(run: Path, out: Path) -> None:
    log_overview(run / "run.mcap")


def compare(run: Path, out: Path) -> None:
    assert compare_logs(run, run, Wire(SETUP.layout)).equal


def recovered(run: Path, out: Path) -> None:
    log = out / "run.mcap.partial"
    shutil.copyfile(run / "run.mcap", log)
    recover(log)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """Record a short and a long run."""
    folder = tmp_path_factory.mktemp("runs")
    return {
        seconds: record_run(prepare(*load_scenario("demo", (f"duration={seconds}",))), folder / str(seconds))
        for seconds in (SHORT, LONG)
    }


@pytest.mark.parametrize("read", [info, compare, recovered])
def test_the_memory_of_a_reader_does_not_grow_with_the_log(
    read: Callable[[Path, Path], None], runs: dict[int, Path], tmp_path: Path
) -> None:
    """Fails if a reader keeps the stamps of all messages, or the messages."""
    peaks = {}
    for seconds in (SHORT, SHORT, LONG):  # the first reading imports modules and fills caches
        out = tmp_path / f"{seconds}-{len(peaks)}"
        out.mkdir()
        tracemalloc.start()
        try:
            read(runs[seconds], out)
            peaks[seconds] = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
    grown = (peaks[LONG] - peaks[SHORT]) / TICKS
    assert grown < BYTES_PER_TICK, peaks
