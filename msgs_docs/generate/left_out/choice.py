"""Choices where a paper gives nothing, with the runs of their sensitivity; read from ``choices.yaml``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from plant_sim.library import consist_path, read_yaml
from train_ato.control.gains import PRINTED, has_gains
from train_ato.control.registry import LAWS
from train_ato.loop.setup import RunSetup, prepare
from train_ato.scenario.overlays import overlay
from train_ato.scenario.scenario import load_scenario


@dataclass(frozen=True)
class ChoiceRun:
    """One run of the engine.

    Attributes
    ----------
    scenario
        ``NAME[:variant+...]`` of a shipped scenario.
    sets
        Assignments of ``--set``.
    consist
        Changed keys in a copy of the train file of the scenario.
    """

    scenario: str
    sets: tuple[str, ...]
    consist: dict[str, Any]

    @property
    def key(self) -> str:
        """Text that is different for every run."""
        return yaml.safe_dump([self.scenario, *self.sets, self.consist], default_flow_style=True, width=10_000).strip()

    def setup(self) -> RunSetup:
        """Return the prepared run, with the printed gains of its law where the scenario gives none.

        Raises
        ------
        ValueError
            For a wrong scenario, assignment or key of the train.
        """
        scenario, path = load_scenario(self.scenario, self.sets)
        printed = {"laws": {scenario.law: {"gains": PRINTED}}} if has_gains(LAWS.get(scenario.law)) else {}
        scenario, path = load_scenario(self.scenario, self.sets, printed)
        if self.consist:
            name = scenario.plant.consist
            assert isinstance(name, str)
            changed = overlay(read_yaml(consist_path(name)), self.consist)
            scenario, path = load_scenario(self.scenario, self.sets, {**printed, "plant": {"consist": changed}})
        return prepare(scenario, path)


@dataclass(frozen=True)
class Choice:
    """Choice where a paper gives nothing.

    Attributes
    ----------
    missing, chosen
        Quantity or form that the paper does not give; value or form here.
    where
        Place of the value: ``module:name``, or ``folder/file:text``.
    base
        Name of the run with the choice.
    metric
        Metric of the run.
    others
        Runs with another choice.
    reason
        Reason for a choice without runs.
    """

    missing: str
    chosen: str
    where: str
    base: str = ""
    metric: str = ""
    others: tuple[ChoiceRun, ...] = ()
    reason: str = ""


@dataclass(frozen=True)
class ChoiceTable:
    """Choices of one paper, and its runs with these choices by name."""

    paper: str
    title: str
    bases: dict[str, ChoiceRun]
    choices: tuple[Choice, ...]


def read_choices(path: Path) -> tuple[ChoiceTable, ...]:
    """Return the tables of a file; unknown keys raise TypeError, an unknown base KeyError."""
    return tuple(_table(data) for data in yaml.safe_load(path.read_text(encoding="utf-8")))


def _table(data: dict[str, Any]) -> ChoiceTable:
    bases = {name: ChoiceRun(row["scenario"], tuple(row.get("set", ())), {}) for name, row in data["bases"].items()}
    choices = []
    for row in data["choices"]:
        others = row.pop("others", ())
        runs = tuple(_other(bases[row["base"]], other) for other in others)
        choices.append(Choice(**row, others=runs))
    return ChoiceTable(data["paper"], data["title"], bases, tuple(choices))


def _other(base: ChoiceRun, row: dict[str, Any]) -> ChoiceRun:
    """Return the run of a base with other assignments (``set``), keys of the train (``consist``) or a ``variant``."""
    given, variant = row.get("set", ()), row.get("variant", "")
    more = (given,) if isinstance(given, str) else tuple(given)
    name = base.scenario + ("+" if ":" in base.scenario else ":") + variant if variant else base.scenario
    return ChoiceRun(name, (*base.sets, *more), row.get("consist", {}))


CHOICES = read_choices(Path(__file__).parent / "choices.yaml")
"""Choices of the five papers."""
