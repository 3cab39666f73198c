"""Persistent sines ("lines") in the disturbances of coupled units: their spectrum, motion and commands.

Equations: `msgs_docs/mpc_derivation.md`. A line is used after ``PERSISTENCE`` searches in turn have found it, with a
weight that rises in ``RISE_TIME``. Without a line nothing changes.
"""

# mypy: allow-untyped-defs

import math
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_cos, libm_sin, matrix_product
from plant_sim.record import Records
from train_ato.control.algorithms.coupled_units import CoupledUnits
from train_ato.control.algorithms.quadratic_program import inverse
from train_ato.control.contract import LawInput
from train_ato.control.train_model import STANDSTILL_SPEED, Actuator, TrainModel
from train_ato.messages.types import Array

LOWEST, HIGHEST, SPACING = 0.4, 5.0, 0.1
"""Grid of the frequencies [rad/s]."""
FILTER_TIME = 6.0
"""1/r, time constant of a demodulator [s]: lines .5 rad/s apart are separate."""
MEMORY_TIME = 20.0
"""Time constant of the mean of c [s]."""
BESIDE = (-8, -5, 5, 8)
"""Places beside a line in the grid, with at most 1 % of its power; the two middle ones of the four powers count, so
that two lines .5 rad/s apart do not hide each other."""
FLOOR_SHARE = 2.0
"""Power over the floor up to which an amplitude counts as noise: the part 1 - 2 floor/power of it is used."""
SIGNIFICANT = 8.0
"""Smallest power of a line over the floor."""
MAX_GAP = 5.0
"""Time without a sample after which the spectrum begins again [s]."""


@compiled
def turned(states, turn):
    """Turn the states of every demodulator, shape (frequencies, ...), by a period without a sample."""
    for j in range(turn.size):
        states[j] *= turn[j]


@compiled
def spectrum_step(first, second, found, pairs, turn, gain, new, period, spring, damper, frequencies, sample):
    """Advance all demodulators by a sample.

    ``first`` and ``second``, shape (frequencies, 3, units), are y1 and y2 of position error [m], speed error [m/s] and
    force over the mass [m/s²], as is ``sample``, shape (3, units). ``found`` and ``pairs``, shape (frequencies, 2,
    units), are q2 [m/s²] and p2 [m/s] and the mean of c. ``turn`` is the turn in a ``period`` [s]; ``gain`` and ``new``
    are the parts of a new sample in a stage and in the mean of c. ``spring`` and ``damper`` are S [1/s²] and D [1/s];
    ``frequencies`` in rad/s.
    """
    count, _, units = found.shape
    rate = gain / ((1.0 - gain) * period)
    rates, both = np.empty((2, units), np.complex128), np.empty(2, np.complex128)
    for j in range(count):
        for i in range(units):
            for q in range(3):
                one = first[j, q, i] * turn[j]
                one += gain * (sample[q, i] - one)
                two = second[j, q, i] * turn[j]
                two += gain * (one - two)
                first[j, q, i], second[j, q, i] = one, two
                if q < 2:
                    rates[q, i] = 1j * frequencies[j] * two + rate * (one - two)
        for i in range(units):
            both[0] = rates[1, i] - second[j, 2, i]
            for k in range(units):
                both[0] -= spring[i, k] * second[j, 0, k] + damper[i, k] * rates[0, k]
            both[1] = rates[0, i] - second[j, 1, i]
            for q in range(2):
                pairs[j, q, i] += new * (both[q] * found[j, q, i].conjugate() - pairs[j, q, i])
                found[j, q, i] = both[q]


@compiled
def line_power(pairs, frequencies):
    """Return |c| of q2 [m²/s⁴] and |c|/w² of p2 [m²], shape (frequencies, 2, units)."""
    power = np.empty(pairs.shape)
    for j in range(pairs.shape[0]):
        for q in range(2):
            scale = 1.0 / frequencies[j] ** 2 if q else 1.0
            for i in range(pairs.shape[2]):
                pair = pairs[j, q, i]
                power[j, q, i] = scale * sqrt(pair.real * pair.real + pair.imag * pair.imag)
    return power


@compiled
def line_amplitudes(found, over, scale, frequency):
    """Return disturbance q + i w p [m/s²] and drift p [m/s] of a line, complex, shape (2, units).

    ``found`` is q2 and p2 of its demodulator and ``over`` their power over the floor, each of shape (2, units);
    ``scale`` is the complex amplitude of the line for an output of 1, ``frequency`` is w [rad/s].
    """
    line = np.empty(found.shape, np.complex128)
    for i in range(found.shape[1]):
        for q in range(2):
            line[q, i] = scale * max(1.0 - FLOOR_SHARE / max(over[q, i], FLOOR_SHARE), 0.0) * found[q, i]
        line[0, i] += 1j * frequency * line[1, i]
    return line


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
        places = np.arange(self._grid.size)
        self._beside = np.array([np.clip(places + shift, 0, self._grid.size - 1) for shift in BESIDE])
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
        self._found = np.zeros((count, 2, n), np.complex128)
        self._pairs = np.zeros((count, 2, n), np.complex128)
        self._over = np.zeros((count, 2 * n))
        self._samples = 0
        self._time = -math.inf

    def step(self, t: float, sample: Array | None) -> None:
        """Take a sample at a time [s]; missed ones only turn the states.

        The sample, shape (3, units), is position error [m], speed error [m/s] and force over the mass [m/s²] of every
        unit; None counts as missed.
        """
        if t - self._time > MAX_GAP:
            self.reset()
            self._time = t - self._period
        missed = max(round((t - self._time) / self._period) - 1, 0) + (sample is None)
        self._time = t
        for _ in range(missed):
            for states in (self._first, self._second, self._found):
                turned(states, self._turn)
        if sample is not None:
            self._samples += 1
            spectrum_step(
                self._first, self._second, self._found, self._pairs, self._turn, self._gain,
                1.0 / min(self._samples, self._memory), self._period, self._units.spring, self._units.damper,
                self._grid, sample,
            )  # fmt: skip

    def peaks(self) -> list[tuple[int, float]]:
        """Return place in the grid and frequency [rad/s] of every significant line, the strongest first."""
        power = line_power(self._pairs, self._grid).reshape(self._over.shape)
        beside = np.sort(power[self._beside], axis=0)
        floor = np.maximum(np.median(power, axis=0), 0.5 * (beside[1] + beside[2]))
        self._over = power / np.maximum(floor, 1e-30)
        values, columns = self._over.max(axis=1).tolist(), self._over.argmax(axis=1).tolist()
        pairs = self._pairs.reshape(self._over.shape)
        found = []
        for j in range(1, len(values) - 1):
            if values[j] > SIGNIFICANT and values[j - 1] < values[j] >= values[j + 1]:
                pair = complex(pairs[j, columns[j]])
                frequency = math.atan2(pair.imag, pair.real) / self._period
                if abs(frequency - float(self._grid[j])) < SPACING:
                    found.append((values[j], j, frequency))
        return [(j, frequency) for _, j, frequency in sorted(found, reverse=True)]

    def amplitudes(self, place: int, frequency: float, weight: float = 1.0) -> Array:
        """Return disturbance [m/s²] and drift [m/s] of a line now times a weight, complex, shape (2, units).

        ``place`` is that of its demodulator in the grid. The gain of the demodulator at the frequency [rad/s] is taken
        out.
        """
        angle = (frequency - float(self._grid[place])) * self._period
        passed = self._gain / (1.0 - (1.0 - self._gain) * complex(math.cos(angle), -math.sin(angle)))
        part = self._over[place].reshape(2, -1)
        found: Array = line_amplitudes(self._found[place], part, 2.0 * weight / (passed * passed), frequency)
        return found


POSITION = 0.1
"""Deviation of a position with the weight 1 [m]."""
COUPLER = 3e4
"""Coupler force with the weight 1 [N]."""
RATE = 0.3
"""Rate of the command over the mass with the weight 1 [m/s³]."""


def periodic_response(units: CoupledUnits, lag: float, frequency: float) -> Array:
    """Return motion x and acting force over the mass for unit disturbances, complex, shape (2, units, units).

    The command u is (1 + i w Ta) times the acting force, with the lag Ta [s] and the frequency w [rad/s].
    """
    n, w = units.n, frequency
    couplers = units.stiffness[:, None] * (np.eye(n)[:-1] - np.eye(n)[1:])
    cost = np.eye(n) / POSITION**2 + matrix_product(np.ascontiguousarray(couplers.T), couplers) / COUPLER**2
    weight = w * w * (1.0 + (w * lag) ** 2) / RATE**2
    real, imaginary = -w * w * np.eye(n) - units.spring, -w * units.damper
    stiff = np.block([[real, -imaginary], [imaginary, real]])
    turned = weight * np.ascontiguousarray(stiff.T)
    both = np.zeros((2 * n, 2 * n))
    both[:n, :n], both[n:, n:] = cost, cost
    motion = matrix_product(inverse(both + matrix_product(turned, stiff)), turned)
    force = matrix_product(stiff, motion) - np.eye(2 * n)
    return np.array([motion[:n, :n] + 1j * motion[n:, :n], force[:n, :n] + 1j * force[n:, :n]])


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

    ``motion``, shape (3, units), is position [m], speed [m/s] and force [N], ``sent``, shape (d, units), the commands
    in flight [N], ``command`` those of the lines [N]. ``response`` is that of :func:`periodic_response`, ``line``,
    shape (2, units), disturbance and drift now [m/s², m/s]. ``mass`` in kg, ``frequency`` in rad/s, ``lag`` and
    ``tick`` in s. A command is held for ``ticks``.
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
            delay = actuators[i].backward if former < 0.0 else actuators[i].forward
            periods = (count - row + ticks - 1) // ticks
            angle = frequency * (delay + (0.5 - periods) * ticks * tick)
            part = demand.real * libm_cos(angle) - demand.imag * libm_sin(angle)
            if row < count:
                sent[row, i] -= part
            else:
                command[i] += part


@dataclass
class SpectralLine:
    """A line of the disturbance, with its place in the grid of the spectrum.

    ``frequency`` is that now, ``computed`` that of the response [rad/s]. ``count`` is the number of searches in turn,
    at most ``PERSISTENCE``, less those that missed it; from there on the line is ``used``. ``weight`` is the part of
    motion and command in use, ``response`` that of :func:`periodic_response`.
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

    def step(
        self, inputs: LawInput, sent: Array, actuators: Records[Actuator], *, trusted: bool
    ) -> tuple[LawInput, Array]:
        """Take the measurements; return inputs and commands in flight without the lines.

        The commands in flight, shape (d, units), have the oldest first [N]. Without ``trusted`` the model of the
        actuators is wrong, and the phase of a command is not known.
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
