"""Access to a running graph from another process: set a parameter, call a service."""

import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from plant_sim.input_error import close_match
from train_ato.ros import require_ros
from train_ato.ros.graph.domain_lock import TRAINS, locked_runs
from train_ato.ros.graph.environment import applied, domain_of_environment, held_domains, opened_by, variables
from train_ato.scenario.leader import check_namespace

WAIT_S = 30.0
"""Maximum wall time to find a node, and to receive its answer [s]."""
ELSEWHERE_S = 5.0
"""Wall time after which a node of the same name in another namespace is named [s]."""


def resolve_domain(wanted: int | None, namespace: str = "") -> int:
    """Return the wanted domain, else the domain of ``ROS_DOMAIN_ID``, or that of the only run with this namespace.

    The run of another host has no lock here: where other hosts may join, a named domain is not checked.
    """
    require_ros()
    try:
        space = namespace and check_namespace(namespace)
        held = [domain for domain in held_domains(space) if space or not _of_trains(domain)]
    except ValueError as error:
        raise ValueError(f"--namespace {error}") from None
    own = domain_of_environment() if wanted is None else None
    for name, domain in (("--domain", wanted), ("ROS_DOMAIN_ID", own)):
        if domain is not None and domain not in held and not opened_by():
            remedy = "" if own is None else "; give --domain N, or unset it"
            raise ValueError(f"{name} {domain}: no run{_of(namespace, domain)} holds it; running: {_listed()}{remedy}")
        if domain is not None:
            return domain
    if not held:
        others = _listed()
        remedy = "start one with `train-ato run SCENARIO`" if others == "none" else f"running: --domain {others}"
        raise ValueError(f"no run{_of(namespace)} is in progress on this machine; {remedy}")
    if len(held) > 1:
        raise ValueError(f"several runs are in progress ({_listed()}); give --domain N")
    return held[0]


def _of_trains(domain: int) -> bool:
    """Return True if a domain is held for trains in namespaces."""
    return (domain, TRAINS) in locked_runs()


def _of(namespace: str, domain: int | None = None) -> str:
    """Return the namespace of a wanted run, in one domain or in any; without one it is said if there are others."""
    if namespace:
        return f" of the namespace {namespace}"
    others = any(space for held, space in locked_runs() if domain in (None, held))
    return " without a namespace" if others else ""


def _listed() -> str:
    """Return the domains of all runs, each with the option for its namespace."""
    runs = sorted((domain, space) for domain, space in locked_runs() if space.strip(TRAINS) or not _of_trains(domain))
    return ", ".join(f"{domain} --namespace {space}" if space else str(domain) for domain, space in runs) or "none"


class GraphClient:
    """Client of the nodes on a domain; a missing or silent node, parameter or service is a ``ValueError``."""

    def __init__(self, node: Any, executor: Any, domain: int) -> None:
        self._node = node
        self._executor = executor
        self._domain = domain

    def set_parameter(self, node: str, name: str, value: Any) -> str | None:
        """Set one parameter of a running node.

        Returns
        -------
        str or None
            The reason if the node refused, else None.
        """
        done, text = self.change_parameters(node, {name: value})
        return None if done else text

    def change_parameters(self, node: str, values: Mapping[str, Any]) -> tuple[bool, str]:
        """Set parameters of a running node, all or none.

        Returns
        -------
        done, text
            True if the node accepted, and its reason for a refusal or its advice.
        """
        from rcl_interfaces.msg import ParameterType
        from rclpy.parameter import Parameter
        from rclpy.parameter_client import AsyncParameterClient

        client = AsyncParameterClient(self._node, node)
        self._find(client.wait_for_services, f"node '{node}'", node)
        changes = []
        for name, value in values.items():
            types = self._answer(client.get_parameter_types([name]), node).types
            if list(types) in ([], [ParameterType.PARAMETER_NOT_SET]):
                known = self._answer(client.list_parameters(), node).result.names
                raise ValueError(f"{node} has no parameter '{name}'{close_match(name, known)}")
            real = isinstance(value, int) and list(types) == [ParameterType.PARAMETER_DOUBLE]
            changes.append(Parameter(name, value=float(value) if real else value))
        result = self._answer(client.set_parameters_atomically(changes), node).result
        return bool(result.successful), str(result.reason)

    def parameter(self, node: str, name: str) -> Any:
        """Return the value of a parameter of a running node, None if it has no value."""
        from rclpy.parameter import parameter_value_to_python
        from rclpy.parameter_client import AsyncParameterClient

        client = AsyncParameterClient(self._node, node)
        self._find(client.wait_for_services, f"node '{node}'", node)
        (value,) = self._answer(client.get_parameters([name]), node).values
        return parameter_value_to_python(value)

    def call(self, service: str, data: bool | None = None) -> tuple[bool, str]:
        """Call a service of ``std_srvs``: ``Trigger``, or ``SetBool`` with ``data``."""
        from std_srvs.srv import SetBool, Trigger

        client = self._node.create_client(Trigger if data is None else SetBool, service)
        self._find(client.wait_for_service, f"service '{service}'", service.partition("/")[0])
        request = Trigger.Request() if data is None else SetBool.Request(data=data)
        response = self._answer(client.call_async(request), service)
        return bool(response.success), str(response.message)

    def _find(self, ready: Callable[[float], bool], what: str, node: str) -> None:
        """Wait for a service of a node."""
        from train_ato.ros.nodes.publishers import in_place_of

        own = self._node.get_namespace()
        for limit in (ELSEWHERE_S, WAIT_S - ELSEWHERE_S):
            if ready(limit):
                return
            others = {space for name, space in self._node.get_node_names_and_namespaces() if name == node} - {own}
            if others:
                remedy = "leave --namespace out" if others == {"/"} else f"give --namespace {max(others)}"
                there = f"{what} is in {', '.join(sorted(others))} of domain {self._domain}, not in {own}"
                raise ValueError(f"{there}; {remedy}")
            if programs := in_place_of(self._node, node):
                external = f"node {node} is the external program {programs} on domain {self._domain}"
                raise ValueError(f"{what} is not there: {external}; use the services of the program")
        raise ValueError(f"{what} is not on domain {self._domain}; is the run still going on?")

    def _answer(self, future: Any, who: str) -> Any:
        self._executor.spin_until_future_complete(future, WAIT_S)
        if not future.done():
            raise ValueError(f"'{who}' on domain {self._domain} does not answer; it may have acted all the same")
        return future.result()


@contextmanager
def graph_client(domain: int, namespace: str = "") -> Iterator[GraphClient]:
    """Yield a client on the domain of a run, in the namespace of its train; destroy it on exit."""
    # the middleware may still write its log into the folder
    folder = tempfile.TemporaryDirectory(prefix="train_ato_set_", ignore_cleanup_errors=True)
    with folder as scratch, applied(variables(domain, Path(scratch))):
        import rclpy

        context = rclpy.Context()
        rclpy.init(context=context, domain_id=domain)
        try:
            node = rclpy.create_node("train_ato_set", context=context, namespace=namespace, enable_rosout=False)
            executor = rclpy.executors.SingleThreadedExecutor(context=context)
            executor.add_node(node)
            yield GraphClient(node, executor, domain)
            executor.shutdown()
            node.destroy_node()
        finally:
            context.try_shutdown()
