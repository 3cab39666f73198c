"""``train-ato params``: print the parameters of the nodes of a scenario as a ROS 2 parameter file.

Options::

    scenario SCENARIO  a shipped name, NAME:variant, or a YAML file
    --observer         and --compensation, --seed, --set: changes of the scenario
    --law NAME         control law (default: as in the scenario)
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.cli.scenario_options import add_change_options, prepare_from
from train_ato.cli.screen import print_result
from train_ato.program.arguments import Options

if TYPE_CHECKING:
    from train_ato.scenario.setup import RunSetup

OF_EVERY_NODE = frozenset({"use_sim_time", "start_type_description_service", "scenario"})

OPTIONS: Options = {"--observer": add_change_options}


def execute(options: argparse.Namespace) -> None:
    """Print the file, for ``--params-file`` of a node or ``params:=`` of a launch file."""
    found = node_parameters(prepare_from(options))
    print_result(found, parameter_file(found), as_json=options.json)


def parameter_file(found: dict[str, dict[str, Any]]) -> str:
    """Return the text of a file with the parameters of nodes, by their names; it holds in every namespace."""
    import yaml

    file = {f"/**/{node}": {"ros__parameters": values} for node, values in found.items()}
    return f"# Made by `train-ato params`.\n{yaml.safe_dump(file, sort_keys=False, allow_unicode=True)}"


def node_parameters(setup: RunSetup) -> dict[str, dict[str, Any]]:
    """Return the parameters of plant, observer and controller; those of other laws and observers are left out."""
    from train_ato.ros import require_ros
    from train_ato.ros.graph.environment import applied, claim_domain, variables

    require_ros()
    with tempfile.TemporaryDirectory() as scratch, claim_domain() as domain, applied(variables(domain, Path(scratch))):
        from train_ato.messages.codec import Wire
        from train_ato.messages.topics import Role
        from train_ato.program.errors import FirstFailure
        from train_ato.ros.graph.assembly import executor_of, make_node
        from train_ato.ros.graph.graph_result import GraphOptions
        from train_ato.ros.nodes.endpoints import NodeEndpoints

        found: dict[str, dict[str, Any]] = {}
        with executor_of(domain) as (context, _):
            for role in (Role.PLANT, Role.OBSERVER, Role.CONTROLLER):
                endpoints = NodeEndpoints(role, Wire(setup.layout), context, FirstFailure())
                make_node(role, setup, endpoints, None, GraphOptions())
                values = {name: entry.value for name, entry in endpoints.node.get_parameters_by_prefix("").items()}
                blocks = ("", setup.scenario.law if role is Role.CONTROLLER else setup.scenario.observer)
                found[role.value] = {
                    name: value
                    for name, value in values.items()
                    if name not in OF_EVERY_NODE and (role is Role.PLANT or name.rpartition(".")[0] in blocks)
                }
                endpoints.destroy()
    return found
