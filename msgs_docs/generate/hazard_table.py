"""Hazards, control actions and the form of the hazard table: data of ``msgs_docs/hazards.md``.

The method is that of STPA (Leveson, Thomas, STPA Handbook, 2018, chapter 2, step 3): every control action can be unsafe
in four ways.  The rows are in ``hazards.yaml``.

A setting removes a monitor where the scenario has one; else a part without effect replaces it for the time of a run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal

from plant_sim.library import read_yaml
from train_ato.loop.train_protection import Protection, TrainProtection
from train_ato.messages.receiver import Receiver
from train_ato.messages.types import Odometry
from train_ato.supervision.plant_line import line_supervision
from train_ato.supervision.supervisor import SupervisionDecision, Supervisor
from train_ato.supervision.track_supervision import TrackSupervision

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


UNLIMITED = 900.0
"""Speed limit without effect [m/s], within the valid values of a message."""
_protect, _receive, _supervise = TrainProtection.step, Receiver.receive, Supervisor.step


def _without_limits(*given: Any, **named: Any) -> TrackSupervision:
    return TrackSupervision(replace(line_supervision(*given, **named).train, max_speed=UNLIMITED), (), (), None)


def _ends_at_any_speed(self: TrainProtection, stamp: int, *, standstill: bool, separated: bool = False) -> Protection:
    return _protect(self, stamp, standstill=True, separated=separated)


def _newest_arrival(self: Receiver, now: int, message: Any) -> Any:
    self._checked = False
    return _receive(self, now, message)


def _wheel_alone(self: Supervisor, odometry: Odometry | None) -> SupervisionDecision:
    if odometry is None:
        return _supervise(self, None)
    wheel = (values[:1].repeat(2) for values in (odometry.position, odometry.speed, odometry.since_balise))
    return _supervise(self, Odometry(odometry.stamp, *wheel))


REMOVALS: dict[str, Monitor] = {monitor.part: monitor for monitor in MONITORS.values() if monitor.removed}
"""Monitors that a pair removes, by the name of the part."""
REPLACEMENTS: dict[str, object] = {
    MONITORS[name].part: replacement
    for name, replacement in {
        "track": _without_limits,
        "estimator": _wheel_alone,
        "odometry_check": lambda *_: "",
        "protection": _ends_at_any_speed,
        "separation": property(lambda _: False),
        "alive": lambda *_: "",
        "measurement_check": lambda *_: "",
        "assurance": lambda *_: False,
        "command_hold": lambda *_: None,
        "ato_state": lambda *_, **__: False,
        "ato_request": lambda *_, **__: None,
        "ato_brake": lambda *_: False,
        "receiver": _newest_arrival,
        "validity": lambda _: lambda _: "",
    }.items()
}
"""Part in place of a monitor whose removal needs more than assignments."""


def monitor_part(name: str) -> object:
    """Return the part of a name ``module:name``.

    Raises
    ------
    ImportError, AttributeError
        If there is no such module or part.
    """
    module, _, path = name.partition(":")
    return attrgetter(path)(import_module(module))


@contextmanager
def _replaced(place: str, replacement: object) -> Iterator[None]:
    module, _, path = place.partition(":")
    outer, _, name = path.rpartition(".")
    owner: Any = monitor_part(f"{module}:{outer}") if outer else import_module(module)
    before = vars(owner)[name]
    setattr(owner, name, replacement)
    try:
        yield
    finally:
        setattr(owner, name, before)


@contextmanager
def removed_monitors(names: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Remove monitors for the time of a run; yield the assignments to its scenario."""
    with ExitStack() as stack:
        for name in names:
            if name in REPLACEMENTS:
                stack.enter_context(_replaced(REMOVALS[name].place or name, REPLACEMENTS[name]))
        yield tuple(text for name in names for text in REMOVALS[name].sets)
