"""Services of a replay with the types of rosbag2, as in ``ros2 bag play``.

Without these types every service is a ``std_srvs/srv/Trigger`` of the same name; the arguments of the requests of
rosbag2 are parameters of the node.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from train_ato.apps.replay.playback import Playback

SERVICES = (
    "pause",
    "resume",
    "toggle_paused",
    "is_paused",
    "get_rate",
    "set_rate",
    "play_next",
    "burst",
    "seek",
    "play",
    "stop",
)


def offer_triggers(node: Any, playback: Playback) -> None:
    """Create the services; the answer to a rejected call is the reason.

    Parameters
    ----------
    node
        Node of the replay; its name is the prefix of the services.
    playback
        Replay to control.
    """
    from std_srvs.srv import Trigger

    def parameter(name: str) -> Any:
        return node.get_parameter(name).value

    def place() -> str:
        state = playback.state
        return f"{'paused' if state.paused else 'plays'} at {state.moment:.3f} of {state.length:.3f} s"

    def burst() -> str:
        sent = playback.burst(parameter("burst"))
        return f"{sent} messages sent; {place()}"

    def stop() -> str:
        before = place()
        playback.stop()
        return f"stopped, {before}"

    actions: dict[str, Callable[[], Any]] = {
        "is_paused": lambda: (playback.state.paused, place()),
        "get_rate": lambda: f"{playback.state.rate:g}",
        "set_rate": lambda: f"rate {playback.state.rate:g}, from the parameter",
        "burst": burst,
        "seek": lambda: playback.seek(parameter("seek")),
        "play": lambda: playback.play(parameter("start_offset"), parameter("playback_duration") or None),
        "stop": stop,
    }
    for name in SERVICES:
        action = actions.get(name) or getattr(playback, name)
        node.create_service(Trigger, f"~/{name}", _triggered(action, place))


def _triggered(action: Callable[[], Any], place: Callable[[], str]) -> Callable[[Any, Any], Any]:
    """Return the callback of a Trigger.

    The message is the result of the action, the place if it has none, or the text of its ValueError.
    """

    def answer(request: Any, response: Any) -> Any:
        try:
            result = action()
            result = place() if result is None else result
            response.success, response.message = (True, result) if isinstance(result, str) else result
        except ValueError as error:
            response.success, response.message = False, str(error)
        return response

    return answer


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
