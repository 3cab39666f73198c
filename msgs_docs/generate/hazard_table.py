"""Hazards, control actions and the form of the hazard table: data of ``msgs_docs/hazards.md``.

The method is that of STPA (Leveson, Thomas, STPA Handbook, 2018, chapter 2, step 3): every control action can be unsafe
in four ways.  Rows: :mod:`msgs_docs.generate.hazard_page`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from msgs_docs.generate.fault_table import BEGIN

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


HAZARDS: tuple[Hazard, ...] = (
    Hazard(
        "H1",
        "The train exceeds a speed limit.",
        "largest speed above the highest limit of the line",
        "km/h",
        "margin of the emergency brake, and the speed gained until the traction is off",
    ),
    Hazard(
        "H2",
        "The train passes the supervised location.",
        "foremost place of the front behind the supervised location",
        "m",
        "0",
    ),
    Hazard(
        "H3",
        "The train rolls back.",
        "largest distance backwards",
        "m",
        "`roll_away`, and the distance until the emergency brake stops the full traction",
    ),
    Hazard(
        "H4",
        "The train departs after an emergency brake without a request.",
        "distance after the first standstill with the emergency brake",
        "m",
        "`roll_away`, as a train at standstill",
    ),
    Hazard(
        "H5",
        "The ATO commands traction while a brake is in effect.",
        "largest traction command two supervision periods after the begin of a brake",
        "kN",
        "0",
    ),
    Hazard("H6", "The train moves on without control.", "speed at the end of the run", "km/h", "standstill"),
    Hazard(
        "H7",
        "The emergency brake ends while the train moves.",
        "speed at the end of an emergency brake",
        "km/h",
        "standstill",
    ),
    Hazard(
        "H8",
        "The train runs past its stop.",
        "foremost place of the front behind the planned stop",
        "m",
        "stopping error",
    ),
    Hazard(
        "H9",
        "Brakes act without need: a train on the open line, and forces in the couplers.",
        "interventions of the supervisor and reactions of the train",
        "",
        "0",
    ),
)

ACTIONS: dict[str, str] = {
    "traction command": "controller to drives",
    "brake command": "controller to drives and brake pipe",
    "brake demand": "supervisor to train, as a brake release that is withdrawn",
    "emergency brake": "train protection to the brakes of the train",
    "odometry": "odometers to supervisor",
    "measurement": "sensors to profile, observer and controller",
    "profile and reference": "profile to controller",
    "takeover": "braking law in place of the law",
    "engagement": "request to the ATO",
}
"""Control action, or feedback it is based on, with sender and receiver."""

HARMLESS: dict[tuple[str, Guide], str] = {
    ("traction command", "not provided"): "the train coasts or remains at standstill: a delay, no hazard",
    ("engagement", "not provided"): "the train remains at standstill with its holding brake: a delay, no hazard",
}
"""Control actions and ways that lead to no hazard, with the reason."""


@dataclass(frozen=True)
class RemovalPair:
    """Run with the monitors of a row, and the same run without them.

    Attributes
    ----------
    without
        Monitors to be removed: keys of :data:`msgs_docs.generate.monitor_removal.REMOVALS`.
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


FULL_TRACTION = f"{{topic: ato/command, begin: {BEGIN}, do: freeze}}"
"""Fault that keeps the full traction of the metro train."""
SUPERVISOR_TEST, ENGAGEMENT_TEST = "test/test_supervisor.py::", "test/test_ato_engagement.py::"
"""Begin of the names of tests."""


def with_full_traction(fault: str) -> tuple[str, ...]:
    """Return the assignment of a fault that begins with the full traction."""
    return (f"faults=[{FULL_TRACTION}, {{begin: {BEGIN}, {fault}}}]",)
