"""Samples of a recording in memory; those of a long run in a temporary file without a name."""

import os
import tempfile
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train_ato.judge.series import TopicSamples
from train_ato.messages.types import Array

IN_MEMORY = 64 * 2**20
"""Size of the samples from which on they are in a file [bytes]."""
CACHED = 32 * 2**20
"""Size of the last used samples of a file that stay in memory too, at least the very last [bytes]."""


@dataclass(frozen=True)
class _Stored:
    """Place and shape of samples in the file."""

    offset: int
    shape: tuple[int, ...]


Part = Array | _Stored


@dataclass
class _Topic:
    """Parts of a topic: times, and samples by name."""

    times: list[Array] = field(default_factory=list)
    parts: list[dict[str, Any]] = field(default_factory=list)
    stored: int = 0

    def store(self, file: "SampleFile") -> None:
        """Move the parts in memory to the file, as one part if their values have equal widths."""
        tail = self.parts[self.stored :]
        if len({tuple((name, values.shape[1:]) for name, values in part.items()) for part in tail}) == 1:
            tail = [{name: np.concatenate([part[name] for part in tail]) for name in tail[0]}]
        for part in tail:
            part.update({name: file.written(values) for name, values in part.items()})
        self.parts[self.stored :] = tail
        self.stored = len(self.parts)


class KeptSamples:
    """Collector of the samples of a recording by topic, in the order in which they arrive.

    Parameters
    ----------
    folder
        Folder of the file, with room for the log of the run. With None, or with a folder that cannot be written, the
        file is in the folder of temporary files. If there is no room, the samples stay in memory.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._topics: dict[str, _Topic] = {}
        self._size, self._limit = 0, float(IN_MEMORY)
        self._file: SampleFile | None = None
        self._time: Array = np.empty(0)

    def add(self, topic: str, samples: TopicSamples) -> None:
        """Add samples of a topic."""
        found = self._topics.setdefault(topic, _Topic())
        if not np.array_equal(self._time, samples.time):  # the topics of a tick share their times
            self._time = samples.time
        found.times.append(self._time)
        found.parts.append(dict(samples.values))
        self._size += sum(values.nbytes for values in samples.values.values())
        if self._size > self._limit:
            self._store()

    def count(self, topic: str) -> int:
        """Return the number of samples of a topic."""
        return sum(time.size for time in self._topics[topic].times) if topic in self._topics else 0

    def _store(self) -> None:
        """Move the samples to the file."""
        try:
            self._file = self._file or SampleFile(self._folder)
            for topic in self._topics.values():
                topic.store(self._file)
        except OSError:  # no room
            self._limit = float("inf")
        self._size = 0

    def finish(self) -> dict[str, TopicSamples]:
        """Return the samples of every topic by rising time; a value of different widths is left out."""
        if self._file is not None and np.isfinite(self._limit):
            self._store()
        found: dict[str, TopicSamples] = {}
        known: list[Array] = []
        for name in list(self._topics):
            topic = self._topics.pop(name)
            time = np.concatenate(topic.times)
            time = next((other for other in known if np.array_equal(other, time)), time)
            known.append(time)
            order = None if (np.diff(time) >= 0).all() else np.argsort(time, kind="stable")
            columns = _Columns(name, topic.parts, order, self._file)
            values = columns if self._file is not None else dict(columns)
            found[name] = TopicSamples(time if order is None else time[order], values)
        return found


class SampleFile:
    """Temporary file with samples, and those that were used last.

    Parameters
    ----------
    folder
        Its folder; without one, or one that cannot be written, that of temporary files.

    Raises
    ------
    OSError
        If it cannot be written either.
    """

    def __init__(self, folder: Path | None) -> None:
        usable = folder if folder is not None and os.access(folder, os.W_OK) else None
        self._file: FileIO = tempfile.TemporaryFile(dir=usable, buffering=0)  # noqa: SIM115  (for its life)
        self._end = 0
        self._cached: OrderedDict[tuple[str, str], Array] = OrderedDict()

    def written(self, part: Array) -> _Stored:
        """Write samples to the file; OSError if there is no room."""
        data: Any = np.ascontiguousarray(part, dtype=np.float64).ravel().view(np.uint8).data  # also without a column
        place = _Stored(self._end, part.shape)
        while data:
            data = data[os.pwrite(self._file.fileno(), data, self._end) :]
            self._end = place.offset + part.nbytes - len(data)
        return place

    def read(self, parts: list[Part], out: Array) -> None:
        """Read parts one after the other into an array."""
        row = 0
        for part in parts:
            rows = out[row : row + part.shape[0]]
            if isinstance(part, _Stored):
                os.preadv(self._file.fileno(), [rows.data], part.offset)
            else:
                rows[:] = part
            row += part.shape[0]

    def row(self, part: Part, number: int) -> Array:
        """Read one row of a part."""
        if not isinstance(part, _Stored):
            return np.asarray(part[number])
        row = np.empty(part.shape[1])
        os.preadv(self._file.fileno(), [row.data], part.offset + number * row.nbytes)
        return row

    def cached(self, key: tuple[str, str], made: Callable[[], Array]) -> Array:
        """Return an array by its key; ``made`` makes it if it was not used lately."""
        if key in self._cached:
            self._cached.move_to_end(key)
        else:
            self._cached[key] = made()
            while len(self._cached) > 1 and sum(values.nbytes for values in self._cached.values()) > CACHED:
                self._cached.popitem(last=False)
        return self._cached[key]


class _Columns(Mapping[str, Array]):
    """Samples of a topic by name, joined at their use."""

    def __init__(
        self, topic: str, parts: list[dict[str, Part]], order: NDArray[np.intp] | None, file: SampleFile | None
    ) -> None:
        self._topic, self._parts, self._order, self._file = topic, parts, order, file
        self._names = [
            name
            for name, values in parts[0].items()
            if all(name in part and part[name].shape[1] == values.shape[1] for part in parts)
        ]

    def __getitem__(self, name: str) -> Array:
        if name not in self._names:
            raise KeyError(name)
        if self._file is None:
            return self._joined(name)
        return self._file.cached((self._topic, name), lambda: self._joined(name))

    def row(self, name: str, number: int) -> Array:
        """Return one row of the samples of a name; only this row is read from the file."""
        if self._file is None:
            return np.asarray(self[name][number])
        number = number if self._order is None else int(self._order[number])
        for part in self._parts:
            if number < part[name].shape[0]:
                return self._file.row(part[name], number)
            number -= part[name].shape[0]
        raise IndexError(f"{self._topic} {name}: no row {number}")

    def _joined(self, name: str) -> Array:
        parts: Any = [part[name] for part in self._parts]
        if self._file is None:
            whole = np.concatenate(parts)
        else:
            whole = np.empty((sum(part.shape[0] for part in parts), parts[0].shape[1]))
            self._file.read(parts, whole)
        return whole if self._order is None else whole[self._order]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __reduce__(self) -> Any:
        return dict, (dict(self),)
