"""Wall time of the controller's steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass
class StepTimes:
    """Wall time of every step of the controller [ns]."""

    nanoseconds: list[int]

    def percentiles_us(self, *percents: float) -> tuple[float | None, ...]:
        """Return percentiles in microseconds, each None before the first step."""
        if not self.nanoseconds:
            return (None,) * len(percents)
        return tuple(float(value) / 1e3 for value in np.percentile(np.array(self.nanoseconds), percents))
