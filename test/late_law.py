"""Law without a valid force in the first seconds of a run, for other processes than that of the test."""

from __future__ import annotations

import math

import numpy as np

from train_ato.control.contract import LawInput, LawOutput
from train_ato.control.laws.pid import Pid

SILENT_S = 3.0
"""Simulated time from which the law has a force [s]."""


class LateLaw(Pid):
    """PID that returns NaN before :data:`SILENT_S`."""

    def step(self, inputs: LawInput) -> LawOutput:
        """Return NaN, then the force of the PID."""
        return LawOutput(np.full(self.n, math.nan)) if inputs.t < SILENT_S else super().step(inputs)
