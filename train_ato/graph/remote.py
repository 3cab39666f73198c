"""Changing a parameter of a running node from another process."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from plant_sim.input_error import close_match
from train_ato.graph.environment import applied, held_domains, variables

WAIT_S = 10.0
"""Longest time in which the node has to be found and to answer."""


def the_running_domain(wanted: int | None) -> int:
    """Return the domain of the run that is meant.

    Raises
    ------
    ValueError
        If no run is going on, or several are and none was named.
    """
    held = held_domains()
    if wanted is not None:
        if wanted not in held:
            raise ValueError(f"--domain {wanted}: no run holds it; running: {_listed(held)}")
        return wanted
    if len(held) != 1:
        raise ValueError(
            f"{'no run is' if not held else 'several runs are'} going on ({_listed(held)}); name --domain N"
        )
    return held[0]


def _listed(domains: list[int]) -> str:
    return ", ".join(map(str, domains)) or "none"


def set_parameter(domain: int, node: str, name: str, value: Any) -> str | None:
    """Set one parameter of a running node.

    Returns
    -------
    str or None
        The reason if the node refused, else None.

    Raises
    ------
    ValueError
        If the node is not there or does not answer.
    """
    with tempfile.TemporaryDirectory(prefix="train_ato_set_") as scratch, applied(variables(domain, Path(scratch))):
        import rclpy
        from rcl_interfaces.msg import ParameterType
        from rclpy.parameter import Parameter
        from rclpy.parameter_client import AsyncParameterClient

        context = rclpy.Context()
        rclpy.init(context=context, domain_id=domain)
        try:
            asking = rclpy.create_node("train_ato_set", context=context, enable_rosout=False)
            client = AsyncParameterClient(asking, node)
            if not client.wait_for_services(WAIT_S):
                raise ValueError(f"node '{node}' is not on domain {domain}; is the run still going on?")
            executor = rclpy.executors.SingleThreadedExecutor(context=context)
            executor.add_node(asking)
            types = _answer(executor, client.get_parameter_types([name]), node, domain).types
            if list(types) in ([], [ParameterType.PARAMETER_NOT_SET]):
                known = _answer(executor, client.list_parameters(), node, domain).result.names
                raise ValueError(f"{node} has no parameter '{name}'{close_match(name, known)}")
            if isinstance(value, int) and list(types) == [ParameterType.PARAMETER_DOUBLE]:
                value = float(value)
            change = client.set_parameters([Parameter(name, value=value)])
            result = _answer(executor, change, node, domain).results[0]
            executor.shutdown()
            asking.destroy_node()
        finally:
            context.try_shutdown()
    return None if result.successful else str(result.reason)


def _answer(executor: Any, future: Any, node: str, domain: int) -> Any:
    executor.spin_until_future_complete(future, WAIT_S)
    if not future.done():
        raise ValueError(f"node '{node}' on domain {domain} does not answer")
    return future.result()
