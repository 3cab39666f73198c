"""Names of the columns: owner, quantity and unit from the topic table and its dataclasses.

Tables of topics with messages of variable length: profiles, speed limits, diagnostics.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from plant_sim.units import unit_suffix
from train_ato.judge.series import seconds
from train_ato.messages.topic import FIXED_NAMES, owns
from train_ato.messages.topics import BY_NAME, DIAGNOSTIC_UNITS, TOPICS, Topic
from train_ato.messages.types import Diagnostic, Trajectory
from train_ato.messages.variable_codec import STATES, decode_diagnostic, decode_trajectory, message_key

if TYPE_CHECKING:
    import pandas as pd
    import xarray

OWNED = re.compile(r"(unit|vehicle|coupler)_(\d+)_(.+)")
"""Column of one of several owners: kind, number, quantity."""
TICKS = "train/measurement"
"""Topic with the times of the ticks."""
TIME = "time_s"
"""Name of every table's index: simulated time [s]; for a log of another tool, time since its first message."""


def merged(times: Any) -> bool:
    """Return True if the times of the ticks are those of several runs: more than a tenth of them is repeated."""
    return bool(1.1 * np.unique(times).size < len(times))


def column(topic: Topic, path: str, owner: str = "") -> str:
    """Return the name of a column, for example ``vehicle_17_coupler_force_n``; "" for a value that is there twice.

    Parameters
    ----------
    topic, path
        Entry of the topic table, and field of the ROS message.
    owner
        Owner of the value as named in the message, for example ``unit_0``.

    Raises
    ------
    ValueError
        If the field has no column.
    """
    places = [place for place in topic.places if place.path == path]
    if not places:
        raise ValueError(f"{topic.name}: {path} makes no column")
    for place in places:
        if len(places) == 1 or (place.owner is not None and owns(place.owner, owner)):
            first = next(other for other in topic.places if other.field == place.field)
            return topic.column(place, owner) if first is place else ""
    return f"{owner}_{path}" if owner else path  # of another program: the kind of the owner is unknown


def unit_of(name: str) -> str:
    """Return the unit of a column from its name; "" without a unit."""
    units = {topic.description(place).unit for topic in TOPICS for place in topic.places}
    found = [unit for unit in {*units, *DIAGNOSTIC_UNITS.values()} if unit and name.endswith(unit_suffix(unit))]
    return max(found, key=lambda unit: len(unit_suffix(unit)), default="")


FIXED = ("node", "level", "message")
"""Columns of diagnostics before those of the keys."""


def trajectory_table(topic: str, payloads: Sequence[bytes]) -> pd.DataFrame:
    """Return one row per knot of the profiles, or per step of the limits, over the time of the knot."""
    import pandas as pd

    tables = [_knots(BY_NAME[topic], decode_trajectory(payload)) for payload in payloads]
    return tables[0] if len(tables) == 1 else pd.concat(tables)


def _knots(topic: Topic, trajectory: Trajectory) -> pd.DataFrame:
    import pandas as pd

    columns: dict[str, Any] = {}
    for place in topic.places:
        if place.field == "stamp":
            columns[column(topic, place.path)] = np.full(trajectory.time.size, trajectory.stamp * 1e-9)
        elif place.field != "time" and (values := getattr(trajectory, place.field)).size:
            columns[column(topic, place.path)] = values
    return pd.DataFrame(columns, index=pd.Index(seconds(trajectory.time), name=TIME))


def states_table(topic: str, payloads: Sequence[bytes]) -> pd.DataFrame:
    """Return one row per message with states and counters, over its stamp and in the order of it."""
    import pandas as pd

    entry, messages = BY_NAME[topic], sorted(map(STATES[topic].decode, payloads), key=attrgetter("stamp"))
    columns: dict[str, Any] = {}
    for place in entry.places:
        rows = np.array([getattr(message, place.field) for message in messages])
        names = FIXED_NAMES[place.owner] if place.owner else ()
        columns |= {entry.column(place, name): rows[:, number] for number, name in enumerate(names)}
    stamps = np.array([message.stamp for message in messages], dtype=np.int64)
    return pd.DataFrame(columns, index=pd.Index(seconds(stamps), name=TIME))


def diagnostic_table(payloads: Sequence[bytes]) -> pd.DataFrame:
    """Return one row per message: ``node``, ``level``, ``message`` and a column per key.

    A key with only numbers is a column of numbers, with NaN for missing values; else a column of texts.
    """
    table = diagnostic_texts(map(decode_diagnostic, payloads))
    return table.assign(**{key: numbers_or_texts(table[key].tolist()) for key in table.columns[len(FIXED) :]})


def diagnostic_texts(messages: Iterable[Diagnostic]) -> pd.DataFrame:
    """Return one row per message in the order of stamp and node, with the values of all keys as texts."""
    import pandas as pd

    rows = sorted(filter(attrgetter("node"), messages), key=attrgetter("stamp", "node"))
    keys: dict[str, None] = {key: None for row in rows for key in row.values}
    columns: dict[str, Any] = {
        "node": [row.node for row in rows],
        "level": np.array([row.level for row in rows], dtype=np.int64),
        "message": [row.message for row in rows],
    }
    for key in keys:
        columns[message_key(key)] = np.array([row.values.get(key) for row in rows], dtype=object)
    index = pd.Index(seconds(np.array([row.stamp for row in rows], dtype=np.int64)), name=TIME)
    return pd.DataFrame(columns, index=index)


def numbers_or_texts(texts: Sequence[str | None]) -> Any:
    """Return texts as numbers, NaN for missing ones; unchanged if one is not a number."""
    try:
        return np.array([np.nan if text is None else float(text) for text in texts])
    except ValueError:
        return texts


def dataset_of(tables: Mapping[str, pd.DataFrame], about: Mapping[str, Any]) -> xarray.Dataset:
    """Return the numbers of all tables as one dataset; see :meth:`train_ato.api.run.Run.to_xarray`."""
    try:
        import xarray
    except ImportError:
        raise ValueError("to_xarray: the package 'xarray' is not installed; install it: pip install xarray") from None
    variables: dict[str, Any] = {}
    ticks = tables[TICKS].index if TICKS in tables else None
    for topic, table in tables.items():
        name = topic.strip("/").replace("/", "_")
        time = "time_s" if ticks is not None and table.index.equals(ticks) else f"{name}_time_s"
        owned: dict[tuple[str, str], list[str]] = {}
        for column in table.select_dtypes(("number", "bool")):
            parts = OWNED.fullmatch(column)
            owned.setdefault((parts[1], parts[3]) if parts else ("", column), []).append(column)
        for (owner, quantity), columns in owned.items():
            numbers = np.array([int(column.split("_")[1]) for column in columns]) if owner else np.empty(0)
            known = variables.get(owner, (owner, numbers))[1]
            number = owner if np.array_equal(known, numbers) else f"{name}_{owner}"
            dims = (time, number) if owner else (time,)
            values = table[columns if owner else columns[0]].to_numpy()
            about_it = {"units": unit_of(quantity), "topic": topic}
            variables[f"{name}_{owner}_{quantity}" if owner else f"{name}_{quantity}"] = (dims, values, about_it)
            variables[time] = (time, table.index.to_numpy(), {"units": "s"})
            if owner:
                variables[number] = (number, numbers)
    plain = {key: value for key, value in about.items() if isinstance(value, (str, int, float))}
    return xarray.Dataset(variables, attrs=plain).set_coords([v for v in variables if v.endswith("time_s")])
