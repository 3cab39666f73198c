"""Options of a replay and selection of its topics."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from train_ato.apps.replay.log import LogTopic
from train_ato.control.parameters import closest

CLOCK = "/clock"


@dataclass(frozen=True)
class ReplayOptions:
    """Options of a replay.

    Attributes
    ----------
    rate : float
        Simulated seconds per second of wall time; infinite: as fast as the readers receive the messages.
    start_offset : float
        Start after the first message [s]; earlier latched messages are sent first.
    duration : float or None
        Published time of the log [s]; None: to its end.
    delay : float
        Wall time before the first message of every loop [s].
    loop, start_paused : bool
        Restart at the end; wait for the service ``resume``.
    clock_hz : float or None
        Rate of ``/clock`` [1/s of wall time], which replaces the recorded one.
    topics, exclude : tuple of str
        Names in the log, with or without the leading slash: published topics (empty: all) and excluded topics.
    remap : mapping of str to str
        Published name by the name in the log.
    meet_s : float
        Longest wall time to wait for existing readers [s].
    acknowledged_s : float
        Longest wall time to wait at the end for the confirmation of all messages by the readers [s].
    """

    rate: float = 1.0
    start_offset: float = 0.0
    duration: float | None = None
    delay: float = 0.0
    loop: bool = False
    start_paused: bool = False
    clock_hz: float | None = None
    topics: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    remap: Mapping[str, str] = field(default_factory=dict)
    meet_s: float = 5.0
    acknowledged_s: float = 5.0

    def check(self) -> None:
        """Reject invalid values.

        Raises
        ------
        ValueError
            One line that names the option, its value and the remedy.
        """
        if not self.rate > 0:
            raise ValueError(f"--rate {self.rate:g}: give a number above 0, 1 for real time, or max")
        if not (math.isfinite(self.start_offset) and self.start_offset >= 0):
            raise ValueError(f"--start-offset {self.start_offset:g}: give seconds from the run's start, 0 or more")
        if self.duration is not None and not (math.isfinite(self.duration) and self.duration > 0):
            raise ValueError(f"--playback-duration {self.duration:g}: give seconds of the run, more than 0")
        if not 0 <= self.delay <= 86_400:
            raise ValueError(f"--delay {self.delay:g}: give 0 to 86400 s")
        if self.clock_hz is not None and not 0 < self.clock_hz <= 10_000:
            raise ValueError(f"--clock {self.clock_hz:g}: give a rate above 0 and up to 10000 Hz")
        if not self.acknowledged_s >= 0:
            raise ValueError(f"--wait-for-all-acked {self.acknowledged_s * 1e3:g}: give milliseconds, 0 for no limit")


def parse_remap(entries: tuple[str, ...]) -> dict[str, str]:
    """Return the mapping of texts ``a:=b``.

    Raises
    ------
    ValueError
        If a text has another form, or a topic has two new names.
    """
    mapping: dict[str, str] = {}
    for entry in entries:
        before, sign, after = entry.partition(":=")
        if not (sign and before and after):
            raise ValueError(f"--remap {entry}: write it as from:=to, for example --remap ato/command:=shadow/command")
        if absolute(before) in map(absolute, mapping):
            raise ValueError(f"--remap {entry}: {before} already has another new name; give one name")
        mapping[before] = after
    return mapping


def absolute(name: str) -> str:
    """Return the name of a topic with a leading slash."""
    return name if name.startswith("/") else f"/{name}"


def chosen_topics(found: Mapping[str, LogTopic], options: ReplayOptions) -> dict[str, LogTopic]:
    """Return the published topics of a log, by their name in the log.

    Raises
    ------
    ValueError
        If a topic is not in the log (with the nearest name), if no topic remains, or if two topics of different types
        have the same published name.
    """
    named = (("--topics", options.topics), ("--exclude-topics", options.exclude), ("--remap", tuple(options.remap)))
    for option, names in named:
        for name in names:
            if absolute(name) not in found:
                raise ValueError(
                    f"{option} {name}: not in the log{closest(absolute(name), found)}; it has: {_list(found)}"
                )
    wanted = {absolute(name) for name in options.topics} or set(found)
    wanted -= {absolute(name) for name in options.exclude}
    if options.clock_hz is not None:
        wanted.discard(CLOCK)
    if not wanted:
        raise ValueError("--topics, --exclude-topics and --clock leave no topic to publish; select at least one")
    renamed = {absolute(before): after for before, after in options.remap.items()}
    chosen = {
        name: replace(topic, published_as=renamed.get(name, topic.published_as))
        for name, topic in found.items()
        if name in wanted
    }
    _check_names(chosen)
    return chosen


def _check_names(chosen: Mapping[str, LogTopic]) -> None:
    kinds: dict[str, LogTopic] = {}
    for topic in chosen.values():
        other = kinds.setdefault(absolute(topic.published_as), topic)
        if other.type != topic.type:
            raise ValueError(
                f"{other.name} ({other.type}) and {topic.name} ({topic.type}) would both be published as "
                f"{topic.published_as}; change --remap"
            )


def _list(names: Mapping[str, object]) -> str:
    return ", ".join(sorted(names))
