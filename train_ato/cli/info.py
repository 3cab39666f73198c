"""``train-ato info``: what a run or a log holds."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path
from typing import Any

from train_ato.cli.screen import print_json, share_bar, table
from train_ato.record.overview import Overview, TopicOverview, overview
from train_ato.record.reading import log_file, partial_of, state_of
from train_ato.record.versions import SCENARIO


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``info``."""
    parser.add_argument("run", type=Path, metavar="RUN", help="run folder, a log alone, or run.mcap.partial")
    parser.add_argument("--json", action="store_true", help="print one JSON value and nothing else")


def execute(options: argparse.Namespace) -> int:
    """Print the summary, topics with counts, rates and gaps, the changes and the versions."""
    run: Path = options.run
    partial = partial_of(run)
    if partial is not None:
        log, note = partial, f"{partial}: {state_of(partial)}"
    else:
        _check_folder(run)
        log, note = log_file(run), ""
    with share_bar(f"reading {log}") as progress:
        found = overview(log, broken=partial is not None, progress=lambda share: progress(share, ""))
    summary = _summary(run)
    changes = summary.pop("changes", None) or found.told.listed()
    if options.json:
        print_json({**summary, **_as_json(found), "changes": changes, "note": note})
        return 0
    if summary:
        table(("figure", "value"), summary.items(), str(run))
    _show(found, changes)
    if note:
        sys.stdout.write(f"{note}\n")
    return 0


def _check_folder(run: Path) -> None:
    """Refuse a folder that holds neither a scenario nor a log."""
    if run.is_dir() and not (run / SCENARIO).is_file() and not (run / "run.mcap").is_file():
        raise ValueError(f"{run}: not a run folder: no {SCENARIO}; name a folder that `run` made")


def _summary(run: Path) -> dict[str, Any]:
    """Return the summary beside the log, empty for a log alone."""
    if not (run / SCENARIO).is_file():
        return {}
    from train_ato.run_folder import read_summary

    return read_summary(run) if partial_of(run) is None else {}


def _as_json(found: Overview) -> dict[str, Any]:
    return {
        "log": str(found.path),
        "log_bytes": found.size,
        "duration_s": found.duration_s,
        "messages": {topic.name: topic.messages for topic in found.topics},
        "topics": [dataclasses.asdict(topic) for topic in found.topics],
        "versions": found.versions,
    }


def _show(found: Overview, changes: list[dict[str, Any]]) -> None:
    """Print what the log holds."""
    count = sum(topic.messages for topic in found.topics)
    title = f"{found.path.name}: {found.size / 1e6:.1f} MB, {count} messages over {found.duration_s:.1f} s"
    rows = [
        (topic.name, topic.messages, topic.rate_hz, topic.first_s, topic.last_s, _gaps(topic)) for topic in found.topics
    ]
    table(("topic", "messages", "1/s", "from s", "to s", "gaps"), rows, title)
    if changes:
        listed = [
            (f"{row['at_s']:.3f}", f"{row['name']} = {_value(row['value'])}", _origin(row.get("planned")))
            for row in changes
        ]
        table(("at s", "change", ""), listed, "changes while the run went on")
    if found.versions:
        told = ", ".join(f"{name} {value}" for name, value in found.versions.items() if value != "absent")
        sys.stdout.write(f"made by {told}\n")


def _gaps(topic: TopicOverview) -> str:
    if not topic.gaps:
        return "none"
    return f"{topic.gaps}, longest {topic.longest_gap_s:.3g} s after {topic.longest_gap_at_s:.3f} s"


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {part:g}" for name, part in value.items())
    return str(value)


def _origin(planned: bool | None) -> str:
    """Say who changed it; a log alone does not tell what was planned."""
    return "" if planned is None else "planned" if planned else "from outside"
