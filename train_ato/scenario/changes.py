"""What was changed while a run went on: the law and its parameters, and what was done to the train.

A change takes effect at a step and stands under that step's stamp in the diagnostics of its node, as JSON: laws and
parameters under ``changed`` of the controller, interventions under theirs of the plant.  So the log alone says what
was done when, whether a scenario had planned it or somebody did it from outside, and the run can be driven again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from train_ato import interventions
from train_ato.interventions import Intervention, due_stamp, planned_for
from train_ato.scenario import Scenario, Swap
from train_ato.types import Diagnostic

KEY = "changed"
"""Key of the controller's diagnostics under which the changes of one step stand."""
LAW = "controller"
"""Name of the parameter that chooses the law; every other one is ``law.parameter``."""
SECOND = 1_000_000_000

Changes = dict[str, Any]
"""New values by parameter name, in the order in which they were set."""


def as_text(changes: Mapping[str, Any]) -> str:
    """Return the changes of one step as they stand in the diagnostics."""
    return json.dumps(changes)


def from_text(text: str) -> Changes:
    """Return the changes of one step that the diagnostics hold.

    Raises
    ------
    ValueError
        If the text is not theirs.
    """
    try:
        found = json.loads(text)
    except ValueError:
        found = None
    if not isinstance(found, dict) or not all(isinstance(value, (bool, int, float, str)) for value in found.values()):
        raise ValueError(f"{KEY} '{text[:60]}': not written by this version")
    return found


def stamp_of(swap: Swap) -> int:
    """Return the stamp from which a planned swap is due [ns]."""
    return round(swap.at * SECOND)


def changes_of(swap: Swap) -> Changes:
    """Return what a planned swap sets: parameters first, so that the law begins with them."""
    values: Changes = {}
    for law, block in swap.controllers.items():
        values |= {f"{law}.{name}": value for name, value in block.items()}
    return values if swap.controller is None else {**values, LAW: swap.controller}


def swap_of(stamp: int, changes: Mapping[str, Any]) -> Swap:
    """Return the swap that does at ``stamp`` [ns] what was done then."""
    blocks: dict[str, dict[str, Any]] = {}
    for name, value in changes.items():
        law, _, parameter = name.partition(".")
        if parameter:
            blocks.setdefault(law, {})[parameter] = value
    return Swap(at=stamp / SECOND, controller=changes.get(LAW), controllers=blocks)


def effective(swap: Swap, tick_ns: int) -> int:
    """Return the stamp of the step at which a planned swap takes effect [ns]."""
    return -(-stamp_of(swap) // tick_ns) * tick_ns


@dataclass
class Told:
    """The changes that the messages of a run tell of.

    Attributes
    ----------
    laws : list of (int, dict)
        Stamp [ns] and new values of every step that began to use another law or parameter.
    done : list of (int, Intervention)
        Stamp [ns] and what was done to the train from it on.
    """

    laws: list[tuple[int, Changes]] = field(default_factory=list)
    done: list[tuple[int, Intervention]] = field(default_factory=list)

    def take(self, message: Diagnostic) -> None:
        """Take what a node's diagnostics tell."""
        if message.node == "controller" and KEY in message.values:
            self.laws.append((message.stamp, from_text(message.values[KEY])))
        elif message.node == "plant" and interventions.KEY in message.values:
            entries = interventions.from_text(message.values[interventions.KEY])
            self.done += [(message.stamp, entry) for entry in entries]

    def rows(self, scenario: Scenario) -> list[dict[str, Any]]:
        """Return the changes as ``summary.json`` lists them: when, what, and whether the scenario had planned it."""
        tick_ns = _tick(scenario)
        listed = []
        for stamp, changes in self.laws:
            planned: Changes = {}
            for swap in scenario.swaps:
                planned |= changes_of(swap) if effective(swap, tick_ns) == stamp else {}
            for name, value in changes.items():
                foreseen = name in planned and planned[name] == value
                listed.append({"at_s": stamp / SECOND, "name": name, "value": value, "planned": foreseen})
        for stamp, entry, foreseen in self._matched(scenario)[0]:
            values = entry.model_dump(exclude={"at", "do"})
            listed.append({"at_s": stamp / SECOND, "name": entry.do, "value": values, "planned": foreseen})
        return sorted(listed, key=lambda row: float(row["at_s"]))

    def listed(self) -> list[dict[str, Any]]:
        """Return the changes without saying which were planned: when, what."""
        told = [(stamp, name, value) for stamp, changes in self.laws for name, value in changes.items()]
        told += [(stamp, entry.do, entry.model_dump(exclude={"at", "do"})) for stamp, entry in self.done]
        told.sort(key=lambda entry: entry[0])
        return [{"at_s": stamp / SECOND, "name": name, "value": value} for stamp, name, value in told]

    def driven(self, scenario: Scenario) -> Scenario:
        """Return the scenario that drives the run again: it plans what took effect, at the same steps.

        What ``scenario``, as the run was started, has planned for steps that the run did not reach stays planned.
        """
        swaps = [swap_of(stamp, changes) for stamp, changes in self.laws]
        reached = {stamp_of(swap) for swap in swaps}
        swaps += [swap for swap in scenario.swaps if effective(swap, _tick(scenario)) not in reached]
        done, ahead = self._matched(scenario)
        acts = [*(planned_for(stamp, entry) for stamp, entry, _ in done), *ahead]
        update = {
            "swaps": tuple(sorted(swaps, key=lambda swap: swap.at)),
            "interventions": tuple(sorted(acts, key=lambda act: act.at or 0.0)),
        }
        return scenario.model_copy(update=update)

    def _matched(self, scenario: Scenario) -> tuple[list[tuple[int, Intervention, bool]], list[Intervention]]:
        """Return what was done, each with whether it was planned, and what is planned and was not done."""
        ahead, matched = list(scenario.interventions), []
        tick_ns = _tick(scenario)
        for stamp, entry in self.done:
            plans = [plan for plan in ahead if _same(plan, entry) and due_stamp(plan, tick_ns) <= stamp]
            if plans:
                ahead.remove(plans[0])
            matched.append((stamp, entry, bool(plans)))
        return matched, ahead


def _same(plan: Intervention, entry: Intervention) -> bool:
    return bool(plan.model_dump(exclude={"at"}) == entry.model_dump(exclude={"at"}))


def _tick(scenario: Scenario) -> int:
    return round(scenario.tick * SECOND)
