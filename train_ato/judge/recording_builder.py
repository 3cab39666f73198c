"""Recording of a run in memory, with the reduction of the data of all vehicles."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train_ato.judge import recording as rec
from train_ato.judge.kept_samples import KeptSamples
from train_ato.judge.repeated_reports import KeptReports, RepeatedReport
from train_ato.judge.series import TopicSamples, seconds
from train_ato.messages.topics import TickBlock
from train_ato.messages.types import Array, Trajectory
from train_ato.scenario.setup import RunSetup

PORTION = 256
"""Number of messages of a topic that are stacked at once."""
SUMMARY_TOPICS = (rec.TRUTH, rec.DISTURBANCE, rec.MEASUREMENT, rec.REFERENCE, rec.COMMAND, rec.ATO_STATE)
"""Topics of the summary of a run without requirements."""


def reduced(topic: str, values: dict[str, Array], units: list[int], *, vehicles: bool = False) -> dict[str, Array]:
    """Return the samples of a topic that a recording contains.

    Parameters
    ----------
    topic
        Name in the topic table.
    values : dict of Array, each of shape (k, n)
        Values of its messages by name.
    units
        Vehicles of the power units.
    vehicles
        Keep the values of every vehicle too.

    Returns
    -------
    dict of Array
        The true states have position and velocity of the first vehicle (``front_``), the last one (``rear_``) and the
        power units (``unit_``).  They have the extremes of the coupler forces for several vehicles, and also samples
        for more than three.  The disturbance has ``unit_force``, and ``total`` if not every vehicle is a power unit.
        The shoe force has ``total``.  Other topics are unchanged.
    """
    kept: dict[str, Array] = {}
    if topic not in (rec.TRUTH, rec.DISTURBANCE, rec.BRAKE_SHOES):
        return values
    for name, part in values.items():
        count = part.shape[1]
        if count == 0:
            continue
        if name == "coupler_force":
            if count > 1:
                kept["coupler_draft_max"] = part.max(axis=1, keepdims=True)
                kept["coupler_buff_max"] = part.min(axis=1, keepdims=True)
            if count > 3:
                kept["coupler_samples"] = np.take(part, [0, (count - 1) // 2, count - 2], axis=1)
        elif topic == rec.TRUTH:
            kept |= {f"front_{name}": part[:, :1].copy(), f"rear_{name}": part[:, -1:].copy()}
        elif count > len(units) or topic == rec.BRAKE_SHOES:
            kept["total"] = part.sum(axis=1, keepdims=True)
        if name in ("position", "velocity", "force"):
            kept[f"unit_{name}"] = np.take(part, [unit for unit in units if unit < count], axis=1)
    return {**values, **kept} if vehicles else kept


@dataclass
class RecordingBuilder:
    """Collects the messages of a run; with ``summary_only`` the series of the summary only.

    Long series are in a temporary file in ``folder``, if it can be written.
    """

    setup: RunSetup
    summary_only: bool = False
    folder: Path | None = None
    _profiles: list[Trajectory] = field(default_factory=list)
    _reports: KeptReports = field(default_factory=KeptReports)
    _limits: Trajectory | None = None

    def __post_init__(self) -> None:
        self._units = list(self.setup.model.units)
        self._topics = SUMMARY_TOPICS if self.summary_only else tuple(rec.FIELDS)
        self._open: dict[str, list[Any]] = {topic: [] for topic in self._topics}
        self._closed = KeptSamples(self.folder)
        self._others: Counter[str] = Counter()

    def add(self, topic: str, message: Any, stamp: int = 0) -> None:
        """Add one message; topics without a series are counted."""
        self.extend(((topic, message),))

    def extend(self, messages: Iterable[tuple[str, Any]]) -> None:
        """Add topics and messages."""
        series = self._open
        for topic, message in messages:
            rows = series.get(topic)
            if rows is None:
                self._others[topic] += 1
                if topic == rec.DIAGNOSTICS:
                    self._reports.add(message)
                elif topic == rec.PROFILE:
                    self._profiles.append(message)
                elif topic == rec.LIMITS:
                    self._limits = message
            else:
                rows.append(message)
                if len(rows) == PORTION:
                    self._close(topic)

    def extend_rows(self, topic: str, stamps: NDArray[np.int64], values: dict[str, Array]) -> None:
        """Add many messages of a topic as arrays.

        Parameters
        ----------
        topic
            Name in the topic table.
        stamps : Array of int, shape (k,)
            Stamps [ns].
        values : dict of Array, each of shape (k, n)
            Values by the names of :data:`~train_ato.judge.recording.FIELDS`.
        """
        if topic not in self._open:
            self._others[topic] += len(stamps)
            return
        self.extend_reduced(topic, stamps, self._kept(topic, values))

    def add_ticks(self, block: TickBlock) -> None:
        """Add the messages of some ticks."""
        for topic, values in block.rows:
            self.extend_rows(topic, block.stamps, {name: values[name] for name in rec.FIELDS.get(topic, ())})
        for _, topic, message in (entry for messages in block.between.values() for entry in messages):
            self.add(topic, message, 0)

    def extend_reduced(self, topic: str, stamps: NDArray[np.int64], values: dict[str, Array]) -> None:
        """Add messages of a recorded topic as in :meth:`extend_rows`, with the values of :func:`reduced`."""
        if self._open[topic]:
            self._close(topic)
        self._closed.add(topic, TopicSamples(seconds(stamps), values))

    def extend_reports(self, reports: Iterable[RepeatedReport]) -> None:
        """Add the diagnostics of compiled ticks."""
        for report in reports:
            self._others[rec.DIAGNOSTICS] += len(report.stamps)
            self._reports.add(report)

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages by topic."""
        series = {topic: self._closed.count(topic) + len(rows) for topic, rows in self._open.items()}
        return {topic: count for topic, count in (series | self._others).items() if count}

    def _close(self, topic: str) -> None:
        """Stack and reduce the open messages of a topic."""
        rows, self._open[topic] = self._open[topic], []
        values = {name: _stacked(list(map(attrgetter(name), rows))) for name in rec.FIELDS[topic]}
        time = seconds([row.stamp for row in rows])
        self._closed.add(topic, TopicSamples(time, self._kept(topic, values)))

    def _kept(self, topic: str, values: dict[str, Array]) -> dict[str, Array]:
        """Return the samples of a topic that the recording contains, with every coupler if the summary needs it."""
        kept = reduced(topic, values, self._units)
        if topic == rec.TRUTH and self.setup.scenario.evaluation.couplers:
            kept["coupler_force"] = values["coupler_force"]
        return kept

    def finish(self) -> rec.Recording:
        """Return the recording, once: the samples go over to it."""
        for topic in self._topics:
            if self._open[topic]:
                self._close(topic)
        found = self._closed.finish()
        topics = {topic: found[topic] for topic in self._topics if topic in found}
        return rec.Recording(topics, tuple(self._profiles), self._limits, self._reports.finish())


def _stacked(parts: list[Any]) -> Array:
    """Return numbers or arrays of equal length as rows, shape (k, n)."""
    if isinstance(parts[0], np.ndarray):
        return np.concatenate(parts).reshape(len(parts), parts[0].size)
    return np.array(parts, dtype=np.float64)[:, None]
