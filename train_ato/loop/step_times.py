"""Wall time of the controller's steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass
class StepTimes:
    """Wall time of every step of the controller [ns]."""

    nanoseconds: list[int]

    def percentile_us(self, percent: float) -> float | None:
        """Return a percentile in microseconds, None before the first step."""
        if not self.nanoseconds:
            return None
        return float(np.percentile(np.array(self.nanoseconds), percent)) / 1e3
