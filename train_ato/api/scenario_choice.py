"""Scenario with checked changes."""

from __future__ import annotations

import copy
import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import yaml

from plant_sim.data_text import TextDumper
from plant_sim.formats.fields import print_assumption
from plant_sim.library import split_name
from train_ato.control.registry import LAWS, REGISTRIES, GivenComponent, Registry, keyword_values, load_class
from train_ato.judge.metric_names import verdict_html
from train_ato.program.errors import InputError
from train_ato.scenario.overlays import RefusedScenario, assign, caused_by, overlay, put, with_absolute_files
from train_ato.scenario.scenario import Scenario, check_scenario, expectation_of, raw_scenario
from train_ato.scenario.scenario_data import PartCache
from train_ato.scenario.scenario_files import SCHEMA, variants_of
from train_ato.scenario.setup import RunSetup, prepare, without_effect

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

    def __init__(
        self, name: str | Mapping[str, Any], path: Path, data: dict[str, Any], changes: tuple[tuple[str, Any], ...] = ()
    ) -> None:
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
        if not isinstance(self._given, str):
            return with_absolute_files(self.data, self.path.parent)
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
        return with_absolute_files(self.data, self.path.parent)

    @cached_property
    def variants(self) -> dict[str, str]:
        """Variants of the scenario file and their descriptions."""
        return variants_of(self.path) if isinstance(self._given, str) else {}

    def with_(self, changes: Changes | None = None, /, **more: Any) -> ScenarioChoice:
        """Return the scenario with some keys changed.

        Parameters
        ----------
        changes
            Values by key, the levels separated by dots, as for ``train-ato run --set``.  A value, also a mapping,
            replaces the previous one.
        **more
            Values of keys of the first level.
        """
        if not isinstance(changes or {}, Mapping) or not all(isinstance(key, str) for key in changes or ()):
            raise InputError(f"set {changes!r}: not a mapping of keys; write for example {{'laws.pid.kp': 0.03}}")
        given = {**(changes or {}), **more}
        data = copy.deepcopy(self._data)
        for key, value in given.items():
            put(data, key, plain(value), f"set {key}")
        return ScenarioChoice(self._given, self.path, data, (*self._changes, *given.items()))

    def changed(self, changes: Changes | None, seed: int | None) -> ScenarioChoice:
        """Return the scenario with the changes that are not None."""
        more = {} if seed is None else {"seed": seed}
        return self.with_(changes, **more) if changes or more else self

    def assigned(self, texts: Sequence[str]) -> ScenarioChoice:
        """Return the scenario after ``--set`` options."""
        data = copy.deepcopy(self._data)
        for text in texts:
            assign(data, text)
        return ScenarioChoice(self._given, self.path, data, (*self._changes, *(("--set", text) for text in texts)))

    def prepare(
        self,
        scenario: Scenario | None = None,
        parts: PartCache | None = None,
        *,
        recorded: bool = False,
        noted: bool = True,
    ) -> RunSetup:
        """Return the setup of a run; ``scenario`` replaces the checked one, ``parts`` are those of former runs.

        Without ``noted``, as for one of the many runs of a study, a part without effect has no line.
        """
        try:
            setup = prepare(scenario or self.checked, self.path, parts, recorded=recorded)
        except ValueError as error:
            raise self._caused(error) from None
        if noted and not recorded and (unused := without_effect(setup.scenario)):
            print_assumption(f"{setup.scenario.name}: {unused}")
        return setup

    def _caused(self, error: ValueError) -> RefusedScenario:
        """Return a refusal with the changes that caused it in place of the file."""
        changes = [
            (value.partition("=")[0].strip(), f"--set {value}") if key == "--set" else (key, f"set {key}={value}")
            for key, value in self._changes
        ]
        return caused_by(error, self.path, changes)

    def _repr_html_(self) -> str:
        expected = None if self._changes or not isinstance(self._given, str) else expectation_of(self._given)
        verdict = f"expected verdict: {expected.text}" if expected else "no expected verdict: changed or not stated"
        return f"{verdict_html(verdict)}<p>{html.escape(repr(self))}: {html.escape(self.summary)}</p>"

    def __repr__(self) -> str:
        changes = f".with_({dict(self._changes)})" if self._changes else ""
        return f"scenario({self._given!r}){changes}"


GivenScenario: TypeAlias = "str | Path | Mapping[str, Any] | Scenario | ScenarioChoice"
"""Every form of a scenario that a function takes."""


def choose_scenario(name: GivenScenario) -> ScenarioChoice:
    """Return a scenario from its name, file, content or object.

    Parameters
    ----------
    name
        Shipped name, ``name:variant[+variant...]``, a YAML file, the content of one as a dict (also with ``base``), or
        a checked scenario.

    Raises
    ------
    ValueError
        If it does not exist or is wrong: one line with file, key and remedy.

    Examples
    --------
    >>> import train_ato as ta
    >>> ta.scenario("demo").checked.law
    'pid'
    >>> ta.scenario({"base": "demo", "law": "smc"}).checked.law
    'smc'
    >>> ta.scenario("demoo")
    Traceback (most recent call last):
    InputError: unknown scenario 'demoo' (did you mean 'demo'?); `train-ato list` names all
    """
    if isinstance(name, ScenarioChoice):
        return name
    if isinstance(name, Scenario):
        name = name.model_dump(mode="json", by_alias=True, exclude_unset=True)
    if not isinstance(name, (str, Path, Mapping)):
        raise ValueError(f"scenario of type {type(name).__name__}: give a name, a file, a dict or ta.scenario(...)")
    given = copy.deepcopy(dict(name)) if isinstance(name, Mapping) else str(name)
    path, data = raw_scenario(given)
    return ScenarioChoice(given, path, data)


def plain(value: Any) -> Any:
    """Return a copy with numbers and arrays of numpy as Python numbers and lists."""
    if isinstance(value, dict):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [plain(entry) for entry in value]
    convert = getattr(value, "tolist", None)
    return convert() if convert is not None else value


@dataclass(frozen=True)
class ComponentChoice:
    """A component and its parameters.

    Attributes
    ----------
    label : str
        Short name in tables and figures.
    component : str or type
        Registered name or ``module:Class``, or the class itself.
    values : dict
        Parameters of an object; they override those of the scenario.
    registry : Registry
        Registry of its kind.
    given : object
        The object; None for a name or a class.
    """

    label: str
    component: str | type
    values: dict[str, Any] = field(default_factory=dict)
    registry: Registry = LAWS
    given: Any = None

    @property
    def name(self) -> str:
        """Name of the component in a scenario."""
        if isinstance(self.component, str):
            return self.component
        try:
            return self.registry.name_of(self.component)
        except ValueError as error:
            raise ValueError(f"{self.registry.kind}: {error}") from None

    def put_into(self, scenario: Scenario) -> Scenario:
        """Return the scenario with this component and its parameters."""
        name, kind = self.name, self.registry.kind
        blocks = dict(getattr(scenario, f"{kind}s"))
        if self.values:
            blocks[name] = {**blocks.get(name, {}), **self.values}
        return scenario.model_copy(update={kind: name, f"{kind}s": blocks})

    def refuse_changes(self, changes: Changes | None) -> None:
        """Refuse changes of the parameters of an object, whose own parameters would replace them."""
        block = f"{self.registry.kind}s.{self.name}."
        lost = [key for key in changes or () if self.given is not None and f"{key}.".startswith(block)]
        if lost:
            raise ValueError(
                f"set {lost[0]}: no effect on an object, which has parameters of its own; give them to the object, "
                f"here {self.label}"
            )

    def check_importable(self) -> None:
        """Check that another process can import the component."""
        if ":" in self.name:
            try:
                load_class(self.name)
            except ValueError as error:
                kind = self.registry.kind
                raise ValueError(f"mode 'processes': another process cannot import the {kind}: {error}") from None


def choose_component(registry: Registry, given: Any) -> ComponentChoice:
    """Return the component for ``law=``, ``observer=`` or ``compensation=``."""
    kind = registry.kind
    if isinstance(given, str):
        return ComponentChoice(given, given, registry=registry)
    if isinstance(given, type):
        return ComponentChoice(given.__name__, given, registry=registry)
    if callable(getattr(given, "step", None)):
        values = {name: plain(value) for name, value in keyword_values(given, kind).items()}
        inside = ", ".join(f"{name}={value!r}" for name, value in values.items())
        return ComponentChoice(f"{type(given).__name__}({inside})", type(given), values, registry, given)
    raise ValueError(f"{kind} {given!r}: give a name, 'module:Class', a class or an object")


def put_components(scenario: Scenario, *, importable: bool, changes: Changes | None = None, **given: Any) -> Scenario:
    """Return the scenario with the components that are not None.

    Parameters
    ----------
    scenario
        Checked scenario.
    importable
        Other processes must be able to import the components.
    changes
        Changes of the same call; parameters of an object among them are refused.
    **given
        ``law``, ``observer`` and ``compensation``, each a name, ``module:Class``, a class or an object.
    """
    for component in _components(given):
        component.refuse_changes(changes)
        scenario = component.put_into(scenario)
        if importable:
            component.check_importable()
    return scenario


def given_objects(scenario: Scenario, **given: Any) -> dict[str, GivenComponent]:
    """Return the objects among the components of a scenario by kind, without names and classes."""
    objects = [choice for choice in _components(given) if choice.given is not None]
    blocks = {choice.registry.kind: getattr(scenario, f"{choice.registry.kind}s") for choice in objects}
    return {
        kind: GivenComponent(choice.given, choice.name, dict(blocks[kind].get(choice.name, {})))
        for kind, choice in zip(blocks, objects, strict=True)
    }


def _components(given: Mapping[str, Any]) -> list[ComponentChoice]:
    """Return the components by kind that are not None."""
    return [choose_component(REGISTRIES[kind], entry) for kind, entry in given.items() if entry is not None]
