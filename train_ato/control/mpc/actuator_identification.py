"""Online estimate of gain and delays of the actuators; equations: `msgs_docs/mpc_derivation.md`."""

# mypy: allow-untyped-defs

import math

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_exp, plain_sum
from train_ato.control.train_model import TrainModel, newest_arrived
from train_ato.messages.types import Array

FACTORS = tuple(0.1 * tenths for tenths in range(4, 21))
"""Candidates for the factor on the delays."""
MEMORY_TIME = 20.0
"""Time constant of the sums [s]."""
SWITCH_RATIO = 0.5
"""Misfit of a candidate over that of the present one, below which the estimate changes."""
MIN_GAIN, MAX_GAIN = 0.5, 1.5
"""Bounds of the gain."""
FORCE_FLOOR = 1e-3
"""Misfit that is not significant, over the largest force of the train."""
WRONG_MISFIT = 0.05
"""Relative misfit of the best candidate above which the model of the actuators counts as wrong."""
UNSAFE_MISFIT = 0.15
"""The same above which full gains are not safe; they are safe again below :data:`WRONG_MISFIT`."""


@compiled
def bank_step(modelled, sums, gains, misfits, sent, last, applied, delays, factors, now, clock, former):
    """Advance all candidates by a control period; return the number of the new one, or the former one.

    ``modelled``, shape (candidates, units), is the modelled force [N]; ``sums``, shape (candidates, 3), those of F F_c,
    F_c² and F² [N²]. ``gains`` and ``misfits`` are results: g_c, and E_c with the floor [N²]. ``sent``, shape (d,
    units), has the commands, oldest first, and receives the ``last`` one for every tick [N]; ``applied`` is the
    measured total force [N]. ``delays``, shape (2, units), are those in traction and braking [s], ``factors`` those of
    the candidates. ``now`` is True for a train in motion, without which the sample counts for traction only, and the
    misfit that is not significant [N²]. ``clock`` has tick [s], lag [s], part of the sums that remains after a tick,
    and ticks of a period.
    """
    (moves, floor), (tick, lag, keep, ticks) = now, clock
    decay = libm_exp(-tick / lag) if lag > 0.0 else 0.0
    counts = moves or sent.min() >= 0.0
    for now_tick in range(ticks):
        sent[:-1] = sent[1:]
        sent[-1] = last
        pairs = int(counts and now_tick == ticks - 1)
        kept = keep if counts else 1.0
        for c in range(factors.size):
            total = 0.0
            for i in range(modelled.shape[1]):
                forward, backward = factors[c] * delays[0, i], factors[c] * delays[1, i]
                due = newest_arrived(sent, i, -0.5 * tick, tick, forward, backward)
                modelled[c, i] = due + (modelled[c, i] - due) * decay
                total += modelled[c, i]
            sums[c, 0] = kept * sums[c, 0] + pairs * applied * total
            sums[c, 1] = kept * sums[c, 1] + pairs * total * total
            sums[c, 2] = kept * sums[c, 2] + pairs * applied * applied
    found = 0
    for c in range(sums.shape[0]):
        crossed, own = sums[c, 0], sums[c, 1]
        gain = min(max(crossed / max(own, floor), MIN_GAIN), MAX_GAIN)
        gains[c] = gain
        misfits[c] = max(sums[c, 2] - 2.0 * gain * crossed + gain * gain * own, 0.0) + floor
        if misfits[c] < misfits[found]:
            found = c
    return found if misfits[found] < SWITCH_RATIO * misfits[former] else former


class ActuatorIdentification:
    """Gain of the actuators, factor on their delays, and test of their model.

    Attributes
    ----------
    model_is_unsafe : bool
        True from a misfit above :data:`UNSAFE_MISFIT` to one below :data:`WRONG_MISFIT`.

    Parameters
    ----------
    model
        The nominal train; its values are the initial estimate.
    period
        Control period [s].
    estimates
        False for a test of the model only: the delays of the model are the single candidate.
    """

    def __init__(self, model: TrainModel, period: float, *, estimates: bool = True) -> None:
        self._delays = np.array([model.delay, model.delay_brake])
        self._factors = np.array(FACTORS) if estimates and self._delays.max() > 0.0 else np.ones(1)
        self._nominal = int(np.argmin(np.abs(self._factors - 1.0)))
        self._factors[self._nominal] = 1.0
        self.length = int(np.ceil(self._delays.max() * self._factors.max() / model.tick - 1e-9)) + 1
        largest = plain_sum(envelope.largest() for envelope in (*model.traction, *model.brake))
        self._floor = (FORCE_FLOOR * largest) ** 2
        keep, ticks = math.exp(-model.tick / MEMORY_TIME), max(1, round(period / model.tick))
        self._clock = model.tick, model.lag, keep, ticks
        self.reset()

    def reset(self) -> None:
        """Return to the values of the model."""
        self.sent = np.zeros((self.length, self._delays.shape[1]))
        self._modelled = np.zeros((self._factors.size, self._delays.shape[1]))
        self._sums = np.zeros((self._factors.size, 3))
        self._gains, self._misfits = np.ones(self._factors.size), np.zeros(self._factors.size)
        self._best = self._nominal
        self.gain, self.misfit = 1.0, 0.0
        self.model_is_unsafe = False

    def take_over(self, in_flight: Array, last: Array, applied: Array) -> None:
        """Begin with the commands in flight, shape (d, units), the last command and the forces that act [N]."""
        commands = (in_flight if in_flight.size else last[None])[-self.length :]
        self.sent[:] = commands[0]
        self.sent[-len(commands) :] = commands
        self.sent[1:] = self.sent[:-1].copy()  # the first step adds the last command
        self._modelled[:] = applied

    @property
    def factor(self) -> float:
        """Present factor on the delays."""
        return float(self._factors[self._best])

    @property
    def model_is_wrong(self) -> bool:
        """True if no candidate explains the measured force."""
        return self.misfit > WRONG_MISFIT

    def step(self, last: Array, applied: float, moves: bool = True) -> bool:
        """Add a control period; return True if the factor has changed.

        ``last``, shape (units,), is the command sent in the last period, ``applied`` the measured total force [N].
        ``moves`` is False at standstill: the holding brake gives the force, and the sample counts for traction only.
        """
        former = self._best
        best = self._best = bank_step(
            self._modelled, self._sums, self._gains, self._misfits, self.sent, last, applied, self._delays,
            self._factors, (moves, self._floor), self._clock, former,
        )  # fmt: skip
        own, total = float(self._sums[best, 1]), float(self._sums[best, 2])
        if own > 100.0 * self._floor:
            self.gain = float(self._gains[best])
            self.misfit = math.sqrt(float(self._misfits[best]) / max(total, self._floor))
            self.model_is_unsafe = self.misfit > (WRONG_MISFIT if self.model_is_unsafe else UNSAFE_MISFIT)
        return self._best != former
