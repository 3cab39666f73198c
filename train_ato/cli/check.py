"""``train-ato check-law``, ``check-observer``, ``check-compensation``: run the contract tests on a component.

Options::

    component NAME|MODULE:CLASS  registered name or a class; modules in the current folder are found
"""

import argparse
import contextlib
import dataclasses
import sys

from train_ato.cli.screen import note_compilation, print_result
from train_ato.program.arguments import Options, add_option
from train_ato.program.errors import RunFailed


def _add_component(parser: argparse.ArgumentParser) -> None:
    """Declare the component, with an example of its kind."""
    kind = parser.prog.rpartition("check-")[2]
    example = f"my_{kind}:My{kind.capitalize()}"
    add_option(
        parser,
        "component NAME|MODULE:CLASS",
        f"registered name, or for example {example}; modules in the current folder are found",
    )


OPTIONS: Options = {"component": _add_component}


def execute(options: argparse.Namespace) -> None:
    """Run the tests; a failed test ends with status 1."""
    from train_ato.api.progress import share_bar
    from train_ato.studies.check_component.checking import RANDOM_TRAINS, check_component, findings_table

    name, kind = options.component, options.command.removeprefix("check-")
    if kind != "observer":
        note_compilation()
    # Standard output is only for the findings; the component may print too.
    with share_bar(f"checking {name}") as progress, contextlib.redirect_stdout(sys.stderr):
        findings = check_component(kind, name, progress=progress, random_trains=RANDOM_TRAINS)
    data = [dataclasses.asdict(finding) for finding in findings]
    print_result(data, findings_table(findings) + "\n", as_json=options.json)
    failed = [finding.test for finding in findings if finding.passed is False]
    if failed:
        raise RunFailed(f"{name}: failed {len(failed)} of {len(findings)} tests: {', '.join(sorted(set(failed)))}")
