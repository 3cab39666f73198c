"""Hazards, control actions and the form of the hazard table: data of ``msgs_docs/hazards.md``.

The method is that of STPA (Leveson, Thomas, STPA Handbook, 2018, chapter 2, step 3): every control action can be unsafe
in four ways.  The rows are in ``hazards.yaml``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from plant_sim.library import read_yaml

Guide = Literal["not provided", "provided wrongly", "too early or late", "too long or too short"]
"""Way in which a control action is unsafe."""
GUIDES: tuple[Guide, ...] = ("not provided", "provided wrongly", "too early or late", "too long or too short")


@dataclass(frozen=True)
class Hazard:
    """State of the train that can lead to an accident or to a lost service.

    Attributes
    ----------
    key, text
        Short name and description.
    measure, unit
        Quantity of a run whose value above the bound is the hazard, and its unit.
    bound
        Origin of the bound.
    """

    key: str
    text: str
    measure: str
    unit: str
    bound: str


@dataclass(frozen=True)
class Monitor:
    """Part that meets a requirement, and one way to remove it.

    Attributes
    ----------
    part
        Name of the part, ``module:name``.
    removed
        Condition of the run without the monitor; "": no row removes it.
    sets
        Assignments to the scenario that remove it.
    place
        Name to be replaced, ``module:name``; "": that of the monitor.
    """

    part: str
    removed: str = ""
    sets: tuple[str, ...] = ()
    place: str = ""


@dataclass(frozen=True)
class RemovalPair:
    """Run with the monitors of a row, and the same run without them.

    Attributes
    ----------
    without
        Monitors to be removed, ``module:name``.
    fault
        Row of the fault table; "" with ``sets``.
    sets
        Assignments to the scenario in place of a row of the fault table.
    """

    without: tuple[str, ...]
    fault: str = ""
    sets: tuple[str, ...] = ()


@dataclass(frozen=True)
class HazardRow:
    """One unsafe control action with its requirement.

    Attributes
    ----------
    requirement
        Identifier of the requirement.
    hazard, action, guide
        Key of the hazard; control action; way in which it is unsafe.
    unsafe
        The unsafe control action in words.
    text
        Text of the requirement.
    monitors
        Parts that meet the requirement: ``module:name``.
    faults
        Rows of the fault table that are runs of this requirement.
    tests
        Other tests, as pytest names them.
    pair
        Run with and without the monitors; None if the row has tests only.
    """

    requirement: str
    hazard: str
    action: str
    guide: Guide
    unsafe: str
    text: str
    monitors: tuple[str, ...]
    faults: tuple[str, ...] = ()
    tests: tuple[str, ...] = ()
    pair: RemovalPair | None = None


@dataclass(frozen=True)
class OpenHazard:
    """Faults that no monitor detects: the run has the hazard.

    Attributes
    ----------
    hazard, text
        Key of the hazard; cause and missing defence in words.
    sets
        Assignments to the scenario.
    """

    hazard: str
    text: str
    sets: tuple[str, ...]


def _with_tuples(row: dict[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in row.items()}


def _parts(names: list[str]) -> tuple[str, ...]:
    return tuple(MONITORS[name].part for name in names)


def _hazard_row(requirement: str, row: dict[str, Any]) -> HazardRow:
    """Return a row of the file, with the names of the parts in place of the short names of the monitors."""
    pair = row.get("pair")
    if pair is not None:
        pair = RemovalPair(**_with_tuples({**pair, "without": _parts(pair["without"])}))
    return HazardRow(requirement, **_with_tuples({**row, "monitors": _parts(row["monitors"]), "pair": pair}))


TABLE: dict[str, Any] = read_yaml(Path(__file__).with_name("hazards.yaml"))
HAZARDS = tuple(Hazard(key, **row) for key, row in TABLE["hazards"].items())
ACTIONS: dict[str, str] = TABLE["actions"]
"""Control action, or feedback it is based on, with sender and receiver."""
HARMLESS: dict[tuple[str, Guide], str] = {(row["action"], row["guide"]): row["reason"] for row in TABLE["harmless"]}
"""Control actions and ways that lead to no hazard, with the reason."""
MONITORS = {name: Monitor(**_with_tuples(row)) for name, row in TABLE["monitors"].items()}
"""Monitors by their short name."""
ROWS = tuple(_hazard_row(name, row) for name, row in TABLE["requirements"].items())
"""Rows of the table."""
OPEN = tuple(OpenHazard(**_with_tuples(row)) for row in TABLE["open"])
"""Hazards without a monitor, found in this analysis."""
