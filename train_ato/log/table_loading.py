"""Loading of the tables of a recorded run: one pandas DataFrame per topic."""

from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from mcap.records import Channel, Schema
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from plant_sim.input_error import close_match
from train_ato.judge.series import seconds
from train_ato.log import table_columns, tables
from train_ato.log.bag_layout import table_name
from train_ato.log.foreign_bag import original
from train_ato.log.reading import MERGED, log_file, time_zero
from train_ato.messages.cdr import typestore
from train_ato.messages.topics import Topic, topic_of
from train_ato.messages.types import Diagnostic
from train_ato.messages.variable_codec import decode_diagnostic

PART = 8 * 2**20
"""Size of the messages of a topic from which on a part of its table is complete [bytes]."""
REPORTS_OF_PART = 4096
"""Number of diagnostics of a part."""
LATE_NS = 10_000_000_000
"""Largest lateness of a diagnostic behind a newer one that does not cost its order in parts [ns]."""

PARSERS: dict[str, Callable[[Schema], Any]] = {
    "ros2msg": lambda schema: get_types_from_msg(schema.data.decode(), schema.name),
    "ros2idl": lambda schema: get_types_from_idl(schema.data.decode()),
}
"""Parsers of the definitions of ROS 2 messages, by encoding."""


class Frames(dict[str, pd.DataFrame]):
    """Tables of a run by topic: ``frames["train/vehicles"]``; a leading slash is optional.

    Attributes
    ----------
    left_out : dict
        Topics of the log without a table, with the reason.
    """

    def __init__(self) -> None:
        super().__init__()
        self.left_out: dict[str, str] = {}

    def __missing__(self, name: str) -> pd.DataFrame:
        for other in (str(name).lstrip("/"), f"/{name}"):
            if other in self:
                return self[other]
        reason = self.left_out.get(name)
        hint = f" ({reason})" if reason else close_match(name, self)
        raise KeyError(f"no table '{name}'{hint}; there are {', '.join(self)}")


def load(
    run: str | Path, topics: Collection[str] | None = None, progress: Callable[[float], None] | None = None
) -> Frames:
    """Return the tables of a recorded run.

    The index of every table is simulated time, ``time_s``; the names of columns contain the unit, as in
    ``vehicle_17_coupler_force_n`` or ``unit_0_speed_m_s``.  ``ato/profile`` and ``ato/limits`` have one row per knot
    or step, ``/diagnostics`` one row per message with a column per key.

    Parameters
    ----------
    run
        Run folder or MCAP file.  ROS 2 topics that are not in the topic table are read too, over publish time and
        without units.
    topics
        Topics to read, with the names in the topic table or in the log; default: all.
    progress
        Receiver of the fraction of the log that is read, 0 to 1.

    Returns
    -------
    Frames
        DataFrames by topic.

    Raises
    ------
    ValueError
        One line: a missing log, the log of a killed run (``train-ato recover`` makes it readable), a damaged log, or a
        topic that the log does not have.
    """
    return TableReader(run, topics, progress).frames()


class TableReader:
    """Reader of the tables of a log, whole or in parts.

    Parameters
    ----------
    run, topics, progress
        As for :func:`load`.

    Attributes
    ----------
    left_out : dict
        Topics of the log without a table, with the reason, by their names in the log.
    """

    def __init__(
        self, run: str | Path, topics: Collection[str] | None = None, progress: Callable[[float], None] | None = None
    ) -> None:
        if isinstance(topics, str):
            raise ValueError(f"topics: '{topics}' is one name; give a list of names")
        self._path = log_file(Path(run))
        self._topics = None if topics is None else tuple(topics)
        self._reader = tables.Reader(self._path, self._wanted, progress)
        self._messages: dict[str, tables.TopicMessages] = {}
        self._payloads = tables.KeptMessages()
        self._reports: dict[str, list[Diagnostic]] = {}
        self.left_out: dict[str, str] = {}

    def frames(self) -> Frames:
        """Read the log and return the tables."""
        for portion in self._reader.portions():
            self._add(portion)
        self._check_topics()
        frames = Frames()
        for name, table in chain.from_iterable(map(self._part, self._names())):
            if (key := self.key(name)) not in frames:
                frames[key] = table if table.index.dtype != np.int64 else self.since_begin(table)
        frames.left_out = {self.key(name): reason for name, reason in self.left_out.items()}
        return frames

    def parts(self) -> Iterator[tuple[str, pd.DataFrame]]:
        """Read the log and yield its tables in parts of some thousand rows, with their names in the log.

        Values of diagnostics are texts. A topic that is not in the topic table has publish time [ns] as index. The rows
        have the order of the log. Diagnostics have the order of their stamps, if no message is later than others by
        :data:`LATE_NS`.
        """
        reports: dict[str, list[Diagnostic]] = {}
        for portion in self._reader.portions():
            name, known = portion.channel.topic, _known(portion.channel.topic, portion.schema)
            if known is None or not known.of_variable_length:
                self._add(portion)
                if name in self._messages and self._messages[name].nbytes >= PART:
                    yield from self._part(name)
            elif known.message is not Diagnostic:
                self._add(portion)
                yield from self._part(name)
            else:
                rows = reports.setdefault(name, [])
                with self._refusing(name):
                    rows.extend(decode_diagnostic(bytes(data)) for data in portion.payloads)
                if len(rows) >= REPORTS_OF_PART:
                    until = max(row.stamp for row in rows) - LATE_NS
                    reports[name] = [row for row in rows if row.stamp > until]
                    yield name, table_columns.diagnostic_texts(row for row in rows if row.stamp <= until)
        self._check_topics()
        for name in self._names():
            yield from self._part(name)
            if name in reports:
                yield name, table_columns.diagnostic_texts(reports[name])

    def _part(self, name: str) -> Iterator[tuple[str, pd.DataFrame]]:
        """Yield the table of the collected messages of a topic, if it has one, and remove them."""
        with self._refusing(name):
            if (table := self._table(name)) is not None:
                yield name, table

    def _names(self) -> Iterable[str]:
        return dict.fromkeys(channel.topic for channel, _ in self._reader.channels)

    def _add(self, portion: tables.Portion) -> None:
        """Add a portion of a topic."""
        name, known = portion.channel.topic, _known(portion.channel.topic, portion.schema)
        if name in self.left_out:
            return
        with self._refusing(name):
            if known is not None and known.of_variable_length:
                self._payloads.keep(name, portion.payloads)
                return
            if name not in self._messages:
                types = _types(portion.schema) if known is None else typestore()
                check = tables.check_foreign if known is None else partial(tables.check_known, known)
                self._messages[name] = tables.TopicMessages(types, portion.schema.name, check)
            self._messages[name].add(portion)

    @contextmanager
    def _refusing(self, name: str) -> Iterator[None]:
        """Omit an unreadable topic; topics of the topic table and requested topics raise ValueError."""
        try:
            yield
        except ValueError as error:
            if self._known_topic(name) is not None or self._topics is not None:
                raise ValueError(f"{original(self._path)}: {name}: {error}") from None
            self.left_out[name] = str(error)

    def since_begin(self, table: pd.DataFrame) -> pd.DataFrame:
        """Return a table over publish time [ns] over the time since the begin of the log [s]."""
        return table.set_axis(pd.Index(seconds(table.index.to_numpy() - self._begin()), name=table_columns.TIME))

    def _wanted(self, channel: Channel, schema: Schema) -> bool:
        if self._topics is not None and not any(_named(channel.topic, name) for name in self._topics):
            return False
        if channel.message_encoding != "cdr" or schema.encoding not in PARSERS:
            encodings = f"{channel.message_encoding}, {schema.encoding or 'no schema'}"
            self.left_out[channel.topic] = f"encoding {encodings}: not ROS 2"
            return False
        return True

    def _table(self, name: str) -> pd.DataFrame | None:
        known = self._known_topic(name)
        if name in self._payloads:
            assert known is not None
            payloads = self._payloads.take(name)
            if known.message is Diagnostic:
                return table_columns.diagnostic_table(payloads)
            return (table_columns.states_table if known.has_states else table_columns.trajectory_table)(
                known.name, payloads
            )
        messages = self._messages.pop(name, None)
        if messages is None or name in self.left_out:
            return None
        table = tables.known_table(known, messages) if known is not None else tables.foreign_table(messages)
        if known is not None and known.name == table_columns.TICKS and table_columns.merged(table.index):
            raise ValueError(f"two messages of one time: {MERGED}")
        return table

    def _known_topic(self, name: str) -> Topic | None:
        return next(_known(name, schema) for channel, schema in self._reader.channels if channel.topic == name)

    def key(self, name: str) -> str:
        """Return the name of a table: that in the topic table, unless the log has several trains."""
        known = self._known_topic(name)
        same = {channel.topic for channel, schema in self._reader.channels if _known(channel.topic, schema) == known}
        return known.name if known is not None and len(same) == 1 else name

    def _begin(self) -> int:
        """Return time 0 [ns since 1970]."""
        ours = any(_known(channel.topic, schema) for channel, schema in self._reader.channels)
        return time_zero(self._reader.first_ns or 0, ours=ours)

    def _check_topics(self) -> None:
        """Refuse names that are not in the log."""
        names = sorted({channel.topic for channel, _ in self._reader.channels})
        for wanted in self._topics or ():
            if not any(_named(name, wanted) for name in names):
                match = close_match(wanted if wanted.startswith("/") else f"/{wanted}", names)
                has = f" (it has: {', '.join(names)})" if names else "; it has no message"
                raise ValueError(f"{original(self._path)}: holds no topic '{wanted}'{match}{has}")
            if (reason := self.left_out.get(wanted)) is not None:
                raise ValueError(f"{original(self._path)}: {wanted}: {reason}")


def _named(name: str, wanted: str) -> bool:
    """Return True if a requested name is that of a topic of the log."""
    return name in (wanted, f"/{wanted}") or table_name(name) in (wanted, wanted.lstrip("/"))


def _known(name: str, schema: Schema) -> Topic | None:
    """Return the entry of a topic of the log with the same type, or with a former one, else None."""
    found = table_name(name)
    return None if found is None else topic_of(found, schema.name)


def _types(schema: Schema) -> Any:
    """Return a type store with the types of a schema; ValueError if the text is not a definition."""
    store = get_typestore(Stores.EMPTY)
    try:
        store.register(PARSERS[schema.encoding](schema))
    except Exception as error:
        raise ValueError(f"the definition of {schema.name} is not readable ({type(error).__name__})") from None
    return store
