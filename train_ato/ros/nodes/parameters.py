"""ROS parameters of the nodes from the declarations of laws and observers.

Every double has a range, because rclpy accepts NaN without one.  Unknown names are refused, because rclpy ignores
them without an error.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from plant_sim.units import number_text
from train_ato.control.contract import Parameter
from train_ato.control.registry import LAWS, OBSERVERS
from train_ato.ros.nodes.parameter_services import unknown_parameter

OF_NODES = {"law", "controller", "observer"}
"""Parameters of the nodes besides those of laws and observers; the plant adds its own."""
_LARGEST = 1.7e308
_INT64 = 2**63 - 1
_CLOCK = frozenset({"use_sim_time", "start_type_description_service"})


@dataclass(frozen=True)
class Declared:
    """ROS parameter of a node: full name, start value and declaration."""

    name: str
    value: Any
    entry: Parameter
    read_only: bool = False


def declare(node: Node, parameters: list[Declared]) -> dict[str, Any]:
    """Declare parameters on a node and return their values, with the start parameters applied."""
    names = [parameter.name for parameter in parameters]
    overrides = node._parameter_overrides
    for given in overrides:
        known = given in names or given in _CLOCK or _of_another_node(given)
        if not known and not given.startswith("qos_overrides."):
            raise ValueError(unknown_parameter(node.get_name(), given, names))
    values = {}
    for parameter in parameters:
        given = overrides.get(parameter.name)
        if isinstance(parameter.value, float) and given is not None and type(given.value) is int:
            overrides[parameter.name] = RosParameter(parameter.name, value=float(given.value))
        try:
            values[parameter.name] = node.declare_parameter(
                parameter.name, parameter.value, descriptor(parameter)
            ).value
        except (InvalidParameterValueException, InvalidParameterTypeException):
            text = parameter.value if given is None else given.value
            raise ValueError(f"parameter {parameter.name}: {text!r} is refused; {_wanted(parameter)}") from None
        value = values[parameter.name]
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError(f"parameter {parameter.name}: {value} is not finite; {_range(parameter.entry)}")
    return values


def _of_another_node(name: str) -> bool:
    """Return True for a parameter of another node of a graph: a file for all nodes has those of each."""
    if name in OF_NODES:
        return True
    block, _, key = name.rpartition(".")
    return any(
        block in registry.names() and key in {entry.name for entry in registry.parameters(block)}
        for registry in (LAWS, OBSERVERS)
    )


def _wanted(parameter: Declared) -> str:
    """Return the values of a parameter, as the remedy for a wrong one."""
    if isinstance(parameter.value, bool):
        return "give true or false"
    if isinstance(parameter.value, str):
        return f"give {' or '.join(parameter.entry.choices) or 'a text'}"
    return _range(parameter.entry)


def _range(entry: Parameter) -> str:
    return f"give {number_text(entry.low)} ... {number_text(entry.high)} {entry.unit}".rstrip()


def descriptor(parameter: Declared) -> Any:
    """Return the descriptor of a parameter: meaning, unit, range, choices."""
    entry = parameter.entry
    result = ParameterDescriptor(
        name=parameter.name,
        description=f"{entry.meaning} [{entry.unit}]" if entry.unit else entry.meaning,
        read_only=parameter.read_only,
        additional_constraints=f"one of: {', '.join(entry.choices)}" if entry.choices else "",
    )
    if isinstance(entry.default, (bool, str)):
        return result
    if isinstance(entry.default, int):
        low, high = (int(min(max(bound, -_INT64), _INT64)) for bound in (entry.low, entry.high))
        result.integer_range = [IntegerRange(from_value=low, to_value=high, step=0)]
    else:
        low_f, high_f = (float(min(max(bound, -_LARGEST), _LARGEST)) for bound in (entry.low, entry.high))
        result.floating_point_range = [FloatingPointRange(from_value=low_f, to_value=high_f, step=0.0)]
    return result


def block_parameters(
    block: str, entries: tuple[Parameter, ...], given: Mapping[str, Any], *, read_only: bool = False
) -> list[Declared]:
    """Return the ROS parameters of a law or an observer, ``block.name``, with the scenario's values as defaults."""
    found = []
    for entry in entries:
        value = given.get(entry.name, entry.default)
        if isinstance(entry.default, float):
            value = float(value)
        found.append(Declared(f"{block}.{entry.name}", value, entry, read_only))
    return found
