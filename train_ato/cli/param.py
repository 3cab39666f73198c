"""``train-ato param``: change a parameter of a node of a running simulation, for example the control law.

Options::

    assignment NAME=VALUE  parameter and value, for example law=smc or pid.kp=0.04
    --node NAME            node of the parameter (default: controller)
    --domain               and --namespace: the running train
"""

import argparse
import sys

from train_ato.cli.screen import print_result
from train_ato.program.arguments import Options, add_train, parse_yaml_value

OPTIONS: Options = {"--node": {"default": "controller"}, "--domain": add_train}


def execute(options: argparse.Namespace) -> None:
    """Set the parameter; a refusal is bad input with the reason of the node."""
    from train_ato.ros.graph.remote import graph_client, resolve_domain

    name, equals, text = options.assignment.partition("=")
    if not equals or not name:
        raise ValueError(f"{options.assignment}: not an assignment; write name=value, for example law=smc")
    value = parse_yaml_value(text, options.assignment)
    if not isinstance(value, (bool, int, float, str)):
        raise ValueError(f"{options.assignment}: not a parameter value; give a number, a word, true or false")
    domain = resolve_domain(options.domain, options.namespace)
    with graph_client(domain, options.namespace) as remote:
        done, text = remote.change_parameters(options.node, {name: value})
    if not done:
        raise ValueError(f"{options.node} refused {name} = {value!r}: {text}")
    if text:
        sys.stderr.write(f"train-ato: {text}\n")
    data = {"node": options.node, "domain": domain, name: value}
    print_result(data, f"{options.node} on domain {domain}: {name} = {value!r}\n", as_json=options.json)
