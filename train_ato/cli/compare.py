"""``train-ato compare``: one scenario, several laws: one table, one figure and one page of all of them side by side."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.cli.run import note_compilation
from train_ato.cli.scenario_options import add_scenario_options, prepare_from
from train_ato.cli.screen import console, print_json, progress_bar, table
from train_ato.control.registry import LAWS
from train_ato.engine import run_engine
from train_ato.failure import RunFailed
from train_ato.outcome import Outcome
from train_ato.run_folder import RunFolder
from train_ato.run_setup import RunSetup

if TYPE_CHECKING:
    from train_ato.report.digest import Digest

COLUMNS: tuple[tuple[str, str], ...] = (
    ("controller", "law"),
    ("speed_rmse_kmh", "rms km/h"),
    ("speed_error_max_kmh", "max"),
    ("stop_error_m", "stop m"),
    ("coupler_draft_max_kn", "draft kN"),
    ("coupler_buff_max_kn", "buff"),
    ("command_variation_kn_per_s", "kN/s"),
    ("saturated_s", "limit s"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``compare``."""
    add_scenario_options(parser)
    parser.add_argument("--controllers", metavar="A,B,...", help="laws to compare (default: all that fit the train)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder to make (default: runs/compare-NAME-N)")
    parser.add_argument(
        "--keep", action="store_true", help="keep every run in a folder of its own, DIR/LAW, with its log"
    )


def execute(options: argparse.Namespace) -> int:
    """Drive the scenario with every law, in the engine, and compare."""
    setups, left_out = _setups(options)
    first = next(iter(setups.values()))
    folder = RunFolder.make(options.out, f"compare-{first.scenario.name}")
    try:
        note_compilation()
        summaries, digests = _drive(setups, folder.path if options.keep else None)
    except (RunFailed, OSError, KeyboardInterrupt):
        folder.discard()
        raise
    (folder.path / "summary.json").write_text(json.dumps(summaries, indent=2) + "\n", encoding="utf-8")
    written = _draw(digests, folder.path, first.scenario.name)
    if options.json:
        print_json(summaries)
    else:
        table(
            (text for _, text in COLUMNS),
            ([summary.get(key) for key, _ in COLUMNS] for summary in summaries),
            f"{first.scenario.name}, observer {first.observer}, compensation {first.compensation}",
        )
        for name, reason in left_out.items():
            sys.stdout.write(f"left out: {name}: {reason}\n")
        sys.stdout.write(f"table, figure and report in {folder.path}\n" if written else f"table in {folder.path}\n")
    failures = [f"{summary['controller']}: {summary['failure']}" for summary in summaries if "failure" in summary]
    if failures:
        raise RunFailed("; ".join(failures))
    return 0


def _setups(options: argparse.Namespace) -> tuple[dict[str, RunSetup], dict[str, str]]:
    """Prepare one run for each law; laws that were not asked for by name are left out when they do not fit."""
    asked = None
    if options.controllers is not None:
        asked = [name.strip() for name in options.controllers.split(",") if name.strip()]
        if not asked:
            raise ValueError(f"--controllers {options.controllers}: names no law; leave it out to take all that fit")
    setups: dict[str, RunSetup] = {}
    left_out: dict[str, str] = {}
    base: RunSetup | None = None
    for name in asked or LAWS.loadable():
        try:
            if base is None:
                base = prepare_from(options, controller=name)
                setups[name] = base
            else:
                base.law(name)
                scenario = base.scenario.model_copy(update={"controller": name})
                setups[name] = dataclasses.replace(base, scenario=scenario)
        except ValueError as error:
            if asked is not None:
                raise
            left_out[name] = str(error).partition(f"controller '{name}'")[2].lstrip(":, ") or str(error)
    if not setups:
        raise ValueError(f"{options.scenario}: no law fits this train: {left_out}")
    return setups, left_out


def _drive(setups: dict[str, RunSetup], keep: Path | None) -> tuple[list[dict[str, Any]], list[Digest]]:
    """Drive every law; of each run only what the report needs stays in memory."""
    summaries: list[dict[str, Any]] = []
    digests: list[Digest] = []
    for name, setup in setups.items():
        with _folder(name, keep) as folder:
            folder.begin(setup)
            with progress_bar(name) as progress, folder.sink(setup) as sink:
                outcome = run_engine(setup, sink=sink, progress=progress)
            outcome = outcome.checked_against(sink.counts)
            outcome = dataclasses.replace(outcome, summary={**outcome.summary, "way": "engine"})
            if outcome.interrupted:
                raise RunFailed("interrupted")
            if keep is not None:
                folder.finish(setup, outcome)
            summaries.append(outcome.summary)
            digests.append(_digest(name, folder.path, outcome, len(setups), kept=keep is not None))
    return summaries, digests


@contextmanager
def _folder(name: str, keep: Path | None) -> Iterator[RunFolder]:
    """Make the folder of one law's run: beside the table, or for as long as it is read."""
    if keep is not None:
        yield RunFolder.make(keep / name, name)
        return
    with tempfile.TemporaryDirectory(prefix="train_ato_compare_") as scratch:
        yield RunFolder.make(Path(scratch) / name, name)


def _digest(name: str, run: Path, outcome: Outcome, runs: int, *, kept: bool) -> Digest:
    """Reduce a law's run to what the report needs; a folder that is not kept is not told."""
    from train_ato.report.digest import digest, empty_digest, share_of
    from train_ato.report.recording import read_recording

    with console().status(f"reading {name}"):
        try:
            recording = dataclasses.replace(read_recording(run), summary=outcome.summary)
        except ValueError as error:
            return empty_digest(name, outcome.summary, str(error))
        reduced = digest(recording, name, share_of(runs))
    if not kept:
        reduced.facts.pop("run", None)
    return reduced


def _draw(digests: list[Digest], folder: Path, title: str) -> bool:
    """Write figure and page; tell whether there was anything to draw."""
    if not any(digest.lines for digest in digests):
        return False
    from train_ato.report import plates, writing
    from train_ato.report.plate_parts import SCREEN_DPI
    from train_ato.report.words import COMPARISON

    with console().status("drawing the report"):
        plates.write_comparison(digests, folder / "figure.png", f"{title}: laws on the same train", SCREEN_DPI)
        writing.write_comparison(digests, folder / COMPARISON)
    return True
