"""Services of a replay with the types of rosbag2, as in ``ros2 bag play``."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from train_ato.apps.replay.playback import Playback
from train_ato.apps.replay.trigger_services import SERVICES


def rosbag2_types() -> Any | None:
    """Return the service types of rosbag2, None if they are not installed."""
    try:
        types = import_module("rosbag2_interfaces.srv")
    except ImportError:
        return None
    return types if all(hasattr(types, type_name(service)) for service in SERVICES) else None


def type_name(service: str) -> str:
    """Return the type name of a service: PlayNext for ``play_next``."""
    return "".join(part.capitalize() for part in service.split("_"))


class Rosbag2Services:
    """Handler of the requests of rosbag2.

    Parameters
    ----------
    node
        Node of the replay; its name is the prefix of the services.
    playback
        Replay to control.
    types
        Module ``rosbag2_interfaces.srv``.
    """

    def __init__(self, node: Any, playback: Playback, types: Any) -> None:
        self._node = node
        self._playback = playback
        for service in SERVICES:
            node.create_service(getattr(types, type_name(service)), f"~/{service}", getattr(self, f"_{service}"))

    def _pause(self, request: Any, response: Any) -> Any:
        self._playback.pause()
        return response

    def _resume(self, request: Any, response: Any) -> Any:
        self._playback.resume()
        return response

    def _toggle_paused(self, request: Any, response: Any) -> Any:
        self._playback.toggle_paused()
        return response

    def _is_paused(self, request: Any, response: Any) -> Any:
        response.paused = self._playback.state.paused
        return response

    def _get_rate(self, request: Any, response: Any) -> Any:
        response.rate = float(self._playback.state.rate)
        return response

    def _set_rate(self, request: Any, response: Any) -> Any:
        from rclpy.parameter import Parameter

        change = Parameter("rate", Parameter.Type.DOUBLE, request.rate)
        response.success = bool(self._node.set_parameters([change])[0].successful)
        return response

    def _play_next(self, request: Any, response: Any) -> Any:
        response.success = self._done(self._playback.play_next)
        return response

    def _burst(self, request: Any, response: Any) -> Any:
        self._done(lambda: setattr(response, "actually_burst", self._playback.burst(int(request.num_messages))))
        return response

    def _seek(self, request: Any, response: Any) -> Any:
        """Move to an absolute time of the log, as in rosbag2."""
        response.success = self._done(lambda: self._playback.seek(self._playback.place_of(_nanoseconds(request.time))))
        return response

    def _play(self, request: Any, response: Any) -> Any:
        offset, duration = _nanoseconds(request.start_offset) * 1e-9, _nanoseconds(request.playback_duration) * 1e-9
        response.success = self._done(lambda: self._playback.play(offset, duration if duration > 0 else None))
        return response

    def _stop(self, request: Any, response: Any) -> Any:
        self._playback.stop()
        return response

    def _done(self, order: Callable[[], None]) -> bool:
        try:
            order()
        except ValueError:
            return False
        return True


def _nanoseconds(time: Any) -> int:
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)
