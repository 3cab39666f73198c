"""Law, observer and compensation of a run: a registered name, ``module:Class``, a class, or an object."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from train_ato.apps.runs.scenario_choice import plain
from train_ato.control.keyword_form import GivenComponent, keyword_values
from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS, Registry, load_class
from train_ato.scenario.scenario import Scenario


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
        """Name of the component in a scenario.

        Raises
        ------
        ValueError
            If the class is no component.
        """
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

    def check_importable(self) -> None:
        """Check that another process can import the component.

        Raises
        ------
        ValueError
            If its class was defined in a script, a notebook or a function.
        """
        if ":" in self.name:
            try:
                load_class(self.name)
            except ValueError as error:
                kind = self.registry.kind
                raise ValueError(f"mode 'processes': another process cannot import the {kind}: {error}") from None


def choose_component(registry: Registry, given: Any) -> ComponentChoice:
    """Return the component for ``law=``, ``observer=`` or ``compensation=``.

    Raises
    ------
    ValueError
        If it is not a component.
    """
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


def put_components(
    scenario: Scenario, *, law: Any = None, observer: Any = None, compensation: Any = None, importable: bool
) -> Scenario:
    """Return the scenario with the components that are not None.

    Parameters
    ----------
    scenario
        Checked scenario.
    law, observer, compensation
        Each a name, ``module:Class``, a class or an object.
    importable
        Other processes must be able to import the components.

    Raises
    ------
    ValueError
        If one is not a component, or cannot be imported.
    """
    chosen = ((LAWS, law), (OBSERVERS, observer), (COMPENSATIONS, compensation))
    for registry, given in chosen:
        if given is not None:
            component = choose_component(registry, given)
            scenario = component.put_into(scenario)
            if importable:
                component.check_importable()
    return scenario


def given_objects(
    scenario: Scenario, *, law: Any = None, observer: Any = None, compensation: Any = None
) -> dict[str, GivenComponent]:
    """Return the objects among the components of a scenario by kind, without names and classes."""
    chosen = ((LAWS, law), (OBSERVERS, observer), (COMPENSATIONS, compensation))
    found = [choose_component(registry, given) for registry, given in chosen if given is not None]
    return {
        choice.registry.kind: GivenComponent(
            choice.given, choice.name, dict(getattr(scenario, f"{choice.registry.kind}s")[choice.name])
        )
        for choice in found
        if choice.given is not None
    }
