"""``train-ato replay --law``: evaluate a law on the recorded inputs; table and figure of both outputs."""

from __future__ import annotations

import argparse
import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.cli.screen import print_json, print_table

if TYPE_CHECKING:
    from train_ato.loop.setup import RunSetup

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


def compare_laws(options: argparse.Namespace) -> int:
    """Evaluate a law on the recorded inputs; the law of the run itself keeps its planned changes."""
    from train_ato.apps.replay.open_loop import replay_open_loop
    from train_ato.apps.runs.progress import progress_bar
    from train_ato.log.run_folder import read_run_folder

    recorded, recorded_summary = read_run_folder(options.run)
    changed = _with_law(recorded, options)
    figure = _figure_path(options)
    with progress_bar(f"{options.law} on the inputs of {options.run.name}") as progress:
        result = replay_open_loop(changed, options.run, progress)
    summary = {
        "run": str(options.run),
        "recorded_controller": recorded_summary.get("controller", recorded.controller),
        "controller": options.law,
        **result.summary(),
        "figure": str(figure),
    }
    from train_ato.apps.replay.open_loop_figure import draw_open_loop

    title = f"{recorded.scenario.name}: {options.law} on the recorded inputs, open loop"
    names = (_recorded_name(recorded, recorded_summary), f"{options.law}, replayed")
    draw_open_loop(result, title, *names, figure)
    if options.json:
        print_json(summary)
    else:
        _print(summary, names)
    return 0


def _recorded_name(recorded: RunSetup, summary: dict[str, Any]) -> str:
    """Return the label of the recorded output: its law, or the measured quantity."""
    from train_ato.apps.import_csv.run import MEASURED, NOT_RECORDED

    if summary.get("controller") != MEASURED:
        return f"{summary.get('controller', recorded.controller)}, recorded"
    return "force at the wheel, measured" if summary.get("measured_command") == NOT_RECORDED else "demand, measured"


def _with_law(recorded: RunSetup, options: argparse.Namespace) -> RunSetup:
    """Return the setup of the recorded run with the law and the keys of the options."""
    import yaml

    from train_ato.loop.setup import prepare
    from train_ato.scenario.overlays import assign, overlay
    from train_ato.scenario.scenario import check_scenario

    data: dict[str, Any] = yaml.safe_load(recorded.resolved_yaml())
    for text in options.set:
        assign(data, text)
    if options.law != recorded.controller:
        data = overlay(data, {"law": options.law, "law_changes": []})
    changed = prepare(check_scenario(data, options.run), options.run)
    if changed.layout != recorded.layout or changed.tick_ns != recorded.tick_ns:
        raise ValueError("--set: train, sensors and tick of a recording are fixed; change other keys")
    return changed


def _figure_path(options: argparse.Namespace) -> Path:
    """Return the path of the figure; check it before the computation."""
    from train_ato.log.reading import log_file

    wanted: Path | None = options.out
    if wanted is not None:
        if wanted.suffix not in FORMATS:
            raise ValueError(f"--out {wanted}: unknown ending; use {', '.join(FORMATS)}")
        if wanted.exists():
            raise ValueError(f"--out {wanted}: exists already; give another name")
        if not wanted.parent.is_dir():
            raise ValueError(f"--out {wanted}: no folder {wanted.parent}; create it")
    else:
        log = log_file(options.run)
        name = re.sub(r"[^A-Za-z0-9_.-]+", "-", options.law)
        stem = "replay" if options.run.is_dir() else f"{log.stem}-replay"
        wanted = log.with_name(f"{stem}-{name}.png")
    if not os.access(wanted.parent, os.W_OK):
        raise ValueError(f"{wanted}: the folder is not writable; give another place with --out")
    return wanted


def _print(summary: dict[str, Any], names: tuple[str, str]) -> None:
    print_table(
        ("output", *names),
        ((text, summary["recorded"][key], summary["replayed"][key]) for key, text in OUTPUT_ROWS),
        f"{summary['controller']} on the recorded inputs of {summary['run']}",
    )
    print_table(("quantity", "value"), ((text, summary[key]) for key, text in DIFFERENCE_ROWS if key in summary))
    sys.stdout.write(f"Open loop: these commands did not act on the recorded train.\nfigure in {summary['figure']}\n")
