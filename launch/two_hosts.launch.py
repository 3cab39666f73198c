"""Nodes of one of two hosts in a network: ``ros2 launch train_ato two_hosts.launch.py host:=track`` or ``host:=train``.

Every host of the network can then join the run. The order of the two commands does not matter.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction, SetEnvironmentVariable

DEMO = str(Path(__file__).resolve().parent / "demo.launch.py")
HOSTS = {"track": "recorder plant", "train": "supervisor profile observer controller"}


def _nodes(context):
    nodes = HOSTS[context.launch_configurations["host"]]
    return [IncludeLaunchDescription(DEMO, launch_arguments={"nodes": nodes}.items())]


def generate_launch_description():
    """Return the nodes of this host; the other arguments of ``demo.launch.py`` hold here too."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("host", choices=list(HOSTS), description="the train with its log, or its control"),
            SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET"),
            OpaqueFunction(function=_nodes),
        ]
    )
