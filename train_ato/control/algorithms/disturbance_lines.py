"""Feed-forward against persistent sines ("lines") in the disturbances of coupled units.

`line_spectrum.py` finds frequencies and amplitudes, `periodic_motion.py` the motion and the command that belong to
them. The law has the measurements and the commands in flight without this motion, and adds the command: for its other
parts the train has no lines. A line is used after ``PERSISTENCE`` searches in turn have found it, with a weight that
rises in ``RISE_TIME``. Without a line nothing changes.

The disturbance follows from motion and force, so that with the model of the train the command does not depend on
itself: it is no feedback, and a wrong line adds a bounded force.
"""

# mypy: allow-untyped-defs

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_cos, libm_sin
from train_ato.control.algorithms.line_spectrum import LineSpectrum
from train_ato.control.algorithms.periodic_motion import periodic_response
from train_ato.control.train_model import STANDSTILL_SPEED

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
"""Searches in turn that find, or miss, a line before it is used, or no longer."""
RISE_TIME = 3.0
"""Time constant of the weight of a line [s]."""
CHANGE = 0.01
"""Change of a frequency after which the response is computed again, one line in a period [rad/s]."""


@compiled
def add_line(motion, sent, command, response, line, mass, frequency, lag, actuators, tick, ticks):
    """Take the periodic motion of a line out of the measurements and add its command.

    Parameters
    ----------
    motion : Array, shape (3, units)
        Position [m], speed [m/s] and force [N] of every unit, without this line after the call.
    sent : Array, shape (d, units)
        Commands in flight, oldest first [N], without this line after the call.
    command : Array, shape (units,)
        Commands of the lines [N], with this line after the call.
    response : complex Array, shape (2, units, units)
        Motion and acting force over the mass for unit disturbances.
    line : complex Array, shape (2, units)
        Disturbance and drift of the line now [m/s², m/s].
    mass : Array, shape (units,)
        Mass with rotating parts [kg].
    frequency, lag, tick
        rad/s, s, s.
    ticks : int
        Ticks of a control period; a command is held for them.
    actuators : Array, shape (3, units)
        Delay in traction and braking [s], share of the force.
    """
    count, units = sent.shape
    for i in range(units):
        place, acting = 0j, 0j
        for k in range(units):
            place += response[0, i, k] * line[0, k]
            acting += response[1, i, k] * line[0, k]
        acting *= mass[i]
        motion[0, i] -= place.real
        motion[1, i] -= (1j * frequency * place - line[1, i]).real
        motion[2, i] -= acting.real
        demand = (1.0 + 1j * frequency * lag) * acting
        for row in range(count + 1):
            former = sent[min(row, count - 1), i] if count else 0.0
            delay = actuators[1, i] if former < 0.0 else actuators[0, i]
            periods = (count - row + ticks - 1) // ticks
            angle = frequency * (delay + (0.5 - periods) * ticks * tick)
            part = demand.real * libm_cos(angle) - demand.imag * libm_sin(angle)
            if row < count:
                sent[row, i] -= part
            else:
                command[i] += part


@dataclass
class SpectralLine:
    """A line of the disturbance.

    Attributes
    ----------
    place
        Place in the grid of the spectrum.
    frequency, computed
        Frequency now and that of the response [rad/s].
    count
        Searches in turn, at most ``PERSISTENCE``, less those that missed it.
    used
        True from the first count of ``PERSISTENCE`` on.
    weight
        Part of the motion and of the command that is used.
    response : complex Array, shape (2, units, units), or None
        Motion and acting force over the mass for unit disturbances.
    """

    place: int
    frequency: float
    count: int = 1
    used: bool = False
    weight: float = 0.0
    computed: float = 0.0
    response: Array | None = None


class DisturbanceLines:
    """Lines of the disturbances, with their motion and commands.

    Parameters
    ----------
    units
        The coupled units.
    model
        The nominal train.
    period
        Control period [s].

    Attributes
    ----------
    command : Array, shape (units,)
        Commands of the lines [N].
    """

    def __init__(self, units: CoupledUnits, model: TrainModel, period: float) -> None:
        self._units, self._model = units, model
        self._spectrum = LineSpectrum(units, period)
        self._ticks = max(1, round(period / model.tick))
        self._every = max(1, round(SEARCH_TIME / period))
        self._rise = 1.0 - math.exp(-period / RISE_TIME)
        self.reset()

    def reset(self) -> None:
        """Forget spectrum and lines."""
        self._spectrum.reset()
        self._lines: list[SpectralLine] = []
        self._steps = 0
        self.command = np.zeros(self._units.n)

    def text(self) -> str:
        """Return the frequencies in use [rad/s]."""
        return " ".join(f"{line.frequency:.3f}" for line in self._lines if line.used)

    def step(self, inputs: LawInput, sent: Array, actuators: Array, trusted: bool) -> tuple[LawInput, Array]:
        """Take the measurements; return inputs and commands in flight without the lines.

        Parameters
        ----------
        inputs
            Inputs of the law.
        sent : Array, shape (d, units)
            Commands in flight, oldest first [N].
        actuators : Array, shape (3, units)
            Delay in traction and braking [s], share of the force.
        trusted
            False if the model of the actuators is wrong: the phase of a command is then not known.
        """
        moves = float(np.abs(inputs.velocity).max()) > STANDSTILL_SPEED
        self._spectrum.step(inputs.t, self._sample(inputs) if moves else None)
        self._steps += 1
        if self._steps % self._every == 0:
            self._search()
        self._weigh(moves and trusted)
        self.command = np.zeros(self._units.n)
        used = [line for line in self._lines if line.response is not None and line.weight > 0.0]
        if not used:
            return inputs, sent
        motion, sent = np.array([inputs.position, inputs.velocity, inputs.applied]), sent.copy()
        for line in used:
            amplitudes = self._spectrum.amplitudes(line.place, line.frequency, line.weight)
            add_line(
                motion, sent, self.command, line.response, amplitudes, self._units.mass, line.frequency,
                self._model.lag, actuators, self._model.tick, self._ticks,
            )  # fmt: skip
        position, velocity, applied = motion
        low, high = inputs.force_min - self.command, inputs.force_max - self.command
        rest = {"position": position, "velocity": velocity, "applied": applied, "force_min": low, "force_max": high}
        return replace(inputs, **rest), sent

    def _sample(self, inputs: LawInput) -> Array:
        """Return position error [m], speed error [m/s] and force over the mass [m/s²], shape (3, units)."""
        ahead, units, model = inputs.lookahead, self._units, self._model
        required = model.inertia * float(ahead.acceleration[0]) + float(ahead.resistance[0])
        return np.array(
            [
                inputs.position + (model.offsets - float(ahead.position[0])),
                inputs.velocity - float(ahead.velocity[0]),
                (inputs.applied - required * units.weight) / units.mass,
            ]
        )

    def _search(self) -> None:
        """Compare the lines with the peaks of the spectrum."""
        found = self._spectrum.peaks()
        for line in self._lines:
            near = [peak for peak in found if abs(peak[0] - line.place) <= 1]
            if near:
                found.remove(near[0])
                line.place, line.frequency = near[0]
                line.count = min(line.count + 1, PERSISTENCE)
                line.used = line.used or line.count == PERSISTENCE
            else:
                line.count = max(line.count - 1, 0)
                line.used = line.used and line.count > 0
        self._lines = [line for line in self._lines if line.count > 0 or line.weight > 0.01]
        self._lines += [SpectralLine(*peak) for peak in found[: MAX_LINES - len(self._lines)]]

    def _weigh(self, usable: bool) -> None:
        """Compute the response of a line that is new or has changed, at most one, and advance the weights."""
        computed = False
        for line in self._lines:
            if line.used and not computed and abs(line.frequency - line.computed) > CHANGE:
                line.response = periodic_response(self._units, self._model.lag, line.frequency)
                line.computed, computed = line.frequency, True
            aim = 1.0 if usable and line.used and line.response is not None else 0.0
            line.weight += self._rise * (aim - line.weight)
