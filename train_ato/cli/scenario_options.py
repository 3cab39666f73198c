"""Options of every command that runs a scenario.

Options::

    --observer NAME      disturbance observer: a name, or MODULE:CLASS without registration
    --compensation NAME  delay compensation: a name, or MODULE:CLASS without registration
    --seed N             seed of every random stream
    --set A.B=VALUE      change any key of the scenario, the value written as YAML; may be repeated
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from train_ato.program.arguments import Options, declare_options

if TYPE_CHECKING:
    from train_ato.scenario.setup import RunSetup


KINDS = ("law", "observer", "compensation")
"""Kinds of components; each is an option."""

OPTIONS: Options = {"--set": {"action": "append", "dest": "assignments"}}


def add_change_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that change a scenario."""
    declare_options(parser, sys.modules[__name__])


def prepare_from(options: argparse.Namespace) -> RunSetup:
    """Load, change and check the scenario of the options."""
    from train_ato.api.progress import COMPILE_NOTE, PLANNER_NOTE, compilation_noted
    from train_ato.scenario.overlays import caused_by
    from train_ato.scenario.scenario import changes_of, load_scenario
    from train_ato.scenario.setup import prepare

    overlay: dict[str, Any] = {**chosen_components(options)}
    if options.seed is not None:
        overlay["seed"] = options.seed
    assignments = tuple(options.assignments)
    scenario, path = load_scenario(options.scenario, assignments, overlay)
    try:
        with compilation_noted(PLANNER_NOTE if scenario.profile.plan is not None else COMPILE_NOTE):
            return prepare(scenario, path)
    except ValueError as error:
        raise caused_by(error, path, changes_of(assignments, overlay)) from None


def chosen_components(options: argparse.Namespace, kinds: Iterable[str] = KINDS) -> dict[str, str]:
    """Return the checked names of the options ``--law``, ``--observer`` and ``--compensation`` that are given."""
    found = {kind: name for kind in kinds if (name := getattr(options, kind)) is not None}
    for kind, name in found.items():
        check_component_name(f"--{kind}", kind, name)
    return found


def listed(text: str | None, option: str, what: str = "name") -> list[str]:
    """Return the entries of a list with commas; [] without the option, which needs one of ``what``."""
    found = [name.strip() for name in (text or "").split(",") if name.strip()]
    if text is not None and not found:
        raise ValueError(f"{option} {text}: no {what}; add one or remove the option")
    return found


def check_component_name(option: str, kind: str, name: str) -> None:
    """Refuse an unknown name of a law, observer or compensation with its option."""
    from train_ato.control.registry import REGISTRIES

    try:
        REGISTRIES[kind].get(name)
    except ValueError as error:
        raise ValueError(f"{option}: {error}") from None
