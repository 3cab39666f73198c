"""Errors of a run at the ticks with an engaged ATO."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from train_ato.loop.recording import ATO_STATE, Recording
from train_ato.loop.setup import RunSetup
from train_ato.messages.types import Array, AtoState
from train_ato.scenario.criteria import TrackingLimits

RESUMED = 2.0
"""Time after the ATO was engaged again in which its new profile arrives [s]; not evaluated."""


class EngagedRun:
    """Ticks with an engaged ATO, with the errors of k ticks and the limits of the outcome of tracking.

    Attributes
    ----------
    setup, recording
        The run and its recording.
    limits : TrackingLimits
        Limits of the scenario.
    engaged : ndarray of bool, shape (k,)
        True for the ticks with an engaged ATO.
    top_speed : float
        Largest speed of the profile [m/s].
    """

    def __init__(self, setup: RunSetup, recording: Recording) -> None:
        self.setup = setup
        self.recording = recording
        self.limits: TrackingLimits = setup.scenario.criteria.tracking
        self.engaged = engaged_ticks(recording)
        self.top_speed = float(np.abs(setup.profile.velocity).max())

    @cached_property
    def rows(self) -> NDArray[np.intp]:
        """Ticks with an engaged ATO."""
        return np.flatnonzero(self.engaged)

    @cached_property
    def at_end(self) -> bool:
        """True if the ATO is engaged at the end."""
        return bool(self.engaged[-1])

    @cached_property
    def direction(self) -> Array:
        """Direction of the reference at every tick, at rest that of the last motion: 1 or -1."""
        sign = np.sign(self.recording.reference_velocity)
        last = np.maximum.accumulate(np.where(sign != 0, np.arange(sign.size), 0))
        return np.where(sign[last] < 0, -1.0, 1.0)

    @cached_property
    def position_error(self) -> Array:
        """Largest position error of all units at every tick, > 0 ahead [m], shape (k,)."""
        recording = self.recording
        reference = recording.reference_position[:, None]
        units = self.setup.layout.n_units
        error = (
            recording.position + self.setup.model.offsets - reference
            if units
            else recording.front_position[:, None] - reference
        )
        worst = np.abs(error).argmax(axis=1)
        return np.asarray(error[np.arange(worst.size), worst]) * self.direction

    @cached_property
    def speed_error(self) -> Array:
        """Speed error of vehicle 0 at every tick, > 0 too fast [m/s], shape (k,).

        Its speed is the derivative of its position, with the drift of paper 002.
        """
        recording = self.recording
        if recording.time.size < 2:
            return np.zeros(recording.time.size)
        speed = np.gradient(recording.front_position, recording.time)
        return np.asarray((speed - recording.reference_velocity) * self.direction)

    def end_text(self, row: int) -> str:
        """Return the time of a tick in words."""
        return "at the end" if row == self.engaged.size - 1 else f"at {self.recording.time[row]:.0f} s"


def engaged_ticks(recording: Recording) -> NDArray[np.bool_]:
    """Return True for the ticks with an engaged ATO, without the time in which a new profile arrives, shape (k,)."""
    time, states = recording.time, recording.of(ATO_STATE, "state")
    if states is None or not states[0].size:
        return np.ones(time.size, dtype=bool)
    row = np.maximum(np.searchsorted(states[0], time, side="right") - 1, 0)
    engaged = states[1][row, 0] == float(AtoState.ENGAGED)
    for resumed in time[1:][engaged[1:] & ~engaged[:-1]]:
        engaged &= (time < resumed) | (time >= resumed + RESUMED)
    return np.asarray(engaged)
