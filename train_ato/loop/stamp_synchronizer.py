"""Synchronisation of the inputs of the controller by stamp, from messages in any order."""

import sys
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from plant_sim.states import frozen_message
from train_ato.messages import types as msg

KINDS = ("measurement", "reference", "estimate")
"""Messages of a step, one of each per stamp."""
SUPERVISED_KINDS = ("protection", "speeds")
"""Additional messages of a step of the supervisor."""


@frozen_message
class ControllerInputs:
    """Inputs of one step with the same stamp; ``profile`` is set at the first step of a new profile."""

    measurement: msg.Measurement
    reference: msg.Reference
    estimate: msg.DisturbanceEstimate
    protection: msg.ProtectionState | None = None
    speeds: msg.SupervisedSpeeds | None = None
    ahead: msg.TrainAhead | None = None
    profile: msg.Trajectory | None = None


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
        self._profiles: dict[int, msg.Trajectory] = {}
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

    def put(self, kind: str, message: Any) -> list[ControllerInputs]:
        """Add a ``profile`` or a message of :data:`KINDS`; return the steps that it completes, in order.

        Incomplete stamps before a complete one are dropped.
        """
        stamp = message.stamp
        if kind == "profile":
            self._profiles[max(0, stamp)] = message
        else:
            if kind == KINDS[0]:
                self._newest = max(self._newest, stamp)
            row, due = self._waiting.get(stamp, {}), KINDS + self._supervised * self._supervised_at(stamp)
            early = self._ahead is not None and stamp > self._newest + self._ahead
            if early or stamp <= self._last or kind not in due or kind in row:
                self.ignored += stamp > self._joined
                return []
            self._waiting[stamp] = row
            row[kind] = message
            if len(row) < len(due):
                return []
            self._last = stamp
            self._joined = min(self._joined, stamp)
            self._waiting = {later: rest for later, rest in self._waiting.items() if later > stamp}
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
