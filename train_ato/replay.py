"""Publishing a recorded run again, with its names, types, quality of service and pace."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from train_ato.control.parameters import closest
from train_ato.record.layout import table_name
from train_ato.record.reading import RawMessage, log_file, stream
from train_ato.replay_player import CLOCK, TURN_S, LogTopic, Player, ReplayOptions
from train_ato.topics import EPOCH_NS

__all__ = ["ReplayOptions", "chosen_topics", "parse_remap", "replay"]


def parse_remap(entries: tuple[str, ...]) -> dict[str, str]:
    """Turn ``a:=b`` texts into a mapping.

    Raises
    ------
    ValueError
        If a text does not have that form.
    """
    mapping = {}
    for entry in entries:
        before, sign, after = entry.partition(":=")
        if not (sign and before and after):
            raise ValueError(f"--remap {entry}: write it as from:=to, for example --remap ato/command:=shadow/command")
        mapping[before] = after
    return mapping


def _absolute(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"


def chosen_topics(run: Path, options: ReplayOptions) -> dict[str, LogTopic]:
    """Return the topics of a log that are published, by their name in the log.

    Raises
    ------
    ValueError
        If a topic that is asked for or renamed is not in the log; with the nearest name.
    """
    found: dict[str, LogTopic] = {}
    for message in stream(log_file(run)):
        name = message.channel.topic
        if name in found:
            continue
        profiles = yaml.safe_load(message.channel.metadata.get("offered_qos_profiles", "")) or [{}]
        latched = profiles[0].get("durability") == "transient_local"
        found[name] = LogTopic(name, name, message.schema.name, latched, max(1, int(profiles[0].get("depth") or 10)))
    for option, names in (("--topics", options.topics), ("--remap", tuple(options.remap))):
        for name in names:
            if _absolute(name) not in found:
                raise ValueError(
                    f"{option} {name}: not in the log{closest(_absolute(name), found)}; it has: {_list(found)}"
                )
    wanted = {_absolute(name) for name in options.topics} or set(found)
    renamed = {_absolute(before): after for before, after in options.remap.items()}
    chosen = {name: topic for name, topic in found.items() if name in wanted}
    if options.clock_hz is not None:
        chosen.pop(CLOCK, None)
    return {
        name: LogTopic(name, renamed.get(name, name), topic.type, topic.latched, topic.depth)
        for name, topic in chosen.items()
    }


def _list(names: Mapping[str, object]) -> str:
    return ", ".join(sorted(names))


def _messages(run: Path, topics: Mapping[str, LogTopic]) -> Iterator[RawMessage]:
    return (message for message in stream(log_file(run)) if message.channel.topic in topics)


def replay(
    run: Path,
    options: ReplayOptions,
    *,
    domain: int | None = None,
    progress: Callable[[float], None] | None = None,
    ready: Callable[[Any], bool] | None = None,
) -> dict[str, int]:
    """Publish a recorded run again until its end or Ctrl-C.

    Messages go out as the bytes that were recorded, at their publish times; latched topics are sent first, so that a
    tool that comes later gets them.

    Parameters
    ----------
    run
        Run folder or MCAP file.
    options
        Pace, choice and names.
    domain
        ROS domain; default: that of the environment.
    progress
        Takes the simulated time [s], about ten times a second.
    ready
        Asked with the node until it returns True; nothing is sent before.

    Returns
    -------
    dict
        Number of messages sent per topic of the log.

    Raises
    ------
    ValueError
        For bad options, topics that are not in the log, or message types that are not installed.
    """
    options.check()
    topics = chosen_topics(run, options)
    from train_ato.graph.assembly import executor_of
    from train_ato.interrupt import interruptible

    with interruptible() as interrupt, executor_of(domain) as (context, executor):
        player = Player(executor, context, topics, options)
        while ready is not None and not interrupt.asked and not ready(player.node):
            executor.spin_once(timeout_sec=0.02)
        again = True
        while again and not interrupt.asked:
            _play_once(player, run, topics, options, progress, lambda: interrupt.asked)
            again = options.loop
        player.settle()
    return player.counts


def _play_once(
    player: Player,
    run: Path,
    topics: Mapping[str, LogTopic],
    options: ReplayOptions,
    progress: Callable[[float], None] | None,
    asked: Callable[[], bool],
) -> None:
    """Publish the log from the offset to its end."""
    latched = {name for name, topic in topics.items() if topic.latched}
    begin: int | None = None
    told = 0.0
    player.begin_at(options.start_offset)
    for message in _messages(run, topics):
        begin = _begin_of(message) if begin is None else begin
        moment = (message.publish_ns - begin) * 1e-9
        if message.channel.topic not in latched:
            if moment < options.start_offset:
                continue
            if not player.wait_for(moment, asked):
                return
        player.publish(message)
        if progress is not None and time.monotonic() - told > TURN_S:
            told = time.monotonic()
            progress(moment)


def _begin_of(first: RawMessage) -> int:
    """Return the time that counts as the start: the epoch for our own logs, the first message for others."""
    ours = table_name(first.channel.topic) is not None and first.publish_ns >= EPOCH_NS
    return EPOCH_NS if ours else first.publish_ns
