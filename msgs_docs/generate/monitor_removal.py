"""Removal of single monitors: the proof that a hazard needs its monitor.

A setting removes a monitor where the scenario has one; else a part without effect replaces it for the time of a run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from operator import attrgetter
from typing import Any

from train_ato.loop.train_protection import Protection, TrainProtection
from train_ato.messages.receiver import Receiver
from train_ato.messages.types import Odometry
from train_ato.supervision.plant_line import line_supervision
from train_ato.supervision.supervisor import SupervisionDecision, Supervisor
from train_ato.supervision.track_supervision import TrackSupervision

SUPERVISOR = "train_ato.supervision.supervisor:Supervisor.step"
TRACK = "train_ato.supervision.track_supervision:TrackSupervision.evaluate"
BRAKE_DATA = "train_ato.supervision.plant_line:line_supervision"
SETTINGS = "train_ato.supervision.settings:SupervisionSpec"
TIME_LIMITS = "train_ato.supervision.settings:FailsafeSpec"
ESTIMATOR = "train_ato.supervision.position_estimate:estimate_motion"
ODOMETRY_CHECK = "train_ato.supervision.odometry_check:OdometryCheck.problem"
COMMAND_AGE = "train_ato.loop.train_protection:TrainProtection.on_command"
RELEASE_AGE = "train_ato.loop.train_protection:TrainProtection.on_release"
PROTECTION = "train_ato.loop.train_protection:TrainProtection.step"
SEPARATION = "plant_sim.train:Train.separation_noticed"
MEASUREMENT_CHECK = "train_ato.control.plausibility:MeasurementCheck.step"
ASSURANCE = "train_ato.control.assurance:AssuranceMonitor.step"
COMMAND_HOLD = "train_ato.control.command_hold:CommandHold.check_limit"
ATO_STATE = "train_ato.control.ato_state:AtoStateMachine.update"
ATO_REQUEST = "train_ato.control.ato_state:AtoStateMachine.check"
ATO_BRAKE = "train_ato.control.ato_state:AtoStateMachine.brakes"
RECEIVER = "train_ato.messages.receiver:Receiver.receive"
VALIDITY = "train_ato.messages.validity:validity_check"
ALIVE = "train_ato.messages.validity:AliveCheck.problem"

UNLIMITED = 900.0
"""Speed limit without effect [m/s], within the valid values of a message."""
TIMES = ("hold", "coast", "service")
"""Keys of the reactions to missing commands."""
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


@dataclass(frozen=True)
class MonitorRemoval:
    """One way to remove a monitor.

    Attributes
    ----------
    text
        Condition of the run without the monitor.
    sets
        Assignments to the scenario.
    replacement
        Part in place of the monitor; None: the assignments are sufficient.
    place
        Name to be replaced, ``module:name``; "": that of the monitor.
    """

    text: str
    sets: tuple[str, ...] = ()
    replacement: object = None
    place: str = ""


REMOVALS: dict[str, MonitorRemoval] = {
    SUPERVISOR: MonitorRemoval("no limit of the movement backwards", ("supervision.roll_away=100000",)),
    TRACK: MonitorRemoval(
        "no speed limits and no supervised location",
        replacement=_without_limits,
        place="train_ato.loop.run_parts:line_supervision",
    ),
    BRAKE_DATA: MonitorRemoval("full braking ability assumed", ("supervision.kdry=1",)),
    SETTINGS: MonitorRemoval("supervised location at the stop", ("supervision.overlap=0",)),
    TIME_LIMITS: MonitorRemoval(
        "no time in which the last command is held", tuple(f"supervision.failsafe.{key}=0" for key in TIMES)
    ),
    ESTIMATOR: MonitorRemoval("wheel odometer alone", replacement=_wheel_alone, place=SUPERVISOR),
    ODOMETRY_CHECK: MonitorRemoval("no check of the odometry", replacement=lambda *_: ""),
    COMMAND_AGE: MonitorRemoval(
        "no limit of the age of the commands", tuple(f"supervision.failsafe.{key}=3600" for key in TIMES)
    ),
    RELEASE_AGE: MonitorRemoval("no limit of the age of the brake release", ("supervision.failsafe.release=3600",)),
    PROTECTION: MonitorRemoval("the emergency brake ends at any speed", replacement=_ends_at_any_speed),
    SEPARATION: MonitorRemoval("separation not noticed", replacement=property(lambda _: False)),
    ALIVE: MonitorRemoval("no check of the alive counter", replacement=lambda *_: ""),
    MEASUREMENT_CHECK: MonitorRemoval("no comparison with the odometry", replacement=lambda *_: ""),
    ASSURANCE: MonitorRemoval("no braking law", replacement=lambda *_: False),
    COMMAND_HOLD: MonitorRemoval("no limit of the held commands", replacement=lambda *_: None),
    ATO_STATE: MonitorRemoval("the ATO remains engaged", replacement=lambda *_, **__: False),
    ATO_REQUEST: MonitorRemoval("every request accepted", replacement=lambda *_, **__: None),
    ATO_BRAKE: MonitorRemoval("a disengaged ATO coasts", replacement=lambda *_: False),
    RECEIVER: MonitorRemoval("the newest arrival is used as it is", replacement=_newest_arrival),
    VALIDITY: MonitorRemoval(
        "no check of the values",
        replacement=lambda _: lambda _: "",
        place="train_ato.messages.receiver:validity_check",
    ),
}  # fmt: skip
"""Removal of every monitor that a pair removes."""


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
            removal = REMOVALS[name]
            if removal.replacement is not None:
                stack.enter_context(_replaced(removal.place or name, removal.replacement))
        yield tuple(text for name in names for text in REMOVALS[name].sets)
