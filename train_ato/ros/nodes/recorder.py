"""Node ``recorder``: writes the received bytes of every topic of the table to the log.

Its queues hold 1000 messages and are polled a few times a second, at a third of the cost of callbacks.
``recorder/progress`` limits the lead of the plant, so that no queue overflows and no message is lost at any speed; the
counts are compared at the end.  All programs of a domain publish ``/diagnostics``; only messages of the graph's nodes
are written.  A repeated ``/clock`` of a pause is not written, nor a first message that is sent again, nor what an
external plant causes after the last tick.
"""

import sys
import time
from bisect import bisect_right
from collections.abc import Mapping
from operator import itemgetter
from types import MappingProxyType

from train_ato.judge.run_end import DONE, RunEnd
from train_ato.log.log_writer import RunLog
from train_ato.messages.cdr import stamp_of, with_stamp
from train_ato.messages.topics import BY_NAME, EPOCH_NS, Rate, Role, published_by, tick_topics, topics_of
from train_ato.messages.types import Tick
from train_ato.program.errors import NodeFault
from train_ato.ros.nodes.answer_watch import LEASE_S
from train_ato.ros.nodes.endpoints import NodeEndpoints
from train_ato.ros.nodes.publishers import wait_for_names

ACKNOWLEDGE_EVERY = 100
"""Ticks between two messages on ``recorder/progress``."""
_SHARED = "/diagnostics"
"""Topic that every node publishes, and other programs."""
HOLD_S = 0.5
"""Longest wall time for which a message waits for a topic of its tick without messages [s]."""
Received = tuple[int, int, int, bytes, float]
"""Message of a topic: stamp and time of receipt [ns], number of the topic, bytes, and time of reading [s]."""


class RecorderNode:
    """ROS node with raw subscriptions to all recorded topics, and one log.

    Parameters
    ----------
    log, endpoints
        Log of the run and endpoints of the node.
    tick_ns
        Length of a tick [ns].
    last_due : dict
        Last stamp to be recorded [ns], by topic, for an external plant that goes on after the run.

    Attributes
    ----------
    closed : bool
        True after the log is closed.
    wrong : ValueError or None
        First fault of the record in a supervised run, which goes on until the train is stopped.
    """

    def __init__(
        self, log: RunLog, endpoints: NodeEndpoints, tick_ns: int, last_due: Mapping[str, int] = MappingProxyType({})
    ) -> None:
        self.log = log
        self.endpoints = endpoints
        self._tick_ns = tick_ns
        self.closed = False
        self._next, self._acknowledged = ACKNOWLEDGE_EVERY, -1
        self._ticking = tick_topics(endpoints.wire.layout)
        self._once = [topic.name for topic in topics_of(endpoints.wire.layout) if topic.rate is Rate.ONCE]
        self._of_plant = [name for name in self._ticking if Role.PLANT in BY_NAME[name].publishers]
        self._last: dict[str, int] = {}
        self._last_due = last_due
        self.wrong: ValueError | None = None
        self._held: list[Received] = []
        self._suspended, self._polled = 0.0, time.monotonic()
        names = [topic.name for topic in topics_of(endpoints.wire.layout) if topic.recorded]
        self._takers = [(name, log.numbers[name], *endpoints.taker(name)) for name in names if name != _SHARED]
        self._sources = {name: source for name, _, _, source in self._takers}
        self._take_shared, self._senders = endpoints.shared_taker(_SHARED)

    @property
    def measured(self) -> bool:
        """True after the first measurement."""
        return self._sources["train/measurement"].begun

    @property
    def answered(self) -> bool:
        """True without an external node, or after its answer to the last measurement."""
        external = self.endpoints.external
        return external is None or self.last_stamp_of(external) >= self.last_stamp("train/measurement")

    @property
    def suspended(self) -> float:
        """Longest wall time without a reading of the queues, the present one included [s]."""
        return max(self._suspended, time.monotonic() - self._polled)

    def last_stamp(self, name: str) -> int:
        """Return the stamp of the last message of a topic [ns], -1 without one."""
        return self._last.get(name, -1)

    def last_stamp_of(self, role: Role) -> int:
        """Return the stamp of the last message of a node on a topic that it must answer [ns], -1 without one."""
        names = [topic.name for topic in published_by(role) if topic.rate is Rate.TICK and not topic.optional]
        return min((self._last.get(name, -1) for name in names), default=-1)

    def poll(self, *, last: bool = False) -> int:
        """Read the queues and write the messages in the order of their stamps; return the number of messages read.

        Each topic has its own receiving thread, so that the order of receipt is not the order of the run. A message
        waits until every topic of a tick has its stamp, :data:`HOLD_S` at most. The ``last`` call writes all messages.
        Publish time and log time are the stamp, as in the log of the engine.

        Raises
        ------
        ValueError
            If a message cannot be recorded or has a second publisher; the messages before it are recorded.  In a
            supervised run the recording goes on until the train is stopped, and :meth:`close` raises.
        OSError
            If the disk is full or gone.
        """
        now, self._suspended = time.monotonic(), self.suspended
        self._polled = now
        waiting: list[Received] = []
        wrong: ValueError | None = None
        last_stamps = self._last
        watched = self.wrong is None  # one failure is enough; its search takes time
        for name, number, take, source in self._takers:
            try:
                clock, last_due = name == "/clock", self._last_due.get(name, sys.maxsize)
                while (found := take()) is not None:
                    data, information = found
                    if watched:
                        source.take(information["publication_sequence_number"])
                    stamp = _stamp(name, data)
                    if stamp == -EPOCH_NS and self.endpoints.sent_outside(name):  # the plant takes it for this tick
                        stamp = max(0, last_stamps.get("train/measurement", 0))
                        data = with_stamp(data, stamp)
                    if source.lost > stamp // self._tick_ns and self.endpoints.sent_outside(name):
                        source.lost = 0  # more than the ticks of this run: sent before it by a program that goes on
                    if (clock and stamp == last_stamps.get(name)) or self.endpoints.is_repeated(name, data):
                        continue
                    last_stamps[name] = stamp
                    if stamp > last_due:
                        continue
                    waiting.append((stamp, information["received_timestamp"], number, data, now))
                if watched:
                    source.check()
            except ValueError as error:
                wrong = wrong or error
        shared = self._read_shared(waiting, now, lossy=not watched or wrong is not None)
        wrong = wrong or shared or self._lost_first()
        self._write(waiting, now, whole=last or wrong is not None)
        if type(wrong) is ValueError and self.suspended > LEASE_S:
            wrong = ValueError(f"{wrong}; its process was suspended for {self.suspended:.1f} s")
        if wrong is not None and not self.endpoints.wire.layout.supervised:
            raise wrong
        if wrong is not None and self.wrong is None:
            self.wrong = wrong
            self.endpoints.note(f"the run will fail: node {getattr(wrong, 'node', self.endpoints.name)}: {wrong}")
        self._acknowledge()
        self.endpoints.answer_requests()
        return len(waiting)

    def _read_shared(self, waiting: list[Received], now: float, *, lossy: bool) -> ValueError | None:
        """Read the diagnostics of the graph's nodes; name other publishers, and return the fault of a false name."""
        senders, number = self._senders, self.log.numbers[_SHARED]
        while (found := self._take_shared()) is not None:
            data, information = found
            if senders.take(data, information["publication_sequence_number"], lossy=lossy):
                self._last[_SHARED] = stamp = _stamp(_SHARED, data)
                if stamp <= self._last_due.get(_SHARED, stamp):
                    waiting.append((stamp, information["received_timestamp"], number, data, now))
        for name in senders.newcomers():
            self.endpoints.note(
                f"node {name} publishes /diagnostics too; only messages of the run's nodes are recorded"
            )
        return senders.fault

    def _lost_first(self) -> ValueError | None:
        """Return the fault of a node whose messages before the first recorded one were lost.

        A recorder that has come after the first measurement records the rest of the run.
        """
        measured = self._sources["train/measurement"]
        if not measured.begun or measured.lost:
            return None
        found = {name: source for name, source in self._sources.items() if source.lost}
        if not found:
            return None
        parts = [f"{name}: {source.lost}" for name, source in found.items()]
        wait_for_names(lambda: [source.publisher_name() for source in found.values()])
        names = {source.name or BY_NAME[name].publishers[0].value for name, source in found.items()}
        for source in found.values():
            source.lost = 0
        return NodeFault(
            " and ".join(sorted(names)),
            f"messages lost before the first recorded one: {', '.join(parts)}; answer ~/ready with true only after "
            "every publisher has the reader of the recorder",
        )

    def _write(self, waiting: list[Received], now: float, *, whole: bool) -> None:
        """Write the held and the waiting messages up to the last complete tick, or all of them."""
        ordered = sorted([*self._held, *waiting])
        count = len(ordered)
        if not whole:
            complete = min(self._last.get(name, -1) for name in self._ticking)
            count = bisect_right(ordered, complete, key=itemgetter(0))
            while count < len(ordered) and ordered[count][4] < now - HOLD_S:
                count += 1
        self._held = ordered[count:]
        self.log.extend(
            (number, EPOCH_NS + stamp, EPOCH_NS + stamp, data) for stamp, _, number, data, _ in ordered[:count]
        )

    def _acknowledge(self) -> None:
        """Publish the stamp up to which all tick topics of the plant are recorded; the answers may be lost."""
        counts, of_plant = self.log.counts, self._of_plant
        complete, stamp = min(counts[name] for name in of_plant), min(map(self.last_stamp, of_plant))
        if complete >= self._next and stamp > self._acknowledged:
            self._next, self._acknowledged = complete + ACKNOWLEDGE_EVERY, stamp
            self.endpoints.publish(("recorder/progress", Tick(stamp)))

    def complete(self, published: Mapping[str, int]) -> bool:
        """Return True if the numbers of recorded and published messages are equal."""
        counts = self.log.counts
        return all(counts[name] >= count for name, count in published.items() if name in counts)

    def close(self, published: Mapping[str, int] | None) -> None:
        """Write the messages in the queues and close the log; compare the message counts if ``published`` is given.

        Raises
        ------
        ValueError
            If the numbers of published and recorded messages of a topic differ, or the last one of a topic is missing.
        OSError
            If the disk is full or gone.
        """
        self.closed = True
        try:
            if self.log.failure is None:
                self.poll(last=True)
        finally:
            self.log.close()
        if self.wrong is not None:
            raise self.wrong
        if published is None:
            self._check_last()
        for name, recorded in self.log.counts.items():
            if self.endpoints.sent_outside(name):
                continue
            if published is not None and published.get(name, 0) != recorded:
                raise ValueError(f"{recorded} messages of {name} are recorded, {published.get(name, 0)} were published")

    def _check_last(self) -> None:
        """Raise ValueError if a topic lacks the message of the last tick of a complete run, or its only one."""
        end = self.endpoints.end and RunEnd.of(self.endpoints.end)
        if not end or end.status != DONE:
            return
        due = dict.fromkeys(self._ticking, (end.ticks - 1) * self._tick_ns) | dict.fromkeys(self._once, 0)
        for name, stamp in due.items():
            if self.last_stamp(name) < stamp and not self.endpoints.sent_outside(name):
                sender = BY_NAME[name].publishers[0].value
                raise ValueError(f"{name} of node {sender} for {stamp * 1e-9:.3f} s did not arrive; check the network")


def _stamp(name: str, data: bytes) -> int:
    """Return the stamp of a message; an error names the topic."""
    try:
        return stamp_of(data)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
