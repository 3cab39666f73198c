"""``train-ato check-law``: the contract tests on a law of your own."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import sys
from pathlib import Path

from train_ato.cli.main import RunFailed
from train_ato.cli.screen import print_json, share_bar
from train_ato.control.check import check_law, table


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``check-law``."""
    parser.add_argument(
        "law", metavar="MODULE:CLASS", help="for example my_law:MyLaw; modules of this folder are found"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON value and nothing else")


def execute(options: argparse.Namespace) -> int:
    """Run the tests; a law that fails one is not fit for the loop and ends with status 1."""
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.insert(0, here)
    # What the law prints belongs on the other stream: standard output is for the findings.
    with share_bar(f"checking {options.law}") as told, contextlib.redirect_stdout(sys.stderr):
        findings = check_law(options.law, told=told)
    if options.json:
        print_json([dataclasses.asdict(finding) for finding in findings])
    else:
        sys.stdout.write(table(findings) + "\n")
    failed = [finding.test for finding in findings if finding.passed is False]
    if failed:
        raise RunFailed(
            f"{options.law}: failed {len(failed)} of {len(findings)} tests: {', '.join(sorted(set(failed)))}"
        )
    return 0
