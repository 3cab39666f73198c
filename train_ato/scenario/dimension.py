"""Units and dimensions of the terms of a formula."""

from __future__ import annotations

import re

from plant_sim.units import unit_symbols

Exponents = tuple[int, int, int]
"""Exponents of metre, kilogram and second."""
NO_DIMENSION: Exponents = (0, 0, 0)
_BASE: dict[str, Exponents] = {
    "m": (1, 0, 0),
    "kg": (0, 1, 0),
    "s": (0, 0, 1),
    "N": (1, 1, -2),
    "W": (2, 1, -3),
    "Pa": (-1, 1, -2),
    "1": NO_DIMENSION,
}
_POWERS = {"²": 2, "³": 3}


def product(left: Exponents, right: Exponents, sign: int = 1) -> Exponents:
    """Return the dimension of a product, with ``sign`` -1 of a quotient."""
    return left[0] + sign * right[0], left[1] + sign * right[1], left[2] + sign * right[2]


def dimension_of(si: str) -> Exponents:
    """Return the dimension of an SI symbol, such as ``m/s²`` or ``N s/m``."""
    above, _, below = si.partition("/")
    found = NO_DIMENSION
    for sign, part in ((1, above), (-1, below)):
        for factor in part.split():
            for _ in range(_POWERS.get(factor[-1], 1)):
                found = product(found, _BASE[factor.rstrip("²³")], sign)
    return found


def _accepted_units() -> dict[str, tuple[Exponents, float]]:
    """Return dimension and divisor of the units that a number can have, with ``m/s2`` and ``m/s^2`` for ``m/s²``."""
    found = {symbol: (dimension_of(si), divisor) for symbol, (si, divisor) in unit_symbols().items() if symbol != "1"}
    found["h"] = (_BASE["s"], 1 / 3600)
    for sign, power in _POWERS.items():
        for symbol in [symbol for symbol in found if sign in symbol]:
            found[symbol.replace(sign, str(power))] = found[symbol.replace(sign, f"^{power}")] = found[symbol]
    return found


UNITS: dict[str, tuple[Exponents, float]] = _accepted_units()
"""Dimension and divisor of every unit: the SI value is the number over the divisor."""
UNIT_PATTERN = re.compile("|".join(re.escape(unit) for unit in sorted(UNITS, key=len, reverse=True)))
"""Longest unit at a place of a text."""


def unit_text(dimension: Exponents) -> str:
    """Return the SI symbol of a dimension, "" without one."""
    if dimension == NO_DIMENSION:
        return ""
    named = (si for si, _ in unit_symbols().values() if dimension_of(si) == dimension)
    powers = zip(("m", "kg", "s"), dimension, strict=True)
    return next(named, " ".join(f"{base}^{power}" for base, power in powers if power))
