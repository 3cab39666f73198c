"""What a replay does next: the messages of a log at their times, and the orders that change this.

It knows no ROS: something else sends the messages and lets the orders in.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol

from train_ato.record.reading import RawMessage
from train_ato.replay.clock import ReplayClock
from train_ato.replay.log import DISORDER_NS, LogTopic, ReplayLog, message_time
from train_ato.replay.options import ReplayOptions

TURN_S = 0.1
"""Longest time for which orders are not looked at [s]."""
BUSY_S = 0.005
"""The same while messages go out without a wait between them [s]."""


class Outlet(Protocol):
    """Where the messages go."""

    def publish(self, message: RawMessage) -> None:
        """Send a message."""

    def ready(self) -> bool:
        """Tell whether the readers can take another message; may wait a little for them."""

    def turn(self, seconds: float, moment_ns: int) -> None:
        """Let orders in for so long at most; ``moment_ns`` is the time of the log on ``/clock``."""


@dataclass(frozen=True)
class ReplayState:
    """How far a replay is: time of the log and its length [s]."""

    moment: float
    length: float
    rate: float
    paused: bool


class Playback:
    """The course of a replay.

    Times in orders and answers are seconds from the first message of the log.

    Parameters
    ----------
    log, topics, options
        What is published, and how; the topics by their name in the log.
    outlet
        Takes the messages.
    asked
        Tells whether the replay is to end at once.
    progress
        Takes the state about ten times a second.

    Raises
    ------
    ValueError
        If the start lies beyond the end of the run.
    """

    def __init__(
        self,
        log: ReplayLog,
        topics: Mapping[str, LogTopic],
        options: ReplayOptions,
        outlet: Outlet,
        asked: Callable[[], bool],
        progress: Callable[[ReplayState], None] | None = None,
    ) -> None:
        self._log = log
        self._topics = topics
        self._depths = {name: topic.depth for name, topic in topics.items() if topic.latched}
        self._options = options
        self._outlet = outlet
        self._asked = asked
        self._progress = progress
        self._clock = ReplayClock(options.rate, options.start_paused)
        self._offset, self._duration = options.start_offset, options.duration
        self._messages: Iterator[RawMessage] = iter(())
        self._next: RawMessage | None = None
        self._turned = self._told = 0.0
        self._damage: ValueError | None = None
        self.stopped = False

    @property
    def length(self) -> float:
        """Time from the first message of the log to the last [s]."""
        return self._log.length

    @property
    def state(self) -> ReplayState:
        """How far the replay is."""
        moment = min(self._clock.now, self.length)
        return ReplayState(moment, self.length, self._clock.rate, self._clock.paused)

    def place_of(self, moment_ns: int) -> float:
        """Return an absolute time of the log [ns since 1970] as seconds from its first message."""
        return (moment_ns - self._log.begin_ns) * 1e-9

    def run(self) -> None:
        """Publish until the end, the order to stop, or Ctrl-C.

        Raises
        ------
        ValueError
            If a damaged part of the log is met.
        """
        self._begin()
        self._follow()
        if self._damage is not None:
            raise self._damage

    def _follow(self) -> None:
        while not (self._asked() or self.stopped):
            if self._next is None:
                if self._clock.paused:
                    self._turn(TURN_S)
                elif self._options.loop:
                    self._begin()
                else:
                    return
                continue
            wait = self._clock.until(self._moment(self._next))
            if wait > 0:
                self._turn(min(wait, TURN_S))
            elif self._outlet.ready():
                self._send()
                if time.monotonic() - self._turned > BUSY_S:
                    self._turn(0.0)
            else:
                self._turn(0.0)

    def _turn(self, seconds: float) -> None:
        self._outlet.turn(seconds, self._log.begin_ns + round(self.state.moment * 1e9))
        self._turned = time.monotonic()
        if self._progress is not None and self._turned - self._told > TURN_S:
            self._told = self._turned
            self._progress(self.state)

    def _moment(self, message: RawMessage) -> float:
        return (message_time(message) - self._log.begin_ns) * 1e-9

    def _begin(self) -> None:
        self._go_to(self._offset)
        self._clock.jump(self._offset, self._options.delay)

    def _go_to(self, place: float) -> None:
        """Send the latched messages that stand at a moment and put the one that comes next in line."""
        start_ns = self._log.begin_ns + round(place * 1e9)
        try:
            standing = self._log.standing(self._depths, start_ns)
        except ValueError as damage:
            self._give_up(damage)
            return
        for message in standing:
            self._outlet.publish(message)
        self._messages = self._from(start_ns)
        self._line_up()

    def _from(self, start_ns: int) -> Iterator[RawMessage]:
        """Read what comes after the latched messages that stand at a moment, up to the last moment that is wanted."""
        last_ns = None
        if self._duration is not None:
            last_ns = self._log.begin_ns + round((self._offset + self._duration) * 1e9)
        for message in self._log.messages(self._topics, start_ns):
            stamp = message_time(message)
            if message.channel.topic in self._depths and stamp <= start_ns:
                continue
            if last_ns is not None and stamp > last_ns:
                if stamp > last_ns + DISORDER_NS:
                    return
                continue
            yield message

    def _send(self) -> None:
        """Publish the message that is in line."""
        assert self._next is not None
        self._outlet.publish(self._next)
        self._clock.reached(self._moment(self._next))
        self._line_up()

    def _line_up(self) -> None:
        """Read the message that comes next; damage ends the replay, also where an order led to it."""
        try:
            self._next = next(self._messages, None)
        except ValueError as damage:
            self._give_up(damage)

    def _give_up(self, damage: ValueError) -> None:
        self._damage, self._next, self.stopped = damage, None, True

    # Orders, given while the outlet turns.

    def pause(self) -> None:
        """Let time stand still; nothing is sent from now on."""
        self._clock.set_paused(True)

    def resume(self) -> None:
        """Let time flow again."""
        self._clock.set_paused(False)

    def set_rate(self, rate: float) -> None:
        """Change the rate; infinite is as fast as possible.

        Raises
        ------
        ValueError
            If it is not above 0.
        """
        self._clock.set_rate(rate)

    def play_next(self) -> None:
        """Send the next message now.

        Raises
        ------
        ValueError
            Without a pause, or at the end.
        """
        if self.burst(1) == 0:
            raise ValueError("play_next: the end of the run is reached; seek back first")

    def burst(self, count: int) -> int:
        """Send so many messages now, 0 for all that are left, and return how many those were.

        Raises
        ------
        ValueError
            Without a pause.
        """
        if not self._clock.paused:
            raise ValueError("play_next and burst work in a pause; call pause first")
        sent = 0
        while self._next is not None and (count == 0 or sent < count) and not (self._asked() or self.stopped):
            if self._outlet.ready():
                self._send()
                sent += 1
        return sent

    def seek(self, place: float) -> None:
        """Go to a moment of the run, forth or back; what is latched there is sent again.

        Raises
        ------
        ValueError
            If the run has no such moment.
        """
        self._log.check_place("seek", place)
        self._go_to(place)
        self._clock.jump(place)

    def play(self, offset: float, duration: float | None) -> None:
        """Play again from an offset, for a duration, once the end is reached.

        Raises
        ------
        ValueError
            If messages are left, or the run has no such moment.
        """
        if self._next is not None:
            raise ValueError("play: the replay is under way; use seek, or resume after a pause")
        self._log.check_place("start offset", offset)
        self._offset, self._duration = offset, duration
        self._begin()
        self.resume()

    def stop(self) -> None:
        """End the replay."""
        self.stopped = True
