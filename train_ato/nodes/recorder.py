"""Node ``recorder``: writes every topic of the table to the log, as the bytes that came.

Its queues hold 1000 messages and are emptied a few times a second, all messages of a topic at once: that costs a
third of a callback for each.  On ``record/acknowledged`` it tells the plant how far it is, so that the plant never
fills a queue; so no message is lost at any speed, and the counts are compared at the end.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from operator import itemgetter

from train_ato.nodes.shell import Shell
from train_ato.record.run_log import RunLog
from train_ato.topics import EPOCH_NS
from train_ato.types import Tick
from train_ato.wire import stamp_of

ACKNOWLEDGE_EVERY = 100
"""Ticks from one acknowledgement to the next."""


class RecorderNode:
    """Raw subscriptions on all recorded topics, one log.

    Attributes
    ----------
    closed : bool
        The log is closed.
    """

    def __init__(self, log: RunLog, shell: Shell) -> None:
        self.log = log
        self.shell = shell
        self.closed = False
        self._next = ACKNOWLEDGE_EVERY
        self._ticking = shell.wire.shape.tick_topics
        self._last: dict[str, int] = {}
        names = [topic.name for topic in shell.wire.shape.topics if topic.recorded]
        self._takers = [(name, shell.taker(name)) for name in names]

    def poll(self) -> int:
        """Write everything that waits in the queues, in the order of receipt; return how many messages that were.

        Raises
        ------
        OSError
            If the disk is full or gone.
        """
        waiting = []
        for name, take in self._takers:
            while (found := take()) is not None:
                data, information = found
                waiting.append((information["received_timestamp"], name, data))
        waiting.sort(key=itemgetter(0))
        add = self.log.add
        last = self._last
        for received, name, data in waiting:
            last[name] = stamp = stamp_of(data)
            add(name, EPOCH_NS + stamp, received, data)
        self._acknowledge()
        return len(waiting)

    def _acknowledge(self) -> None:
        """Say how far the log is on every topic."""
        counts, ticking = self.log.counts, self._ticking
        complete = min(counts[name] for name in ticking)
        if complete >= self._next:
            self._next = complete + ACKNOWLEDGE_EVERY
            self.shell.publish("record/acknowledged", Tick(min(self._last[name] for name in ticking)))

    def complete(self, published: Mapping[str, int]) -> bool:
        """Tell whether as many messages are recorded as were published."""
        return all(self.log.counts[name] >= count for name, count in published.items() if name in self.log.counts)

    def close(self, published: Mapping[str, int] | None) -> None:
        """Write what has come and close the log; with the numbers of published messages, compare them.

        Raises
        ------
        ValueError
            If a topic was published more or less often than it was recorded.
        OSError
            If the disk is full or gone.
        """
        self.closed = True
        if self.log.failure is None:
            self.poll()
        self.log.close()
        for name, recorded in self.log.counts.items():
            if published is not None and published.get(name, 0) != recorded:
                raise ValueError(f"{recorded} messages of {name} are recorded, {published.get(name, 0)} were published")


def main() -> int:
    """Run this node alone in a process."""
    from train_ato.nodes.process import run_role
    from train_ato.topics import Role

    return run_role(Role.RECORDER)


if __name__ == "__main__":
    sys.exit(main())
