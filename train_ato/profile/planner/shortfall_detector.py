"""Detection of a force shortfall from measurements.

A law whose response is delayed increases the force while the error grows.  At a shortfall the applied force stays
constant, or decreases with the speed like an envelope.  It is then below the force that the profile requires, or at the
maximum assumed so far, and the error grows in the direction of the missing force.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from plant_sim.summation import plain_sum

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel

CONSTANT_TOLERANCE = 0.01
"""Relative change within the window up to which a force counts as constant."""
FORCE_TOLERANCE = 0.01
"""Relative force that must be missing, and relative distance at which a limit counts as reached."""
GROWING_FRACTION = 0.2
"""Fraction of the speed threshold above which a growing position error is sufficient."""
MIN_ERROR_FRACTION = 0.1
"""Fraction of the speed threshold below which no detection takes place."""


@dataclass(frozen=True, slots=True)
class Sample:
    """Measurement of one tick.

    Attributes
    ----------
    position_error, speed_error : float
        Measured minus profile [m, m/s].
    speed : float
        Measured speed [m/s].
    applied : float
        Applied force of the whole train [N], > 0 forward.
    required : float
        Force of the nominal train on the profile [N].
    available : tuple of float
        Maximum assumed so far in traction and in braking [N], both >= 0.
    """

    position_error: float
    speed_error: float
    speed: float
    applied: float
    required: float
    available: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Shortfall:
    """A detected force shortfall.

    Attributes
    ----------
    direction : int
        1 traction, -1 braking.
    level : float
        Force during the shortfall [N], >= 0.
    fraction : float
        The same divided by the nominal envelope at this speed.
    follows_envelope, is_constant : bool
        The force followed the envelope; the force was constant. Both are true for a flat envelope.
    expected : bool
        The force is at the maximum assumed so far: the mass or the resistance is larger than in the model.
    position_error, speed_error : float
        Errors at the last sample, from a linear regression over the window [m, m/s].
    """

    direction: int
    level: float
    fraction: float
    follows_envelope: bool
    is_constant: bool
    expected: bool
    position_error: float
    speed_error: float


class ShortfallDetector:
    """Detector of a force shortfall over a sliding window.

    Parameters
    ----------
    model
        Nominal train.
    speed_error, position_error
        Thresholds of the detection [m/s, m].
    window
        Window [s].
    """

    def __init__(self, model: TrainModel, speed_error: float, position_error: float, window: float) -> None:
        self._model = model
        self._speed_error = speed_error
        self._position_error = position_error
        self._samples: deque[Sample] = deque(maxlen=max(4, round(window / model.tick) + 1))
        low, high = model.force_limits(np.zeros(model.n_units))
        self._largest = max(float(high.sum()), -float(low.sum()), 1.0)

    def reset(self) -> None:
        """Discard all samples, for a new profile."""
        self._samples.clear()

    def step(self, sample: Sample) -> Shortfall | None:
        """Add a sample; return the shortfall if one is detected."""
        samples = self._samples
        samples.append(sample)
        if len(samples) < (samples.maxlen or 0) or abs(sample.speed_error) < MIN_ERROR_FRACTION * self._speed_error:
            return None
        speed = _regression_end([entry.speed_error for entry in samples])
        position = _regression_end([entry.position_error for entry in samples])
        direction = -1 if speed > 0 else 1
        if not self._is_large(abs(speed), -direction * position):
            return None
        forces = [direction * entry.applied for entry in samples]
        level = forces[-1]
        tolerance = CONSTANT_TOLERANCE * max(abs(level), 0.01 * self._largest)
        if min(forces) < -tolerance or not self._grows(direction):
            return None
        constant = max(forces) - min(forces) <= tolerance
        fractions = [force / self.envelope(direction, entry.speed) for force, entry in self._three_samples(forces)]
        follows = max(fractions) - min(fractions) <= CONSTANT_TOLERANCE * max(fractions[-1], 0.01)
        if not (constant or follows):
            return None
        available = sample.available[0 if direction > 0 else 1]
        expected = level >= (1.0 - FORCE_TOLERANCE) * available
        if not expected and level >= (1.0 - FORCE_TOLERANCE) * direction * sample.required:
            return None
        return Shortfall(
            direction, max(level, 0.0), max(fractions[-1], 0.0), follows, constant, expected, position, speed
        )

    def envelope(self, direction: int, speed: float) -> float:
        """Return the nominal maximum force in a direction at a speed [N], at least 1."""
        low, high = self._model.force_limits(np.full(self._model.n_units, max(speed, 0.0)))
        return max(float(high.sum()) if direction > 0 else -float(low.sum()), 1.0)

    def _is_large(self, speed: float, behind: float) -> bool:
        """Return true for an error above the thresholds."""
        return speed > self._speed_error or (
            speed > GROWING_FRACTION * self._speed_error and behind > self._position_error
        )

    def _grows(self, direction: int) -> bool:
        """Return true for a larger error in the second half of the window."""
        errors = [-direction * entry.speed_error for entry in self._samples]
        half = len(errors) // 2
        return plain_sum(errors[-half:]) > plain_sum(errors[:half])

    def _three_samples(self, forces: list[float]) -> list[tuple[float, Sample]]:
        """Return force [N] and sample at begin, middle and end of the window."""
        return [(forces[index], self._samples[index]) for index in (0, len(forces) // 2, -1)]


def _regression_end(values: list[float]) -> float:
    """Return the linear regression of evenly spaced values at the last of them."""
    n = len(values)
    middle = (n - 1) / 2
    slope = plain_sum((k - middle) * value for k, value in enumerate(values)) / (n * (n * n - 1) / 12)
    return plain_sum(values) / n + slope * middle
