"""Loading of the tables of a recorded run: one pandas DataFrame per topic."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from mcap.records import Channel, Schema
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from plant_sim.input_error import close_match
from train_ato.log.bag_layout import table_name
from train_ato.log.reading import log_file
from train_ato.log.tables.portions import KeptMessages, Portion, Reader
from train_ato.log.tables.series import TopicColumns
from train_ato.log.tables.tables import check_foreign, check_known, foreign_table, known_part, known_table
from train_ato.log.tables.variable_length import diagnostic_table, trajectory_table
from train_ato.messages.codec.cdr import typestore
from train_ato.messages.topics import BY_NAME, EPOCH_NS
from train_ato.messages.types import Diagnostic

__all__ = ["Frames", "load"]

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
        for other in (name.lstrip("/"), f"/{name}"):
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
        One line: a missing log, the log of a killed run (``train-ato recover`` makes it readable), a damaged log, or
        a topic that is not in it.
    """
    path = log_file(Path(run))
    return _Loading(path, topics, progress).run()


class _Loading:
    """State of the loading of a log."""

    def __init__(
        self, path: Path, topics: Collection[str] | None, progress: Callable[[float], None] | None = None
    ) -> None:
        if isinstance(topics, str):
            raise ValueError(f"topics: '{topics}' is one name; give a list of names")
        self._topics = None if topics is None else tuple(topics)
        self._reader = Reader(path, self._wanted, progress)
        self._path = path
        self._series: dict[str, TopicColumns] = {}
        self._payloads = KeptMessages()
        self._left_out: dict[str, str] = {}

    def run(self) -> Frames:
        """Read the log and return the tables."""
        for portion in self._reader.portions():
            name = portion.channel.topic
            if name not in self._left_out:
                try:
                    self._take(name, portion)
                except ValueError as error:
                    self._refuse(name, error)
        self._check_topics()
        names = [channel.topic for channel, _ in self._reader.channels]
        frames = Frames()
        for name in dict.fromkeys(names):
            try:
                table = self._table(name)
            except ValueError as error:
                self._refuse(name, error)
                continue
            if table is not None:
                frames[self._key(name)] = table
        frames.left_out = {self._key(name): reason for name, reason in self._left_out.items()}
        return frames

    def _wanted(self, channel: Channel, schema: Schema) -> bool:
        if self._topics is not None and not any(_named(channel.topic, name) for name in self._topics):
            return False
        if channel.message_encoding != "cdr" or schema.encoding not in PARSERS:
            encodings = f"{channel.message_encoding}, {schema.encoding or 'no schema'}"
            self._left_out[channel.topic] = f"encoding {encodings}: not ROS 2"
            return False
        return True

    def _take(self, name: str, portion: Portion) -> None:
        """Add a portion of a topic."""
        known = _known(name, portion.schema)
        if known is not None and BY_NAME[known].of_variable_length:
            self._payloads.keep(name, portion.payloads)
            return
        if name not in self._series:
            if known is not None:
                chosen = partial(known_part, known)
                self._series[name] = TopicColumns(typestore(), portion.schema.name, chosen, partial(check_known, known))
            else:
                self._series[name] = TopicColumns(_types(portion.schema), portion.schema.name, check=check_foreign)
        self._series[name].add(portion)

    def _table(self, name: str) -> pd.DataFrame | None:
        """Return the table of a topic, None without messages."""
        known = self._known_name(name)
        if name in self._payloads:
            payloads = self._payloads.pop(name)
            if BY_NAME[str(known)].message is Diagnostic:
                return diagnostic_table(payloads)
            return trajectory_table(str(known), payloads)
        series = self._series.pop(name, None)
        if series is None or name in self._left_out:
            return None
        return known_table(known, series) if known is not None else foreign_table(series, self._begin())

    def _refuse(self, name: str, error: ValueError) -> None:
        """Omit an unreadable topic; topics of the topic table and requested topics raise ValueError."""
        if self._known_name(name) is not None or self._topics is not None:
            raise ValueError(f"{self._path}: {name}: {error}") from None
        self._left_out[name] = str(error)

    def _known_name(self, name: str) -> str | None:
        return next(_known(name, schema) for channel, schema in self._reader.channels if channel.topic == name)

    def _key(self, name: str) -> str:
        """Return the name of a table: that in the topic table, unless the log has several trains."""
        known = self._known_name(name)
        same = {channel.topic for channel, schema in self._reader.channels if _known(channel.topic, schema) == known}
        return known if known is not None and len(same) == 1 else name

    def _begin(self) -> int:
        """Return time 0 [ns since 1970]: the start of the simulation, or the first message of a foreign log."""
        ours = any(_known(channel.topic, schema) for channel, schema in self._reader.channels)
        first = self._reader.first_ns or 0
        return EPOCH_NS if ours and first >= EPOCH_NS else first

    def _check_topics(self) -> None:
        """Refuse names that are not in the log."""
        names = sorted({channel.topic for channel, _ in self._reader.channels})
        for wanted in self._topics or ():
            if not any(_named(name, wanted) for name in names):
                match = close_match(wanted if wanted.startswith("/") else f"/{wanted}", names)
                raise ValueError(f"{self._path}: holds no topic '{wanted}'{match} (it has: {', '.join(names)})")
            if (reason := self._left_out.get(wanted)) is not None:
                raise ValueError(f"{self._path}: {wanted}: {reason}")


def _named(name: str, wanted: str) -> bool:
    """Return True if a requested name is that of a topic of the log."""
    return name in (wanted, f"/{wanted}") or table_name(name) in (wanted, wanted.lstrip("/"))


def _known(name: str, schema: Schema) -> str | None:
    """Return the name in the topic table of a topic of the log with the same type, else None."""
    found = table_name(name)
    return found if found is not None and BY_NAME[found].type == schema.name else None


def _types(schema: Schema) -> Any:
    """Return a type store with the types of a schema.

    Raises
    ------
    ValueError
        If the text is not a definition.
    """
    store = get_typestore(Stores.EMPTY)
    try:
        store.register(PARSERS[schema.encoding](schema))
    except Exception as error:
        raise ValueError(f"the definition of {schema.name} is not readable ({type(error).__name__})") from None
    return store
