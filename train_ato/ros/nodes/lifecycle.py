"""State of a node by the services of a managed node.

A run begins with the first measurement of its plant and ends with the end notice: no transition is made from outside.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState

if TYPE_CHECKING:
    from train_ato.ros.nodes.endpoints import NodeEndpoints

LABELS = {
    State.PRIMARY_STATE_UNCONFIGURED: "unconfigured",
    State.PRIMARY_STATE_INACTIVE: "inactive",
    State.PRIMARY_STATE_ACTIVE: "active",
    State.PRIMARY_STATE_FINALIZED: "finalized",
}
REFUSED = "~/change_state: refused, the plant begins and ends the run; see its services ~/pause, ~/start, ~/stop"


def serve_lifecycle(endpoints: NodeEndpoints) -> None:
    """Offer ``~/get_state``, no transitions, and ``~/change_state``, which refuses every transition in one line.

    ``ros2 lifecycle set`` and ``list`` wait for ever for a node without the services that list its transitions.
    """

    def answer(_: Any, response: Any) -> Any:
        number = _state(endpoints)
        response.current_state = State(id=number, label=LABELS[number])
        return response

    def refuse(_: Any, response: Any) -> Any:
        endpoints.note(f"node {endpoints.name}: {REFUSED}")
        response.success = False
        return response

    endpoints.serve(GetState, "~/get_state", answer)
    endpoints.serve(ChangeState, "~/change_state", refuse)
    for name in ("~/get_available_transitions", "~/get_transition_graph"):
        endpoints.serve(GetAvailableTransitions, name, lambda _, response: response)


def _state(endpoints: NodeEndpoints) -> int:
    """Return unconfigured before all connections, inactive before the first tick, then active, finalized at the end."""
    if endpoints.ended:
        return int(State.PRIMARY_STATE_FINALIZED)
    if endpoints.begun:
        return int(State.PRIMARY_STATE_ACTIVE)
    return int(State.PRIMARY_STATE_UNCONFIGURED if endpoints.missing() else State.PRIMARY_STATE_INACTIVE)
