"""Names of the columns: owner, quantity and unit from the topic table and its dataclasses."""

from __future__ import annotations

from plant_sim.states import FieldDescription
from plant_sim.units import unit_suffix
from train_ato.messages.codec.diagnostic_keys import message_key
from train_ato.messages.topics import BY_NAME, DIAGNOSTIC_UNITS, TOPICS

__all__ = ["TIME", "column", "diagnostic_column", "has_column", "unit_of"]

TIME = "time_s"
"""Name of every table's index: simulated time [s]; for a log of another tool, time since its first message."""


def has_column(topic: str, path: str) -> bool:
    """Return True if a field of the messages of a topic has columns."""
    return any(place.path == path for place in BY_NAME[topic].places)


def column(topic: str, path: str, owner: str = "") -> str:
    """Return the name of a column, for example ``vehicle_17_coupler_force_n``.

    Parameters
    ----------
    topic, path
        Topic of the table, and field of its ROS message.
    owner
        Owner of the value as named in the message, for example ``unit_0``.

    Raises
    ------
    ValueError
        If the field has no column.
    """
    found = _description(topic, path, owner)
    name = found.column + unit_suffix(found.unit)
    return f"{owner}_{name}" if owner else name


def _description(topic: str, path: str, owner: str) -> FieldDescription:
    """Return the description of the field at a path for a kind of owner; a single description is for all owners."""
    known = BY_NAME[topic]
    kind = owner.rstrip("0123456789").rstrip("_")
    places = [place for place in known.places if place.path == path]
    for place in places:
        if place.owner is not None and place.owner.value == kind:
            return known.description(place)
    if len(places) == 1:
        return known.description(places[0])
    if places:
        return FieldDescription(path, "")
    raise ValueError(f"{topic}: {path} makes no column")


def diagnostic_column(key: str) -> str:
    """Return the name of a column of ``/diagnostics``: the key with the suffix of its unit."""
    return message_key(key)


def unit_of(name: str) -> str:
    """Return the unit of a column from its name; "" without a unit."""
    units = {topic.description(place).unit for topic in TOPICS for place in topic.places}
    found = [unit for unit in {*units, *DIAGNOSTIC_UNITS.values()} if unit and name.endswith(unit_suffix(unit))]
    return max(found, key=lambda unit: len(unit_suffix(unit)), default="")
