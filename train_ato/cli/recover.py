"""``train-ato recover``: make a readable log of one whose recorder was killed."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from train_ato.cli.screen import print_json
from train_ato.record.recover import recover


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``recover``."""
    parser.add_argument("file", type=Path, metavar="FILE", help="run.mcap.partial, or the folder that holds it")
    parser.add_argument("--json", action="store_true", help="print one JSON value and nothing else")


def execute(options: argparse.Namespace) -> int:
    """Write what can be read of the log again, beside it."""
    path, messages = recover(options.file)
    if options.json:
        print_json({"log": str(path), "messages": messages})
    else:
        sys.stdout.write(f"{messages} messages recovered into {path}\n")
    return 0
