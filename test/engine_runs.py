"""Runs of the engine for tests, in the folder of the command ``run`` without its figure."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from train_ato.log.difference import LogComparison, compare_logs
from train_ato.log.run_folder import RunFolder, read_run_folder
from train_ato.loop.engine import run_engine
from train_ato.messages.codec import Wire
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.scenario_data import PartCache
from train_ato.scenario.setup import RunSetup, prepare

PARTS = PartCache(256)
"""Trains, lines, models and planned profiles of the cases of a process, each made once."""


def setup_of(name: str = "demo", *assignments: str, changes: dict[str, Any] | None = None) -> RunSetup:
    """Return the prepared run of a scenario with assignments of `--set` and with changes."""
    return prepare(*load_scenario(name, assignments, changes), parts=PARTS)


@contextmanager
def no_figure() -> Iterator[None]:
    """Leave out figures, also those of a comparison: most of the time of a short run, in tests of other files."""
    from train_ato.api.compare import Comparison
    from train_ato.api.run import Run
    from train_ato.report import print_figures

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Run, "finish", Run.folder)
        patch.setattr(print_figures, "write_run_figure", lambda *_: None)
        patch.setattr(Comparison, "drawable", False)
        yield


def record_run(setup: RunSetup, path: Path) -> Path:
    """Run a scenario to its end; return its folder with log, scenario and summary."""
    folder = RunFolder.make(path, setup.scenario.name)
    folder.begin(setup)
    with folder.sink(setup) as sink:
        outcome = run_engine(setup, sink=sink)
    assert outcome.failure is None
    folder.finish(setup, outcome)
    return folder.path


def compared(run: Path, other: Path) -> LogComparison:
    """Compare the log of a run folder with another log."""
    return compare_logs(run, other, Wire(read_run_folder(run)[0].layout))
