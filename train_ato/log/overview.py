"""What a log holds: topics with their rates and gaps, changes while the run went on, and what made it."""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train_ato.changes import Told
from train_ato.record.layout import table_name
from train_ato.record.reading import Progress, attachments, stream
from train_ato.record.versions import VERSIONS, read_versions
from train_ato.topics import BY_NAME, EPOCH_NS, Rate
from train_ato.wire_variable import decode_diagnostic

LATE = 1.5
"""A message that comes later than so many usual periods after the one before leaves a gap."""


@dataclass(frozen=True)
class TopicOverview:
    """One topic of a log; times are simulated [s], from the run's start or from a foreign log's first message.

    Attributes
    ----------
    rate_hz : float or None
        Messages per simulated second, None for fewer than two times.
    gaps : int
        Places at which messages are missing, by the usual period of the topic.
    longest_gap_s, longest_gap_at_s : float or None
        Longest of them and the message before it.
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
    """A whole log.

    Attributes
    ----------
    topics : tuple of TopicOverview
        In the order in which they first appear.
    told : Told
        Changes of laws and parameters, and what was done to the train.
    versions : dict
        Of what recorded it; empty for a log of another recorder.
    """

    path: Path
    size: int
    topics: tuple[TopicOverview, ...]
    told: Told
    versions: dict[str, str]

    @property
    def duration_s(self) -> float:
        """Simulated time from the first to the last message [s]."""
        if not self.topics:
            return 0.0
        return max(topic.last_s for topic in self.topics) - min(topic.first_s for topic in self.topics)


def overview(path: Path, *, broken: bool = False, progress: Progress | None = None) -> Overview:
    """Read a log through and return what it holds.

    Parameters
    ----------
    path
        MCAP file.
    broken
        Of a file that was never closed: what can be read of it.
    progress
        Takes the share of the file that is read.

    Raises
    ------
    ValueError
        If the file is no log, or damaged.
    """
    stamps: dict[str, array[int]] = {}
    types: dict[str, str] = {}
    told = Told()
    for message in stream(path, broken=broken, progress=progress):
        name = message.channel.topic
        if name not in stamps:
            stamps[name] = array("q")
            types[name] = message.schema.name
        stamps[name].append(message.publish_ns)
        if table_name(name) == "/diagnostics" and types[name] == BY_NAME["/diagnostics"].type:
            told.take(decode_diagnostic(message.data))
    times = {name: np.sort(np.frombuffer(found, np.int64)) for name, found in stamps.items()}
    begin = min((int(found[0]) for found in times.values()), default=0)
    if begin >= EPOCH_NS and any(table_name(name) is not None for name in times):
        begin = EPOCH_NS
    topics = tuple(_topic(name, types[name], found, begin) for name, found in times.items())
    attached = attachments(path, broken=broken)
    return Overview(path, path.stat().st_size, topics, told, read_versions(attached.get(VERSIONS, b"")))


def _topic(name: str, kind: str, stamps: NDArray[np.int64], begin: int) -> TopicOverview:
    first, last = (float(stamps[place] - begin) / 1e9 for place in (0, -1))
    rate = (stamps.size - 1) / (last - first) if last > first else None
    found: dict[str, Any] = {}
    if _periodic(name):
        distinct = np.unique(stamps)
        steps = np.diff(distinct)
        late = steps > LATE * np.median(steps) if steps.size > 1 else np.zeros(0, dtype=bool)
        if late.any():
            worst = int(steps.argmax())
            found = {
                "gaps": int(late.sum()),
                "longest_gap_s": float(steps[worst]) / 1e9,
                "longest_gap_at_s": float(distinct[worst] - begin) / 1e9,
            }
    return TopicOverview(name, kind, int(stamps.size), rate, first, last, **found)


def _periodic(name: str) -> bool:
    """Tell whether a topic is sent again and again; those sent once leave no gap."""
    known = table_name(name)
    return known is None or BY_NAME[known].rate is not Rate.ONCE
