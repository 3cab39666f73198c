"""``train-ato inject``: inject a gust, a delay change, a fault or the emergency brake into a running simulation.

It also sends requests to the ATO: engage, disengage, reset.

Options::

    action ACTION          one of the actions below
    parameters NAME=VALUE  parameter of a gust, a delay jump or a fault; kept for the next call
    --domain               and --namespace: the running train
"""

import argparse
from typing import NamedTuple

from train_ato.cli.screen import print_result
from train_ato.program.arguments import Options, add_train, parse_yaml_value


class Action(NamedTuple):
    """Service of a node: its name, its boolean argument or None, and its meaning."""

    node: str
    service: str
    data: bool | None
    meaning: str


ACTIONS: dict[str, Action] = {
    "gust": Action("plant", "gust", None, "gust on the whole train; acceleration= [m/s²], duration= [s], ramp= [s]"),
    "delay-jump": Action("plant", "delay_jump", None, "change of the command delays from now on; factor=, add= [s]"),
    "drop": Action("plant", "message_loss", None, "no messages of a topic at the plant; topic=, duration= [s]"),
    "freeze": Action("plant", "message_freeze", None, "constant content of a topic; topic=, duration= [s]"),
    "cut-out": Action("plant", "drive_gain", None, "force of all drives times factor= (0) for the rest of the run"),
    "brake-fade": Action("plant", "brake_fade", None, "force of the friction brakes times factor= (0.5)"),
    "adhesion": Action("plant", "adhesion", None, "adhesion times factor= (0.3)"),
    "emergency-brake": Action(
        "plant", "emergency_brake", True, "emergency brake, independent of law and drives; traction cut-off"
    ),
    "release": Action("plant", "emergency_brake", False, "release of a requested emergency brake, only at standstill"),
    "engage": Action("controller", "engage", None, "engage the ATO, from its state ready"),
    "disengage": Action("controller", "disengage", None, "disengage the ATO: it coasts 5 s, then brakes to a stop"),
    "reset": Action("controller", "reset", None, "end the state failure of the ATO, only at standstill"),
    "pause": Action("plant", "pause", True, "pause after the present tick"),
    "resume": Action("plant", "pause", False, "continue after a pause"),
    "step": Action("plant", "step", None, "run one tick during a pause"),
    "stop": Action("plant", "stop", None, "end of the run after the present tick"),
    "restart": Action("plant", "reset", None, "end of the run, which `train-ato run` then begins again"),
}
"""Actions by name."""
WITH_PARAMETERS = ("gust", "delay_jump", "message_loss", "message_freeze", "drive_gain", "brake_fade", "adhesion")
"""Services with strengths that are parameters."""

OPTIONS: Options = {"action": {"choices": tuple(ACTIONS)}, "parameters": {"nargs": "*"}, "--domain": add_train}


def finish(parser: argparse.ArgumentParser) -> None:
    """Add the actions below the options."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = "actions:\n" + "\n".join(f"  {name:<16} {action.meaning}" for name, action in ACTIONS.items())


def execute(options: argparse.Namespace) -> None:
    """Set the parameters, then call the service; a refusal is bad input with the reason of the node."""
    from train_ato.ros.graph.remote import graph_client, resolve_domain

    node, service, data, _ = ACTIONS[options.action]
    given = dict(_parameter(options.action, service, text) for text in options.parameters)
    parameters = {f"{service}.{name}": value for name, value in given.items()}
    domain = resolve_domain(options.domain, options.namespace)
    with graph_client(domain, options.namespace) as remote:
        done, reason = remote.change_parameters(node, parameters) if parameters else (True, "")
        if not done:
            named = ", ".join(f"{name} = {value!r}" for name, value in parameters.items())
            raise ValueError(f"{node} refused {named}: {reason}")
        success, message = remote.call(f"{node}/{service}", data)
    if not success:
        raise ValueError(f"{options.action}: refused by the {node}: {message}")
    result = {"action": options.action, "domain": domain, "message": message}
    print_result(result, f"{node} on domain {domain}: {message}\n", as_json=options.json)


def _parameter(action: str, service: str, text: str) -> tuple[str, float | str]:
    if service not in WITH_PARAMETERS:
        known = ", ".join(name for name, entry in ACTIONS.items() if entry.service in WITH_PARAMETERS)
        raise ValueError(f"{action}: has no parameter '{text}'; remove it (only {known} have parameters)")
    name, equals, given = text.partition("=")
    value = parse_yaml_value(given, text) if equals else None
    if name == "topic" and isinstance(value, str):
        return name, value
    if not name or isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"{text}: not a parameter; write name=number, for example duration=20")
    return name, float(value)
