"""Nodes of the demo, and a program in place of one: ``ros2 launch train_ato external.launch.py program:=FILE.py``."""

import sys
from pathlib import Path

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    IncludeLaunchDescription,
    OpaqueFunction,
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


def _program(context):
    """Return the program, in the namespace of the nodes."""
    file, space = (LaunchConfiguration(name).perform(context) for name in ("program", "namespace"))
    words = ["--ros-args", "-r", f"__ns:={space if space.startswith('/') else f'/{space}'}"] if space else []
    return [ExecuteProcess(cmd=[sys.executable, file, *words], output="screen")]


def generate_launch_description():
    """Return the other nodes and the program; the arguments of ``demo.launch.py`` hold here too."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("external", default_value="controller", description="node that the program replaces"),
            DeclareLaunchArgument("program", default_value=str(PROGRAM), description="Python file of the program"),
            IncludeLaunchDescription(str(HERE / "demo.launch.py")),
            OpaqueFunction(function=_program),
            RegisterEventHandler(OnProcessExit(on_exit=_after_recorder)),
        ]
    )
