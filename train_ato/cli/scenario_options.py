"""Options that every command which drives a scenario shares."""

from __future__ import annotations

import argparse
from typing import Any

from train_ato.cli.screen import COMPILE_NOTE, PLANNER_NOTE, noted_when_slow
from train_ato.run_setup import RunSetup, prepare
from train_ato.scenario import load


def add_scenario_options(parser: argparse.ArgumentParser) -> None:
    """Add SCENARIO and the options that change it."""
    parser.add_argument("scenario", metavar="SCENARIO", help="a shipped name, NAME:variant, or a YAML file")
    parser.add_argument("--observer", metavar="NAME", help="disturbance observer")
    parser.add_argument("--compensation", metavar="NAME", help="delay compensation")
    parser.add_argument("--seed", type=int, metavar="N", help="seed of every random stream")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="A.B=VALUE",
        dest="assignments",
        help="change any key of the scenario, the value written as YAML; may be repeated",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON value and nothing else")


def prepare_from(options: argparse.Namespace, **changes: Any) -> RunSetup:
    """Load, change and check the scenario that the options name.

    Raises
    ------
    ValueError
        One line saying what is wrong with the input.
    """
    overlay = {
        "observer": options.observer,
        "compensation": options.compensation,
        "seed": options.seed,
        **changes,
    }
    overlay = {key: value for key, value in overlay.items() if value is not None}
    scenario, path = load(options.scenario, tuple(options.assignments), overlay)
    with noted_when_slow(PLANNER_NOTE if scenario.profile.plan is not None else COMPILE_NOTE):
        return prepare(scenario, path)
