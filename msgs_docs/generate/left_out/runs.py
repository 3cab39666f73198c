"""Runs of the sensitivities: measured one after the other, kept in a file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from msgs_docs.generate.left_out.choice import CHOICES, ChoiceRun
from train_ato.apps.runs.progress import share_bar
from train_ato.loop.engine import run_engine

NAME = "left_out"
"""Name of the page for ``--measure``."""
MEASURED = Path("msgs_docs", "left_out_measured.json")
"""Metrics of the runs by key of the run."""
LOST = "lost"
"""Value of a run that failed."""

Metrics = dict[str, dict[str, float | str]]


def wanted() -> Iterator[tuple[ChoiceRun, str]]:
    """Yield every run with a metric of it; a run can occur with several metrics."""
    for table in CHOICES:
        for choice in table.choices:
            if choice.metric:
                yield from ((run, choice.metric) for run in (table.bases[choice.base], *choice.others))


def measure_choices(root: Path) -> None:
    """Drive all runs and write their metrics."""
    metrics: dict[str, set[str]] = {}
    runs: dict[str, ChoiceRun] = {}
    for run, metric in wanted():
        runs[run.key] = run
        metrics.setdefault(run.key, set()).add(metric)
    found: Metrics = {}
    with share_bar("sensitivities") as report:
        for number, (key, run) in enumerate(runs.items()):
            report(number / len(runs), run.scenario)
            found[key] = drive_choice(run, sorted(metrics[key]))
    text = json.dumps(found, indent=1, ensure_ascii=False)
    (root / MEASURED).write_text(text + "\n", encoding="utf-8")


def drive_choice(run: ChoiceRun, metrics: list[str]) -> dict[str, float | str]:
    """Drive a run in the engine and return metrics to three digits, or ``lost``."""
    result = run_engine(run.setup())
    return {name: LOST if result.failure else float(f"{result.summary[name]:.3g}") for name in metrics}


def read_metrics(root: Path) -> Metrics:
    """Return the measured metrics by key of the run."""
    path = root / MEASURED
    found: Metrics = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    return found


def unmeasured_choices(root: Path) -> list[str]:
    """Return one line per run without a measured metric, and per leftover."""
    found, remedy = read_metrics(root), f"run python -m msgs_docs.generate --measure {NAME}"
    missing = {run.key for run, metric in wanted() if metric not in found.get(run.key, {})}
    leftover = found.keys() - {run.key for run, _ in wanted()}
    return [f"choice {key}: not measured; {remedy}" for key in sorted(missing)] + [
        f"choice {key}: no such run; {remedy}" for key in sorted(leftover)
    ]
