"""Robust average of the unexplained resistance over the last runs of one line."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from train_ato.apps.learn.residual import Residual, by_place
from train_ato.control.learned_resistance import DIGITS, LARGEST, LearnedResistance
from train_ato.messages.types import Array
from train_ato.profile.profile import Profile

SPACING = 5.0
"""Distance between the learned values [m]."""
MEMORY = 20
"""Number of the last runs in the average."""
TRIMMED = 5
"""One of so many values is left out on each side, from three runs on at least one: a gust of a single run."""


class RunAverage:
    """Mean resistance of the last runs at evenly spaced places, without the extreme values of every place.

    The estimate of a run does not contain the learned resistance of that run: the average has no feedback.

    Parameters
    ----------
    profile
        Profile of the runs; its places are the range of the values.
    spacing
        Distance between the values [m].
    memory
        Number of the last runs in the average.
    former
        Result of former runs to go on from; it counts as its number of runs.

    Raises
    ------
    ValueError
        For a spacing or memory out of range.
    """

    def __init__(
        self, profile: Profile, spacing: float = SPACING, memory: int = MEMORY, former: LearnedResistance | None = None
    ) -> None:
        if not 0.5 <= spacing <= 1000.0:
            raise ValueError(f"spacing {spacing:g}: out of range; give 0.5 to 1000 m")
        if not 1 <= memory <= 1000:
            raise ValueError(f"memory {memory}: out of range; give 1 to 1000 runs")
        places = profile.position
        self._spacing = spacing
        self.begin = math.floor(float(places.min()) / spacing) * spacing
        self._count = math.ceil(float(places.max()) / spacing) + 1 - round(self.begin / spacing)
        self._estimates: deque[Array] = deque(maxlen=memory)
        self.runs = 0
        if former is not None:
            where: Array = np.asarray(self.begin + spacing * np.arange(self._count), dtype=np.float64)
            inside = (where >= former.places[0]) & (where <= former.places[-1])
            self._estimates.extend([np.where(inside, former.at(where), np.nan)] * min(former.runs, memory))
            self.runs = former.runs

    def add(self, residual: Residual) -> None:
        """Add a run."""
        self._estimates.append(by_place(residual, self.begin, self._spacing, self._count))
        self.runs += 1

    def mean(self) -> tuple[float, tuple[float, ...]]:
        """Return the first place that a run has reached [m] and the mean resistance from there on [m/s²], bounded."""
        rising = np.sort(np.array(self._estimates), axis=0)  # NaN last
        number = np.count_nonzero(~np.isnan(rising), axis=0)
        left_out = np.maximum(number // TRIMMED, number >= 3)
        row = np.arange(len(rising))[:, None]
        kept = (row >= left_out) & (row < number - left_out)
        known = np.flatnonzero(number)
        total = np.where(kept, rising, 0.0).sum(axis=0)[known]
        mean = total / (number - 2 * left_out)[known]
        values = np.clip(np.interp(np.arange(known[0], known[-1] + 1), known, mean), -LARGEST, LARGEST)
        begin = self.begin + self._spacing * float(known[0])
        return begin, tuple(round(value, DIGITS) + 0.0 for value in values.tolist())
