"""``train-ato set``: change a parameter of a running controller, for example swap its law."""

from __future__ import annotations

import argparse
import sys

from train_ato.cli.screen import print_json
from train_ato.given import given_value
from train_ato.graph.remote import set_parameter, the_running_domain


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``set``."""
    parser.add_argument("assignment", metavar="NAME=VALUE", help="for example controller=smc, or pid.kp=0.04")
    parser.add_argument("--node", default="controller", metavar="NAME", help="node that has the parameter")
    parser.add_argument("--domain", type=int, metavar="N", help="ROS domain of the run (default: the only one)")
    parser.add_argument("--json", action="store_true", help="print one JSON value and nothing else")


def execute(options: argparse.Namespace) -> int:
    """Set the parameter; a refusal is bad input and carries the node's reason."""
    name, equals, text = options.assignment.partition("=")
    if not equals or not name:
        raise ValueError(f"{options.assignment}: write it as name=value, for example controller=smc")
    value = given_value(text, options.assignment)
    if not isinstance(value, (bool, int, float, str)):
        raise ValueError(f"{options.assignment}: a parameter is a number, a word, true or false")
    domain = the_running_domain(options.domain)
    reason = set_parameter(domain, options.node, name, value)
    if reason is not None:
        raise ValueError(f"{options.node} refused {name} = {value!r}: {reason}")
    if options.json:
        print_json({"node": options.node, "domain": domain, name: value})
    else:
        sys.stdout.write(f"{options.node} on domain {domain}: {name} = {value!r}\n")
    return 0
