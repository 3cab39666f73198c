"""ROS 2 nodes, their graph, and standalone nodes."""

from __future__ import annotations

import importlib.util

REMEDY = (
    "run the engine (`train-ato run --engine`, mode='engine'), source a ROS 2 installation, or "
    "`pip install 'ros-jazzy-rclpy[fastrtps]' ros-jazzy-common-interfaces`"
)


def require_ros() -> None:
    """Check that ROS 2 is installed.

    Raises
    ------
    ValueError
        With the remedy.
    """
    if importlib.util.find_spec("rclpy") is None:
        raise ValueError(f"ROS 2 is not installed (no rclpy); {REMEDY}")


def missing_ros(error: Exception) -> str | None:
    """Return the remedy as one line if the error is a missing package of ROS 2, else None."""
    name = error.name if isinstance(error, ModuleNotFoundError) and error.name else ""
    if name.startswith(("rclpy", "rcl_interfaces", "rosgraph_msgs", "builtin_interfaces", "rosidl", "rpyutils")) or (
        name.partition(".")[0].endswith(("_msgs", "_srvs"))
    ):
        return f"ROS 2 is not installed (no {name}); {REMEDY}"
    return None
