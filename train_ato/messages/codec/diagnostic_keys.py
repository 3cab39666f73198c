"""Keys and values of diagnostics in a message: one plain number per key, with its unit at the end of the key.

In the program a value has the key without unit, and a list of numbers is one value.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache

from plant_sim.units import unit_suffix
from train_ato.messages.topics import DIAGNOSTIC_UNITS, Role

LISTED = ("delay", "delay_brake")
"""Values with one number per power unit."""
HARDWARE: dict[str, str] = {
    Role.PLANT.value: "train",
    Role.PROFILE.value: "ato",
    Role.OBSERVER.value: "ato",
    Role.CONTROLLER.value: "ato",
    Role.SUPERVISOR.value: "atp",
}
"""Unit of the vehicle with a node, ``hardware_id`` of its diagnostics."""


@lru_cache(maxsize=1024)
def message_key(key: str) -> str:
    """Return the key of a value in a message: the key with the suffix of its unit."""
    return key + unit_suffix(DIAGNOSTIC_UNITS.get(key, ""))


_KEYS = {message_key(key): key for key in DIAGNOSTIC_UNITS}
_ENTRIES = re.compile("|".join(rf"({key})_(\d+){unit_suffix(DIAGNOSTIC_UNITS[key])}" for key in LISTED))


def message_values(values: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Yield keys and values of a message."""
    for key, value in values.items():
        if key in LISTED and value.startswith("["):
            unit = unit_suffix(DIAGNOSTIC_UNITS[key])
            entries = value.strip("[]").split(", ")
            yield from ((f"{key}_{number}{unit}", entry) for number, entry in enumerate(entries) if entry)
        else:
            yield message_key(key), value


def program_values(pairs: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Return the values of a message by the keys of the program; keys without unit are kept."""
    found: dict[str, str] = {}
    lists: dict[str, list[str]] = {}
    for key, value in pairs:
        name = _listed(key)
        if name is None:
            found[_KEYS.get(key, key)] = value
        else:
            lists.setdefault(name, []).append(value)
            found[name] = f"[{', '.join(lists[name])}]"
    return found


@lru_cache(maxsize=1024)
def _listed(key: str) -> str | None:
    """Return the name of the list to which a key of a message belongs, None for a single value."""
    match = _ENTRIES.fullmatch(key)
    return None if match is None else next(name for name in match.groups()[::2] if name is not None)
