"""Parameter services of a node that answer unreadable requests."""

from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import ParameterType, SetParametersResult
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.parameter_service import ParameterService

from plant_sim.input_error import close_match
from train_ato.program.errors import FirstFailure, of_own_code


def unknown_parameter(node: str, given: str, names: list[str]) -> str:
    """Return the refusal of a parameter that a node does not have."""
    return (
        f"parameter {given}: node {node} has none of that name{close_match(given, names)}; `ros2 param list` names all"
    )


class ParameterServices(ParameterService):  # type: ignore[misc]
    """Parameter services that refuse unreadable requests with the reason.

    The services of rclpy raise instead, for example for an unknown parameter type, and the
    request of the client never times out. They also drop the reason of an accepted change.

    Attributes
    ----------
    on_accepted : callable
        Returns the reason of the answer to an accepted change: its advice, "" for none.
    """

    def __init__(self, node: Node, watch: FirstFailure) -> None:
        self._watch = watch
        self.on_accepted: Callable[[], str] = str
        super().__init__(node)

    def _set_parameters_callback(self, request: Any, response: Any) -> Any:
        for entry in request.parameters:
            one, answer = SetParametersAtomically.Request(parameters=[entry]), SetParametersAtomically.Response()
            response.results.append(self._set_parameters_atomically_callback(one, answer).result)
        return response

    def _set_parameters_atomically_callback(self, request: Any, response: Any) -> Any:
        for entry in request.parameters:  # an integer is a number of a parameter with doubles, as on the command line
            node, value = self._get_node(), entry.value
            if not node.has_parameter(entry.name):  # rclpy names none in its refusal
                reason = unknown_parameter(node.get_name(), entry.name, list(node._parameters))
                response.result = SetParametersResult(successful=False, reason=reason)
                return response
            integer = value.type == ParameterType.PARAMETER_INTEGER
            if integer and node.get_parameter(entry.name).type_ is RosParameter.Type.DOUBLE:
                value.type, value.double_value = ParameterType.PARAMETER_DOUBLE, float(value.integer_value)
        try:
            response = super()._set_parameters_atomically_callback(request, response)
            if response.result.successful:
                response.result.reason = self.on_accepted()
            return response
        except Exception as error:
            if of_own_code(error):
                self._watch.fail(self._get_node().get_name(), error)
            response.result = SetParametersResult(successful=False, reason=" ".join(str(error).split()))
            return response
