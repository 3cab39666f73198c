"""Components with a page of their own: every law, observer and compensation of this package."""

from __future__ import annotations

import inspect
import sys
from dataclasses import dataclass
from typing import Any

from train_ato.control.contract import Parameter
from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS, Registry

REGISTRIES = (LAWS, OBSERVERS, COMPENSATIONS)
PLURAL = {"law": "laws", "observer": "observers", "compensation": "compensations"}
KIND = {"law": "control law", "observer": "disturbance observer", "compensation": "delay compensation"}


@dataclass(frozen=True)
class Component:
    """A law, an observer or a compensation.

    Attributes
    ----------
    page : str
        File name of its page and figure without ending: its name, with its kind where two kinds share the name.
    """

    registry: Registry
    name: str
    page: str

    @property
    def kind(self) -> str:
        """``law``, ``observer`` or ``compensation``."""
        return self.registry.kind

    @property
    def key(self) -> str:
        """Name among the measured figures."""
        return f"{self.kind}/{self.name}"

    @property
    def cls(self) -> Any:
        """The class."""
        return self.registry.get(self.name)

    @property
    def summary(self) -> str:
        """First line of the class's docstring."""
        return self.registry.summary(self.name)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters, in the order of their declaration."""
        return self.registry.parameters(self.name)

    @property
    def text(self) -> str:
        """Docstring of its module, cleaned: equations, corrections, needs."""
        return inspect.cleandoc(sys.modules[self.cls.__module__].__doc__ or "")

    @property
    def source(self) -> str:
        """File of its module, from the root of the repository."""
        module: str = self.cls.__module__
        return module.replace(".", "/") + ".py"


def components() -> tuple[Component, ...]:
    """Return the components of this package, ordered by kind."""
    found = [(registry, name) for registry in REGISTRIES for name in registry.loadable()]
    ours = [
        (registry, name)
        for registry, name in found
        if ":" not in name and registry.get(name).__module__.startswith("train_ato.")
    ]
    names = [name for _, name in ours]
    return tuple(
        Component(registry, name, name if names.count(name) == 1 else f"{name}_{registry.kind}")
        for registry, name in ours
    )
