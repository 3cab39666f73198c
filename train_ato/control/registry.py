"""Laws, observers and compensations (components) by name.

The components of this project are in the tables below. Another package registers its own by an entry point in the
group of the registry, for example in its ``pyproject.toml``::

    [project.entry-points."train_ato.controllers"]
    my_law = "my_package.my_law:MyLaw"

A component can also be named as ``module:Class`` without registration; modules of the current folder are found. A
component is imported at its first use. Its parameters are a dataclass, or keywords: ``MyLaw(gain=0.1)``.
"""

import dataclasses
import importlib
import inspect
import math
import os
import sys
from collections.abc import Collection, Mapping
from contextlib import suppress
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from plant_sim.input_error import close_match
from train_ato.control.component_fault import refused_at_start, text_of_error
from train_ato.control.contract import Parameter, RefusedParameter, make_parameters, parameter, parameters_of
from train_ato.control.gains import Gains, gains_of

_KINDS = {"bool": bool, "int": int, "float": float, "str": str}
_OF_TRAIN = ("model", "period", "n", "share", "saturated", "actuators", "shoes")
"""Attributes that the bases of laws, observers and compensations set for a train."""


class KeywordForm:
    """A law, observer or compensation class with keyword parameters, in the form ``(parameters, model, period)``.

    Parameters
    ----------
    component
        Class whose constructor takes keywords with defaults and keeps each one in an attribute of that name.

    Attributes
    ----------
    component : type
        The class; its other attributes are also attributes of this object.
    Parameters : type
        Frozen dataclass made from the keywords.  A field of a dataclass that was made by
        :func:`train_ato.control.contract.parameter` keeps its unit, range and meaning; others have no range.

    Raises
    ------
    ValueError
        If the class has no ``step()`` or ``reset()``, or a keyword without a usable default.
    """

    def __init__(self, component: type) -> None:
        for method in ("reset", "step"):
            if not callable(getattr(component, method, None)):
                raise ValueError(f"class {component.__name__} has no method {method}(); add reset() and step()")
        self.component = component
        self.__doc__ = component.__doc__
        self.__module__ = component.__module__
        self.Parameters = _dataclass_of(component)

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the class, for example ``predicts`` of a compensation."""
        return getattr(self.__dict__["component"], name)

    def __call__(self, parameters: Any, model: Any, period: float) -> Any:
        """Return a new component for one train."""
        values = {entry.name: getattr(parameters, entry.name) for entry in dataclasses.fields(parameters)}
        return started(self.component(**values), model, period, values)


@dataclasses.dataclass(frozen=True)
class GivenComponent:
    """An object such as ``MyLaw(gain=0.1)`` with its name in the scenario and its keywords."""

    component: Any
    name: str
    values: Mapping[str, Any]


def started(component: Any, model: Any, period: float, names: Collection[str]) -> Any:
    """Bind a component with keywords to a train and the control period [s], clear its state, and return it.

    Raises
    ------
    ValueError
        If a value of the train replaces one of the named parameters, so that it has no effect.
    """
    bind = getattr(component, "bind", None)
    if bind is not None:
        given = {name: getattr(component, name) for name in _OF_TRAIN if name in names and hasattr(component, name)}
        bind(model, period)
        if taken := next((name for name, value in given.items() if getattr(component, name) is not value), None):
            raise ValueError(f"bind() replaces its parameter '{taken}'; choose another name for the parameter")
    component.reset()
    return component


def in_contract_form(block: Any) -> Any:
    """Return a class with ``Parameters`` unchanged, and any other class as a :class:`KeywordForm`."""
    return KeywordForm(block) if isinstance(block, type) and not hasattr(block, "Parameters") else block


def keyword_values(component: object, kind: str) -> dict[str, Any]:
    """Return the parameters of an object such as ``MyLaw(gain=0.1)``; ``kind`` begins the messages.

    Raises
    ------
    ValueError
        If the class is not one with keyword parameters, or the object does not keep one of them.
    """
    name = type(component).__name__
    if hasattr(type(component), "Parameters"):
        raise ValueError(f"{kind}: this {name} was made for one train; give the class {name} or its name instead")
    values = {}
    for entry in parameters_of(KeywordForm(type(component)).Parameters):
        if not hasattr(component, entry.name):
            raise ValueError(
                f"{kind}: {name} does not keep its parameter '{entry.name}'; set self.{entry.name} in __init__, "
                "or make the class a dataclass"
            )
        values[entry.name] = getattr(component, entry.name)
    return values


def _dataclass_of(component: type) -> type:
    """Return the parameter dataclass that the keywords of a constructor make."""
    described = (
        {entry.name: entry for entry in dataclasses.fields(component)} if dataclasses.is_dataclass(component) else {}
    )
    fields = []
    for entry in inspect.signature(component).parameters.values():
        kind = _KINDS.get(getattr(entry.annotation, "__name__", entry.annotation), type(entry.default))
        default = float(entry.default) if kind is float and type(entry.default) is int else entry.default
        if entry.kind in (entry.VAR_POSITIONAL, entry.VAR_KEYWORD, entry.POSITIONAL_ONLY):
            raise ValueError(f"class {component.__name__}: '{entry}' in __init__; name every parameter")
        if type(default) not in _KINDS.values():
            raise ValueError(
                f"class {component.__name__}: parameter '{entry.name}' needs a default that is a number, a truth "
                f"value or a text, for example {entry.name}: float = 1.0"
            )
        field = described.get(entry.name)
        if field is not None and "parameter" in field.metadata:
            made = dataclasses.field(default=default, metadata=field.metadata)
        else:
            made = parameter(default, "", -math.inf, math.inf, entry.name.replace("_", " "))
        fields.append((entry.name, type(default), made))
    return dataclasses.make_dataclass("Parameters", fields, frozen=True)


class Registry:
    """Components of one kind by name.

    Parameters
    ----------
    kind
        Kind in messages: ``controller``, ``observer`` or ``compensation``.
    group
        Entry-point group of other packages.
    built_in
        Name to ``module:Class`` for the components of this project.
    methods
        Methods that every component must have.
    """

    def __init__(
        self, kind: str, group: str, built_in: Mapping[str, str], methods: tuple[str, ...] = ("reset", "step")
    ) -> None:
        self.kind = kind
        self.group = group
        self.methods = methods
        self._targets: dict[str, str] = dict(built_in)
        self._loaded: dict[str, Any] = {}
        self._unregistered: dict[str, Any] = {}

    def register(self, name: str, target: type) -> None:
        """Add a class under a new name."""
        if name in self._targets or name in self._loaded:
            raise ValueError(f"{self.kind} '{name}' is registered already; choose another name")
        self._loaded[name] = self._in_form(target)

    def name_of(self, block: type) -> str:
        """Return the name of a class; one that is not registered can be used as ``module:Class`` from then on.

        The last class of a ``module:Class`` counts, as after a second run of a notebook's cell.
        """
        target = f"{block.__module__}:{block.__qualname__}"
        for name, loaded in self._loaded.items():
            if getattr(loaded, "component", loaded) is block:
                return name
        external = {name: point.value for name, point in self._entry_points().items()}
        for name in (*self._targets, *external):
            if target in (self._targets.get(name), external.get(name)):
                return name
        self._unregistered[target] = self._in_form(block)
        return target

    def names(self) -> tuple[str, ...]:
        """Return the registered names, sorted, including those of other packages."""
        return tuple(sorted({*self._targets, *self._loaded, *self._entry_points()}))

    def loadable(self) -> tuple[str, ...]:
        """Return the names whose class can be imported; a broken package affects only its own components."""
        found = []
        for name in self.names():
            with suppress(ValueError):
                self.get(name)
                found.append(name)
        return tuple(found)

    def get(self, name: str) -> Any:
        """Return the class registered under ``name``, or the class ``module:Class``.

        Raises
        ------
        ValueError
            If the name is not registered or its module cannot be imported.
        """
        known = self._unregistered if ":" in str(name) else self._loaded
        found = known.get(name)
        if found is not None:
            return found
        target = self._targets.get(name, name if ":" in str(name) else None)
        if target is None and (entry := self._entry_points().get(name)) is not None:
            target = f"{entry.module}:{entry.attr}"
        if target is None:
            names = self.names()
            hint = close_match(str(name), names)
            own = "" if hint else f"; one of your own is MODULE:CLASS, for example my_{self.kind}:My{self.kind.title()}"
            raise ValueError(f"unknown {self.kind} '{name}'{hint}; known: {', '.join(names)}{own}")
        try:
            loaded = self._in_form(load_class(target))
        except ValueError as error:
            raise ValueError(f"{self.kind} '{name}': {error}") from error.__cause__
        known[name] = loaded
        return loaded

    def parameters(self, name: str) -> tuple[Parameter, ...]:
        """Return the parameters of a component, in order."""
        return parameters_of(self.get(name).Parameters)

    def summary(self, name: str) -> str:
        """Return the first line of the docstring of a component."""
        return (self.get(name).__doc__ or "").strip().partition("\n")[0]

    def check_parameters(self, name: str, values: Mapping[str, Any]) -> None:
        """Check parameters without making the component."""
        make_parameters(self.get(name).Parameters, values, name)

    def make(self, name: str, values: Mapping[str, Any], *arguments: Any) -> Any:
        """Return a new component; ``arguments`` follow the parameters in its constructor.

        Raises
        ------
        ValueError
            For an unknown component, a wrong parameter, or a train that the component rejects.
        """
        component = self.get(name)
        parameters = make_parameters(component.Parameters, values, name)
        with refused_at_start(self.kind, name, component):
            try:
                made = component(parameters, *arguments)
                if self.kind == "law" and (fault := preview_fault(made)):
                    raise ValueError(fault)
                return made
            except RefusedParameter as error:
                raise error.of(self.kind, name) from None
            except ValueError as error:
                raise ValueError(f"{self.kind} '{name}': {error}") from None

    def _in_form(self, block: Any) -> Any:
        """Return a class in the form of the contract; raise ValueError if it has not all methods of its kind."""
        found = in_contract_form(block)
        for method in self.methods:
            if isinstance(block, type) and not callable(getattr(block, method, None)):
                remedy = f"see the template of `train-ato new {self.kind} mine`"
                raise ValueError(f"class {block.__name__} has no method {method}(); {remedy}")
        return found

    def _entry_points(self) -> dict[str, EntryPoint]:
        folders = (Path(entry).absolute() for entry in sys.path)
        return _installed(self.group, tuple((folder, _changed_at(folder)) for folder in folders))


def preview_fault(law: Any) -> str:
    """Return the fault of the horizon or of the lookahead times of a law; "" without one."""
    horizon, times = getattr(law, "horizon", 0), getattr(law, "lookahead_times", None)
    if isinstance(horizon, bool) or not isinstance(horizon, (int, np.integer)) or horizon < 0:
        return f"horizon is {horizon!r}; give a number of entries, 0 or more"
    numbers = isinstance(times, np.ndarray) and times.ndim == 1 and times.dtype.kind in "fiu"
    if times is None or (numbers and np.isfinite(times).all()):
        return ""
    shown = " ".join(str(times).split())[:60]
    return f"lookahead_times is {shown}; give a numpy array of times in s"


class LawRegistry(Registry):
    """Laws by name; the parameters that are not given follow from the train (:mod:`train_ato.control.gains`)."""

    def gains(self, name: str, values: Mapping[str, Any], model: Any, period: float) -> Gains:
        """Return the parameters of a law for a train."""
        return gains_of(name, self.get(name), values, model, period)

    def make(self, name: str, values: Mapping[str, Any], *arguments: Any) -> Any:
        """Return a new law for a train and a period: the second and the third argument."""
        return super().make(name, self.gains(name, values, *arguments).values, *arguments)


@cache
def _installed(group: str, path: tuple[tuple[Path, int], ...]) -> dict[str, EntryPoint]:
    """Return the entry points of a group on a path; a search reads a file of every installed package."""
    return {point.name: point for point in entry_points(group=group)}


def _changed_at(folder: Path) -> int:
    """Return the time of the last change of a folder [ns], 0 without one; Python compares the same."""
    try:
        return folder.stat().st_mtime_ns
    except OSError:
        return 0


def load_class(target: str) -> type:
    """Import the class ``module:Class`` (or ``module.Class``); the current folder is searched last."""
    module_name, _, attribute = target.partition(":") if ":" in target else target.rpartition(".")
    if target.endswith(".py"):
        module_name, attribute = target, "CLASS"
    if not module_name or not attribute or module_name.startswith("."):
        raise ValueError(f"'{target}' does not name a class; write package.module:Class")
    if "/" in module_name or module_name.endswith(".py"):
        file = Path(module_name)
        place = "" if file.parent == Path() else f", in the folder {file.parent}"
        raise ValueError(f"'{target}' names a file; write {file.stem}:{attribute}{place}")
    if module_name == "__main__" or "<locals>" in attribute:
        raise ValueError(
            f"{attribute.rpartition('.')[2]}: a class of a script, a notebook or a function is in no module; move it "
            "into one of its own, for example my_law.py, and name it as my_law:MyLaw"
        )
    try:
        module = _module(module_name)
    except (Exception, SystemExit) as error:
        missing = isinstance(error, ModuleNotFoundError) and error.name == module_name.partition(".")[0]
        problem = "there is none of this name here or in the Python path" if missing else text_of_error(error)
        raise ValueError(f"module '{module_name}' cannot be imported: {problem}; correct name or module") from error
    found: Any = module
    for name in attribute.split("."):
        found = getattr(found, name, None)
    if not isinstance(found, type):
        near = close_match(attribute, [name for name, value in vars(module).items() if isinstance(value, type)])
        origin = getattr(module, "__file__", None) or "a part of Python"
        raise ValueError(f"module '{module_name}' has no class '{attribute}'{near}; its file is {origin}")
    return found


def _module(name: str) -> ModuleType:
    """Import a module; its change of the present folder is undone, as that is where the files of a run belong."""
    here = str(Path.cwd())
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name.partition(".")[0] or here in sys.path:
            raise
        sys.path.append(here)
        importlib.invalidate_caches()
        return importlib.import_module(name)
    finally:
        os.chdir(here)


LAWS = LawRegistry(
    "law",
    "train_ato.controllers",
    {
        "pid": "train_ato.control.laws.pid:Pid",
        "smc": "train_ato.control.laws.smc:Smc",
        "fixed_time_smc": "train_ato.control.laws.fixed_time_smc:FixedTimeSmc",
        "lag_smc": "train_ato.control.laws.lag_smc:LagSmc",
        "funnel": "train_ato.control.laws.funnel:Funnel",
        "gpc": "train_ato.control.laws.gpc:Gpc",
        "mpc": "train_ato.control.laws.mpc:Mpc",
        "rbf_smc": "train_ato.control.laws.rbf_smc:RbfSmc",
        "rbf_switching_smc": "train_ato.control.laws.rbf_switching_smc:RbfSwitchingSmc",
    },
)
"""Control laws."""
OBSERVERS = Registry(
    "observer",
    "train_ato.observers",
    {
        "none": "train_ato.control.observers.none:NoObserver",
        "ndo": "train_ato.control.observers.ndo:Ndo",
        "cascaded": "train_ato.control.observers.cascaded:Cascaded",
        "eso": "train_ato.control.observers.eso:Eso",
    },
)
"""Disturbance observers."""
COMPENSATIONS = Registry(
    "compensation",
    "train_ato.compensations",
    {
        "none": "train_ato.control.compensation.none:NoCompensation",
        "pade": "train_ato.control.compensation.pade:Pade",
        "preview": "train_ato.control.compensation.preview:PreviewFeedforward",
        "predictor": "train_ato.control.compensation.predictor:Predictor",
        "train_predictor": "train_ato.control.compensation.train_predictor:TrainPredictor",
        "twin": "train_ato.control.compensation.twin:Twin",
    },
    ("reset", "step", "set_profile"),
)
"""Delay compensations."""
REGISTRIES: dict[str, Registry] = {registry.kind: registry for registry in (LAWS, OBSERVERS, COMPENSATIONS)}
"""Registries by kind."""
