"""Runs of the grid in child processes, their hashes, and the first difference from the reference cell."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from train_ato.apps.grid.cell import Axes, Batch, Cell, batches, environment
from train_ato.apps.grid.interpreters import ROOT
from train_ato.log.difference import Difference, compare_logs
from train_ato.log.run_hash import run_hash
from train_ato.loop.setup import RunSetup, prepare
from train_ato.messages.codec.codec import Wire
from train_ato.scenario.scenario import load_scenario

Report = Callable[[float, str], None]
"""Receiver of the finished fraction, 0 to 1, and a text."""
END_S = 5.0
"""Wall time for the end of a child process after SIGTERM [s]."""


@dataclass(frozen=True)
class GridScenario:
    """Scenario of the grid: name or file, and changes as for ``--set``."""

    name: str
    changes: tuple[str, ...] = ()

    def __str__(self) -> str:
        return " ".join((self.name, *(f"--set {change}" for change in self.changes)))

    def prepare(self) -> RunSetup:
        """Return the checked setup.

        Raises
        ------
        ValueError
            Bad input, in one line.
        """
        return prepare(*load_scenario(self.name, self.changes))


DEFAULT = (
    GridScenario("demo", ("duration=30", "law_changes=[{at: 15, law: rbf_smc}]")),
    GridScenario("crh380a_funnel:short", ("duration=20",)),
    GridScenario("crh380a_gpc:short", ("duration=20",)),
)
"""106 vehicles with an air brake, with ``pid``, then the RBF law; ``funnel``; ``gpc``."""


@dataclass
class CellResult:
    """Runs of one cell.

    Attributes
    ----------
    cell : Cell
        The cell.
    hashes : list of str
        SHA-256 of the run of each scenario, in their order.
    failure : str
        Reason of a failed run, otherwise empty.
    first : tuple of (str, Difference) or None
        First scenario with other messages than in the reference cell, and its first difference.
    """

    cell: Cell
    hashes: list[str] = field(default_factory=list)
    failure: str = ""
    first: tuple[str, Difference] | None = None

    @property
    def hash(self) -> str:
        """SHA-256 of all scenarios: that of the run for one scenario, otherwise of the line with their hashes."""
        if self.failure:
            return ""
        return self.hashes[0] if len(self.hashes) == 1 else hashlib.sha256(" ".join(self.hashes).encode()).hexdigest()


class Grid:
    """Runs of some scenarios in every cell.

    Parameters
    ----------
    scenarios
        Scenarios of every cell.

    Attributes
    ----------
    results : list of CellResult
        Finished cells, the reference cell first; also after an interruption.

    Raises
    ------
    ValueError
        For a bad scenario, in one line.
    """

    def __init__(self, scenarios: Sequence[GridScenario]) -> None:
        self.scenarios = tuple(scenarios)
        self.results: list[CellResult] = []
        self._wires = [Wire(scenario.prepare().layout) for scenario in self.scenarios]

    @property
    def one_hash(self) -> str | None:
        """SHA-256 of all cells, None if one differs or failed."""
        reference = self.results[0]
        equal = all(not entry.failure and entry.hashes == reference.hashes for entry in self.results)
        return reference.hash if equal else None

    def run(self, axes: Axes, scratch: Path, report: Report) -> None:
        """Run all cells of the axes; the logs and the compiled kernels are in ``scratch``."""
        planned = list(batches(axes))
        total, done = len(self.scenarios) * sum(len(batch.modes) for batch in planned), 0
        for number, batch in enumerate(planned):
            folder = scratch / f"batch{number}"
            folder.mkdir()
            cells = [CellResult(cell) for cell in batch.cells]
            self.results += cells
            report(done / total, str(batch.cells[0]))
            jobs = [(case.name, list(case.changes), mode) for mode in batch.modes for case in self.scenarios]
            reason = "interrupted"
            try:
                with _child(batch, jobs, folder, scratch) as answers:
                    for answer in answers:
                        mode, scenario = divmod(answer["number"], len(self.scenarios))
                        self._take(cells[mode], scenario, answer["failure"], folder / str(answer["number"]))
                        done += 1
                        report(done / total, str(cells[mode].cell))
                reason = _last_line(folder / "stderr") or "its process ended without a result"
            finally:
                for cell in cells:
                    if len(cell.hashes) < len(self.scenarios) and not cell.failure:
                        cell.failure = reason
            if self.results[0].failure:
                return
            if number:
                shutil.rmtree(folder)

    def _take(self, result: CellResult, scenario: int, failure: str, run: Path) -> None:
        """Hash a finished run; compare it with the reference cell if the hash differs."""
        if failure:
            result.failure = f"{self.scenarios[scenario]}: {failure}"
            return
        wire, reference = self._wires[scenario], self.results[0]
        result.hashes.append(run_hash(run, wire))
        if result is reference:
            return
        if result.first is None and result.hashes[scenario] != reference.hashes[scenario]:
            other = run.parent.parent / "batch0" / str(scenario)
            found = compare_logs(other, run, wire).first
            result.first = (str(self.scenarios[scenario]), found or Difference("log", 0, "bytes", "", ""))
        shutil.rmtree(run)


@contextmanager
def _child(batch: Batch, jobs: list[Any], folder: Path, scratch: Path) -> Iterator[Iterator[dict[str, Any]]]:
    """Start the child process of a batch; yield its answers; end it on exit."""
    command = [batch.interpreter.path, "-m", "train_ato.apps.grid.cell_runs", str(folder), json.dumps(jobs)]
    variables = environment(batch, dict(os.environ), str(ROOT), str(scratch))
    with (folder / "stderr").open("w") as errors:
        child = subprocess.Popen(command, env=variables, stdout=subprocess.PIPE, stderr=errors, text=True)
        try:
            assert child.stdout is not None
            yield _answers(child.stdout)
            child.wait()
        finally:
            if child.poll() is None:
                child.terminate()
                try:
                    child.wait(END_S)
                except subprocess.TimeoutExpired:
                    child.kill()
                    child.wait()


def _answers(lines: IO[str]) -> Iterator[dict[str, Any]]:
    for line in lines:
        if line.startswith("{"):
            yield json.loads(line)


def _last_line(path: Path) -> str:
    lines = path.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    return lines[-1] if lines else ""


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Yield a folder for logs and compiled kernels; it is removed on exit."""
    with tempfile.TemporaryDirectory(prefix="train_ato_grid_", ignore_cleanup_errors=True) as name:
        yield Path(name)
