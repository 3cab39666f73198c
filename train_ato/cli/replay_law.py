"""``train-ato replay --controller``: another law on the recorded inputs, both outputs as a table and a figure."""

from __future__ import annotations

import argparse
import os
import re
import sys
from pathlib import Path
from typing import Any

import yaml

from train_ato.cli.screen import print_json, progress_bar, table
from train_ato.measured.run import MEASURED, NOT_RECORDED
from train_ato.open_loop import replay_open_loop
from train_ato.record.reading import log_file
from train_ato.run_folder import open_run
from train_ato.run_setup import RunSetup, prepare
from train_ato.scenario import assign, check, overlay

FORMATS = (".png", ".svg", ".pdf")
OUTPUT_ROWS: tuple[tuple[str, str], ...] = (
    ("force_max_kn", "force demand, largest in kN"),
    ("force_min_kn", "force demand, smallest in kN"),
    ("force_rms_kn", "force demand, rms in kN"),
    ("variation_kn_per_s", "variation in kN/s"),
)
DIFFERENCE_ROWS: tuple[tuple[str, str], ...] = (
    ("ticks", "ticks compared"),
    ("equal_ticks", "ticks with the same output"),
    ("difference_rms_kn", "difference, rms in kN"),
    ("difference_max_kn", "difference, largest in kN"),
    ("difference_max_at_s", "largest at s"),
    ("difference_mean_kn", "difference, mean in kN"),
    ("brake_pipe_difference_max_kpa", "brake pipe, largest difference in kPa"),
)


def compare(options: argparse.Namespace) -> int:
    """Drive a law with the recorded inputs; the law of the run itself keeps the swaps that were planned in it."""
    recorded, told = open_run(options.run)
    changed = _with_law(recorded, options)
    figure = _figure_path(options)
    with progress_bar(f"{options.controller} on the inputs of {options.run.name}") as progress:
        result = replay_open_loop(changed, options.run, progress)
    summary = {
        "run": str(options.run),
        "recorded_controller": MEASURED if told.get("controller") == MEASURED else recorded.controller,
        "controller": options.controller,
        **result.summary(),
        "figure": str(figure),
    }
    from train_ato.open_loop_figure import draw_open_loop

    title = f"{recorded.scenario.name}: {options.controller} on the recorded inputs, the loop is open"
    names = (_recorded_name(recorded, told), f"{options.controller}, replayed")
    draw_open_loop(result, title, *names, figure)
    if options.json:
        print_json(summary)
    else:
        _print(summary, names)
    return 0


def _recorded_name(recorded: RunSetup, told: dict[str, Any]) -> str:
    """Return what the recorded output is called: the law that gave it, or what was measured."""
    if told.get("controller") != MEASURED:
        return f"{recorded.controller}, recorded"
    return "force at the wheel, measured" if told.get("measured_command") == NOT_RECORDED else "demand, measured"


def _with_law(recorded: RunSetup, options: argparse.Namespace) -> RunSetup:
    """Return the recorded run's setup with the law and the keys that are to be tried."""
    data: dict[str, Any] = yaml.safe_load(recorded.resolved_yaml())
    for text in options.set:
        assign(data, text)
    if options.controller != recorded.controller:
        data = overlay(data, {"controller": options.controller, "swaps": []})
    changed = prepare(check(data, options.run), options.run)
    if changed.shape != recorded.shape or changed.tick_ns != recorded.tick_ns:
        raise ValueError("--set: the train, its sensors and the tick are those of the recording; change something else")
    return changed


def _figure_path(options: argparse.Namespace) -> Path:
    """Return where the figure goes, and refuse what cannot be written before anything is computed."""
    wanted: Path | None = options.out
    if wanted is not None:
        if wanted.suffix not in FORMATS:
            raise ValueError(f"--out {wanted}: name a file that ends in {', '.join(FORMATS)}")
        if wanted.exists():
            raise ValueError(f"--out {wanted}: exists already; name a file that does not")
        if not wanted.parent.is_dir():
            raise ValueError(f"--out {wanted}: there is no folder {wanted.parent}; make it first")
    else:
        log = log_file(options.run)
        name = re.sub(r"[^A-Za-z0-9_.-]+", "-", options.controller)
        stem = "replay" if options.run.is_dir() else f"{log.stem}-replay"
        wanted = log.with_name(f"{stem}-{name}.png")
    if not os.access(wanted.parent, os.W_OK):
        raise ValueError(f"{wanted}: the folder cannot be written; name another place with --out")
    return wanted


def _print(summary: dict[str, Any], names: tuple[str, str]) -> None:
    table(
        ("output", *names),
        ((text, summary["recorded"][key], summary["replayed"][key]) for key, text in OUTPUT_ROWS),
        f"{summary['controller']} on the recorded inputs of {summary['run']}",
    )
    table(("figure", "value"), ((text, summary[key]) for key, text in DIFFERENCE_ROWS if key in summary))
    sys.stdout.write(
        f"The loop is open: the train in the log did not feel these commands.\nfigure in {summary['figure']}\n"
    )
