"""Making the nodes of a run; both runners and the entry points use it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions

from plant_sim.node import PlantNode
from plant_sim.train import compile_kernel
from train_ato.nodes.controller import ControllerNode
from train_ato.nodes.observer import ObserverNode
from train_ato.nodes.profile import ProfileNode
from train_ato.nodes.recorder import RecorderNode
from train_ato.nodes.shell import Shell
from train_ato.record.run_log import RunLog
from train_ato.record.versions import attachments_for
from train_ato.roles.controller import ControllerRole
from train_ato.roles.plant import PlantRole
from train_ato.roles.profile import ProfileRole
from train_ato.run_setup import RunSetup
from train_ato.topics import Role

TURN_S = 0.1
"""Longest time that the executor waits for an event; it must never be without a limit."""


@contextmanager
def executor_of(domain: int | None, arguments: list[str] | None = None) -> Iterator[tuple[Context, Any]]:
    """Give a context of its own and its events executor, and take both down in the order that leaves no thread."""
    context = Context()
    rclpy.init(context=context, args=arguments, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    executor = EventsExecutor(context=context)
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
    shell: Shell,
    folder: Path | None,
    realtime: float | None,
    timeout: float,
    recorded: bool = True,
    pace: float = 0.0,
) -> Any:
    """Return the node of a role.

    Raises
    ------
    ValueError
        If a parameter given at the start is refused, or the log cannot be written.
    """
    if role is Role.PLANT:
        compile_kernel()
        resolved = (folder or setup.folder) / "scenario.yaml"
        return PlantNode(
            PlantRole(setup),
            shell,
            realtime=realtime,
            timeout=timeout,
            recorded=recorded,
            pace=pace,
            scenario=str(resolved.resolve()) if resolved.is_file() else "",
        )
    if role is Role.PROFILE:
        return ProfileNode(ProfileRole(setup), shell)
    if role is Role.OBSERVER:
        return ObserverNode(setup, shell)
    if role is Role.CONTROLLER:
        return ControllerNode(ControllerRole(setup), shell)
    if folder is None:
        raise ValueError("the recorder needs a folder; give --out DIR")
    attached = attachments_for(setup.resolved_yaml())
    log = RunLog(folder, setup.shape.topics, shell.node.get_namespace(), attached)
    return RecorderNode(log, shell)
