"""``train-ato info``: print topics, rates, gaps, changes and versions of a run or a log.

Options::

    run RUN                run folder, single log, or run.mcap.partial
    --requirement FORMULA  also evaluate a requirement on the log, such as 'G (speed <= limit + 1 km/h)'; may be
                           repeated
    --fatigue OTHER        also count the force cycles of the couplers (rainflow) and print their fatigue damage. One
                           cycle of 1 MN counts 1, with the slope 5. With the run or log OTHER the ratio is printed too
"""

from __future__ import annotations

import argparse
import dataclasses
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plant_sim.units import number_text
from train_ato.cli.screen import kilometre_cell, print_json, print_table
from train_ato.program.arguments import Options

if TYPE_CHECKING:
    from train_ato.log.overview import Overview, TopicOverview

TABLES = ("criteria", "requirements", "stops", "couplers", "tracking_findings")
"""Keys of the summary with a table each."""
ALONE = Path()
"""Value of ``--fatigue`` without another run."""

ORIGINS = {None: "", True: "planned", False: "from outside"}
"""Origin of a change; not known for a log without its scenario."""
OPTIONS: Options = {"--requirement": {"action": "append"}, "--fatigue": {"nargs": "?", "const": ALONE}}


def execute(options: argparse.Namespace) -> None:
    """Print summary, topics with counts, rates and gaps, changes and versions."""
    from train_ato.api.progress import share_bar
    from train_ato.log.bag_layout import LOG
    from train_ato.log.foreign_bag import bag_files
    from train_ato.log.overview import log_overview
    from train_ato.log.reading import log_file, partial_of, state_of

    run: Path = options.run
    _check_formulas(options.requirement)
    partial = partial_of(run)
    if partial is not None:
        log, note = partial, f"{partial}: {state_of(partial)}"
    else:
        log, note = log_file(run), ""
    with share_bar(f"reading {run}") as progress:
        found = log_overview(log, broken=partial is not None, progress=lambda share: progress(share, ""))
    note = note or found.note
    files = [log] if partial is not None or (run / LOG).is_file() else bag_files(run)
    size = sum(file.stat().st_size for file in files)
    found = dataclasses.replace(found, path=files[0] if len(files) == 1 else run, size=size)
    summary = _summary(run)
    rows = requirement_rows_of(run, options.requirement)
    if rows:
        summary["requirements"] = rows
    fatigue = fatigue_of(run, options.fatigue)
    changes = summary.pop("changes", None) or found.changes.rows()
    if options.json:
        of_log = {
            "log": str(found.path),
            "log_bytes": found.size,
            "duration_s": found.duration_s,
            "messages": {topic.name: topic.messages for topic in found.topics},
            "topics": [dataclasses.asdict(topic) for topic in found.topics],
            "versions": found.versions,
            "wall_time": None if found.wall_time is None else found.wall_time.listed(),
        }
        print_json({**summary, **of_log, "changes": changes, "note": note, **fatigue})
        return
    if summary:
        print_summary(summary, str(run))
    if fatigue:
        print_table(("quantity", "value"), fatigue["fatigue"].items(), "fatigue of the couplers")
    _print_overview(found, changes)
    if note:
        sys.stdout.write(f"{note}\n")


def _summary(run: Path) -> dict[str, Any]:
    """Return the summary beside the log, empty for a single log."""
    from train_ato.log.reading import partial_of
    from train_ato.log.versions import SCENARIO

    if not (run / SCENARIO).is_file():
        return {}
    from train_ato.log.run_folder import read_summary

    return read_summary(run) if partial_of(run) is None else {}


def print_summary(summary: dict[str, Any], title: str) -> None:
    """Print verdict, criteria, stops and metrics of a run."""
    from train_ato.judge.verdict import verdict_line

    if line := verdict_line(summary):
        sys.stdout.write(f"{line}\n")
    ends = {True: "passed", False: "failed", None: "not evaluated"}
    for key, title_ in (("criteria", "criteria of the scenario"), ("requirements", "requirements of this command")):
        if rows := summary.get(key):
            cells = [(_criterion(row), row["value"], row["limit"], *_place(row), ends[row["passed"]]) for row in rows]
            print_table(("criterion", "value", "limit", "at s", "km", ""), cells, title_)
    if findings := summary.get("tracking_findings"):
        keys = ("outcome", "value", "limit", "unit", "text")
        print_table(keys, ([row[key] for key in keys] for row in findings), "deviations from the reference")
    for key in ("stops", "couplers"):
        if rows := summary.get(key):
            print_table(rows[0], ([row[name] for name in rows[0]] for row in rows), key)
    print_table(("quantity", "value"), ((key, value) for key, value in summary.items() if key not in TABLES), title)


def _check_formulas(formulas: Sequence[str]) -> None:
    """Check the formulas of the command line before the log is read."""
    from train_ato.scenario.formula import parse_formula

    for text in formulas:
        try:
            parse_formula(text)
        except ValueError as error:
            raise ValueError(f"--requirement '{text}': {error}") from None


def requirement_rows_of(run: Path, formulas: Sequence[str]) -> list[dict[str, Any]]:
    """Return the rows of formulas over the log of a run, as in ``criteria`` of a summary."""
    if not formulas:
        return []
    from train_ato.judge.requirements import recorded_rows
    from train_ato.log.recorded import open_recording

    return recorded_rows(open_recording(run, vehicles=False), formulas, f"{run}: --requirement")


def fatigue_of(run: Path, other: Path | None) -> dict[str, Any]:
    """Return the fatigue of the couplers of a run as ``fatigue``, with another run also the ratio to it.

    Parameters
    ----------
    run
        Run folder or log.
    other
        None: no evaluation; :data:`ALONE`: without another run.
    """
    from train_ato.api.progress import activity
    from train_ato.log.reading import partial_of

    if other is None:
        return {}
    from train_ato.judge.metrics import coupler_fatigue, relative_fatigue
    from train_ato.log.recorded import open_recording

    found = []
    for path in (run,) if other == ALONE else (run, other):
        if partial_of(path) is not None:
            command = f"train-ato recover {shlex.quote(str(path))}"
            raise ValueError(f"--fatigue: {path}: a run without its end; recover it first: {command}")
        with activity(f"reading {path}"):
            fatigue = coupler_fatigue(open_recording(path))
        if fatigue is None:
            raise ValueError(f"--fatigue: {path}: no coupler forces in the log; name the run of a train with couplers")
        found.append(fatigue)
    return {"fatigue": {**found[0].summary(), **(relative_fatigue(*found) if len(found) > 1 else {})}}


def _criterion(row: dict[str, Any]) -> str:
    """Return the metric of a criterion, or name, formula and unit of a requirement."""
    if "formula" not in row:
        return str(row["metric"])
    name = "" if row["criterion"] == row["formula"] else f"{row['criterion']}: "
    return f"{name}{row['formula']}{' in ' if row['unit'] else ''}{row['unit']}"


def _place(row: dict[str, Any]) -> tuple[str | None, Any]:
    """Return the cells of time [s] and place [km] of the worst value of a criterion."""
    at_s, km = row.get("at_s"), row.get("km")
    return None if at_s is None else f"{at_s:.1f}", None if km is None else row.get("post") or kilometre_cell(km)


def _print_overview(found: Overview, changes: list[dict[str, Any]]) -> None:
    """Print topics, changes and versions of the log."""
    count = sum(topic.messages for topic in found.topics)
    title = f"{found.path.name}: {found.size / 1e6:.1f} MB, {count} messages over {found.duration_s:.1f} s"
    rows = [
        (topic.name, topic.messages, topic.rate_hz, topic.first_s, topic.last_s, _gaps(topic)) for topic in found.topics
    ]
    print_table(("topic", "messages", "1/s", "from s", "to s", "gaps"), rows, title)
    if changes:
        listed = [
            (f"{row['at_s']:.3f}", f"{row['name']} = {_value(row['value'])}", ORIGINS[row.get("planned")])
            for row in changes
        ]
        print_table(("at s", "change", ""), listed, "changes during the run")
    if found.versions:
        versions = ", ".join(f"{name} {value}" for name, value in found.versions.items() if value != "absent")
        sys.stdout.write(f"recorded with {versions}\n")
    if found.wall_time is not None:
        lasted = "" if found.wall_time.duration_s is None else f", {found.wall_time.duration_s:.1f} s of wall time"
        sys.stdout.write(f"recorded from {found.wall_time.begin}{lasted}\n")


def _gaps(topic: TopicOverview) -> str:
    if not topic.gaps or topic.longest_gap_s is None:
        return "none"
    return f"{topic.gaps}, longest {number_text(topic.longest_gap_s, 3)} s after {topic.longest_gap_at_s:.3f} s"


def _value(value: Any) -> str:
    if isinstance(value, dict):
        texts = {name: part if isinstance(part, str) else number_text(part) for name, part in value.items()}
        return ", ".join(f"{name} {text}" for name, text in texts.items())
    return str(value)
