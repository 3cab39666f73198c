"""``train-ato scene``: publish the train on its line for 3D viewers, beside a running simulation or a replay.

Options::

    run RUN    run or log of a replay (default: the running simulation)
    --domain   and --namespace: the running train
    --rate HZ  messages per simulated second (default: 5)
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from train_ato.cli.screen import print_result
from train_ato.program.arguments import Options, add_train

if TYPE_CHECKING:
    from train_ato.scenario.setup import RunSetup


OPTIONS: Options = {"run": {"nargs": "?"}, "--domain": add_train, "--rate": {"default": 5.0}}


def execute(options: argparse.Namespace) -> None:
    """Publish /tf, /tf_static, poses, markers and track until the run ends."""
    from train_ato.log.run_folder import read_run_folder
    from train_ato.program.interrupt import interruptible
    from train_ato.ros import require_ros
    from train_ato.ros.graph.environment import applied, check_domain, domain_of_environment, variables
    from train_ato.ros.graph.remote import resolve_domain
    from train_ato.view.train_scene import TrainScene, check_rate

    check_rate(options.rate)
    check_domain(options.domain)
    own = domain_of_environment() if options.domain is None else options.domain
    require_ros()
    if options.run is None:
        domain = resolve_domain(options.domain, options.namespace)
        setup = _running(domain, options.namespace)
    elif own is None:
        raise ValueError("--domain: missing; give the ROS domain of the replay")
    else:
        domain, setup = own, read_run_folder(options.run)[0]
    scene = TrainScene(setup, rate=options.rate)
    with (
        tempfile.TemporaryDirectory(prefix="train_ato_scene_", ignore_cleanup_errors=True) as scratch,
        applied(variables(domain, Path(scratch))),
        interruptible() as interrupt,
    ):
        from train_ato.view.scene_node import publish_scene

        counts = publish_scene(scene, domain, lambda: interrupt.asked, options.namespace)
    text = f"domain {domain}: {', '.join(f'{count} {name}' for name, count in counts.items())}\n"
    print_result({"domain": domain, "rate": options.rate, "messages": counts}, text, as_json=options.json)


def _running(domain: int, namespace: str) -> RunSetup:
    """Return the scenario of the run on a domain, from the parameter of its plant."""
    from train_ato.ros.graph.remote import graph_client
    from train_ato.scenario.scenario import load_scenario
    from train_ato.scenario.setup import prepare

    with graph_client(domain, namespace) as remote:
        named = Path(str(remote.parameter("plant", "scenario")))
    if not named.is_file():
        raise ValueError(f"domain {domain}: the plant names no scenario file; give RUN, the folder of the run")
    return prepare(*load_scenario(str(named)))
