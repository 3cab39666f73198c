"""What the controller needs for a step, free of ROS: messages of one stamp and the profile its reference names."""

from __future__ import annotations

from collections import deque
from typing import Any

from train_ato.nodes.barrier import Barrier
from train_ato.types import Trajectory

Step = tuple[Trajectory | None, tuple[Any, ...]]
"""A profile to take first, if it is another one, and measurement, reference and estimate of one stamp."""


class StepInputs:
    """Puts steps together from messages in any order of topics.

    A profile that was planned anew is used from the stamp on whose reference names it, neither earlier nor later; a
    step waits for it.  A reference that names a profile which never comes because a newer one took its place is
    answered with that one.
    """

    def __init__(self) -> None:
        self._barrier = Barrier("measurement", "reference", "estimate")
        self._profiles: dict[int, Trajectory] = {}
        self._current = -1
        self._held: deque[tuple[Any, ...]] = deque()

    @property
    def ignored(self) -> int:
        """Messages that came twice or too late."""
        return self._barrier.ignored

    def put(self, kind: str, message: Any) -> list[Step]:
        """Take a profile, measurement, reference or estimate; return the steps that are complete with it, in order."""
        if kind == "profile":
            self._profiles[max(0, message.stamp)] = message
        elif (complete := self._barrier.put(kind, message)) is not None:
            self._held.append(complete)
        ready: list[Step] = []
        while self._held:
            profile = None
            planned = self._held[0][1].planned
            if planned > self._current:
                known = [stamp for stamp in self._profiles if stamp >= planned]
                if not known:
                    break
                self._current = min(known)
                profile = self._profiles[self._current]
                self._profiles = {stamp: other for stamp, other in self._profiles.items() if stamp > self._current}
            ready.append((profile, self._held.popleft()))
        return ready


__all__ = ["Step", "StepInputs"]
