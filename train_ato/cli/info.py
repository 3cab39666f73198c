"""``train-ato info``: what a run folder holds."""

from __future__ import annotations

import argparse
from pathlib import Path

from train_ato.cli.screen import print_json, table
from train_ato.record.reading import log_file, message_counts
from train_ato.run_folder import read_summary


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``info``."""
    parser.add_argument("run", type=Path, metavar="RUN", help="run folder")
    parser.add_argument("--json", action="store_true", help="print one JSON value and nothing else")


def execute(options: argparse.Namespace) -> int:
    """Print the summary and the number of messages of every topic."""
    summary = read_summary(options.run)
    counts = message_counts(options.run)
    size = log_file(options.run).stat().st_size
    if options.json:
        print_json({**summary, "messages": counts, "log_bytes": size})
        return 0
    table(("figure", "value"), summary.items(), str(options.run))
    table(("topic", "messages"), counts.items(), f"run.mcap, {size / 1e6:.1f} MB")
    return 0
