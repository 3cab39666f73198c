"""Trains in one domain, each in a namespace with its own log: ``ros2 launch train_ato two_trains.launch.py``.

``following:=following_metro`` runs the trains of a following file, each with live reports of the train ahead.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription, OpaqueFunction

from train_ato.api.following_live import write_live_scenarios
from train_ato.scenario.following import find_following, load_following

DEMO = str(Path(__file__).resolve().parent / "demo.launch.py")
ARGUMENTS = {
    "folder": ("runs/two_trains", "new folder of the logs"),
    "train_1_scenario": ("demo", "scenario of train_1"),
    "train_2_scenario": ("demo", "scenario of train_2"),
    "following": ("", "shipped following trains, or a file of them, in place of both scenarios"),
}


def _trains(context):
    """Return the nodes of all trains; the other arguments of ``demo.launch.py`` hold for each of them."""
    given = {name: context.launch_configurations[name] for name in ARGUMENTS}
    scenarios = {name: given[f"{name}_scenario"] for name in ("train_1", "train_2")}
    if given["following"]:
        file = find_following(given["following"])
        if file is None:
            raise ValueError(f"following:={given['following']}: no following file; see `train-ato list`")
        scenarios, _ = write_live_scenarios(load_following(file), Path(given["folder"]))
    groups = []
    for name, scenario in scenarios.items():
        own = {"scenario": str(scenario), "out": f"{given['folder']}/{name}", "namespace": f"/{name}"}
        own["followed"] = "true" if given["following"] and name != list(scenarios)[-1] else ""
        groups.append(GroupAction([IncludeLaunchDescription(DEMO, launch_arguments=own.items())]))
    return groups


def generate_launch_description():
    """Return arguments and trains."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=meaning)
        for name, (default, meaning) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_trains)])
