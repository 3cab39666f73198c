"""Scenario with checked changes."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml

from plant_sim.data_text import TextDumper
from plant_sim.library import split_name
from train_ato.loop.part_cache import PartCache
from train_ato.loop.setup import RunSetup, prepare
from train_ato.scenario.overlays import RefusedScenario, assign, caused_by, overlay, put, with_absolute_files
from train_ato.scenario.scenario import SCHEMA, Scenario, check_scenario, raw_scenario, variants_of

Changes = Mapping[str, Any]
"""Values by key: ``{"laws.pid.kp": 0.03}``."""


class ScenarioChoice:
    """Scenario with changes; the object is immutable.

    Made by :func:`train_ato.scenario`.

    Examples
    --------
    >>> import train_ato as ta
    >>> demo = ta.scenario("demo")
    >>> short = demo.with_({"laws.pid.kp": 0.03}, duration=20, seed=7)
    >>> short
    scenario('demo').with_({'laws.pid.kp': 0.03, 'duration': 20, 'seed': 7})
    >>> short.checked.seed, demo.checked.seed
    (7, 1)
    >>> ta.run(short).metrics["seed"]
    7
    """

    def __init__(self, name: str, path: Path, data: dict[str, Any], changes: tuple[tuple[str, Any], ...] = ()) -> None:
        self._given = name
        self._data = data
        self._changes = changes
        self.path = path
        try:
            self.checked: Scenario = check_scenario(data, path)
        except ValueError as error:
            raise self._caused(error) from None

    @property
    def name(self) -> str:
        """Name of the scenario, with its variants."""
        return self.checked.name

    @property
    def summary(self) -> str:
        """Description in one line."""
        return self.checked.summary

    @property
    def yaml(self) -> str:
        """Text of the scenario with its base, variants and changes."""
        return yaml.dump(self._data, Dumper=TextDumper, sort_keys=False, allow_unicode=True, width=120)

    @property
    def data(self) -> dict[str, Any]:
        """Content of the scenario with its base, variants and changes; a copy."""
        return copy.deepcopy(self._data)

    @property
    def as_overlay(self) -> dict[str, Any]:
        """Raw scenario with ``base`` and the changed keys only; whole if no overlay has the same content."""
        stem, variant = split_name(self._given)
        named = str(self.path.absolute()) if Path(stem).suffix in (".yaml", ".yml") or Path(stem).is_file() else stem
        changed: dict[str, Any] = {}
        for key, value in self._changes:
            if key == "--set":
                assign(changed, value)
            else:
                put(changed, key, plain(value), f"set {key}")
        if overlay(raw_scenario(self._given)[1], changed) == self._data:
            return {"schema": SCHEMA, "base": f"{named}{variant}", **changed}
        return with_absolute_files(copy.deepcopy(self._data), self.path.parent)

    @cached_property
    def variants(self) -> dict[str, str]:
        """Variants of the scenario file and their descriptions."""
        return variants_of(self.path)

    def with_(self, changes: Changes | None = None, /, **more: Any) -> ScenarioChoice:
        """Return the scenario with some keys changed.

        Parameters
        ----------
        changes
            Values by key, the levels separated by dots, as for ``train-ato run --set``.  A value, also a mapping,
            replaces the previous one.
        **more
            Values of keys of the first level.

        Raises
        ------
        ValueError
            One line: file, key, value, remedy.
        """
        given = {**(changes or {}), **more}
        data = copy.deepcopy(self._data)
        for key, value in given.items():
            put(data, key, plain(value), f"set {key}")
        return ScenarioChoice(self._given, self.path, data, (*self._changes, *given.items()))

    def changed(self, changes: Changes | None, seed: int | None) -> ScenarioChoice:
        """Return the scenario with the changes that are not None."""
        given = {**(changes or {}), **({} if seed is None else {"seed": seed})}
        return self.with_(given) if given else self

    def assigned(self, texts: Sequence[str]) -> ScenarioChoice:
        """Return the scenario after ``--set`` options."""
        data = copy.deepcopy(self._data)
        for text in texts:
            assign(data, text)
        return ScenarioChoice(self._given, self.path, data, (*self._changes, *(("--set", text) for text in texts)))

    def prepare(self, scenario: Scenario | None = None, parts: PartCache | None = None) -> RunSetup:
        """Return the setup of a run; ``scenario`` replaces the checked one, ``parts`` are those of former runs."""
        try:
            return prepare(scenario or self.checked, self.path, parts)
        except ValueError as error:
            raise self._caused(error) from None

    def _caused(self, error: ValueError) -> RefusedScenario:
        """Return a refusal with the changes that caused it in place of the file."""
        changes = [
            (value.partition("=")[0].strip(), f"--set {value}") if key == "--set" else (key, f"set {key}={value}")
            for key, value in self._changes
        ]
        return caused_by(error, self.path, changes)

    def __repr__(self) -> str:
        changes = f".with_({dict(self._changes)})" if self._changes else ""
        return f"scenario({self._given!r}){changes}"


def choose_scenario(name: str | Path | ScenarioChoice) -> ScenarioChoice:
    """Return a scenario by its name or file.

    Parameters
    ----------
    name
        Shipped name, ``name:variant[+variant...]``, or a YAML file.

    Raises
    ------
    ValueError
        If it does not exist or is wrong: one line with file, key and remedy.

    Examples
    --------
    >>> import train_ato as ta
    >>> ta.scenario("demo").checked.law
    'pid'
    >>> ta.scenario("demoo")
    Traceback (most recent call last):
    ValueError: unknown scenario 'demoo' (did you mean 'demo'?); `train-ato list` names all
    """
    if isinstance(name, ScenarioChoice):
        return name
    if not isinstance(name, (str, Path)):
        raise ValueError(f"scenario of type {type(name).__name__}: give a name, a file or train_ato.scenario(...)")
    path, data = raw_scenario(str(name))
    return ScenarioChoice(str(name), path, data)


def plain(value: Any) -> Any:
    """Return numbers and arrays of numpy as Python numbers and lists."""
    convert = getattr(value, "tolist", None)
    return convert() if convert is not None else value
