"""Feed-forward against persistent sines ("lines") in the disturbances of coupled units.

`line_spectrum.py` finds frequencies and amplitudes, `periodic_motion.py` the command and the motion that belong to
them. The law has the measurements without this motion and adds the command: for the rest of the law the train has no
lines. Without a significant line nothing changes.
"""

# mypy: allow-untyped-defs

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from train_ato.control.algorithms.line_spectrum import SPACING, LineSpectrum
from train_ato.control.algorithms.periodic_motion import periodic_response

if TYPE_CHECKING:
    from train_ato.control.algorithms.coupled_units import CoupledUnits
    from train_ato.control.contract import LawInput
    from train_ato.control.train_model import TrainModel
    from train_ato.messages.types import Array

MAX_LINES = 6
"""Largest number of lines."""
SEARCH_TIME = 1.0
"""Time between two searches [s]."""
PERSISTENCE = 5
"""Consecutive searches that find or miss a line before it is used or dropped."""
RISE_TIME = 3.0
"""Time constant of the weight of a line [s]."""
CHANGE = 0.01
"""Change of a frequency for which the response is computed again [rad/s]."""


@dataclass
class Line:
    """A line: place in the grid, frequency [rad/s], count of searches, weight and response."""

    place: int
    frequency: float
    count: int = 0
    used: bool = False
    weight: float = 0.0
    at: float = 0.0
    motion: Array | None = None
    command: Array | None = None


class DisturbanceLines:
    """Lines in the disturbances, with the motion and the commands that belong to them."""

    def __init__(self, units: CoupledUnits, model: TrainModel, period: float) -> None:
        self._units, self._model, self._period = units, model, period
        self._spectrum = LineSpectrum(units, period)
        self._every = max(1, round(SEARCH_TIME / period))
        self._rise = 1.0 - math.exp(-period / RISE_TIME)
        self.reset()

    def reset(self) -> None:
        """Forget lines and spectrum."""
        self._spectrum.reset()
        self._lines: list[Line] = []
        self._steps = 0
        self.command = np.zeros(self._units.n)

    def step(self, inputs: LawInput, sent: Array, actuators: Array) -> tuple[LawInput, Array]:
        """Take the measurements; return inputs and commands in flight without the lines."""
        ahead, units, model = inputs.lookahead, self._units, self._model
        required = model.inertia * float(ahead.acceleration[0]) + float(ahead.resistance[0])
        position = inputs.position + model.offsets - float(ahead.position[0])
        speed = inputs.velocity - float(ahead.velocity[0])
        self._spectrum.step(position, speed, (inputs.applied - required * units.weight) / units.mass)
        self._steps += 1
        if self._steps % self._every == 0:
            self._search()
        self._update()
        return self._without(inputs, sent, actuators)

    def _search(self) -> None:
        found = self._spectrum.peaks()
        for line in self._lines:
            near = [peak for peak in found if abs(peak[0] - line.place) <= 1]
            if near:
                found.remove(near[0])
                line.place, line.frequency = near[0]
                line.count = min(line.count + 1, PERSISTENCE)
                line.used = line.used or line.count == PERSISTENCE
            else:
                line.count -= 1
        self._lines = [line for line in self._lines if line.count > 0 or line.weight > 0.01]
        for place, frequency in found:
            if len(self._lines) < MAX_LINES:
                self._lines.append(Line(place, frequency, 1))

    def _update(self) -> None:
        computed = False
        for line in self._lines:
            if line.used and abs(line.frequency - line.at) > CHANGE and not computed:
                line.motion, line.command = periodic_response(self._units, self._model.lag, line.frequency)
                line.at, computed = line.frequency, True
            aim = 1.0 if line.used and line.count > 0 and line.motion is not None else 0.0
            line.weight += self._rise * (aim - line.weight)

    def _without(self, inputs: LawInput, sent: Array, actuators: Array) -> tuple[LawInput, Array]:
        n, lag, tick, half = self._units.n, self._model.lag, self._model.tick, 0.5 * self._period
        self.command = np.zeros(n)
        position, velocity, applied = inputs.position, inputs.velocity, inputs.applied
        for line in self._lines:
            if line.motion is None:
                continue
            w = line.frequency
            b, p = self._spectrum.amplitude(line.place, w)
            b, p = line.weight * b, line.weight * p
            x, u = line.motion @ b, self._units.mass * (line.command @ b)
            position = position - x.real
            velocity = velocity - (1j * w * x - p).real
            applied = applied - (u / (1.0 + 1j * w * lag)).real
            last = sent[-1] if len(sent) else self.command
            delays = np.where(last < 0.0, actuators[1], actuators[0])
            self.command = self.command + (u * np.exp(1j * w * (delays + half))).real
            ages = tick * np.arange(len(sent), 0, -1)[:, None]
            delays = np.where(sent < 0.0, actuators[1], actuators[0])
            sent = sent - (u * np.exp(1j * w * (delays + half - ages))).real
        return replace(inputs, position=position, velocity=velocity, applied=applied), sent
