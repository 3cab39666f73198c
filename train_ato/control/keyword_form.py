"""Components with parameters as keywords: ``MyLaw(gain=0.1)`` instead of a separate parameter dataclass."""

import dataclasses
import inspect
import math
from collections.abc import Mapping
from typing import Any

from train_ato.control.contract import parameter, parameters_of

_KINDS = {"bool": bool, "int": int, "float": float, "str": str}


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
        return started(self.component(**values), model, period)


@dataclasses.dataclass(frozen=True)
class GivenComponent:
    """An object such as ``MyLaw(gain=0.1)`` with its name in the scenario and its keywords."""

    component: Any
    name: str
    values: Mapping[str, Any]


def started(component: Any, model: Any, period: float) -> Any:
    """Bind a component with keywords to a train and the control period [s], clear its state, and return it."""
    bind = getattr(component, "bind", None)
    if bind is not None:
        bind(model, period)
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
