"""Two trains in one domain, each in a namespace with its own log: ``ros2 launch train_ato two_trains.launch.py``."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.substitutions import LaunchConfiguration

DEMO = str(Path(__file__).resolve().parent / "demo.launch.py")


def generate_launch_description():
    """Return the nodes of both trains; the other arguments of ``demo.launch.py`` hold for both."""
    trains = []
    for train in ("train_1", "train_2"):
        scenario = DeclareLaunchArgument(f"{train}_scenario", default_value="demo", description=f"scenario of {train}")
        own = {
            "scenario": LaunchConfiguration(f"{train}_scenario"),
            "out": [LaunchConfiguration("folder"), f"/{train}"],
            "namespace": f"/{train}",
        }
        included = IncludeLaunchDescription(DEMO, launch_arguments=own.items())
        trains += [scenario, GroupAction([included])]
    folder = DeclareLaunchArgument("folder", default_value="runs/two_trains", description="folder of both logs")
    return LaunchDescription([folder, *trains])
