"""``train-ato compare``: one scenario, several laws, one table and one figure."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

from train_ato.cli.main import RunFailed
from train_ato.cli.run import note_compilation
from train_ato.cli.scenario_options import add_scenario_options, prepare_from
from train_ato.cli.screen import print_json, progress_bar, table
from train_ato.control.registry import LAWS
from train_ato.engine import run_engine
from train_ato.figure import draw_comparison
from train_ato.history import History
from train_ato.run_folder import RunFolder
from train_ato.run_setup import RunSetup

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


def execute(options: argparse.Namespace) -> int:
    """Drive the scenario with every law, in the engine, and compare."""
    setups, left_out = _setups(options)
    first = next(iter(setups.values()))
    folder = RunFolder.make(options.out, f"compare-{first.scenario.name}")
    note_compilation()
    try:
        summaries, histories = _drive(setups)
    except RunFailed:
        folder.discard()
        raise
    (folder.path / "summary.json").write_text(json.dumps(summaries, indent=2) + "\n", encoding="utf-8")
    if histories:
        draw_comparison(first, histories, folder.path / "figure.png")
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
        sys.stdout.write(f"table and figure in {folder.path}\n")
    failures = [f"{summary['controller']}: {summary['failure']}" for summary in summaries if "failure" in summary]
    if failures:
        raise RunFailed("; ".join(failures))
    return 0


def _setups(options: argparse.Namespace) -> tuple[dict[str, RunSetup], dict[str, str]]:
    """Prepare one run for each law; laws that were not asked for by name are left out when they do not fit."""
    asked = [name.strip() for name in options.controllers.split(",") if name.strip()] if options.controllers else None
    setups: dict[str, RunSetup] = {}
    left_out: dict[str, str] = {}
    base: RunSetup | None = None
    for name in asked or LAWS.loadable():
        try:
            if base is None:
                base = prepare_from(options, controller=name)
                setups[name] = base
            else:
                LAWS.make(name, base.controller_parameters.get(name, {}), base.model, base.control_period)
                scenario = base.scenario.model_copy(update={"controller": name})
                setups[name] = dataclasses.replace(base, scenario=scenario)
        except ValueError as error:
            if asked is not None:
                raise
            left_out[name] = str(error).rsplit(": ", 1)[-1]
    if not setups:
        raise ValueError(f"{options.scenario}: no law fits this train: {left_out}")
    return setups, left_out


def _drive(setups: dict[str, RunSetup]) -> tuple[list[dict[str, Any]], dict[str, History]]:
    summaries: list[dict[str, Any]] = []
    histories: dict[str, History] = {}
    for name, setup in setups.items():
        with progress_bar(name) as progress:
            outcome = run_engine(setup, progress=progress)
        summaries.append(outcome.summary)
        if outcome.history is not None:
            histories[name] = outcome.history
        if outcome.interrupted:
            raise RunFailed("interrupted")
    return summaries, histories
