"""Changes during a run, read from its diagnostics: law, law parameters, interventions on the train, ATO requests.

A change takes effect at a step. The diagnostics of the node contain it under the stamp of that step. The controller has
laws and parameters as JSON under ``changed``, and an accepted request to the ATO under ``ato_request``. The plant has
interventions as JSON under ``interventions``. So the log contains every change, planned by the scenario or requested
from outside, and the run can be repeated from it.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Any

from plant_sim.data_text import parse_json
from train_ato.messages.types import Diagnostic
from train_ato.scenario import interventions
from train_ato.scenario.interventions import (
    AtoRequest,
    Intervention,
    Request,
    due_stamp,
    planned_for,
    request_from_text,
)
from train_ato.scenario.scenario import LawChange, Scenario

KEY = "changed"
"""Key of the controller's diagnostics that contains the changes of one step."""
GIVEN = "given"
"""Key of the first diagnostics of controller and observer: start parameters that replace values of the scenario."""
LAW = "controller"
"""Name of the law in the diagnostics of the controller; every other name of a change is ``law.parameter``."""
SECOND = 1_000_000_000

Changes = dict[str, Any]
"""New values by parameter name, in the order in which they were set."""


def changes_to_json(changes: Mapping[str, Any]) -> str:
    """Return the changes of one step as JSON text for the diagnostics."""
    return json.dumps(changes)


def changes_from_json(text: str) -> Changes:
    """Return the changes of one step from the JSON text of the diagnostics.

    Raises
    ------
    ValueError
        If the text was not written by :func:`changes_to_json`.
    """
    try:
        found = parse_json(text)
    except ValueError:
        found = None
    if not isinstance(found, dict) or not all(isinstance(value, (bool, int, float, str)) for value in found.values()):
        raise ValueError(f"{KEY} '{text[:60]}': not written by this version; open the run with its own version")
    return found


def requested_stamp(change: LawChange) -> int:
    """Return the stamp from which a planned change is due [ns]."""
    return round(change.at * SECOND)


def values_of(change: LawChange) -> Changes:
    """Return the values of a planned change: parameters first, so that a new law starts with them."""
    values: Changes = {}
    for law, block in change.laws.items():
        values |= {f"{law}.{name}": value for name, value in block.items()}
    return values if change.law is None else {**values, LAW: change.law}


def values_by_law(values: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the values of parameters by law."""
    blocks: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        law, _, parameter = name.rpartition(".")
        if law:
            blocks.setdefault(law, {})[parameter] = value
    return blocks


def change_at(stamp: int, values: Mapping[str, Any]) -> LawChange:
    """Return the planned change that sets the values at ``stamp`` [ns]."""
    return LawChange(at=stamp / SECOND, law=values.get(LAW), laws=values_by_law(values))


def effective_stamp(change: LawChange, tick_ns: int) -> int:
    """Return the stamp of the step at which a planned change takes effect [ns]."""
    return -(-requested_stamp(change) // tick_ns) * tick_ns


@dataclass
class RunChanges:
    """Changes of laws and parameters, interventions and ATO requests during a run, from the diagnostics.

    Attributes
    ----------
    given : dict of dict
        Start parameters in place of values of the scenario, by node.
    laws : list of (int, dict)
        Stamp [ns] and new values of every step with a change of law or parameters.
    done : list of (int, Intervention)
        Stamp [ns] and the intervention that starts there.
    requests : list of (int, Request)
        Stamp [ns] and the request that the ATO accepted there.
    """

    given: dict[str, Changes] = field(default_factory=dict)
    laws: list[tuple[int, Changes]] = field(default_factory=list)
    done: list[tuple[int, Intervention]] = field(default_factory=list)
    requests: list[tuple[int, Request]] = field(default_factory=list)

    @classmethod
    def of(cls, reports: Iterable[Diagnostic]) -> "RunChanges":
        """Return the changes in the diagnostics of a run."""
        found = cls()
        for message in reports:
            found.take(message)
        return found

    def take(self, message: Diagnostic) -> None:
        """Add the changes in one diagnostics message."""
        if message.node in _CHOICES and GIVEN in message.values:
            self.given[message.node] = changes_from_json(message.values[GIVEN])
        if message.node == "controller":
            if KEY in message.values:
                self.laws.append((message.stamp, changes_from_json(message.values[KEY])))
            if interventions.REQUEST_KEY in message.values:
                self.requests.append((message.stamp, request_from_text(message.values[interventions.REQUEST_KEY])))
        elif message.node == "plant" and interventions.KEY in message.values:
            entries = interventions.interventions_from_json(message.values[interventions.KEY])
            self.done += [(message.stamp, entry) for entry in entries]

    def rows(self, scenario: Scenario | None = None) -> list[dict[str, Any]]:
        """Return the rows ``changes`` of ``summary.json``: time [s], name, value, planned by the scenario or not.

        Those of a log without its scenario have no ``planned``.
        """
        found: list[tuple[int, str, Any, bool]] = []
        for stamp, changes in self.laws:
            planned: Changes = {}
            for change in () if scenario is None else scenario.law_changes:
                planned |= values_of(change) if scenario and effective_stamp(change, _tick(scenario)) == stamp else {}
            found += [(stamp, name, value, planned.get(name) == value) for name, value in changes.items()]
        (done, _), (accepted, _) = self._matched(scenario)
        found += [(stamp, entry.do, entry.model_dump(exclude={"at", "do"}), known) for stamp, entry, known in done]
        found += [(stamp, interventions.REQUEST_KEY, entry.do, known) for stamp, entry, known in accepted]
        keys = ("at_s", "name", "value", "planned")[: 3 if scenario is None else 4]
        found.sort(key=itemgetter(0))
        return [dict(zip(keys, (stamp / SECOND, *row), strict=False)) for stamp, *row in found]

    def begun(self, scenario: Scenario) -> Scenario:
        """Return the scenario with the start parameters of the nodes."""
        for node, values in self.given.items():
            scenario = _with_values(scenario, values, *_CHOICES[node])
        return scenario

    def at_start(self, scenario: Scenario) -> Scenario:
        """Return the scenario with the law and the parameters of the first step."""
        for stamp, values in self.laws:
            scenario = scenario if stamp else _with_values(scenario, values, *_CHOICES["controller"])
        return scenario

    def driven(self, scenario: Scenario) -> Scenario:
        """Return the scenario that repeats the run: every change that took effect is planned at the same step.

        Changes that ``scenario`` planned for steps that the run did not reach stay planned.
        """
        scenario = self.begun(scenario)
        tick_ns = _tick(scenario)
        # one by one: the changes of a step keep the order of the log
        changes = [change_at(stamp, {name: value}) for stamp, step in self.laws for name, value in step.items()]
        reached = {requested_stamp(change) for change in changes}
        changes += [change for change in scenario.law_changes if effective_stamp(change, tick_ns) not in reached]
        acts, requests = (
            [*(planned_for(stamp, entry) for stamp, entry, _ in done), *ahead]
            for done, ahead in self._matched(scenario)
        )
        update = {
            "law_changes": tuple(sorted(changes, key=lambda change: change.at)),
            "interventions": tuple(sorted(acts, key=lambda act: act.at or 0.0)),
            "ato_requests": tuple(sorted(requests, key=lambda request: request.at)),
        }
        return scenario.model_copy(update=update)

    def _matched(self, scenario: Scenario | None) -> tuple["_Matched", "_Matched"]:
        """Return the interventions and the requests of the run beside those of the scenario."""
        requests = [(stamp, AtoRequest(at=stamp / SECOND, do=request)) for stamp, request in self.requests]
        if scenario is None:
            return _match(self.done, (), 1), _match(requests, (), 1)
        waiting = sorted(scenario.ato_requests, key=lambda plan: plan.at)
        return _match(self.done, scenario.interventions, _tick(scenario)), _match(requests, waiting, 1)


_Matched = tuple[list[tuple[int, Any, bool]], list[Any]]
"""Entries that took place (stamp, entry, planned or not), and the planned ones that did not."""


def _match(done: Iterable[tuple[int, Any]], planned: Iterable[Any], tick_ns: int) -> _Matched:
    """Return entries with the planned ones; each is the first planned one with its values that is due."""
    ahead, found = list(planned), []
    for stamp, entry in done:
        alike = entry.model_dump(exclude={"at"})
        due = (plan for plan in ahead if due_stamp(plan, tick_ns) <= stamp)
        plan = next((plan for plan in due if plan.model_dump(exclude={"at"}) == alike), None)
        if plan is not None:
            ahead.remove(plan)
        found.append((stamp, entry, plan is not None))
    return found, ahead


_CHOICES = {"controller": ("law", "laws"), "observer": ("observer", "observers")}
"""Keys of the scenario by node: the choice, and the parameters of all choices."""


def _with_values(scenario: Scenario, values: Changes, choice: str, parameters: str) -> Scenario:
    """Return the scenario with other values of a node; a name with a dot is that of a parameter."""
    update: dict[str, Any] = {parameters: {name: dict(block) for name, block in getattr(scenario, parameters).items()}}
    for name, value in values.items():
        block, _, key = name.rpartition(".")
        if block:
            update[parameters].setdefault(block, {})[key] = value
        else:
            update[choice] = value
    return scenario.model_copy(update=update)


def _tick(scenario: Scenario) -> int:
    return round(scenario.tick * SECOND)
