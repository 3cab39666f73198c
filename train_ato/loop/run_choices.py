"""Choices of a scenario for a run: names and parameters of law, observer and compensation, links, faults."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from train_ato.control.registry import LAWS
from train_ato.scenario.scenario import LawChange, Links, PlantBlock, Scenario

__all__ = ["RunChoices"]


@dataclass(frozen=True)
class RunChoices:
    """Choices of a scenario by their names in a run.

    Attributes
    ----------
    scenario : Scenario
        Checked scenario with current names of parameters.
    """

    scenario: Scenario

    @property
    def plant(self) -> PlantBlock:
        """Block ``plant`` of the scenario."""
        return self.scenario.plant

    @property
    def seed(self) -> int:
        """Seed of every random stream."""
        return self.scenario.seed

    @property
    def links(self) -> Links:
        """Delays on topics."""
        return self.scenario.links

    @property
    def observer(self) -> str:
        """Name of the observer."""
        return self.scenario.observer

    @property
    def observer_parameters(self) -> dict[str, Any]:
        """Parameters of the observer that differ from its defaults."""
        return self.scenario.observers.get(self.observer, {})

    @property
    def controller(self) -> str:
        """Name of the law at the start."""
        return self.scenario.law

    @property
    def controller_parameters(self) -> dict[str, dict[str, Any]]:
        """Parameters of every law that differ from its defaults."""
        return self.scenario.laws

    @property
    def laws(self) -> tuple[str, ...]:
        """Names of the laws this run can change to: the registered ones, and each ``module:Class`` of the scenario."""
        named = [self.controller, *self.controller_parameters]
        for change in self.law_changes:
            named += [change.law or self.controller, *change.laws]
        return tuple(dict.fromkeys((*LAWS.loadable(), *named)))

    @property
    def compensation(self) -> str:
        """Name of the delay compensation."""
        return self.scenario.compensation

    @property
    def compensation_parameters(self) -> dict[str, Any]:
        """Parameters of the compensation that differ from its defaults."""
        return self.scenario.compensations.get(self.compensation, {})

    @property
    def law_changes(self) -> tuple[LawChange, ...]:
        """Planned changes of laws and parameters."""
        return self.scenario.law_changes

    @property
    def has_faults(self) -> bool:
        """True for a run in which messages can get lost or change on their way."""
        return bool(self.scenario.faults or self.scenario.interventions)
