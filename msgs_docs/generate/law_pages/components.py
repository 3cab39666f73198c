"""The blocks that have a page: every law, observer and compensation of this package."""

from __future__ import annotations

import inspect
import sys
from dataclasses import dataclass
from typing import Any

from train_ato.compensate.registry import COMPENSATIONS
from train_ato.control.contract import Parameter
from train_ato.control.registry import LAWS, Registry
from train_ato.observe.registry import OBSERVERS

REGISTRIES = (LAWS, OBSERVERS, COMPENSATIONS)
PLURAL = {"controller": "laws", "observer": "observers", "compensation": "compensations"}
KIND = {"controller": "control law", "observer": "disturbance observer", "compensation": "delay compensation"}


@dataclass(frozen=True)
class Block:
    """A law, an observer or a compensation.

    Attributes
    ----------
    page : str
        Name of its page and figure, without an ending: the block's name, and its kind where two kinds share it.
    """

    registry: Registry
    name: str
    page: str

    @property
    def kind(self) -> str:
        """``controller``, ``observer`` or ``compensation``."""
        return self.registry.kind

    @property
    def key(self) -> str:
        """Name among the measured figures."""
        return f"{self.kind}/{self.name}"

    @property
    def block(self) -> Any:
        """The class."""
        return self.registry.get(self.name)

    @property
    def summary(self) -> str:
        """First line of the class's docstring."""
        return self.registry.summary(self.name)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What can be set."""
        return self.registry.parameters(self.name)

    @property
    def text(self) -> str:
        """Docstring of its module: the law itself."""
        return inspect.cleandoc(sys.modules[self.block.__module__].__doc__ or "")

    @property
    def source(self) -> str:
        """File of its module, from the root of the repository."""
        module: str = self.block.__module__
        return module.replace(".", "/") + ".py"


def blocks() -> tuple[Block, ...]:
    """Return the blocks of this package in the order of their kinds; those of other packages document themselves."""
    found = [(registry, name) for registry in REGISTRIES for name in registry.loadable()]
    ours = [(registry, name) for registry, name in found if registry.get(name).__module__.startswith("train_ato.")]
    names = [name for _, name in ours]
    return tuple(
        Block(registry, name, name if names.count(name) == 1 else f"{name}_{registry.kind}") for registry, name in ours
    )
