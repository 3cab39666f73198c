"""Publishing a recorded run again, with its names, types, quality of service and pace."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from train_ato.interrupt import interruptible
from train_ato.replay.log import ReplayLog
from train_ato.replay.options import ReplayOptions, chosen_topics
from train_ato.replay.playback import Playback, ReplayState


@dataclass(frozen=True)
class Replayed:
    """What a replay sent, and how it ended.

    Attributes
    ----------
    counts : dict
        Number of messages sent, by their topic in the log.
    moment : float
        Time of the log that was reached [s].
    end : str
        ``end``, ``stopped`` by the service, or ``interrupted`` by Ctrl-C.
    acknowledged : bool
        The readers have confirmed that they have everything.
    """

    counts: dict[str, int]
    moment: float
    end: str
    acknowledged: bool


Keys = Callable[[Playback], None]
"""Looks at the keyboard and gives its orders."""


def replay(
    run: Path,
    options: ReplayOptions,
    *,
    domain: int | None = None,
    progress: Callable[[ReplayState], None] | None = None,
    keys: Keys | None = None,
) -> Replayed:
    """Publish a recorded run again until its end, the service ``stop``, or Ctrl-C.

    Messages go out as the bytes that were recorded, in the order of the log, at their publish times.  Nothing is sent
    before readers that are there already are matched; latched topics from before the start are sent first.

    Parameters
    ----------
    run
        Run folder or MCAP file.
    options
        Pace, choice and names.
    domain
        ROS domain; default: that of the environment.
    progress
        Takes the state about ten times a second.
    keys
        Called as often.

    Returns
    -------
    Replayed
        What was sent and how it ended.

    Raises
    ------
    ValueError
        For bad options, topics that are not in the log, message types that are not installed, or a damaged log.
    """
    options.check()
    with ReplayLog(run) as log, interruptible() as interrupt:
        topics = chosen_topics(log.topics, options)
        log.check_place("--start-offset", options.start_offset)
        from train_ato.graph.assembly import executor_of
        from train_ato.replay.orders import ReplayParameters, offer_services
        from train_ato.replay.player import Player

        def asked() -> bool:
            return interrupt.asked

        def told(state: ReplayState) -> None:
            if progress is not None:
                progress(state)
            if keys is not None:
                keys(playback)

        # without arguments of its own rclpy reads those of the command line, and renames what is renamed already
        with executor_of(domain, []) as (context, executor):
            player = Player(executor, context, topics, options.clock_hz)
            playback = Playback(log, topics, options, player, asked, told)
            ReplayParameters(player.node, playback)
            player.meet(options.meet_s, asked)
            others = player.others()
            _warn_of_others(others)
            offer_services(player.node, playback)
            playback.run()
            acknowledged = player.settle(options.acknowledged_s, asked)
            _warn_of_others({topic: nodes for topic, nodes in player.others().items() if topic not in others})
        end = "stopped" if playback.stopped else "interrupted" if interrupt.asked else "end"
        return Replayed(player.counts, playback.state.moment, end, acknowledged)


def _warn_of_others(others: Mapping[str, Sequence[str]]) -> None:
    for topic, nodes in others.items():
        sys.stderr.write(
            f"train-ato: {topic}: published on this domain by {', '.join(nodes)} too, readers get both; give --domain, "
            "--remap or --exclude-topics\n"
        )
