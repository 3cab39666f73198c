"""Removal of single monitors: the proof that a hazard needs its monitor.

A setting removes a monitor where the scenario has one; else a part without effect replaces it for the time of a run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from importlib import import_module
from operator import attrgetter
from typing import Any

from msgs_docs.generate.hazard_table import MONITORS, Monitor
from train_ato.loop.train_protection import Protection, TrainProtection
from train_ato.messages.receiver import Receiver
from train_ato.messages.types import Odometry
from train_ato.supervision.plant_line import line_supervision
from train_ato.supervision.supervisor import SupervisionDecision, Supervisor
from train_ato.supervision.track_supervision import TrackSupervision

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
