"""Sequence of a replay: messages of a log at their times, and the service calls that change it.

This module does not use ROS; a :class:`~train_ato.playback.publishing.Player` sends the messages and processes the
service calls.
"""

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from train_ato.log.mcap_records import RawMessage
from train_ato.playback.log import DISORDER_NS, LogTopic, ReplayLog, ReplayOptions


class ReplayClock:
    """Clock of the log time with rate, pause and jump.

    Parameters
    ----------
    rate
        Simulated seconds per second of wall time; if infinite, the time follows the messages.
    paused
        Start paused.
    steady
        Monotonic wall clock [s].
    """

    def __init__(self, rate: float, *, paused: bool, steady: Callable[[], float] = time.monotonic) -> None:
        self._steady = steady
        self.rate = rate
        self.paused = paused
        self._place = 0.0
        self._since = steady()

    @property
    def now(self) -> float:
        """Time of the log [s]."""
        if self.paused or math.isinf(self.rate):
            return self._place
        return self._place + max(0.0, self._steady() - self._since) * self.rate

    def jump(self, place: float, delay: float = 0.0) -> None:
        """Set the time of the log [s]; it is constant for a delay [s of wall time]."""
        self._place = place
        self._since = self._steady() + delay

    def reached(self, place: float) -> None:
        """Set the time of the log to that of a sent message [s], in a pause or at an infinite rate."""
        if self.paused or math.isinf(self.rate):
            self._place = place

    def set_rate(self, rate: float) -> None:
        """Change the rate; ValueError if the rate is not above 0."""
        if not rate > 0:
            raise ValueError(f"rate {rate:g}: give a number above 0, 1 for real time")
        self._settle()
        self.rate = rate

    def set_paused(self, paused: bool) -> None:
        """Pause or resume the clock."""
        self._settle()
        self.paused = paused

    def _settle(self) -> None:
        """Restart the time count at the present time; a running delay continues."""
        self._place, self._since = self.now, max(self._since, self._steady())

    def until(self, place: float) -> float:
        """Return the wall time until a time of the log [s]; infinite in a pause."""
        if self.paused:
            return math.inf
        delay = max(0.0, self._since - self._steady())
        if math.isinf(self.rate):
            return delay
        return delay + max(0.0, (place - self.now) / self.rate)


TURN_S = 0.1
"""Longest time between two checks for service calls [s]."""
BUSY_S = 0.005
"""Longest such time while messages are sent without a wait [s]."""


@dataclass(frozen=True)
class ReplayState:
    """State of a replay: time of the log and its length [s], rate, pause."""

    moment: float
    length: float
    rate: float
    paused: bool


class Playback:
    """Sequence of a replay.

    Times in arguments and results are seconds from the first message of the log.

    Parameters
    ----------
    log, topics, options
        Log, published topics by their name in the log, and options.
    outlet
        Destination of the messages, a ``Player``: its methods ``publish``, ``ready`` and ``turn``.
    interrupted
        Returns True if the replay must end at once.
    progress
        Callback for the state, about ten times a second.
    """

    def __init__(
        self,
        log: ReplayLog,
        topics: Mapping[str, LogTopic],
        options: ReplayOptions,
        outlet: Any,
        *,
        interrupted: Callable[[], bool],
        progress: Callable[[ReplayState], None] | None = None,
    ) -> None:
        self._log = log
        self._topics = topics
        self._depths = {name: topic.depth for name, topic in topics.items() if topic.latched}
        self._options = options
        self._outlet = outlet
        self._interrupted = interrupted
        self._progress = progress
        self._clock = ReplayClock(options.rate, paused=options.start_paused)
        self._offset, self._duration = options.start_offset, options.duration
        self._messages: Iterator[RawMessage] = iter(())
        self._next: RawMessage | None = None
        self._turned = self._reported = 0.0
        self._damage: ValueError | None = None
        self.stopped = False

    @property
    def state(self) -> ReplayState:
        """State of the replay."""
        moment = min(self._clock.now, self._log.length)
        return ReplayState(moment, self._log.length, self._clock.rate, self._clock.paused)

    def place_of(self, moment_ns: int) -> float:
        """Return an absolute time of the log [ns since 1970] as seconds from its first message."""
        return (moment_ns - self._log.begin_ns) * 1e-9

    def run(self) -> None:
        """Publish until the end, a stop, or Ctrl-C.

        Raises
        ------
        ValueError
            If a part of the log is damaged.
        """
        self._begin()
        self._follow()
        if self._damage is not None:
            raise self._damage

    def _follow(self) -> None:
        while not (self._interrupted() or self.stopped):
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
        if self._progress is not None and self._turned - self._reported > TURN_S:
            self._reported = self._turned
            self._progress(self.state)

    def _moment(self, message: RawMessage) -> float:
        return (message.publish_ns - self._log.begin_ns) * 1e-9

    def _begin(self) -> None:
        self._go_to(self._offset)
        self._clock.jump(self._offset, self._options.delay)

    def _go_to(self, place: float) -> None:
        """Send the latched messages in force at a time and read the next message."""
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
        """Read the messages after a start, without the latched messages already sent, to the end of the duration."""
        last_ns = None
        if self._duration is not None:
            last_ns = self._log.begin_ns + round((self._offset + self._duration) * 1e9)
        for message in self._log.messages(self._topics, start_ns):
            stamp = message.publish_ns
            if message.channel.topic in self._depths and stamp <= start_ns:
                continue
            if last_ns is not None and stamp > last_ns:
                if stamp > last_ns + DISORDER_NS:
                    return
                continue
            yield message

    def _send(self) -> None:
        """Publish the next message."""
        assert self._next is not None
        self._outlet.publish(self._next)
        self._clock.reached(self._moment(self._next))
        self._line_up()

    def _line_up(self) -> None:
        """Read the next message; damage ends the replay."""
        try:
            self._next = next(self._messages, None)
        except ValueError as damage:
            self._give_up(damage)

    def _give_up(self, damage: ValueError) -> None:
        self._damage, self._next, self.stopped = damage, None, True

    # Commands from the service calls.

    def pause(self) -> None:
        """Pause the time; no message is sent."""
        self._clock.set_paused(True)

    def resume(self) -> None:
        """Resume the time."""
        self._clock.set_paused(False)

    def toggle_paused(self) -> None:
        """Pause, or resume after a pause."""
        self._clock.set_paused(not self._clock.paused)

    def set_rate(self, rate: float) -> None:
        """Change the rate; an infinite rate is as fast as possible.

        Raises
        ------
        ValueError
            If the rate is not above 0.
        """
        self._clock.set_rate(rate)

    def play_next(self) -> None:
        """Send the next message now; ValueError if the replay is not paused, or at its end."""
        if self.burst(1) == 0:
            raise ValueError("play_next: end of the run; seek back first")

    def burst(self, count: int) -> int:
        """Send a number of messages now, 0 for all that remain; return the number of sent messages.

        Raises
        ------
        ValueError
            If the replay is not paused.
        """
        if not self._clock.paused:
            raise ValueError("play_next and burst work in a pause; call pause first")
        sent = 0
        while self._next is not None and (count == 0 or sent < count) and not (self._interrupted() or self.stopped):
            if self._outlet.ready():
                self._send()
                sent += 1
        return sent

    def seek(self, place: float) -> None:
        """Move to a time of the run; the latched messages in force there are sent again.

        Raises
        ------
        ValueError
            If the time is outside the run.
        """
        self._log.check_place("seek", place)
        self._go_to(place)
        self._clock.jump(place)

    def play(self, offset: float, duration: float | None) -> None:
        """Play again from an offset for a duration, after the end of the replay.

        Raises
        ------
        ValueError
            If the replay has not ended, or the offset is outside the run.
        """
        if self._next is not None:
            raise ValueError("play: the replay has not ended; use seek, or resume after a pause")
        self._log.check_place("start offset", offset)
        self._offset, self._duration = offset, duration
        self._begin()
        self.resume()

    def stop(self) -> None:
        """End the replay."""
        self.stopped = True
