"""Replay of a recorded run with its names, types, quality of service and pace."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from train_ato.apps.replay.log import ReplayLog
from train_ato.apps.replay.options import ReplayOptions, chosen_topics
from train_ato.apps.replay.playback import Playback, ReplayState
from train_ato.apps.replay.rosbag2_services import Rosbag2Services, offer_triggers, rosbag2_types
from train_ato.interrupt import interruptible
from train_ato.ros import require_ros


@dataclass(frozen=True)
class Replayed:
    """Result of a replay.

    Attributes
    ----------
    counts : dict
        Number of sent messages by topic of the log.
    moment : float
        Last time of the log [s].
    end : str
        ``end``, ``stopped`` by the service, or ``interrupted`` by Ctrl-C.
    acknowledged : bool
        The readers have confirmed all messages.
    """

    counts: dict[str, int]
    moment: float
    end: str
    acknowledged: bool


Keys = Callable[[Playback], None]
"""Callback that processes the keys."""


def replay(
    run: Path,
    options: ReplayOptions,
    *,
    domain: int | None = None,
    progress: Callable[[ReplayState], None] | None = None,
    keys: Keys | None = None,
) -> Replayed:
    """Publish a recorded run until its end, the service ``stop``, or Ctrl-C.

    The recorded bytes are sent in the order of the log at their publish times.  The first message is sent after the
    existing readers are matched; latched messages from before the start are sent first.

    Parameters
    ----------
    run
        Run folder or MCAP file.
    options
        Rate, selection and names.
    domain
        ROS domain; default: that of the environment.
    progress
        Callback for the state, about ten times a second.
    keys
        Callback for the keys, at the same rate.

    Returns
    -------
    Replayed
        Sent messages and end of the replay.

    Raises
    ------
    ValueError
        For invalid options, topics not in the log, missing message types, or a damaged log.
    """
    options.check()
    require_ros()
    with ReplayLog(run) as log, interruptible() as interrupt:
        topics = chosen_topics(log.topics, options)
        log.check_place("--start-offset", options.start_offset)
        from train_ato.apps.replay.player import Player
        from train_ato.ros.graph.assembly import executor_of

        def interrupted() -> bool:
            return interrupt.asked

        def report(state: ReplayState) -> None:
            if progress is not None:
                progress(state)
            if keys is not None:
                keys(playback)

        # an empty list: without arguments rclpy would apply the remappings of the command line a second time
        with executor_of(domain, []) as (context, executor):
            player = Player(executor, context, topics, options.clock_hz)
            playback = Playback(log, topics, options, player, interrupted, report)
            ReplayParameters(player.node, playback)
            player.wait_for_readers(options.meet_s, interrupted)
            others = player.others()
            _warn_of_others(others)
            offer_services(player.node, playback)
            playback.run()
            acknowledged = player.wait_for_confirmation(options.acknowledged_s, interrupted)
            _warn_of_others({topic: nodes for topic, nodes in player.others().items() if topic not in others})
        end = "stopped" if playback.stopped else "interrupted" if interrupt.asked else "end"
        return Replayed(player.counts, playback.state.moment, end, acknowledged)


def _warn_of_others(others: Mapping[str, Sequence[str]]) -> None:
    for topic, nodes in others.items():
        sys.stderr.write(
            f"train-ato: {topic}: also published on this domain by {', '.join(nodes)}, readers receive both; give "
            "--domain, --remap or --exclude-topics\n"
        )


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
