"""``train-ato recover``: make a readable log of one that was cut or damaged."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from train_ato.cli.screen import print_json, share_bar
from train_ato.record.layout import METADATA
from train_ato.record.recover import recover


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``recover``."""
    parser.add_argument(
        "file", type=Path, metavar="FILE", help="run.mcap.partial or a damaged log, or the folder that holds it"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON value and nothing else")


def execute(options: argparse.Namespace) -> int:
    """Write what is whole of the log as a new one; the damaged file is kept beside it."""
    with share_bar(f"recovering {options.file}") as progress:
        found = recover(options.file, lambda share: progress(share, ""))
    if options.json:
        print_json(
            {
                "log": str(found.path),
                "kept": None if found.kept is None else str(found.kept),
                "messages": found.messages,
                "lost_chunks": found.lost_chunks,
                "metadata_only": found.metadata_only,
            }
        )
        return 0
    if found.metadata_only:
        kept = f"; kept as it was: {found.kept}" if found.kept else ""
        again = found.path.parent / METADATA
        sys.stdout.write(f"{found.path} is whole, {found.messages} messages; written again: {again}{kept}\n")
        return 0
    lost = f"; {found.lost_chunks} damaged or cut chunks were left out" if found.lost_chunks else ""
    sys.stdout.write(f"{found.messages} messages recovered into {found.path}{lost}; kept as it was: {found.kept}\n")
    return 0
