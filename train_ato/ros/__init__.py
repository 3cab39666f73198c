"""ROS 2 nodes, their graph, and standalone nodes."""

import importlib.util
import os
import subprocess
import sys
import traceback
from functools import lru_cache

DEFAULT_MIDDLEWARE = "rmw_fastrtps_cpp"
"""Middleware of the nodes without ``RMW_IMPLEMENTATION``."""
_MIDDLEWARE = "RMW_IMPLEMENTATION"
REMEDY = (
    "run the engine (`train-ato run --engine`, mode='engine'), source a ROS 2 installation, or "
    "`pip install 'ros-jazzy-rclpy[fastrtps]' ros-jazzy-common-interfaces`"
)


def require_ros() -> None:
    """Check that ROS 2 is installed, and the middleware of ``RMW_IMPLEMENTATION``."""
    if importlib.util.find_spec("rclpy") is None:
        raise ValueError(f"ROS 2 is not installed (no rclpy); {REMEDY}")
    wanted = os.environ.get(_MIDDLEWARE, "")
    if wanted not in ("", DEFAULT_MIDDLEWARE) and not _loads(wanted):
        raise ValueError(
            f"{_MIDDLEWARE}={wanted}: this middleware is not installed; `unset {_MIDDLEWARE}`, or install its package"
        )


@lru_cache(maxsize=4)
def _loads(middleware: str) -> bool:
    """Return True if rclpy loads a middleware; rcl ends the process without one, so another process loads it."""
    command = [sys.executable, "-c", "import rclpy; rclpy.get_rmw_implementation_identifier()"]
    environment = {**os.environ, _MIDDLEWARE: middleware}
    return subprocess.run(command, env=environment, capture_output=True, check=False).returncode == 0


def missing_ros(error: Exception) -> str | None:
    """Return the remedy as one line if the error is a package of ROS 2 that is missing or does not load, else None."""
    if not isinstance(error, ImportError):
        return None
    if isinstance(error, ModuleNotFoundError) and _of_ros(error.name or ""):
        return f"ROS 2 is not installed (no {error.name}); {REMEDY}"
    passed = [frame.f_globals.get("__name__", "") for frame, _ in traceback.walk_tb(error.__traceback__)]
    if any(_of_ros(name) for name in passed):
        return f"ROS 2 does not load ({str(error).partition(chr(10))[0]}); {REMEDY}"
    return None


def _of_ros(name: str) -> bool:
    """Return True for the name of a Python module of ROS 2."""
    return name.startswith(
        ("rclpy", "rcl_interfaces", "rosgraph_msgs", "builtin_interfaces", "rosidl", "rpyutils")
    ) or (name.partition(".")[0].endswith(("_msgs", "_srvs")))
