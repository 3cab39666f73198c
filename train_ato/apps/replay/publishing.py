"""Replay of a recorded run with its names, types, quality of service and pace."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from train_ato.apps.replay.log import ReplayLog
from train_ato.apps.replay.options import ReplayOptions, chosen_topics
from train_ato.apps.replay.playback import Playback, ReplayState
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
        from train_ato.apps.replay.orders import ReplayParameters, offer_services
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
