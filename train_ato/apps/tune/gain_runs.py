"""Runs of the search for gains: every scenario with every seed and variation, as one task each."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from train_ato.apps.runs.component_choice import put_components
from train_ato.apps.runs.scenario_choice import ScenarioChoice
from train_ato.loop.engine import run_engine
from train_ato.loop.setup import RunSetup
from train_ato.scenario.scenario import Scenario

SEARCHED, HELD_OUT = "searched", "held out"
"""Parts of a tuning: scenarios and seeds of the search, and those that the search does not use."""
FIXED_KEYS = ("law", "laws", "law_changes", "seed", "controller", "controllers", "controller_changes", "swaps")
"""Keys that a variation cannot change: those of the law, and the seed with an option of its own."""


@dataclass(frozen=True)
class GainTask:
    """One run of the tuning.

    Attributes
    ----------
    label
        Scenario, seed if there are several, and variation.
    part
        :data:`SEARCHED` or :data:`HELD_OUT`.
    choice
        Scenario with its own law, for the reference run.
    scenario
        The same with the tuned law, observer and compensation.
    """

    label: str
    part: str
    choice: ScenarioChoice
    scenario: Scenario


def gain_tasks(
    choices: Sequence[ScenarioChoice],
    law: Any,
    part: str,
    seeds: Sequence[int] | None,
    variations: Sequence[Mapping[str, Any]] = (),
    *,
    observer: Any = None,
    compensation: Any = None,
) -> list[GainTask]:
    """Return a task for every scenario, seed and variation; the first variation is none.

    Raises
    ------
    ValueError
        For a variation of the law, or a scenario with a wrong key.
    """
    tasks = []
    for choice in choices:
        for seed in seeds or (None,):
            for variation in ({}, *variations):
                changed = choice.changed(dict(variation), seed)
                scenario = put_components(
                    changed.checked, law=law, observer=observer, compensation=compensation, importable=False
                )
                parts = [choice.name, *([f"seed {seed}"] if seed is not None else [])]
                parts += [f"{key}={value}" for key, value in variation.items()]
                tasks.append(GainTask(", ".join(parts), part, changed, scenario))
    return tasks


class GainRunner:
    """Runs of tasks with different gains; the setup of a task is prepared once.

    Parameters
    ----------
    tasks
        All tasks.
    """

    def __init__(self, tasks: Sequence[GainTask]) -> None:
        self._tasks = tasks
        self._setups: dict[int, RunSetup] = {}

    def setup(self, index: int) -> RunSetup:
        """Return the prepared run of a task with the gains of its scenario.

        Raises
        ------
        ValueError
            If the law does not fit the train, or the scenario is wrong.
        """
        if index not in self._setups:
            self._setups[index] = self._tasks[index].choice.prepare(self._tasks[index].scenario)
        return self._setups[index]

    def reference(self, index: int) -> dict[str, Any]:
        """Return the metrics of a task with the law and the gains of the scenario."""
        return self._run(self._tasks[index].choice.prepare())

    def run(self, index: int, gains: Mapping[str, Any]) -> dict[str, Any]:
        """Return the metrics of a task; ``status`` is ``refused`` if the law refuses the gains.

        Raises
        ------
        KeyboardInterrupt
            After Ctrl-C during the run.
        """
        setup = self.setup(index)
        name = setup.controller
        blocks = {**setup.scenario.laws, name: {**setup.scenario.laws.get(name, {}), **gains}}
        changed = dataclasses.replace(setup, scenario=setup.scenario.model_copy(update={"laws": blocks}))
        try:
            changed.law(name)
        except ValueError as error:
            return {"status": "refused", "failure": str(error)}
        return self._run(changed)

    @staticmethod
    def _run(setup: RunSetup) -> dict[str, Any]:
        return run_engine(setup, summary_only=True).summary
