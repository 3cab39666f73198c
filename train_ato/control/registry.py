"""Blocks that are chosen by name: laws here, observers and compensations in their own packages.

A block of this project is registered in a table below its registry; a package outside registers through an entry
point of the registry's group, for example in its ``pyproject.toml``::

    [project.entry-points."train_ato.controllers"]
    my_law = "my_package.my_law:MyLaw"

Blocks are imported when they are first asked for.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from contextlib import suppress
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from train_ato.control.contract import Parameter, parameters_of
from train_ato.control.parameters import closest, make_parameters


class Registry:
    """Names of blocks of one kind and where they are found.

    Parameters
    ----------
    kind
        Word for messages: ``controller``, ``observer``, ``compensation``.
    group
        Entry-point group in which other packages register.
    built_in
        Name to ``module:Class``.
    """

    def __init__(self, kind: str, group: str, built_in: Mapping[str, str]) -> None:
        self.kind = kind
        self.group = group
        self._targets: dict[str, str] = dict(built_in)
        self._loaded: dict[str, type] = {}

    def register(self, name: str, target: str | type) -> None:
        """Add a block under a new name: a class, or ``module:Class``.

        Raises
        ------
        ValueError
            If the name is taken.
        """
        if name in self._targets or name in self._loaded:
            raise ValueError(f"{self.kind} '{name}' is registered already; choose another name")
        if isinstance(target, str):
            self._targets[name] = target
        else:
            self._loaded[name] = target

    def names(self) -> tuple[str, ...]:
        """Return every known name, sorted, those of other packages included."""
        return tuple(sorted({*self._targets, *self._loaded, *self._outside()}))

    def loadable(self) -> tuple[str, ...]:
        """Return the names whose class can be loaded: a broken package of somebody else harms only who asks for it."""
        found = []
        for name in self.names():
            with suppress(ValueError):
                self.get(name)
                found.append(name)
        return tuple(found)

    def get(self, name: str) -> Any:
        """Return the class registered under ``name``.

        Raises
        ------
        ValueError
            If nothing is registered under it, or its module cannot be imported.
        """
        found = self._loaded.get(name)
        if found is not None:
            return found
        target = self._targets.get(name)
        outside = self._outside() if target is None else {}
        if target is None and name not in outside:
            names = self.names()
            hint = closest(str(name), names)
            raise ValueError(f"unknown {self.kind} '{name}'{hint}; known: {', '.join(names)}")
        try:
            loaded = load(target) if target is not None else outside[name].load()
        except Exception as error:
            raise ValueError(f"{self.kind} '{name}' cannot be loaded: {type(error).__name__}: {error}") from error
        self._loaded[name] = loaded
        return loaded

    def parameters(self, name: str) -> tuple[Parameter, ...]:
        """Return the parameters of a block, in order."""
        return parameters_of(self.get(name).Parameters)

    def summary(self, name: str) -> str:
        """Return the first line of a block's docstring."""
        return (self.get(name).__doc__ or "").strip().partition("\n")[0]

    def check_parameters(self, name: str, values: Mapping[str, Any]) -> None:
        """Check parameters without making the block.

        Raises
        ------
        ValueError
            For an unknown block or a wrong parameter.
        """
        make_parameters(self.get(name).Parameters, values, name)

    def make(self, name: str, values: Mapping[str, Any], *arguments: Any) -> Any:
        """Return a new block with its parameters checked; ``arguments`` follow the parameters in its constructor.

        Raises
        ------
        ValueError
            With the reason: unknown block, wrong parameter, or a train on which the block makes no sense.
        """
        block = self.get(name)
        parameters = make_parameters(block.Parameters, values, name)
        try:
            return block(parameters, *arguments)
        except ValueError as error:
            raise ValueError(f"{self.kind} '{name}': {error}") from None

    def _outside(self) -> dict[str, EntryPoint]:
        return {point.name: point for point in entry_points(group=self.group)}


def load(target: str) -> type:
    """Return the class that ``module:Class`` (or ``module.Class``) names.

    Raises
    ------
    ValueError
        If the module or the class is not there.
    """
    module_name, _, attribute = target.partition(":") if ":" in target else target.rpartition(".")
    if not module_name or not attribute:
        raise ValueError(f"'{target}' does not name a class; write package.module:Class")
    try:
        module = importlib.import_module(module_name)
    except ImportError as error:
        raise ValueError(f"module '{module_name}' cannot be imported: {error}") from error
    found = getattr(module, attribute, None)
    if not isinstance(found, type):
        classes = [name for name, value in vars(module).items() if isinstance(value, type)]
        raise ValueError(f"module '{module_name}' has no class '{attribute}'{closest(attribute, classes)}")
    return found


LAWS = Registry(
    "controller",
    "train_ato.controllers",
    {
        "pid": "train_ato.control.laws.pid:Pid",
        "smc": "train_ato.control.laws.smc:Smc",
        "fixed_time_smc": "train_ato.control.laws.fixed_time_smc:FixedTimeSmc",
        "lag_smc": "train_ato.control.laws.lag_smc:LagSmc",
        "funnel": "train_ato.control.laws.funnel:Funnel",
        "gpc": "train_ato.control.laws.gpc:Gpc",
        "rbf_smc": "train_ato.control.laws.rbf_smc:RbfSmc",
        "rbf_switching_smc": "train_ato.control.laws.rbf_switching_smc:RbfSwitchingSmc",
    },
)
"""Control laws."""
