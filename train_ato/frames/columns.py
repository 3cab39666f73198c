"""Names of the columns: who, what, and the unit that the topic table gives."""

from __future__ import annotations

from train_ato.topics import BY_NAME, DIAGNOSTIC_UNITS

__all__ = ["TIME", "column", "diagnostic_column", "has_column", "quantity_of", "suffix", "unit_of"]

TIME = "time_s"
"""Name of every table's index: simulated time [s]; for a log that is not ours, time since its first message."""

_QUANTITIES: tuple[tuple[str, str, str, str], ...] = (
    ("/clock", "clock", "", "clock"),
    ("train/cars", "position", "", "position"),
    ("train/cars", "velocity", "", "speed"),
    ("train/cars", "effort", "", "coupler_force"),
    ("train/measurement", "position", "unit", "position"),
    ("train/measurement", "velocity", "unit", "speed"),
    ("train/measurement", "effort", "unit", "applied_force"),
    ("train/measurement", "position", "coupler", "deflection"),
    ("train/measurement", "velocity", "coupler", "deflection_rate"),
    ("train/measurement", "effort", "coupler", "force"),
    ("train/brake_pipe", "fluid_pressure", "", "pressure"),
    ("train/brake_cylinders", "effort", "", "shoe_force"),
    ("train/disturbance", "effort", "", "disturbance_force"),
    ("ato/profile", "points[].positions", "", "position"),
    ("ato/profile", "points[].velocities", "", "speed"),
    ("ato/profile", "points[].accelerations", "", "acceleration"),
    ("ato/profile", "header.stamp", "", "planned"),
    ("ato/limits", "points[].positions", "", "position"),
    ("ato/limits", "points[].velocities", "", "speed"),
    ("ato/reference", "points[0].positions", "", "position"),
    ("ato/reference", "points[0].velocities", "", "speed"),
    ("ato/reference", "points[0].accelerations", "", "acceleration"),
    ("ato/reference", "points[0].time_from_start", "", "planned"),
    ("ato/estimate", "effort", "", "disturbance_force"),
    ("ato/command", "effort", "", "force"),
    ("ato/brake_pipe", "fluid_pressure", "", "pressure"),
)
"""Topic, field of the topic table, kind of owner where it makes a difference, and what the number is."""
_BY_FIELD = {(topic, field, kind): name for topic, field, kind, name in _QUANTITIES}
_FIELDS = {(topic, field) for topic, field, _, _ in _QUANTITIES}
_UNITS = {(topic.name, field): unit for topic in BY_NAME.values() for field, unit, _ in topic.fields}


def suffix(unit: str) -> str:
    """Return a unit as the end of a column's name: ``m/s²`` becomes ``_m_s2``; nothing without a unit."""
    return "_" + unit.lower().replace("/", "_").replace("²", "2").replace("³", "3") if unit else ""


def has_column(topic: str, field: str) -> bool:
    """Tell whether a field of a topic of the table makes columns."""
    return (topic, field) in _FIELDS


def quantity_of(topic: str, field: str, owner: str = "") -> str | None:
    """Return what a field of a topic of the table is, such as ``coupler_force``; None if it is not in the tables.

    Parameters
    ----------
    topic, field
        As in the topic table.
    owner
        Whose it is: a name in the message such as ``unit_0``.
    """
    kind = owner.rstrip("0123456789").rstrip("_")
    return _BY_FIELD.get((topic, field, kind), _BY_FIELD.get((topic, field, "")))


def column(topic: str, field: str, owner: str = "") -> str | None:
    """Return the name of a column, such as ``car_17_coupler_force_n``; None for a field that is not in the tables."""
    quantity = quantity_of(topic, field, owner)
    if quantity is None:
        return None
    return f"{owner}_{quantity}{suffix(_UNITS[topic, field])}" if owner else quantity + suffix(_UNITS[topic, field])


def diagnostic_column(key: str) -> str:
    """Return the name of a column of ``/diagnostics``: the key and its unit, if it has one."""
    return key + suffix(DIAGNOSTIC_UNITS.get(key, ""))


def unit_of(name: str) -> str:
    """Return the unit that the name of a column ends with, as the tables write it; '' if there is none."""
    found = [unit for unit in _SUFFIXES if name.endswith(_SUFFIXES[unit])]
    return max(found, key=lambda unit: len(_SUFFIXES[unit]), default="")


_SUFFIXES = {unit: suffix(unit) for unit in {*_UNITS.values(), *DIAGNOSTIC_UNITS.values()} if unit}
