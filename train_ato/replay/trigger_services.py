"""Services of a replay under the names of rosbag2's player, without its types.

Every service is a ``std_srvs/srv/Trigger``; what a request of rosbag2 carries is a parameter of the node, set first.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from train_ato.replay.playback import Playback

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


class TriggerServices:
    """Answers calls; an order that is refused answers with the reason.

    Parameters
    ----------
    node
        Node of the replay; the services get its name in front.
    playback
        Takes the orders.
    """

    def __init__(self, node: Any, playback: Playback) -> None:
        from std_srvs.srv import Trigger

        self._node = node
        self._playback = playback
        for name in SERVICES:
            node.create_service(Trigger, f"~/{name}", _triggered(getattr(self, f"_{name}")))

    def _parameter(self, name: str) -> Any:
        return self._node.get_parameter(name).value

    def _place(self) -> str:
        state = self._playback.state
        return f"{'paused' if state.paused else 'plays'} at {state.moment:.3f} of {state.length:.3f} s"

    def _pause(self) -> str:
        self._playback.pause()
        return self._place()

    def _resume(self) -> str:
        self._playback.resume()
        return self._place()

    def _toggle_paused(self) -> str:
        return self._resume() if self._playback.state.paused else self._pause()

    def _is_paused(self) -> tuple[bool, str]:
        return self._playback.state.paused, self._place()

    def _get_rate(self) -> str:
        return f"{self._playback.state.rate:g}"

    def _set_rate(self) -> str:
        return f"rate {self._playback.state.rate:g}, that of the parameter"

    def _play_next(self) -> str:
        self._playback.play_next()
        return self._place()

    def _burst(self) -> str:
        sent = self._playback.burst(self._parameter("burst"))
        return f"{sent} messages sent; {self._place()}"

    def _seek(self) -> str:
        self._playback.seek(self._parameter("seek"))
        return self._place()

    def _play(self) -> str:
        self._playback.play(self._parameter("start_offset"), self._parameter("playback_duration") or None)
        return self._place()

    def _stop(self) -> str:
        place = self._place()
        self._playback.stop()
        return f"stopped, {place}"


def _triggered(action: Callable[[], str | tuple[bool, str]]) -> Callable[[Any, Any], Any]:
    """Return the callback of a Trigger; what an action refuses is its answer."""

    def answer(request: Any, response: Any) -> Any:
        try:
            result = action()
            response.success, response.message = (True, result) if isinstance(result, str) else result
        except ValueError as error:
            response.success, response.message = False, str(error)
        return response

    return answer
