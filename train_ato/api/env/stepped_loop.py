"""Loop of the environment: that of the engine, with its messages in a tree of states in place of one recording.

The prepared run, its data and its model are named by their place in it and not copied, and the topics by their names.
An array that is a part of another one stays a part of it.
"""

import io
import pickle
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import reduce
from typing import Any

import numpy as np

from train_ato.control.registry import REGISTRIES
from train_ato.loop.engine import TickLoop
from train_ato.loop.stage_messages import Published
from train_ato.messages.receiver import validity_check
from train_ato.messages.topics import TOPICS
from train_ato.messages.types import Array
from train_ato.scenario.setup import RunSetup


class Past:
    """Messages of some ticks, and those before them.

    Attributes
    ----------
    before : Past or None
        Messages of the ticks before; None: none.
    ticks : list of tuple
        Stamp [ns] and messages of every part of a tick.
    """

    __slots__ = ("before", "ticks")

    def __init__(self, ticks: list[tuple[int, Published]], before: "Past | None" = None) -> None:
        self.ticks, self.before = ticks, before

    def all(self) -> list[tuple[int, Published]]:
        """Return stamp and messages of all ticks, oldest first."""
        parts, past = [], self.before
        parts.append(self.ticks)
        while past is not None:
            parts.append(past.ticks)
            past = past.before
        return [tick for part in reversed(parts) for tick in part]

    def __reduce__(self) -> Any:
        """Pickle without the tree."""
        return Past, (self.all(),)


class History:
    """Messages of a run up to now; made by :class:`train_ato.api.env.stepped_loop.SteppedLoop`."""

    def __init__(self, past: Past | None = None) -> None:
        self._past, self._ticks = past, list[tuple[int, Published]]()

    def add(self, stamp: int, messages: Published) -> None:
        """Add the messages of a stage at a stamp [ns]."""
        self._ticks.append((stamp, messages))

    @property
    def newest(self) -> dict[str, Any]:
        """Messages of the last stage by topic."""
        return dict(self._ticks[-1][1])

    def mark(self) -> Past:
        """Return the messages up to now; later ones do not change it."""
        self._past, self._ticks = Past(self._ticks, self._past), []
        return self._past


Path = tuple[tuple[str, Any], ...]
"""Way from the root to a part: ``("attr", name)`` and ``("item", key)``."""
PLAIN = (str, bytes, int, float, bool, complex, type, type(None))


class SharedParts:
    """Parts that a state does not contain: the prepared run with all its data, the topics, and the law of the caller.

    Attributes
    ----------
    places : dict
        Place of every shared part by its id.
    """

    def __init__(self, setup: RunSetup, others: Mapping[str, Any]) -> None:
        self._roots: dict[str, Any] = {"setup": setup, **others, **REGISTRIES}
        for topic in TOPICS:
            self._roots[f"topic {topic.name}"] = topic
            self._roots[f"check {topic.name}"] = validity_check(topic)
        self.places: dict[int, Any] = {id(part): (name, ()) for name, part in self._roots.items()}
        self._kept: list[Any] = []
        for path, part in _parts(setup, ()):
            if id(part) not in self.places:
                self.places[id(part)] = ("setup", path)
                self._kept.append(part)  # a part that is gone would leave its id to another object

    def part(self, place: tuple[str, Path]) -> Any:
        """Return the part at a place."""
        root, path = place
        return reduce(_step, path, self._roots[root])

    def dump(self, state: Any) -> bytes:
        """Return a state as bytes."""
        stream = io.BytesIO()
        _Writer(stream, self).dump(state)
        return stream.getvalue()

    def load(self, data: bytes) -> Any:
        """Return a new state from the bytes of :meth:`dump` in a process with an equal prepared run."""
        return _Reader(io.BytesIO(data), self).load()


def _step(part: Any, step: tuple[str, Any]) -> Any:
    kind, name = step
    return getattr(part, name) if kind == "attr" else part[name]


def _parts(part: Any, path: Path, known: set[int] | None = None) -> Iterator[tuple[Path, Any]]:
    """Yield all parts of a prepared run with their paths, except the objects given to it, which have a state."""
    known = set() if known is None else known
    if isinstance(part, PLAIN) or id(part) in known:
        return
    known.add(id(part))
    if path:
        yield path, part
    for step, inner in _inside(part):
        if step != ("attr", "given"):
            yield from _parts(inner, (*path, step), known)


def _inside(part: Any) -> list[tuple[tuple[str, Any], Any]]:
    if isinstance(part, Mapping):
        return [(("item", key), value) for key, value in part.items() if isinstance(key, (str, int))]
    if isinstance(part, (list, tuple)):
        plain = not part or isinstance(part[0], PLAIN)
        return [] if plain else [(("item", index), value) for index, value in enumerate(part)]
    if isinstance(part, np.ndarray) or type(part).__module__.partition(".")[0] not in ("train_ato", "plant_sim"):
        return []
    names = [entry.name for entry in fields(part)] if is_dataclass(part) else []
    return [(("attr", name), getattr(part, name)) for name in dict.fromkeys((*names, *getattr(part, "__dict__", ())))]


class _Writer(pickle.Pickler):
    def __init__(self, stream: io.BytesIO, shared: SharedParts) -> None:
        super().__init__(stream, protocol=5)
        self._places = shared.places

    def persistent_id(self, part: Any) -> Any:
        """Return the place of a shared part, None for any other object."""
        return self._places.get(id(part))

    def reducer_override(self, part: Any) -> Any:
        """Keep a view of an array as a view."""
        if isinstance(part, np.ndarray):
            if isinstance(part.base, np.ndarray) and part.base.flags.c_contiguous and not part.dtype.hasobject:
                return np.ndarray, (part.shape, part.dtype, part.base, _offset(part, part.base), part.strides)
        elif isinstance(part, np.void) and isinstance(part.base, np.ndarray):
            return _record, (part.base, part.dtype, _offset(part, part.base))
        return NotImplemented


class _Reader(pickle.Unpickler):
    def __init__(self, stream: io.BytesIO, shared: SharedParts) -> None:
        super().__init__(stream)
        self._shared = shared

    def persistent_load(self, place: Any) -> Any:
        """Return a shared part."""
        return self._shared.part(place)


def _offset(part: Any, base: Any) -> int:
    start: int = part.__array_interface__["data"][0]
    return start - int(base.__array_interface__["data"][0])


def _record(base: Any, dtype: Any, offset: int) -> Any:
    return np.ndarray((1,), dtype, buffer=base, offset=offset)[0]


PARTS = (
    "plant", "profile", "observer", "controller", "supervisor", "ticks", "command", "begun", "last_report", "_release",
)  # fmt: skip
"""Attributes that a run changes."""
TRUTH = ("/clock", "train/vehicles", "train/brake_pipe", "train/brake_pipe_tail", "train/brake_shoes",
         "train/disturbance")  # fmt: skip
"""Topics after the last tick of a run, without its diagnostics."""
GIVEN = "force of the caller"
"""Name of the forces in the history."""


class SteppedLoop(TickLoop):
    """Stages of a run whose ticks are divided before the law.

    Attributes
    ----------
    history : History
        Messages so far.
    command : Array, shape (units,)
        Last command [N].
    begun : int
        Number of entries of the history that belong to the tick that has begun.
    """

    def __init__(self, setup: RunSetup) -> None:
        super().__init__(setup, None)
        self.history = History()
        self.command: Array = np.zeros(setup.layout.n_units)
        self.begun = 0

    def _publish(self, stamp: int, messages: Published) -> None:
        self.history.add(stamp, messages)
        self.begun += 1

    def observe(self) -> None:
        """Run the stages of a tick up to the inputs of the law."""
        self.begun = 0
        super().observe()

    def act(self) -> None:
        """Run the law and the train of a tick."""
        super().act()
        self.command, self.begun = self.history.newest["ato/command"].force, 0

    def note_force(self, force: Array) -> None:
        """Keep the force of a step [N] in the history."""
        self._publish(self.plant.stamp, [(GIVEN, force)])

    def forces(self) -> list[Array]:
        """Return the forces of all steps [N]."""
        return [messages[0][1] for _, messages in self.history.mark().all() if messages and messages[0][0] == GIVEN]

    def messages(self, *, failed: bool = False) -> list[tuple[int, Published]]:
        """Return stamp and messages of all ticks; of one that has begun in a run that goes on only the truth."""
        found = self.history.mark().all()
        if self.begun and not failed:
            begun, found = found[-self.begun :], found[: -self.begun]
            truth = [(topic, message) for topic, message in begun[0][1] if topic in TRUTH]
            found.append((self.plant.stamp, [*truth, ("/diagnostics", self.plant.diagnostic())]))
        return [entry for entry in found if not entry[1] or entry[1][0][0] != GIVEN]

    @property
    def state(self) -> dict[str, Any]:
        """Attributes that a run changes."""
        return {name: getattr(self, name) for name in PARTS}
