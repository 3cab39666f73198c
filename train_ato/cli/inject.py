"""``train-ato do``: act on a running train: a gust, a longer delay, the emergency brake, pause and single steps."""

from __future__ import annotations

import argparse
import sys

from train_ato.cli.screen import print_json
from train_ato.given import given_value
from train_ato.graph.remote import asking, the_running_domain

ACTIONS: dict[str, tuple[str, bool | None, str]] = {
    "gust": ("gust", None, "a gust on the whole train; acceleration=, duration=, ramp="),
    "delay-jump": ("delay_jump", None, "longer delays of the commands from now on; factor=, add="),
    "emergency-brake": ("emergency_brake", True, "full brake and a vented brake pipe, whatever the law commands"),
    "release": ("emergency_brake", False, "release the emergency brake; at standstill only"),
    "pause": ("pause", True, "begin no further tick"),
    "resume": ("pause", False, "go on"),
    "step": ("step", None, "one tick, while paused"),
    "stop": ("stop", None, "end the run after the tick under way"),
}
"""Action to service of the node ``plant``, the truth value it is called with, and the meaning."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``do``."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = "actions:\n" + "\n".join(f"  {name:<16} {entry[2]}" for name, entry in ACTIONS.items())
    parser.add_argument("action", choices=tuple(ACTIONS), metavar="ACTION", help="see below")
    parser.add_argument(
        "strength", nargs="*", metavar="NAME=VALUE", help="of a gust or a delay jump, kept for the next one"
    )
    parser.add_argument("--domain", type=int, metavar="N", help="ROS domain of the run (default: the only one)")
    parser.add_argument("--json", action="store_true", help="print one JSON value and nothing else")


def execute(options: argparse.Namespace) -> int:
    """Set how strong it is, then act; a refusal is bad input and carries the node's reason."""
    service, data, _ = ACTIONS[options.action]
    strengths = dict(_strength(options.action, service, text) for text in options.strength)
    domain = the_running_domain(options.domain)
    with asking(domain) as remote:
        for name, value in strengths.items():
            reason = remote.set_parameter("plant", f"{service}.{name}", value)
            if reason is not None:
                raise ValueError(f"plant refused {service}.{name} = {value!r}: {reason}")
        success, message = remote.call(f"plant/{service}", data)
    if not success:
        raise ValueError(f"{options.action}: refused: {message}")
    if options.json:
        print_json({"action": options.action, "domain": domain, "message": message})
    else:
        sys.stdout.write(f"plant on domain {domain}: {message}\n")
    return 0


def _strength(action: str, service: str, text: str) -> tuple[str, float]:
    if service not in ("gust", "delay_jump"):
        raise ValueError(f"{action}: takes no '{text}'; only gust and delay-jump have a strength")
    name, equals, number = text.partition("=")
    value = given_value(number, text) if equals else None
    if not name or isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"{text}: write it as name=number, for example duration=20")
    return name, float(value)
