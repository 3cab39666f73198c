"""Synchronisation of the inputs of controller and profile by stamp, from messages in any order."""

import sys
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from plant_sim.states import frozen_for_types
from train_ato.messages.types import (
    AtoReport,
    DisturbanceEstimate,
    Measurement,
    ProtectionState,
    Reference,
    SupervisedSpeeds,
    TrainAhead,
    Trajectory,
)
from train_ato.scenario.setup import RunSetup

KINDS = ("measurement", "reference", "estimate")
"""Messages of a step, one of each per stamp."""
SUPERVISED_KINDS = ("protection", "speeds")
"""Additional messages of a step of the supervisor."""


@frozen_for_types
@dataclass(frozen=True, slots=True)
class ControllerInputs:
    """Inputs of one step with the same stamp; ``profile`` is set at the first step of a new profile."""

    measurement: Measurement
    reference: Reference
    estimate: DisturbanceEstimate
    protection: ProtectionState | None = None
    speeds: SupervisedSpeeds | None = None
    ahead: TrainAhead | None = None
    profile: Trajectory | None = None


class StampSynchronizer:
    """Collects one message of every kind per stamp and returns each complete stamp once, in order.

    A new profile is used from the first reference that names it; the step of this reference waits for it.  If a newer
    profile has replaced it, the newer one is used.

    Parameters
    ----------
    ahead
        Maximum lead of the other messages over the newest measurement [ns]; None: no limit.
    supervised_at
        Returns True for the stamp [ns] of a step of the supervisor.
    behind
        True for live reports of the train ahead, which are messages of such a step too.

    Attributes
    ----------
    ignored : int
        Number of messages that were duplicate, late or too far ahead.
    """

    def __init__(
        self,
        ahead: int | None = None,
        supervised_at: Callable[[int], bool] = lambda stamp: False,
        *,
        behind: bool = False,
    ) -> None:
        self._ahead = ahead
        self._supervised = (*SUPERVISED_KINDS, "ahead") if behind else SUPERVISED_KINDS
        self._supervised_at = supervised_at
        self._newest = -1
        self._waiting: dict[int, dict[str, Any]] = {}
        self._last = -1
        self._profiles: dict[int, Trajectory] = {}
        self._current = -1
        self._complete: deque[ControllerInputs] = deque()
        self._joined = -1
        self.ignored = 0

    @property
    def awaited(self) -> str:
        """Kind of the first missing message of the oldest incomplete step; "" for none."""
        if self._complete:
            return "profile"
        if not self._waiting:
            return ""
        oldest = min(self._waiting)
        kinds = KINDS + self._supervised * self._supervised_at(oldest)
        return next(kind for kind in kinds if kind not in self._waiting[oldest])

    def join(self) -> None:
        """Join a run in progress: messages up to the first complete stamp are not counted as ignored."""
        self._joined = sys.maxsize

    def _ignore(self, stamp: int) -> None:
        self.ignored += stamp > self._joined

    def put(self, kind: str, message: Any) -> list[ControllerInputs]:
        """Add a ``profile`` or a message of :data:`KINDS`; return the steps that it completes, in order."""
        if kind == "profile":
            self._profiles[max(0, message.stamp)] = message
        elif (row := self._row(kind, message)) is not None:
            self._complete.append(ControllerInputs(**row))
        ready: list[ControllerInputs] = []
        while self._complete:
            inputs = self._complete[0]
            planned = inputs.reference.planned
            if planned > self._current:
                known = [stamp for stamp in self._profiles if stamp >= planned]
                if not known:
                    break
                self._current = min(known)
                profile = self._profiles[self._current]
                inputs = replace(inputs, profile=profile)
                self._profiles = {stamp: other for stamp, other in self._profiles.items() if stamp > self._current}
            self._complete.popleft()
            ready.append(inputs)
        return ready

    def _row(self, kind: str, message: Any) -> dict[str, Any] | None:
        """Add a message; return all messages of its stamp if they are complete.

        Incomplete stamps before a complete one are dropped.
        """
        stamp = message.stamp
        if kind == KINDS[0]:
            self._newest = max(self._newest, stamp)
        elif self._ahead is not None and stamp > self._newest + self._ahead:
            self._ignore(stamp)
            return None
        due = stamp > self._last and (kind in KINDS or self._supervised_at(stamp))
        row = self._waiting.setdefault(stamp, {}) if due else None
        if row is None or kind in row:
            self._ignore(stamp)
            return None
        row[kind] = message
        if len(row) < len(KINDS) + len(self._supervised) * self._supervised_at(stamp):
            return None
        self._last = stamp
        self._joined = min(self._joined, stamp)
        if len(self._waiting) > 1:
            self._waiting = {later: rest for later, rest in self._waiting.items() if later > stamp}
        else:
            self._waiting.clear()
        return row


ProfileInputs = tuple[Measurement, AtoReport | None, TrainAhead | None]
"""Measurement, report of the ATO at the step before, and live report of the train ahead."""


class AwaitedReport:
    """Holds back a measurement until the report of the period before has arrived, and that of the train ahead.

    If the next measurement comes first, the held one is released with the newest report: without lockstep the plant
    does not wait.

    Parameters
    ----------
    setup
        Prepared run with its supervision period.
    left_out
        Returns True in a run without reports.
    """

    def __init__(self, setup: RunSetup, left_out: Callable[[], bool] = lambda: False) -> None:
        self._setup = setup
        self._left_out = left_out
        self._period_ns = setup.supervision_ticks * setup.tick_ns
        self._held: Measurement | None = None
        self._report: AtoReport | None = None
        self._ahead: TrainAhead | None = None
        self._heard = -1 if setup.layout.behind else sys.maxsize
        self._last = -1
        self.ignored = 0

    @property
    def waits(self) -> bool:
        """True if a measurement is held back."""
        return self._held is not None

    def put(self, message: Measurement) -> list[ProfileInputs]:
        """Add a measurement; return the inputs that are complete, in order."""
        if message.stamp <= self._last:
            self.ignored += 1
            return []
        self._last = message.stamp
        ready = [] if self._held is None else [(self._held, self._report, self._ahead)]
        self._held = message
        return ready + self._complete()

    def report(self, report: AtoReport) -> list[ProfileInputs]:
        """Add a report of the ATO; return the inputs that it completes."""
        if self._report is not None and report.stamp <= self._report.stamp:
            self.ignored += 1
            return []
        self._report = report
        return self._complete()

    def ahead(self, ahead: TrainAhead) -> list[ProfileInputs]:
        """Add a report of the train ahead; return the inputs that it completes."""
        self._ahead, self._heard = ahead, ahead.stamp
        return self._complete()

    def _complete(self) -> list[ProfileInputs]:
        held, report = self._held, self._report
        if held is None:
            return []
        supervised = self._setup.supervised_at(held.stamp)
        due = supervised and held.stamp > 0
        if due and (report is None or report.stamp < held.stamp - self._period_ns) and not self._left_out():
            return []
        if supervised and self._heard < held.stamp:
            return []
        self._held = None
        return [(held, report if due else None, self._ahead)]
