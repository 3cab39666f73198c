"""Overview of a log: topics with rates and gaps, changes during the run, versions."""

from array import array
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train_ato.log.bag_layout import table_name
from train_ato.log.foreign_bag import original
from train_ato.log.mcap_records import MAX_TIME_NS, Definitions, Progress, blocks, readable
from train_ato.log.reading import MERGED, WallTime, attachments, read_wall_time, time_zero
from train_ato.log.table_columns import TICKS, merged
from train_ato.log.versions import VERSIONS, read_versions
from train_ato.messages.topics import BY_NAME, Rate
from train_ato.messages.variable_codec import decode_diagnostic
from train_ato.scenario.changes import RunChanges

LATE = 1.5
"""Minimum distance of two messages for a gap, in median periods of the topic."""


@dataclass(frozen=True)
class TopicOverview:
    """One topic of a log; simulated times [s] from the start of the run, or from the first message of a foreign log.

    Attributes
    ----------
    rate_hz : float or None
        Messages per simulated second, None for fewer than two times.
    gaps : int
        Number of gaps, by the median period of the topic.
    longest_gap_s, longest_gap_at_s : float or None
        Duration of the longest gap and time of the message before it [s].
    """

    name: str
    type: str
    messages: int
    rate_hz: float | None
    first_s: float
    last_s: float
    gaps: int = 0
    longest_gap_s: float | None = None
    longest_gap_at_s: float | None = None


@dataclass(frozen=True)
class Overview:
    """Overview of a log.

    Attributes
    ----------
    topics : tuple of TopicOverview
        Topics in the order of their first message.
    changes : RunChanges
        Changes of laws and parameters, interventions and ATO requests.
    versions : dict
        Versions of the recorder; empty for a log of another recorder.
    wall_time : WallTime or None
        Wall time of the recording; None for a log of another recorder.
    note : str
        Complaint about a log of several runs; empty for other logs.
    """

    path: Path
    size: int
    topics: tuple[TopicOverview, ...]
    changes: RunChanges
    versions: dict[str, str]
    wall_time: WallTime | None
    note: str = ""

    @property
    def duration_s(self) -> float:
        """Simulated time from the first to the last message [s]."""
        if not self.topics:
            return 0.0
        return max(topic.last_s for topic in self.topics) - min(topic.first_s for topic in self.topics)


class _Stamps:
    """Stamps of a topic in the order of the log [ns]; equal steps in a row are one number."""

    def __init__(self) -> None:
        self._steps, self._counts = array("q"), array("q")
        self._newest = 0
        self.first, self.last = MAX_TIME_NS, 0

    def add(self, stamp: int) -> None:
        """Add a stamp."""
        step, self._newest = stamp - self._newest, stamp
        if self._steps and self._steps[-1] == step:
            self._counts[-1] += 1
        else:
            self._steps.append(step)
            self._counts.append(1)
        if stamp < self.first:
            self.first = stamp
        if stamp > self.last:
            self.last = stamp

    def sorted(self) -> NDArray[np.int64]:
        """Return the stamps in the order of time."""
        found = np.cumsum(np.repeat(np.frombuffer(self._steps, np.int64), np.frombuffer(self._counts, np.int64)))
        found.sort()
        return found


def log_overview(path: Path, *, broken: bool = False, progress: Progress | None = None) -> Overview:
    """Return the overview of a log.

    Parameters
    ----------
    path
        MCAP file.
    broken
        Read the undamaged part of a partial file.
    progress
        Receiver of the fraction of the file that is read.
    """
    stamps: dict[str, _Stamps] = {}
    types: dict[str, str] = {}
    changes = RunChanges()
    known, topics_of_channels, reports = Definitions(), dict[int, _Stamps](), set[int]()
    with readable(path, broken=broken):
        for block in blocks(path, progress):
            for number, _, publish_ns, place, stop in known.walk(block):
                if number not in topics_of_channels:
                    channel, schema = known.kind(number)
                    topics_of_channels[number] = stamps.setdefault(channel.topic, _Stamps())
                    types.setdefault(channel.topic, schema.name)
                    if table_name(channel.topic) == "/diagnostics" and schema.name == BY_NAME["/diagnostics"].type:
                        reports.add(number)
                topics_of_channels[number].add(publish_ns)
                if number in reports:
                    try:
                        changes.take(decode_diagnostic(block[place:stop]))
                    except ValueError as error:
                        raise ValueError(f"{original(path)}: {known.kind(number)[0].topic}: {error}") from None
    ours = any(table_name(name) is not None for name in stamps)
    begin = time_zero(min((found.first for found in stamps.values()), default=0), ours=ours)
    end = max((found.last for name, found in stamps.items() if table_name(name) is not None), default=begin)
    topics = tuple(_topic(name, types[name], found.sorted(), begin, end) for name, found in stamps.items())
    mixed = any(table_name(name) == TICKS and merged(found.sorted()) for name, found in stamps.items())
    attached = attachments(path, broken=broken)
    return Overview(
        path,
        path.stat().st_size,
        topics,
        changes,
        read_versions(attached.get(VERSIONS, b"")),
        read_wall_time(path, broken=broken),
        f"{original(path)}: {TICKS}: two messages of one time: {MERGED}" if mixed else "",
    )


def _topic(name: str, kind: str, stamps: NDArray[np.int64], begin: int, end: int) -> TopicOverview:
    """Return the overview of a topic; one of the table that ends before the log has a gap up to its end [ns]."""
    first, last = (float(stamps[place] - begin) / 1e9 for place in (0, -1))
    rate = (stamps.size - 1) / (last - first) if last > first else None
    found: dict[str, Any] = {}
    known = table_name(name)
    if known is None or BY_NAME[known].rate is not Rate.ONCE:  # a topic without repeated messages has no gaps
        distinct = np.unique(stamps)
        steps = np.diff(distinct, append=distinct[-1] if known is None else max(end, distinct[-1]))
        late = steps > LATE * np.median(steps[:-1]) if steps.size > 2 else np.zeros(0, dtype=bool)
        if late.any():
            worst = int(steps.argmax())
            found = {
                "gaps": int(late.sum()),
                "longest_gap_s": float(steps[worst]) / 1e9,
                "longest_gap_at_s": float(distinct[worst] - begin) / 1e9,
            }
    return TopicOverview(name, kind, int(stamps.size), rate, first, last, **found)
