"""What a column of a recorder's file may hold: quantity, unit in the name, and whose it is."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, get_args

from plant_sim.input_error import close_match
from plant_sim.units import Force, Length, Pressure, Speed, Time, Unit
from train_ato.frames.columns import suffix

__all__ = ["QUANTITIES", "TIMESTAMP", "Column", "Quantity", "column_of", "spellings"]

TIMESTAMP = "timestamp"
"""Column of moments as date and time of day instead of seconds."""
_MORE: dict[str, tuple[tuple[str, float], ...]] = {
    "s": (("h", 1 / 3600),),
    "m/s": (("mph", 1 / 0.44704),),
    "Pa": (("bar", 1e-5),),
}
"""Units that recorders use beside those of our own data files."""


@dataclass(frozen=True)
class Quantity:
    """One quantity that a recorder may give.

    Attributes
    ----------
    units : dict
        SI value of one unit, by the unit as it ends the column's name.
    of_unit
        Whether it may be given for every power unit: ``unit_1_force_kn``.
    """

    name: str
    units: dict[str, float]
    meaning: str
    of_unit: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Names under which a column gives it."""
        return tuple(f"{self.name}_{unit}" for unit in self.units)


def _units(kind: Any) -> dict[str, float]:
    unit = next(entry for entry in get_args(kind)[1:] if isinstance(entry, Unit))
    pairs = (*unit.suffixes, *_MORE.get(unit.si, ()))
    return {suffix(unit.si)[1:]: 1.0, **{name: 1 / divisor for name, divisor in pairs}}


QUANTITIES: tuple[Quantity, ...] = (
    Quantity("time", _units(Time), "from any zero, rising"),
    Quantity("speed", _units(Speed), "of the train, forward", True),
    Quantity("position", _units(Length), "of the first vehicle's centre, along the line", True),
    Quantity("front_position", _units(Length), "of the train's front, along the line, instead of position"),
    Quantity("force", _units(Force), "at the wheel of all power units, > 0 traction, < 0 electric brake", True),
    Quantity("traction_force", _units(Force), "instead of force: its traction, >= 0"),
    Quantity("brake_force", _units(Force), "instead of force: its electric brake, >= 0"),
    Quantity("command_force", _units(Force), "demanded of all power units, signed like force", True),
    Quantity("reference_speed", _units(Speed), "that the driver or the ATO was to keep"),
    Quantity("brake_pipe_pressure", _units(Pressure), "at the head, absolute: 600 kPa charged"),
)
_BY_NAME = {
    name: (quantity, unit) for quantity in QUANTITIES for name, unit in zip(quantity.names, quantity.units, strict=True)
}
_ALIASES = {"applied_force": "force"}
"""Names in the tables of our own runs, and the quantity."""
_UNIT = re.compile(r"^unit_(\d{1,3})_(.+)$")


@dataclass(frozen=True)
class Column:
    """One column of a file.

    Attributes
    ----------
    title
        Its name in the file, for messages.
    quantity
        Name of the quantity.
    factor
        SI value of one of its unit.
    unit
        Number of the power unit it belongs to; None: the whole train.
    """

    title: str
    quantity: str
    factor: float
    unit: int | None = None


def spellings() -> tuple[str, ...]:
    """Return every name that a column of the whole train may have."""
    return (TIMESTAMP, *_BY_NAME)


def column_of(title: str, name: str) -> Column:
    """Return what a column holds.

    Parameters
    ----------
    title
        Its name in the file.
    name
        The name it goes under; the same unless it was renamed.

    Raises
    ------
    ValueError
        For a name that says no quantity or no unit, with the nearest that does.
    """
    if name == TIMESTAMP:
        return Column(title, TIMESTAMP, 1.0)
    match = _UNIT.match(name)
    number, rest = (int(match[1]), match[2]) if match else (None, name)
    for alias, meant in _ALIASES.items():
        if rest.startswith(f"{alias}_"):
            rest = meant + rest.removeprefix(alias)
    found = _BY_NAME.get(rest)
    if found is not None and (number is None or found[0].of_unit):
        return Column(title, found[0].name, found[0].units[found[1]], number)
    raise ValueError(_unknown(title, name, rest if number is not None else None))


def _unknown(title: str, name: str, of_unit: str | None) -> str:
    """Say what is wrong with a name, and what it may be called."""
    if of_unit is not None:
        known = [f"{quantity.name}_{unit}" for quantity in QUANTITIES if quantity.of_unit for unit in quantity.units]
        return f"column '{title}': a power unit has {', '.join(known)}{close_match(of_unit, known)}"
    bare = next((quantity for quantity in QUANTITIES if quantity.name == name.lower()), None)
    if bare is not None:
        return (
            f"column '{title}' names no unit; call it {' or '.join(bare.names)}, or give --rename "
            f"'{title}:={bare.names[0]}'"
        )
    plain = plainly(name)
    near = f"; did you mean '{plain}'?" if plain in _BY_NAME else close_match(plain, spellings())
    return (
        f"unknown column '{title}'{near}; --rename '{title}:=NAME' gives it a name, --ignore '{title}' leaves it out "
        "(names: train-ato import --help)"
    )


def plainly(name: str) -> str:
    """Return a name as one of ours would be written: ``Speed [km/h]`` becomes ``speed_kmh``."""
    text = (
        name.strip().lower().replace("km/h", "kmh").replace("kph", "kmh").replace("m/s²", "m_s2").replace("m/s", "m_s")
    )
    return re.sub(r"[^a-z0-9]+", "_", text).strip("_")
