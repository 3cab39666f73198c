"""Services of a replay with the names of rosbag2's player, without its types.

Every service is a ``std_srvs/srv/Trigger``; the arguments of the requests of rosbag2 are parameters of the node.
"""

from __future__ import annotations

from collections.abc import Callable
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
