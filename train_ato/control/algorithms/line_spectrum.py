"""Spectrum of the disturbances of coupled units, for persistent sines ("lines") of unknown frequency.

A bank of demodulators, one per frequency w of a grid, has measured position errors y, speed errors and forces f beyond
those of the reference as inputs, for every unit. A demodulator is a low-pass of second order with the time constant
1/r around its frequency::

    y1' = (i w - r) y1 + r y,   y2' = (i w - r) y2 + r y1

with the gain 1 at w and 1/(1 + i (v - w)/r)² at v. The derivatives of y2 follow from the states, so that the motion
gives the disturbance b [m/s²] through the same filter, without a model of b and for any command::

    b2 = y2'' - S y2 - D y2' - f2/m

with the springs S and dampers D of the couplers. A unit may have a drift between its speed and the change of its
position (wheels): p2 = y2' - v2 with the measured speed v.

From sample to sample a line turns b2 by its frequency times the period h. c = b2(k) conj(b2(k - 1)), averaged over
``MEMORY_TIME``, has the frequency in its angle and the power in its magnitude (pulse pair: Miller and Rochwarger 1972,
IEEE Transactions on Information Theory 18). |c|/w⁴ is a power of displacement, in which the noise of the positions is
the same at all frequencies: its median over the grid is the noise floor of a unit.
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
"""1/r, time constant of a demodulator [s]: lines .5 rad/s apart are separate."""
MEMORY_TIME = 20.0
"""Time constant of the mean of c [s]."""
SIGNIFICANT = 6.0
"""Power of a line over the noise floor."""
MAX_GAP = 5.0
"""Time without a sample after which the spectrum begins again [s]."""


@compiled
def turned(states, turn):
    """Turn the states of every demodulator, shape (frequencies, ...), by a period without a sample."""
    for j in range(turn.size):
        states[j] *= turn[j]


@compiled
def spectrum_step(first, second, forced, pairs, turn, gain, new, period, spring, damper, frequencies, sample):
    """Advance all demodulators by a sample.

    Parameters
    ----------
    first, second : complex Array, shape (frequencies, 3, units)
        y1 and y2 of position error [m], speed error [m/s] and force over the mass [m/s²].
    forced : complex Array, shape (frequencies, units)
        b2 [m/s²].
    pairs : complex Array, shape (frequencies, units)
        Mean of c [m²/s⁴].
    turn : complex Array, shape (frequencies,)
        Turn in a period.
    gain, new
        Part of a new sample in a stage and in the mean of c.
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
            pairs[j, i] += new * (value * forced[j, i].conjugate() - pairs[j, i])
            forced[j, i] = value


@compiled
def displacement_power(pairs, frequencies):
    """Return |c|/w⁴ [m²], shape (frequencies, units)."""
    power = np.empty(pairs.shape)
    for j in range(pairs.shape[0]):
        scale = 1.0 / (frequencies[j] * frequencies[j]) ** 2
        for i in range(pairs.shape[1]):
            pair = pairs[j, i]
            power[j, i] = scale * math.sqrt(pair.real * pair.real + pair.imag * pair.imag)
    return power


class LineSpectrum:
    """Frequencies and amplitudes of the lines in the disturbances of coupled units.

    Parameters
    ----------
    units
        The coupled units.
    period
        Control period [s].
    """

    def __init__(self, units: CoupledUnits, period: float) -> None:
        self._grid = LOWEST + SPACING * np.arange(round((HIGHEST - LOWEST) / SPACING) + 1)
        self._units, self._period = units, period
        angles = (self._grid * period).tolist()
        self._turn = np.array([complex(math.cos(angle), math.sin(angle)) for angle in angles])
        self._gain = 1.0 - math.exp(-period / FILTER_TIME)
        self._memory = MEMORY_TIME / period
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        count, n = self._grid.size, self._units.n
        self._first = np.zeros((count, 3, n), np.complex128)
        self._second = np.zeros((count, 3, n), np.complex128)
        self._forced = np.zeros((count, n), np.complex128)
        self._pairs = np.zeros((count, n), np.complex128)
        self._samples = 0
        self._time = -math.inf

    def step(self, t: float, sample: Array | None) -> None:
        """Take a sample; missed ones only turn the states.

        Parameters
        ----------
        t
            Time of the sample [s].
        sample : Array, shape (3, units), or None
            Position error [m], speed error [m/s] and force over the mass [m/s²] of every unit; None counts as missed.
        """
        if t - self._time > MAX_GAP:
            self.reset()
            self._time = t - self._period
        missed = max(round((t - self._time) / self._period) - 1, 0) + (sample is None)
        self._time = t
        for _ in range(missed):
            for states in (self._first, self._second, self._forced):
                turned(states, self._turn)
        if sample is not None:
            self._samples += 1
            spectrum_step(
                self._first, self._second, self._forced, self._pairs, self._turn, self._gain,
                1.0 / min(self._samples, self._memory), self._period, self._units.spring, self._units.damper,
                self._grid, sample,
            )  # fmt: skip

    def peaks(self) -> list[tuple[int, float]]:
        """Return place in the grid and frequency [rad/s] of every significant line, the strongest first."""
        power = displacement_power(self._pairs, self._grid)
        over = power / np.maximum(np.median(power, axis=0), 1e-30)
        values, units = over.max(axis=1).tolist(), over.argmax(axis=1).tolist()
        found = []
        for j in range(1, len(values) - 1):
            if values[j] > SIGNIFICANT and values[j - 1] < values[j] >= values[j + 1]:
                pair = complex(self._pairs[j, units[j]])
                frequency = math.atan2(pair.imag, pair.real) / self._period
                if abs(frequency - float(self._grid[j])) < SPACING:
                    found.append((values[j], j, frequency))
        return [(j, frequency) for _, j, frequency in sorted(found, reverse=True)]

    def amplitudes(self, place: int, frequency: float) -> tuple[Array, Array]:
        """Return disturbance [m/s²] and drift [m/s] of a line now, complex, shape (units,).

        Parameters
        ----------
        place
            Place of its demodulator in the grid.
        frequency
            Its frequency [rad/s]: the gain of the demodulator there is taken out.
        """
        gain, grid = self._gain, float(self._grid[place])
        rate = gain / ((1.0 - gain) * self._period)
        angle = (frequency - grid) * self._period
        passed = gain / (1.0 - (1.0 - gain) * complex(math.cos(angle), -math.sin(angle)))
        scale = 2.0 / (passed * passed)
        one, two = self._first[place, 0], self._second[place, 0]
        drift = 1j * grid * two + rate * (one - two) - self._second[place, 1]
        return scale * self._forced[place], scale * drift
