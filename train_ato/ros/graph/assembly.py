"""Creation of the nodes of a run, for both runners and the entry points.

The services of a managed node give the state of a node. A run begins with the first measurement of its plant and ends
with the end notice: no transition is made from outside.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rclpy
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from plant_sim.data_text import parse_yaml
from plant_sim.formats.fields import print_assumption
from plant_sim.input_error import close_match
from plant_sim.train import compile_kernel
from train_ato.loop.controller import ControllerStage
from train_ato.loop.plant import PlantStage
from train_ato.loop.profile import ProfileStage
from train_ato.loop.supervisor import SupervisorStage
from train_ato.messages.topics import Role, topics_of
from train_ato.program.errors import FirstFailure, of_own_code
from train_ato.ros.graph.graph_result import GraphOptions
from train_ato.ros.nodes.controller import ControllerNode
from train_ato.ros.nodes.endpoints import NodeEndpoints, placed
from train_ato.ros.nodes.plant import PlantNode
from train_ato.ros.nodes.stages import ObserverNode, ProfileNode, SupervisorNode
from train_ato.scenario.setup import RunSetup

if TYPE_CHECKING:
    from train_ato.ros.nodes.recorder import RecorderNode

TURN_S = 0.1
"""Maximum wait of the executor for an event [s]; an unlimited wait would block Ctrl-C."""


class _Executor(rclpy_implementation.EventsExecutor):  # type: ignore[misc]
    """Events executor that survives invalid requests from other programs.

    Parameters
    ----------
    context
        rclpy context of its nodes.
    watch
        Receiver of errors of this project's code; None raises them.
    """

    def __init__(self, context: Context, watch: FirstFailure | None) -> None:
        super().__init__(context)
        context.on_shutdown(self.wake)
        self._watch = watch
        self._refused = 0

    def spin_for(self, seconds: float) -> None:
        """Run the callbacks of a time [s], without a return to Python after each; errors as in :meth:`spin_once`."""
        self._guard(super().spin_until_future_complete, Future(), seconds)

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Run the due callbacks; an error of rclpy drops the request and does not end the run."""
        self._guard(super().spin_once, timeout_sec)

    def _guard(self, spin: Callable[..., None], *arguments: Any) -> None:
        try:
            spin(*arguments)
        except Exception as error:
            if not of_own_code(error):
                self._refused += 1
                if self._refused == 1:
                    sys.stderr.write(f"a request from outside was not answered: {type(error).__name__}: {error}\n")
            elif self._watch is not None:
                self._watch.fail("graph", error)
            else:
                raise


def check_arguments(arguments: Sequence[str], role: Role) -> None:
    """Check the ``--ros-args`` of a node with a context and a node of their own."""
    if not arguments:
        return
    context = Context()
    shown, nothing = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 2)  # rcl prints lines of its own
    try:
        rclpy.init(context=context, args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
        node = Node(role.value, context=context, enable_rosout=False, start_parameter_services=False)
        name = node.get_name()
        node.destroy_node()
    except Exception as error:  # RCLError and many others, after the fault
        kept = [line.strip() for line in str(error).splitlines() if line.strip()]
        reason = (kept or [type(error).__name__])[0].partition(", at ")[0].rstrip(".,: ")
        if isinstance(error, rclpy_implementation.UnknownROSArgsError):
            reason = f"unknown: {reason.strip('[]')}"
        raise ValueError(f"{' '.join(arguments)}: {reason}; see `ros2 run --help` for the form") from None
    finally:
        context.try_shutdown()
        os.dup2(shown, 2)
        os.close(shown)
        os.close(nothing)
    if name != role.value:
        text = f"the other nodes find node {role.value} by this name, not {name}; leave __node out, or give a namespace"
        raise ValueError(f"{' '.join(arguments)}: {text}")
    _note_misspelt([file for word, file in pairwise(arguments) if word == "--params-file"], role)


def _note_misspelt(files: Sequence[str], role: Role) -> None:
    """Print a note for a name in a parameter file that is nearly that of this node: rclpy passes over it."""
    known = [other.value for other in Role]
    for file in files:
        with suppress(ValueError):  # what rcl has read, the parser of scenarios may refuse
            for key in _nodes_of(parse_yaml(Path(file).read_bytes())):
                match = close_match(name := key.rpartition("/")[2], known)
                if name not in known and f"'{role.value}'" in match:
                    print_assumption(f"{file}: {key}: no node has this name, and its parameters have no effect{match}")


def _nodes_of(blocks: Any, above: str = "") -> Iterator[str]:
    """Yield the names of the nodes in a parameter file, also of those nested in namespaces."""
    for key, block in blocks.items() if isinstance(blocks, dict) else ():
        if isinstance(block, dict) and "ros__parameters" in block:
            yield f"{above}{key}"
        else:
            yield from _nodes_of(block, f"{above}{key}/")


@contextmanager
def executor_of(
    domain: int | None, arguments: list[str] | None = None, watch: FirstFailure | None = None
) -> Iterator[tuple[Context, Any]]:
    """Yield a private context and its events executor; shut both down on exit, in the order that ends all threads."""
    context = Context()
    rclpy.init(context=context, args=arguments, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    executor = _Executor(context, watch)
    try:
        yield context, executor
    finally:
        nodes = list(executor.get_nodes())
        for node in nodes:
            executor.remove_node(node)
        executor.shutdown()
        for node in nodes:
            node.destroy_node()
        context.try_shutdown()


def make_node(
    role: Role,
    setup: RunSetup,
    endpoints: NodeEndpoints,
    folder: Path | None,
    options: GraphOptions,
    *,
    recorded: bool = True,
) -> Any:
    """Return the node of a role; ``recorded`` limits the lead of the plant over the recorder."""
    serve_lifecycle(endpoints)
    if role is Role.PLANT:
        compile_kernel()
        scenario = (folder or setup.folder) / "scenario.yaml"
        file = str(scenario.resolve()) if scenario.is_file() else ""
        return PlantNode(PlantStage(setup), endpoints, options, recorded=recorded, scenario=file)
    if role is Role.SUPERVISOR:
        return SupervisorNode(SupervisorStage(setup), endpoints)
    if role is Role.PROFILE:
        return ProfileNode(ProfileStage(setup), endpoints)
    if role is Role.OBSERVER:
        return ObserverNode(setup, endpoints)
    if role is Role.CONTROLLER:
        return ControllerNode(ControllerStage(setup), endpoints)
    assert folder is not None
    return _make_recorder(setup, endpoints, folder, options.compression)


def _make_recorder(setup: RunSetup, endpoints: NodeEndpoints, folder: Path, compression: str) -> RecorderNode:
    """Return the recorder; only its process imports the log, 0.05 s."""
    from train_ato.log.bag_layout import log_name, table_name
    from train_ato.log.log_writer import RunLog
    from train_ato.log.versions import attachments_for
    from train_ato.ros.nodes.recorder import RecorderNode

    attached = attachments_for(setup.resolved_yaml())

    def resolved(name: str) -> str:
        return str(endpoints.node.resolve_topic_name(placed(endpoints.node, name)))

    for topic in topics_of(setup.layout):
        if topic.recorded and table_name(found := resolved(topic.name)) != topic.name:
            endpoints.note(f"{topic.name} is {found} in this graph; the log has it as {log_name(topic)}")
    log = RunLog(folder, topics_of(setup.layout), resolved, attachments=attached, compression=compression)
    last_due = {}
    if endpoints.external is Role.PLANT:
        last_due = {
            topic.name: setup.tick_ns * (setup.ticks - (Role.PLANT not in topic.publishers))
            for topic in topics_of(setup.layout)
        }
    return RecorderNode(log, endpoints, setup.tick_ns, last_due)


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
