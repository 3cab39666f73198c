"""Services and parameters of a replay, with the names of rosbag2's player.

With the package ``rosbag2_interfaces`` the services have its types, and ``ros2 service call`` works as with
``ros2 bag play``.  The package is not among the wheels; without it every service is a ``std_srvs/srv/Trigger``.
"""

from __future__ import annotations

import math
from typing import Any

from train_ato.apps.replay.playback import Playback
from train_ato.apps.replay.rosbag2_services import Rosbag2Services, rosbag2_types
from train_ato.apps.replay.trigger_services import offer_triggers

PARAMETERS: tuple[tuple[str, float | int, str], ...] = (
    ("rate", 1.0, "simulated seconds per second, .inf for as fast as possible; takes effect at once"),
    ("seek", 0.0, "time of the service seek [s from the first message]"),
    ("burst", 1, "number of messages of the service burst; 0: all"),
    ("start_offset", 0.0, "start of the service play [s from the first message]"),
    ("playback_duration", 0.0, "duration of the service play [s]; 0: to the end"),
)


def offer_services(node: Any, playback: Playback) -> None:
    """Create the services of a replay on its node, after the wait for existing readers."""
    types = rosbag2_types()
    if types is None:
        offer_triggers(node, playback)
    else:
        Rosbag2Services(node, playback, types)


class ReplayParameters:
    """Parameters of the node: the rate, and the arguments of services without a request."""

    def __init__(self, node: Any, playback: Playback) -> None:
        from rcl_interfaces.msg import ParameterDescriptor

        self._playback = playback
        for name, value, text in PARAMETERS:
            start = playback.state.rate if name == "rate" else value
            node.declare_parameter(name, start, ParameterDescriptor(description=text))
        node.add_on_set_parameters_callback(self._refuse)
        node.add_post_set_parameters_callback(self._take_over)

    def _refuse(self, parameters: list[Any]) -> Any:
        """Check new values, without side effects."""
        from rcl_interfaces.msg import SetParametersResult

        for parameter in parameters:
            value = parameter.value
            if parameter.name == "rate" and not value > 0:
                return SetParametersResult(successful=False, reason=f"rate {value:g}: give a number above 0")
            if parameter.name in ("seek", "burst", "start_offset", "playback_duration") and not 0 <= value < math.inf:
                return SetParametersResult(successful=False, reason=f"{parameter.name} {value:g}: give 0 or more")
        return SetParametersResult(successful=True)

    def _take_over(self, parameters: list[Any]) -> None:
        for parameter in parameters:
            if parameter.name == "rate":
                self._playback.set_rate(parameter.value)
