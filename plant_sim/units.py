"""Quantities of the data files: SI by default, other units by a suffix of the key.

A field that is annotated with a :class:`Unit` has its name (SI) or its name with a suffix of the unit: ``mass`` in kg
or ``mass_t`` in tonnes, ``speed`` in m/s or ``speed_kmh``. The models are in ``si_model``. This file does not import
pydantic, because this import takes longer than the help of a command.
"""

from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any

GRAVITY = 9.81
"""Default gravity of a data file [m/s²]."""
KMH = 3.6
"""Speed in km/h of 1 m/s."""


@dataclass(frozen=True)
class Unit:
    """SI unit with the suffixes of other accepted units.

    Parameters
    ----------
    si
        Symbol of the SI unit.
    suffixes
        Pairs of suffix and divisor; the SI value is the written value over the divisor.
    """

    si: str
    suffixes: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Usual:
    """Usual magnitudes of a key, in SI; another one is probably in another unit, and a file with it has a note."""

    low: float
    high: float


_FOOT, _MILE = ("ft", 1 / 0.3048), ("mi", 1 / 1609.344)
Mass = Annotated[float, Unit("kg", (("t", 1e-3), ("ton", 1 / 907.18474), ("lb", 1 / 0.45359237)))]
Length = Annotated[float, Unit("m", (("km", 1e-3), ("mm", 1e3), _MILE, _FOOT))]
Place = Annotated[float, Unit("m", (("km", 1e-3), _MILE, _FOOT))]
Speed = Annotated[float, Unit("m/s", (("kmh", KMH), ("mph", 1 / 0.44704)))]
Acceleration = Annotated[float, Unit("m/s²")]
Jerk = Annotated[float, Unit("m/s³")]
Time = Annotated[float, Unit("s", (("ms", 1e3), ("min", 1 / 60), ("h", 1 / 3600)))]
_POUND_FORCE = 4.4482216152605
Force = Annotated[
    float, Unit("N", (("kn", 1e-3), ("mn", 1e-6), ("lbf", 1 / _POUND_FORCE), ("klbf", 1e-3 / _POUND_FORCE)))
]
ForceRate = Annotated[float, Unit("N/s", (("kn_per_s", 1e-3), ("lbf_per_s", 1 / _POUND_FORCE)))]
Power = Annotated[float, Unit("W", (("kw", 1e-3), ("mw", 1e-6)))]
Pressure = Annotated[float, Unit("Pa", (("kpa", 1e-3), ("bar", 1e-5), ("psi", 1 / 6894.757293168)))]
Reduction = Annotated[Pressure, Usual(10e3, 1e6)]
Slope = Annotated[float, Unit("1", (("permille", 1e3),))]
Stiffness = Annotated[float, Unit("N/m", (("kn_per_m", 1e-3), ("mn_per_m", 1e-6)))]
Damping = Annotated[float, Unit("N s/m", (("kns_per_m", 1e-3), ("mns_per_m", 1e-6)))]
Ratio = Annotated[float, Unit("1", (("percent", 1e2),))]
Number = Annotated[float, Unit("1")]
QUANTITY_KINDS: tuple[Any, ...] = (
    Mass, Length, Speed, Acceleration, Jerk, Time, Force, ForceRate, Power, Pressure, Slope, Stiffness, Damping, Ratio,
)  # fmt: skip
"""Every kind of quantity."""
_SIGNS = {"kmh": "km/h", "permille": "‰", "percent": "%", "kn": "kN", "mn": "MN", "kw": "kW", "mw": "MW", "kpa": "kPa"}


@cache
def unit_suffix(unit: str) -> str:
    """Return a unit as suffix of a name: ``m/s²`` becomes ``_m_s2``; "" without a unit."""
    return "_" + unit.lower().replace("/", "_").replace("²", "2").replace("³", "3") if unit else ""


@cache
def unit_suffixes() -> dict[str, str]:
    """Return the symbol of every unit by its suffix of a key: _kmh has km/h, _m_s has m/s."""
    units = [kind.__metadata__[0] for kind in QUANTITY_KINDS]
    found = {unit_suffix(unit.si): unit.si for unit in units if unit.si != "1"}
    return found | {f"_{suffix}": unit_symbol(suffix) for unit in units for suffix, _ in unit.suffixes}


@cache
def unit_symbols() -> dict[str, tuple[str, float]]:
    """Return the SI symbol and the divisor of every unit of the quantities, by its symbol: km/h has m/s and 3.6."""
    found: dict[str, tuple[str, float]] = {}
    for kind in QUANTITY_KINDS:
        unit: Unit = kind.__metadata__[0]
        found[unit.si] = (unit.si, 1.0)
        for suffix, divisor in unit.suffixes:
            found[unit_symbol(suffix)] = (unit.si, divisor)
    return found


def unit_symbol(suffix: str) -> str:
    """Return the symbol of a unit from its suffix: kN/m for kn_per_m."""
    above, _, below = suffix.partition("_per_")
    above = {"kns": "kN s", "mns": "MN s"}.get(above, _SIGNS.get(above, above))
    return f"{above}/{below}" if below else above


MAX_WRITTEN_OUT = 1e15
"""Magnitude from which a number keeps its exponent: more digits than a float has."""


def without_comma(whole: str, part: str) -> str:
    """Return how a number with a comma is written: a decimal one, or with three digits perhaps one of thousands.

    Examples
    --------
    >>> without_comma("60", "5"), without_comma("12", "000")
    ('60.5', '12000, or 12.000')
    """
    thousands = len(part) == 3 and whole.lstrip("+-")[:1] != "0"
    return f"{whole}{part}, or {whole}.{part}" if thousands else f"{whole}.{part}"


def number_text(value: float, digits: int = 6) -> str:
    """Return a number with its significant digits; all digits before the point are written.

    Parameters
    ----------
    value
        Number, also infinite or nan.
    digits
        Significant digits of a number with fewer digits before the point.

    Examples
    --------
    >>> number_text(1e6), number_text(0.25), number_text(999.7, digits=3), number_text(1234.5, digits=3)
    ('1000000', '0.25', '1000', '1234')
    """
    text = f"{value:.{digits}g}"
    return f"{value:.0f}" if "e+" in text and abs(value) < MAX_WRITTEN_OUT else text
