"""``train-ato list [NAME | FILE.yaml]``: all names with one line each, or the details of one name or file."""

from __future__ import annotations

import argparse
from collections.abc import Iterable

from plant_sim.input_error import close_match
from train_ato.cli.details import details
from train_ato.cli.screen import print_json, print_names


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``list``."""
    parser.add_argument(
        "name",
        nargs="?",
        metavar="NAME | FILE.yaml",
        help="print details of this name, or of a scenario, consist or line file",
    )


def catalogue() -> dict[str, dict[str, str]]:
    """Return the names of every kind with their one-line summaries."""
    from train_ato.apps.runs import catalogue as shipped
    from train_ato.scenario.scenario import shipped_scenarios, variants_of

    scenarios: dict[str, str] = {}
    paths = shipped_scenarios()
    for name, summary in shipped.scenarios().items():
        scenarios |= {name: summary}
        scenarios |= {f"{name}:{variant}": text for variant, text in variants_of(paths[name]).items()}
    return {
        "scenarios": scenarios,
        "laws": shipped.laws(),
        "observers": shipped.observers(),
        "compensations": shipped.compensations(),
        "consists": shipped.trains(),
        "lines": shipped.lines(),
    }


def execute(options: argparse.Namespace) -> int:
    """Print the catalogue, or the details of one name."""
    found = catalogue() if options.name is None else _details_of(options.name)
    expected = expected_verdicts(found.get("scenarios", {}))
    if options.json:
        print_json({**found, "expected": expected} if expected else found)
        return 0
    for kind, entries in found.items():
        if kind == "scenarios":
            rows = [(name, expected[name].partition(" ")[0], summary) for name, summary in entries.items()]
            print_names("scenarios, with expected verdict (`train-ato list NAME` has its cause)", rows)
        else:
            print_names(kind, entries.items())
    return 0


def expected_verdicts(names: Iterable[str]) -> dict[str, str]:
    """Return the expected verdict of every scenario, with failed criteria and cause; "" for a scenario without."""
    from train_ato.scenario.scenario import expectation_of

    found = {name: expectation_of(name) for name in names}
    return {name: "" if expected is None else expected.text for name, expected in found.items()}


def _details_of(name: str) -> dict[str, dict[str, str]]:
    found = details(name)
    if not found:
        from plant_sim.library import consist_names, line_names
        from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS
        from train_ato.scenario.scenario import shipped_scenarios

        components = (name for registry in (LAWS, OBSERVERS, COMPENSATIONS) for name in registry.names())
        known = {*shipped_scenarios(), *components, *consist_names(), *line_names()}
        raise ValueError(f"unknown name '{name}'{close_match(name, known)}; see `train-ato list`")
    return {f"{kind} {name}": facts for kind, facts in found.items()}
