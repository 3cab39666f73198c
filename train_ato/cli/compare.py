"""``train-ato compare``: compare laws in one scenario: table, figure and page."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.cli.scenario_options import KINDS, add_scenario_options, check_component_name
from train_ato.cli.screen import note_compilation, print_json, print_table
from train_ato.errors import RunFailed

if TYPE_CHECKING:
    from train_ato.apps.runs.comparison import Comparison

COLUMNS: tuple[tuple[str, str], ...] = (
    ("controller", "law"),
    ("speed_rmse_kmh", "rms km/h"),
    ("speed_error_max_kmh", "max"),
    ("stop_error_m", "stop error m"),
    ("coupler_draft_max_kn", "draft kN"),
    ("coupler_buff_max_kn", "buff"),
    ("command_variation_kn_per_s", "kN/s"),
    ("saturated_s", "limit s"),
    ("tracking", "tracking"),
    ("verdict", "verdict"),
    ("gains", "gains"),
    ("status", "status"),
)
COMPARED = COLUMNS[:8]
"""Law and the metrics with a best value."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``compare``."""
    add_scenario_options(parser)
    parser.add_argument(
        "--laws", metavar="A,B,...", help="laws: names or MODULE:CLASS (default: all that fit the train)"
    )
    parser.add_argument("--engine", action="store_true", help="as in run; a comparison always uses the engine")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder to make (default: runs/compare-NAME-N)")
    parser.add_argument(
        "--strict",
        action="store_true",
        help="exit status 1 if a run is not tracked or fails a criterion of the scenario",
    )
    parser.add_argument("--keep", action="store_true", help="keep every run with its log in DIR/LAW")


def execute(options: argparse.Namespace) -> int:
    """Run the scenario with every law in the engine, and compare."""
    from train_ato.apps.runs.compare import compare
    from train_ato.apps.runs.scenario_choice import choose_scenario
    from train_ato.log.run_folder import RunFolder
    from train_ato.loop.verdict import unmet_requirements

    laws = None
    if options.laws is not None:
        laws = [name.strip() for name in options.laws.split(",") if name.strip()]
        if not laws:
            raise ValueError(f"--laws {options.laws}: no law; add one or remove the option")
    for kind in KINDS[1:]:
        if (name := getattr(options, kind)) is not None:
            check_component_name(f"--{kind}", kind, name)
    for name in laws or ():
        check_component_name("--laws", "law", name)
    choice = choose_scenario(options.scenario).assigned(options.assignments)
    choice = choice.changed(None, options.seed)
    note_compilation()
    folder = RunFolder.make(options.out, f"compare-{choice.name}")
    try:
        result = compare(
            choice,
            laws,
            observer=options.observer,
            compensation=options.compensation,
            keep=folder.path if options.keep else None,
        )
        write_comparison_folder(result, folder.path)
    except BaseException:
        folder.discard()
        raise
    print_comparison(result, folder.path, options.json)
    ends = ("failed",) if laws is None else ("failed", "refused")
    failures = [f"{law.label}: {law.reason}" for law in result.laws if law.status in ends]
    if options.strict:
        failures += [f"{law.label}: {unmet}" for law in result.laws if (unmet := unmet_requirements(law.metrics))]
    if failures:
        raise RunFailed("; ".join(failures))
    return 0


def write_comparison_folder(result: Comparison, folder: Path) -> None:
    """Write summary, figure and page into the folder."""
    from train_ato.apps.runs.progress import activity
    from train_ato.log.whole_file import write_whole

    text = json.dumps(result.rows, indent=2) + "\n"
    write_whole(folder / "summary.json", text)
    if result.drawable:
        from train_ato.apps.report.words import COMPARISON

        with activity("drawing the report"):
            result.plot(folder / "figure.png")
            result.report(folder / COMPARISON)


def print_comparison(result: Comparison, folder: Path, as_json: bool) -> None:
    """Print the table; a run with brake interventions, or a disengaged ATO, has a line on stderr."""
    from train_ato.apps.runs.protection_note import summary_events
    from train_ato.loop.verdict import is_tracked, tracking_text

    for law in result.laws:
        if advice := law.metrics.get("advice"):
            sys.stderr.write(f"train-ato: {advice}\n")
        if events := summary_events(law.metrics):
            sys.stderr.write(f"train-ato: {law.label}: {events}\n")
    if as_json:
        print_json(result.rows)
        return
    rows = result.rows
    first = next(iter(result.metrics.values()))
    print_table(
        (text for _, text in COLUMNS),
        ([_value(key, row, rows) for key, _ in COLUMNS] for row in rows),
        f"{result.scenario}, observer {first.get('observer')}, compensation {first.get('compensation')}",
    )
    driven = [row for row in rows if row["status"] != "refused"]
    if len(driven) > 1:
        print_table(
            (text for _, text in COMPARED),
            ([_difference(key, row, driven) for key, _ in COMPARED] for row in driven),
            "difference from the best value (*)",
        )
    for law in result.laws:
        if law.reason:
            sys.stdout.write(f"{law.status}: {law.label}: {law.reason}\n")
        if not is_tracked(law.metrics):
            sys.stdout.write(f"not tracked: {law.label}: {tracking_text(law.metrics)}\n")
    what = "table, figure and report" if result.drawable else "table"
    sys.stdout.write(f"{what} in {folder}\n")


def _value(key: str, row: dict[str, Any], rows: list[dict[str, Any]]) -> str:
    """Return a value as text, with ``*`` if it is the best of its column, with ``!`` if the run is not tracked."""
    from train_ato.apps.runs.ranking import difference_from_best
    from train_ato.apps.runs.summary_table import format_value
    from train_ato.loop.verdict import is_tracked

    if key == "tracking" and not is_tracked(row):
        return f"{row[key]}!"
    best = difference_from_best(key, row, rows) == 0.0
    return f"{format_value(row.get(key))}{'*' if best else ''}"


def _difference(key: str, row: dict[str, Any], rows: list[dict[str, Any]]) -> str:
    """Return the difference of a value from the best of its column as text."""
    from train_ato.apps.runs.ranking import difference_from_best
    from train_ato.apps.runs.summary_table import format_value

    if key == COLUMNS[0][0]:
        return str(row[key])
    difference = difference_from_best(key, row, rows)
    return "" if difference is None else "0" if difference == 0.0 else f"+{format_value(difference)}"
