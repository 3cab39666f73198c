"""Memory of a run and of the readers of its log: that of a window or a part, and of the profile."""

import functools
import shutil
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest
from engine_runs import record_run, setup_of

from train_ato.cli.main import main
from train_ato.log.difference import compare_logs
from train_ato.log.overview import log_overview
from train_ato.log.recorded import open_recording, read_changes
from train_ato.log.recover import recover
from train_ato.log.run_folder import read_run_folder
from train_ato.loop.engine import run_engine
from train_ato.messages.codec import Wire
from train_ato.report.page_data import page_data
from train_ato.scenario.setup import RunSetup
from train_ato.view.recorded import RecordedFeed

TICK, TRIP = 0.1, 60
"""Tick and duration of a trip from stop to stop [s]."""
WINDOWS = {
    "log.difference.PORTION": 64, "log.difference.WINDOW_NS": 10**10, "log.table_loading.PART": 2**14,
    "log.table_loading.REPORTS_OF_PART": 64, "log.tables.PORTION": 2**14, "judge.kept_samples.CACHED": 2**14,
    "judge.kept_samples.IN_MEMORY": 2**14, "loop.forecast.WINDOW": 2**10,
}  # fmt: skip
"""Windows in memory: messages, bytes, ticks."""
TRIPS = """
schema: train_ato/scenario/1
name: shuttle
duration: {seconds}
tick: {tick}
step: 0.05
plant: {{consist: xuzhou_metro_3, line: line.yaml, lag: 0.4}}
profile: {{limits: {{jerk: 0.6, acceleration: 0.8, deceleration: 0.8}}, phases: [{phases}]}}
law: pid
compensation: preview
"""


def shuttle(folder: Path, seconds: int) -> RunSetup:
    """Return a run of trips from its begin to its end: its profile grows with its duration."""
    trip = "{{accelerate_to_kmh: 36}}, {{cruise_for: 10}}, {{brake_to: 0}}, {{cruise_until: {end}}}"
    phases = ", ".join(trip.format(end=end) for end in range(TRIP, seconds + 1, TRIP))
    path = folder / f"{seconds}.yaml"
    (folder / "line.yaml").write_text("{schema: train_ato/line/1, name: level, end_km: 6, source: chosen}")
    path.write_text(TRIPS.format(seconds=seconds, tick=TICK, phases=phases))
    return setup_of(str(path))


def info(run: Path, out: Path) -> None:
    log_overview(run / "run.mcap")


def compared(run: Path, out: Path) -> None:
    setup, _ = read_run_folder(run)
    assert compare_logs(run, run, Wire(setup.layout)).equal


def repeated(run: Path, out: Path) -> None:
    """Run it again, as the command ``verify`` does before it compares; its log needs a few chunks."""
    setup, _ = read_run_folder(run)
    assert not read_changes(run).rows(setup.scenario)
    assert run_engine(setup, messages_only=True).failure is None


def exported(run: Path, out: Path) -> None:
    assert main(["export", str(run), "--out", str(out / "tables")]) == 0


def reported(run: Path, out: Path) -> None:
    page_data(open_recording(run), share=0.01)  # the short run fills its curves, too


def viewed(run: Path, out: Path) -> None:
    RecordedFeed(run)


def recovered(run: Path, out: Path) -> None:
    log = out / "run.mcap.partial"
    shutil.copyfile(run / "run.mcap", log)
    recover(log)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Callable[[int], Path]:
    """Return a function that records a run of a duration, once."""
    folder = tmp_path_factory.mktemp("runs")
    return functools.cache(lambda seconds: record_run(shuttle(folder, seconds), folder / str(seconds)))


@pytest.mark.parametrize(  # durations of two runs [s] that fill some chunks of the log; a comparison is slow
    ("read", "lengths"),
    [(compared, (120, 240)), *((read, (480, 960)) for read in (info, recovered, repeated, exported, reported, viewed))],
)
def test_a_day_needs_less_than_a_gigabyte(read, lengths, runs, tmp_path, monkeypatch):
    """Fails if a run or a reader keeps all messages or samples, or several copies of the profile."""
    # The windows in memory are so small that the short run fills them, too.
    for place, size in WINDOWS.items():
        monkeypatch.setattr(f"train_ato.{place}", size)
    short, long = lengths
    peaks = {}
    for number, seconds in enumerate((short, short, long)):  # the first reading imports modules and fills caches
        out = tmp_path / str(number)
        out.mkdir()
        run = runs(seconds)
        if number > 0:
            tracemalloc.start()
        try:
            read(run, out)
            peaks[seconds] = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
    grown = (peaks[long] - peaks[short]) / ((long - short) / TICK)
    assert grown < (1e9 - 2e8) / (24 * 3600 * 20), peaks  # 200 MB without a log; a day of ticks of 0.05 s
