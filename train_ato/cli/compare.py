"""``train-ato compare``: compare laws in one scenario: table, figure and page; in several: a leaderboard.

Options::

    scenario SCENARIO  a shipped name, NAME:variant, or a YAML file; several: the leaderboard of the laws
    --observer         and --compensation, --seed, --set: changes of the scenario
    --seeds N          leaderboard over N seeds from --seed on (default: 1)
    --laws A,B,...     laws: names or MODULE:CLASS (default: all that fit the train)
    --engine           as in run; a comparison always uses the engine
    --out DIR          folder to make (default: runs/compare-NAME-N)
    --strict           exit status 1 if a run is not tracked or fails a criterion of the scenario
    --keep             keep every run with its log in DIR/LAW
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.cli.scenario_options import KINDS, add_change_options, check_component_name, chosen_components, listed
from train_ato.cli.screen import note_compilation, print_json, print_table
from train_ato.program.arguments import Options
from train_ato.program.errors import RunFailed, RunInterrupted, missing_packages

if TYPE_CHECKING:
    from train_ato.api.compare import Comparison
    from train_ato.api.scenario_choice import ScenarioChoice

COLUMNS: tuple[tuple[str, str], ...] = (
    ("controller", "law"), ("speed_rmse_kmh", "rms km/h"), ("speed_error_max_kmh", "max"),
    ("overspeed_max_kmh", "overspeed"), ("stop_error_m", "last stop m"), ("coupler_draft_max_kn", "draft kN"),
    ("coupler_buff_max_kn", "buff"), ("command_variation_kn_per_s", "kN/s"), ("saturated_s", "limit s"),
    ("tracking", "tracking"), ("verdict", "verdict"), ("gains", "gains"), ("status", "status"),
)  # fmt: skip
COMPARED = COLUMNS[:9]
"""Law and the metrics with a best value."""

OPTIONS: Options = {"scenario": {"nargs": "+"}, "--observer": add_change_options, "--seeds": {"default": 1}}


def execute(options: argparse.Namespace) -> None:
    """Run the scenario with every law in the engine, and compare."""
    from train_ato.api.compare import compare
    from train_ato.api.scenario_choice import choose_scenario
    from train_ato.log.run_folder import RunFolder

    laws = listed(options.laws, "--laws", "law") or None
    chosen_components(options, KINDS[1:])
    for name in laws or ():
        check_component_name("--laws", "law", name)
    if options.seeds < 1:
        raise ValueError(f"--seeds {options.seeds}: give a number from 1 on")
    choices = [
        choose_scenario(name).assigned(options.assignments).changed(None, options.seed) for name in options.scenario
    ]
    note_compilation()
    if len(choices) > 1 or options.seeds > 1:
        _leaderboard(options, choices, laws)
        return
    (choice,) = choices
    folder = RunFolder.make(options.out, f"compare-{choice.name}")
    with folder.kept_if_recorded():
        components = {"observer": options.observer, "compensation": options.compensation}
        result = compare(choice, laws, **components, out=folder.path if options.keep else None)
    try:
        write_comparison_folder(result, folder.path)
    except OSError:  # a full disk costs files, not the table of the runs
        print_comparison(result, None, as_json=options.json)
        raise
    print_comparison(result, folder.path, as_json=options.json)
    _tell_failures([(law.label, row) for law, row in zip(result.laws, result.rows, strict=True)], options, laws)


def _tell_failures(runs: list[tuple[str, dict[str, Any]]], options: argparse.Namespace, laws: list[str] | None) -> None:
    """Raise RunFailed for failed runs, for refused laws that were named and, with ``--strict``, for unmet criteria."""
    from train_ato.judge.verdict import unmet_requirements

    ends = ("failed",) if laws is None else ("failed", "refused")
    texts = [f"{run}: {row.get('reason', '')}" for run, row in runs if row["status"] in ends]
    if options.strict:
        texts += [f"{run}: {unmet}" for run, row in runs if (unmet := unmet_requirements(row))]
    if texts:
        raise RunFailed("; ".join(texts))


STANDINGS: tuple[tuple[str, str], ...] = (
    ("law", "law"), ("passed", "passed"), ("tracked", "tracked"), ("runs", "runs"), ("refused", "refused"),
    ("first", "first"), ("rank", "mean rank"), ("speed_rmse_kmh", "median rms km/h"),
    ("stop_error_m", "last stop m, largest"),
)  # fmt: skip
"""Keys of :func:`train_ato.judge.ranking.standings` with their headings."""


def _leaderboard(options: argparse.Namespace, choices: list[ScenarioChoice], laws: list[str] | None) -> None:
    """Compare the laws in every scenario with every seed; print and write their standings."""
    from train_ato.api.compare import compare
    from train_ato.log.run_folder import RunFolder

    if options.keep:
        raise ValueError("--keep: keeps the runs of one scenario and seed; remove it, or name one scenario")
    comparisons = len(choices) * options.seeds
    title = f"{', '.join(choice.name for choice in choices)}; seeds of each: {options.seeds}"
    folder = RunFolder.make(options.out, "leaderboard")
    found: list[list[dict[str, Any]]] = []
    try:
        for choice in choices:
            for seed in range(choice.checked.seed, choice.checked.seed + options.seeds):
                result = compare(
                    choice.changed(None, seed), laws, observer=options.observer, compensation=options.compensation
                )
                found.append([{**row, "scenario": choice.name, "seed": seed} for row in result.rows])
    except BaseException as error:
        if not found:
            folder.discard()
            raise
        _write_standings(folder.path, found, f"{title}; ended after {len(found)} of {comparisons} comparisons")
        if not isinstance(error, KeyboardInterrupt):
            raise
        raise RunInterrupted(f"interrupted after {len(found)} of {comparisons} comparisons, in {folder.path}") from None
    rows, lines = _write_standings(folder.path, found, title)
    if options.json:
        print_json(rows)
    else:
        print_table(lines[0], lines[2:], title, [key for key, _ in STANDINGS])
        sys.stdout.write(f"leaderboard and all metrics in {folder.path}\n")
    every = [row for part in found for row in part]
    runs = [(f"{row['scenario']}, seed {row['seed']}: {row['controller']}", row) for row in every]
    _tell_failures(runs, options, laws)


def _write_standings(
    folder: Path, found: list[list[dict[str, Any]]], title: str
) -> tuple[list[dict[str, Any]], list[list[str]]]:
    """Write leaderboard and metrics of the finished comparisons; return the standings and the rows of their table."""
    from train_ato.judge.metric_names import format_value
    from train_ato.judge.ranking import standings
    from train_ato.log.whole_file import write_whole

    rows = standings(found)
    lines = [[heading for _, heading in STANDINGS], ["---"] * len(STANDINGS)]
    lines += [[format_value(row[key]) for key, _ in STANDINGS] for row in rows]
    table = "".join(f"| {' | '.join(cells)} |\n" for cells in lines)
    write_whole(folder / "summary.json", json.dumps({"laws": rows, "runs": found}, indent=2) + "\n")
    write_whole(folder / "leaderboard.md", f"# Leaderboard\n\n{title}\n\n{table}")
    return rows, lines


def write_comparison_folder(result: Comparison, folder: Path) -> None:
    """Write summary, figure and page into the folder."""
    from train_ato.api.progress import activity
    from train_ato.log.whole_file import write_whole

    text = json.dumps(result.rows, indent=2) + "\n"
    write_whole(folder / "summary.json", text)
    if result.drawable:
        from train_ato.report.words import COMPARISON

        with activity("drawing the report"):
            result.plot(folder / "figure.png")
            if missing := missing_packages("bokeh", "jinja2"):
                sys.stderr.write(f"train-ato: without {COMPARISON}: {missing}\n")
            else:
                result.report(folder / COMPARISON)


def print_comparison(result: Comparison, folder: Path | None, *, as_json: bool) -> None:
    """Print the table, and its folder; a run with brake interventions, or a disengaged ATO, has a line on stderr."""
    from train_ato.judge.protection_record import summary_events
    from train_ato.judge.verdict import is_tracked, tracking_text

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
        [key for key, _ in COLUMNS],
    )
    driven = [row for row in rows if row["status"] != "refused"]
    if len(driven) > 1:
        print_table(
            (text for _, text in COMPARED),
            ([_difference(key, row, driven) for key, _ in COMPARED] for row in driven),
            "difference from the best value (*)",
            [key for key, _ in COMPARED],
        )
    for law in result.laws:
        if law.reason:
            sys.stdout.write(f"{law.status}: {law.label}: {law.reason}\n")
        if not is_tracked(law.metrics):
            sys.stdout.write(f"not tracked: {law.label}: {tracking_text(law.metrics)}\n")
    what = "table, figure and report" if result.drawable else "table"
    if folder is not None:
        sys.stdout.write(f"{what} in {folder}\n")


def _value(key: str, row: dict[str, Any], rows: list[dict[str, Any]]) -> str:
    """Return a value as text, with ``*`` if it is the best of its column, with ``!`` if the run is not tracked."""
    from train_ato.judge.metric_names import format_value
    from train_ato.judge.ranking import difference_from_best
    from train_ato.judge.verdict import is_tracked

    if key == "tracking" and not is_tracked(row):
        return f"{row[key]}!"
    best = difference_from_best(key, row, rows) == 0.0
    return f"{format_value(row.get(key))}{'*' if best else ''}"


def _difference(key: str, row: dict[str, Any], rows: list[dict[str, Any]]) -> str:
    """Return the difference of a value from the best of its column as text."""
    from train_ato.judge.metric_names import format_value
    from train_ato.judge.ranking import difference_from_best

    if key == COLUMNS[0][0]:
        return str(row[key])
    difference = difference_from_best(key, row, rows)
    return "" if difference is None else "0" if difference == 0.0 else f"+{format_value(difference)}"
