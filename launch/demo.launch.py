"""Nodes of a scenario, a process each: ``ros2 launch train_ato demo.launch.py scenario:=demo out:=runs/launched``."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import matches_action
from launch.events.process import ShutdownProcess
from launch_ros.actions import Node

from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import prepare

ARGUMENTS = {
    "scenario": ("demo", "shipped scenario or file"),
    "set": ("", "changes of the scenario with spaces between them: 'duration=60 seed=3'"),
    "out": ("runs/launched", "new folder of the log"),
    "rate": ("", "simulated seconds per second of wall time, or max; default: that of the file, else max"),
    "params": ("", "file with parameters of the nodes, as config/demo.yaml"),
    "namespace": ("", "namespace of all nodes and topics"),
    "nodes": ("recorder supervisor profile observer controller plant", "nodes to start here"),
    "external": ("", "node in whose place a program of yours runs"),
    "followed": ("", "true: do not begin before a train behind reads the reports of this train"),
}


def _rate(text):
    try:
        return 0.0 if text == "max" else float(text)
    except ValueError:
        raise ValueError(f"rate:={text}: give simulated seconds per second of wall time, or max") from None


def _nodes(context):
    """Return the nodes; a scenario that cannot be read ends the launch before the first process."""
    given = {name: context.launch_configurations[name] for name in ARGUMENTS}
    known = ARGUMENTS["nodes"][0].split()
    for name, choices in (("nodes", known), ("external", [node for node in known if node != "recorder"])):
        if wrong := next((node for node in given[name].split() if node not in choices), None):
            raise ValueError(f"{name}:={given[name]}: no node '{wrong}'; choose from {', '.join(choices)}")
    supervised = prepare(*load_scenario(given["scenario"], tuple(given["set"].split()))).layout.supervised
    of_all = ["--scenario", given["scenario"], *(f"--set={change}" for change in given["set"].split())]
    of_all += ["--external", given["external"]] if given["external"] else []
    of_one = {"recorder": ["--out", given["out"]], "plant": ["--recorded"]}
    of_one["plant"] += ["--followed"] if given["followed"].lower() == "true" else []
    file = [given["params"]] if given["params"] else []
    if file and not Path(file[0]).is_file():  # launch warns and starts the nodes without it
        raise ValueError(f"params:={file[0]}: no such file")
    rate = [{"rate": _rate(given["rate"])}] if given["rate"] else []
    # these two names are absolute: in a namespace every train has its own
    absolute = [(f"/{name}", name) for name in ("clock", "diagnostics")] if given["namespace"] else []
    nodes = [
        Node(
            package="train_ato",
            executable=f"{node}_node",
            namespace=given["namespace"],
            arguments=[*of_all, *of_one.get(node, [])],
            parameters=file + rate * (node == "plant"),
            remappings=absolute,
            output="screen",
        )
        for node in given["nodes"].split()
        if node != given["external"] and (node != "supervisor" or supervised)
    ]

    def end_others(event, _):
        """End the other nodes after a refused one, for which they would wait."""
        refused = event.action in nodes and event.returncode == 2
        return [EmitEvent(event=ShutdownProcess(process_matcher=matches_action(node))) for node in nodes if refused]

    return [*nodes, RegisterEventHandler(OnProcessExit(on_exit=end_others))]


def generate_launch_description():
    """Return arguments and nodes."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=meaning)
        for name, (default, meaning) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_nodes)])
