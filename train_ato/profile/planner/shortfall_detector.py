"""Seeing from measurements alone that a train cannot follow its profile.

A law that is merely late pushes harder while the error grows.  A train that lacks force does not: its applied force
sits still, or falls with the speed as an envelope does, below what the profile needs or at the most that is believed
to be there, and the error keeps growing in the direction in which the force is missing.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from train_ato.model import TrainModel

__all__ = ["Sample", "Shortfall", "ShortfallWatch"]

STILL = 0.01
"""Change of a force that sits, over the window, as a part of it."""
SHORT = 0.01
"""Part of the force needed that must be missing, and distance from the limit that counts as being there."""
SLOW = 0.2
"""Part of the speed threshold beyond which a growing error of the position counts."""
LEAST = 0.1
"""Samples closer to the profile than this part of the threshold are not looked at at all."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One measured tick: errors > 0 ahead of the profile and faster; forces of the whole train, > 0 forward.

    ``needed`` is what the nominal train needs on the profile [N], ``believed`` the most that is counted on in traction
    and in braking, both >= 0 [N].
    """

    position_error: float
    speed_error: float
    speed: float
    applied: float
    needed: float
    believed: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Shortfall:
    """Force that was found to be all there is.

    Attributes
    ----------
    direction : int
        1 traction, -1 braking.
    level : float
        Force at the limit [N], >= 0.
    part : float
        The same as a part of the nominal envelope at this speed.
    by_part, by_level : bool
        The force followed the envelope, sat at one value; where the envelope is flat it did both.
    known : bool
        It is what was counted on already: the train is heavier, or held back, or its resistance is greater.
    position_error, speed_error : float
        Of the last sample, from a line through those of the window [m, m/s].
    """

    direction: int
    level: float
    part: float
    by_part: bool
    by_level: bool
    known: bool
    position_error: float
    speed_error: float


class ShortfallWatch:
    """Looks at the last second or so of errors and forces.

    Parameters
    ----------
    model
        The nominal train.
    speed_error, position_error
        Errors from which on the train is looked at [m/s, m].
    window
        Time over which the force must sit [s].
    """

    def __init__(self, model: TrainModel, speed_error: float, position_error: float, window: float) -> None:
        self._model = model
        self._speed_error = speed_error
        self._position_error = position_error
        self._samples: deque[Sample] = deque(maxlen=max(4, round(window / model.tick) + 1))
        low, high = model.force_limits(np.zeros(model.n_units))
        self._largest = max(float(high.sum()), -float(low.sum()), 1.0)

    def forget(self) -> None:
        """Begin anew: the profile is another one."""
        self._samples.clear()

    def step(self, sample: Sample) -> Shortfall | None:
        """Take a tick; return what is missing if the train cannot follow."""
        samples = self._samples
        samples.append(sample)
        if len(samples) < (samples.maxlen or 0) or abs(sample.speed_error) < LEAST * self._speed_error:
            return None
        speed = _last_on_line([entry.speed_error for entry in samples])
        position = _last_on_line([entry.position_error for entry in samples])
        direction = -1 if speed > 0 else 1
        if not self._off(abs(speed), -direction * position):
            return None
        forces = [direction * entry.applied for entry in samples]
        level = forces[-1]
        tolerance = STILL * max(abs(level), 0.01 * self._largest)
        if min(forces) < -tolerance or not self._grows(direction):
            return None
        sits = max(forces) - min(forces) <= tolerance
        parts = [force / self.envelope(direction, entry.speed) for force, entry in self._ends(forces)]
        follows = max(parts) - min(parts) <= STILL * max(parts[-1], 0.01)
        if not (sits or follows):
            return None
        believed = sample.believed[0 if direction > 0 else 1]
        known = level >= (1.0 - SHORT) * believed
        if not known and level >= (1.0 - SHORT) * direction * sample.needed:
            return None
        return Shortfall(direction, max(level, 0.0), max(parts[-1], 0.0), follows, sits, known, position, speed)

    def envelope(self, direction: int, speed: float) -> float:
        """Return the nominal largest force of the train in a direction at a speed [N], at least 1."""
        low, high = self._model.force_limits(np.full(self._model.n_units, max(speed, 0.0)))
        return max(float(high.sum()) if direction > 0 else -float(low.sum()), 1.0)

    def _off(self, speed: float, behind: float) -> bool:
        """Tell whether the error is large enough to be looked at."""
        return speed > self._speed_error or (speed > SLOW * self._speed_error and behind > self._position_error)

    def _grows(self, direction: int) -> bool:
        """Tell whether the second half of the window is further off than the first."""
        errors = [-direction * entry.speed_error for entry in self._samples]
        half = len(errors) // 2
        return sum(errors[-half:]) > sum(errors[:half])

    def _ends(self, forces: list[float]) -> list[tuple[float, Sample]]:
        """Return force and sample at begin, middle and end of the window."""
        return [(forces[index], self._samples[index]) for index in (0, len(forces) // 2, -1)]


def _last_on_line(values: list[float]) -> float:
    """Return the value of the line through evenly spaced values at the last of them: noise is averaged out."""
    n = len(values)
    middle = (n - 1) / 2
    slope = sum((k - middle) * value for k, value in enumerate(values)) / (n * (n * n - 1) / 12)
    return sum(values) / n + slope * middle
