"""Spectrum of the disturbances of coupled units, for persistent sines ("lines") of unknown frequency.

A bank of demodulators, one per frequency w of a grid, has measured position errors y, speed errors and forces beyond
the reference f of all units as inputs. A demodulator is a low-pass of second order of the signal turned back by w::

    y1' = (i w - r) y1 + r y,   y2' = (i w - r) y2 + r y1

with the gain 1 at w and 1/(1 + i (v - w)/r)² at v. The derivatives of y2 follow from the states, so that the motion of
the units gives the disturbance b that passed the same filter, without a model of the disturbance and independent of
the commands::

    b2 = y2'' - S y2 - D y2' - f2/m

A unit may have a drift between speed and position (wheels). Its part of the line is p2 = y2' - v2 with the measured
speed v. A line turns b2 by its frequency times the period from sample to sample. The sum c of b2(k) conj(b2(k - 1)) over
the units, averaged over ``MEMORY_TIME``, has the frequency in its angle and the coherent power in its magnitude (pulse
pair: Miller and Rochwarger 1972, IEEE Transactions on Information Theory 18).
"""

# mypy: allow-untyped-defs

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from plant_sim.compiled import compiled

if TYPE_CHECKING:
    from train_ato.control.algorithms.coupled_units import CoupledUnits
    from train_ato.messages.types import Array

LOWEST, HIGHEST, SPACING = 0.4, 5.0, 0.1
"""Grid of the frequencies [rad/s]."""
FILTER_TIME = 6.0
"""1/r, time constant of a demodulator [s]."""
MEMORY_TIME = 10.0
"""Time constant of the mean of c [s]."""
SIGNIFICANT = 5.0
"""Power of a line over the median of the grid, in displacement."""


@compiled
def spectrum_step(first, second, forced, pairs, turn, gain, keep, period, spring, damper, frequencies, sample):
    """Advance all demodulators by a sample.

    Parameters
    ----------
    first, second : complex Array, shape (frequencies, 3, units)
        y1 and y2 of position error [m], speed error [m/s] and force over the mass [m/s²].
    forced : complex Array, shape (frequencies, units)
        b2 [m/s²].
    pairs : complex Array, shape (frequencies,)
        Mean of c [m²/s⁴].
    turn : complex Array, shape (frequencies,)
        Turn in a period.
    gain, keep
        Part of a new sample in a stage, and of the former mean in c.
    period
        Control period [s].
    spring, damper : Array, shape (units, units)
        S [1/s²] and D [1/s].
    frequencies : Array, shape (frequencies,)
        [rad/s].
    sample : Array, shape (3, units)
        Position error, speed error and force over the mass.
    """
    count, units = forced.shape
    rate = gain / ((1.0 - gain) * period)
    speed, change = np.empty(units, np.complex128), np.empty(units, np.complex128)
    for j in range(count):
        for q in range(3):
            for i in range(units):
                one = first[j, q, i] * turn[j]
                one += gain * (sample[q, i] - one)
                two = second[j, q, i] * turn[j]
                first[j, q, i], second[j, q, i] = one, two + gain * (one - two)
        spin = 1j * frequencies[j]
        for i in range(units):
            one, two = first[j, 0, i], second[j, 0, i]
            speed[i] = spin * two + rate * (one - two)
            one_rate = spin * one + rate * (sample[0, i] - one)
            change[i] = spin * speed[i] + rate * (one_rate - speed[i]) - second[j, 2, i]
        for i in range(units):
            value = change[i]
            for k in range(units):
                value -= spring[i, k] * second[j, 0, k] + damper[i, k] * speed[k]
            pairs[j, i] += (1.0 - keep) * (value * forced[j, i].conjugate() - pairs[j, i])
            forced[j, i] = value


class LineSpectrum:
    """Frequencies and amplitudes of the lines in the disturbances of coupled units.

    Parameters
    ----------
    units
        The coupled units.
    period
        Control period [s].

    Attributes
    ----------
    frequencies : Array, shape (frequencies,)
        The grid [rad/s].
    """

    def __init__(self, units: CoupledUnits, period: float) -> None:
        self.frequencies = np.arange(LOWEST, HIGHEST + 0.5 * SPACING, SPACING)
        self._units, self._period = units, period
        angles = (self.frequencies * period).tolist()
        self._turn = np.array([complex(math.cos(angle), math.sin(angle)) for angle in angles])
        self._gain = 1.0 - math.exp(-period / FILTER_TIME)
        self._keep = math.exp(-period / MEMORY_TIME)
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        count, n = self.frequencies.size, self._units.n
        self._first = np.zeros((count, 3, n), np.complex128)
        self._second = np.zeros((count, 3, n), np.complex128)
        self.forced = np.zeros((count, n), np.complex128)
        self.pairs = np.zeros((count, n), np.complex128)

    def step(self, position: Array, speed: Array, force: Array) -> None:
        """Take a sample of position error [m], speed error [m/s] and force over the mass [m/s²] of every unit."""
        spectrum_step(
            self._first, self._second, self.forced, self.pairs, self._turn, self._gain, self._keep, self._period,
            self._units.spring, self._units.damper, self.frequencies, np.array([position, speed, force]),
        )  # fmt: skip

    def amplitude(self, place: int, frequency: float) -> tuple[Array, Array]:
        """Return disturbance [m/s²] and drift [m/s] of a line now, complex, shape (units,)."""
        rate = self._gain / ((1.0 - self._gain) * self._period)
        one, two = self._first[place], self._second[place]
        drift = 1j * self.frequencies[place] * two[0] + rate * (one[0] - two[0]) - two[1]
        angle = (frequency - float(self.frequencies[place])) * self._period
        passed = self._gain / (1.0 - (1.0 - self._gain) * complex(math.cos(angle), -math.sin(angle)))
        scale = 2.0 / passed**2
        return scale * self.forced[place], scale * drift

    def peaks(self) -> list[tuple[int, float]]:
        """Return place in the grid and frequency [rad/s] of every significant line, the strongest first."""
        power = np.abs(self.pairs) / self.frequencies[:, None] ** 4
        over = power / (np.median(power, axis=0) + 1e-30)
        values, units = over.max(axis=1).tolist(), over.argmax(axis=1).tolist()
        found = []
        for j in range(1, len(values) - 1):
            if values[j] > SIGNIFICANT and values[j - 1] < values[j] >= values[j + 1]:
                pair = complex(self.pairs[j, units[j]])
                frequency = math.atan2(pair.imag, pair.real) / self._period
                if abs(frequency - self.frequencies[j]) < SPACING:
                    found.append((values[j], j, frequency))
        return [(j, frequency) for _, j, frequency in sorted(found, reverse=True)]
