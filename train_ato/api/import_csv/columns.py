"""Columns of a recorder's file: quantity, unit and power unit in their names."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from plant_sim.input_error import close_match
from plant_sim.units import Force, Length, Pressure, Speed, Time, Unit, unit_suffix

MAX_GAP = 5.0
"""Default of the maximum time between rows [s]."""
TIMESTAMP = "timestamp"
"""Column of date and time of day instead of seconds."""
NOTCH = "notch"
"""Column of the notches of a layout, as shares of the largest force."""


@dataclass(frozen=True)
class MeasuredQuantity:
    """One quantity of a recorder's file.

    Attributes
    ----------
    units : dict
        SI value of one unit, by the suffix of the column name.
    of_unit
        True if columns per power unit are permitted: ``unit_1_force_kn``.
    """

    name: str
    units: dict[str, float]
    meaning: str
    of_unit: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Column names of the quantity."""
        return tuple(f"{self.name}_{unit}" for unit in self.units)


def _units(kind: Any) -> dict[str, float]:
    unit = next(entry for entry in get_args(kind)[1:] if isinstance(entry, Unit))
    return {unit_suffix(unit.si)[1:]: 1.0, **{name: 1 / divisor for name, divisor in unit.suffixes}}


QUANTITIES: tuple[MeasuredQuantity, ...] = (
    MeasuredQuantity("time", _units(Time), "increasing, with any zero"),
    MeasuredQuantity("speed", _units(Speed), "of the train, forward", True),
    MeasuredQuantity("position", _units(Length), "of the first vehicle's centre, along the line", True),
    MeasuredQuantity(
        "front_position", _units(Length), "of the front of the train, along the line; instead of position"
    ),
    MeasuredQuantity("force", _units(Force), "at the wheel of all power units, > 0 traction, < 0 electric brake", True),
    MeasuredQuantity("traction_force", _units(Force), "instead of force: traction, >= 0"),
    MeasuredQuantity("brake_force", _units(Force), "instead of force: electric brake, >= 0"),
    MeasuredQuantity("command_force", _units(Force), "demand of all power units, with the sign of force", True),
    MeasuredQuantity("reference_speed", _units(Speed), "target speed of the driver or of the ATO"),
    MeasuredQuantity("brake_pipe_pressure", _units(Pressure), "at the head, absolute; 600 kPa when charged"),
)
_BY_NAME = {
    name: (quantity, unit) for quantity in QUANTITIES for name, unit in zip(quantity.names, quantity.units, strict=True)
}
_ALIASES = {"applied_force": "force"}
"""Quantity by its name in the tables of train_ato."""
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
        Number of the power unit; None: the whole train.
    """

    title: str
    quantity: str
    factor: float
    unit: int | None = None


LAYOUTS = Path(__file__).parent / "layouts"


def layout_names() -> tuple[str, ...]:
    """Return the names of the shipped layouts."""
    return tuple(sorted(path.stem for path in LAYOUTS.glob("*.yaml")))


def spellings() -> tuple[str, ...]:
    """Return the permitted column names of the whole train."""
    return (TIMESTAMP, *_BY_NAME)


def column_of(title: str, name: str) -> Column:
    """Return quantity, unit and power unit of a column.

    Parameters
    ----------
    title
        Its name in the file.
    name
        Its name after ``--rename``.
    """
    if name in (TIMESTAMP, NOTCH):
        return Column(title, name, 1.0)
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
    """Return the message on an unknown name, with valid names."""
    if of_unit is not None:
        known = [f"{quantity.name}_{unit}" for quantity in QUANTITIES if quantity.of_unit for unit in quantity.units]
        return f"column '{title}': not a quantity of a power unit; use {', '.join(known)}{close_match(of_unit, known)}"
    bare = next((quantity for quantity in QUANTITIES if quantity.name == name.lower()), None)
    if bare is not None:
        return (
            f"column '{title}' has no unit; name it {' or '.join(bare.names)}, or give --rename "
            f"'{title}:={bare.names[0]}'"
        )
    plain = plainly(name)
    near = f"; did you mean '{plain}'?" if plain in _BY_NAME else close_match(plain, spellings())
    return (
        f"unknown column '{title}'{near}; rename it with --rename '{title}:=NAME' or remove it with --ignore '{title}' "
        "(names: train-ato import --help)"
    )


def plainly(name: str) -> str:
    """Return a name in the spelling of train_ato: ``Speed [km/h]`` becomes ``speed_kmh``."""
    text = (
        name.strip().lower().replace("km/h", "kmh").replace("kph", "kmh").replace("m/s²", "m_s2").replace("m/s", "m_s")
    )
    return re.sub(r"[^a-z0-9]+", "_", text).strip("_")


def plain_notch(text: str) -> str:
    """Return the text of a notch; a number without its decimals: ``8.0`` is ``8``."""
    plain = text.strip().upper().replace(",", ".")
    whole, point, part = plain.partition(".")
    return whole if point and not part.strip("0") else plain
