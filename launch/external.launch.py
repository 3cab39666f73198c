"""Nodes of the demo, and a program in place of one: ``ros2 launch train_ato external.launch.py program:=FILE.py``."""

import sys
from pathlib import Path

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    IncludeLaunchDescription,
    RegisterEventHandler,
    Shutdown,
)
from launch.event_handlers import OnProcessExit
from launch.substitutions import LaunchConfiguration

HERE = Path(__file__).resolve().parent
PROGRAM = HERE.parent / "examples" / "ros" / "my_controller.py"


def _after_recorder(event, _):
    """End the program, which runs on, after the log is closed."""
    return [Shutdown()] if "recorder_node" in event.process_name else []


def generate_launch_description():
    """Return the other nodes and the program; the arguments of ``demo.launch.py`` hold here too."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("external", default_value="controller", description="node that the program replaces"),
            DeclareLaunchArgument("program", default_value=str(PROGRAM), description="Python file of the program"),
            IncludeLaunchDescription(str(HERE / "demo.launch.py")),
            ExecuteProcess(cmd=[sys.executable, LaunchConfiguration("program")], output="screen"),
            RegisterEventHandler(OnProcessExit(on_exit=_after_recorder)),
        ]
    )
