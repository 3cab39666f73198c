"""``train-ato sweep``: run a scenario at many points, or one row of a sweep again.

Options::

    sweep SPEC           YAML file with scenario, design, over and set; or the folder of a sweep, to continue it
    --out DIR            folder; a sweep that is already there is continued (default: runs/sweep-N)
    --jobs N             local worker processes (default: one for each core)
    --scheduler ADDRESS  tcp://HOST:PORT of a Dask scheduler with workers (default: local)
    --dashboard          serve the Dask dashboard of the local workers, on this machine only
    --metric NAME        metric of the figures (default: %(default)s)
    --border             border of stability in the map: outcome of tracking, or verdict (default: tracking)
    --row N              run row N of the sweep in the folder SPEC, or of its results.parquet, alone and compare it
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.cli.screen import note_compilation, print_json, print_table
from train_ato.program.arguments import Options
from train_ato.program.errors import RunFailed
from train_ato.studies.sweep.groups import BORDERS, ERROR_METRIC

if TYPE_CHECKING:
    from train_ato.studies.sweep.result import SweepFolder, SweepResult

COLUMNS = ("runs", "done", "tracked", "passed", "median", "largest")

OPTIONS: Options = {
    "--metric": {"default": ERROR_METRIC},
    "--border": {"choices": tuple(BORDERS), "default": "tracking"},
}


def execute(options: argparse.Namespace) -> None:
    """Run the sweep, or one row of it again."""
    from train_ato.api.progress import activity
    from train_ato.studies.sweep.result import SweepFolder
    from train_ato.studies.sweep.spec import read_sweep
    from train_ato.studies.sweep.sweep import PreparedSweep

    if options.row is not None:
        _run_row(options)
        return
    folder = None
    if SweepFolder.holds(options.sweep):
        if options.out is not None:
            raise ValueError(f"--out {options.out}: {options.sweep} is the folder of the sweep already; remove --out")
        folder = SweepFolder(options.sweep)
    spec = read_sweep(options.sweep) if folder is None else folder.spec()
    note_compilation()
    prepared = PreparedSweep(
        spec, jobs=options.jobs, scheduler=options.scheduler, dashboard=options.dashboard, dash="--"
    )
    folder = folder or SweepFolder.opened(options.out)
    result = prepared.run(folder, announce=lambda text: print(f"train-ato: {text}", file=sys.stderr))
    with folder.full_disk_told(), activity("drawing the figures"):
        figures = result.figures(folder.path, options.metric, options.border)
    _print(result, folder, figures, options.metric, as_json=options.json)
    failed = result.table[result.table["status"] == "failed"]
    if len(failed):
        first = failed.iloc[0]
        raise RunFailed(f"{len(failed)} of {len(result.table)} runs failed; first: run {first['run']}: "
                        f"{first['reason']}")  # fmt: skip


def _print(result: SweepResult, folder: SweepFolder, figures: dict[str, Path], metric: str, *, as_json: bool) -> None:
    """Print one line for every law or value of another list, and the files."""
    from train_ato.studies.sweep.groups import grouped, inside, list_key, metric_words, shown_metrics

    words = metric_words(result.table, metric) if (result.table["status"] == "done").any() else metric
    key = list_key(result.spec)
    rows = []
    for label, runs in grouped(shown_metrics(result.table), key):
        kept = runs[inside(runs)]
        values = kept[metric].dropna() if metric in kept else kept["wall_s"].head(0)
        rows.append({
            key or "runs of": label,
            "runs": len(runs),
            "done": int((runs["status"] == "done").sum()),
            "tracked": len(kept),
            "passed": int((runs["verdict"] == "passed").sum()),
            "median": float(values.median()) if len(values) else None,
            "largest": float(values.abs().max()) if len(values) else None,
        })  # fmt: skip
    if as_json:
        print_json({
            "folder": str(folder.path), "results": str(folder.results), "counts": result.counts, "metric": metric,
            "groups": rows, "figures": {name: str(file) for name, file in figures.items()},
        })  # fmt: skip
        return
    title = f"{result.spec.title}, {result.spec.design}: {words} of the tracked runs"
    print_table((key or "", *COLUMNS), (tuple(row.values()) for row in rows), title)
    for _, row in result.table[result.table["status"] != "done"].head(5).iterrows():
        sys.stdout.write(f"{row['status']}: run {row['run']}: {row['point']}: {row['reason']}\n")
    counts = ", ".join(f"{count} {status}" for status, count in result.counts.items())
    drawn = f", figures {', '.join(file.name for file in figures.values())}" if figures else ""
    sys.stdout.write(f"{counts}: {folder.results}{drawn}\n")


def _run_row(options: argparse.Namespace) -> None:
    """Run one row again and compare it."""
    from train_ato.studies.sweep.rerun import run_row_again

    for name in ("jobs", "scheduler", "dashboard"):
        if getattr(options, name) not in (None, False):
            raise ValueError(f"--{name}: no effect with --row; remove it")
    if not options.sweep.exists():
        raise ValueError(f"{options.sweep}: does not exist; name the folder of a sweep or its results.parquet")
    note_compilation()
    found = run_row_again(options.sweep, options.row, options.out)
    if options.json:
        content: dict[str, Any] = {**dataclasses.asdict(found), "equal": not found.difference}
        print_json(content | {"folder": None if found.folder is None else str(found.folder)})
    elif not found.difference:
        place = f"; run in {found.folder}" if found.folder is not None else ""
        sys.stdout.write(f"row {found.run}: {found.values} values are equal, bit for bit{place}\n")
    if found.difference:
        raise RunFailed(f"row {found.run}: {found.difference}")
