"""Kalman filters of the motion of a train as one mass: disturbance, error of the mass, and noise of the sensors.

    e_p' = e_v,   e_v' = (F - W)/M - v_d' + d + theta x,   x = (F - W + W_line)/M,   d' = white noise of PSD q

F is the measured force, W the resistance of the model with the line force W_line. theta is the error of the mass: a
train of mass m M has theta = 1/m - 1, since its line force grows with the mass. x is known, so that a filter of
(e_p, e_v, d, theta) is linear. This filter has a disturbance that changes like an unknown grade (``GRADE_CHANGE``), so
that it does not take a grade for a mass.

A bank of filters of (e_p, e_v, d) and the rate of d uses its theta. They differ in q (`disturbance_filters.py`).
Interacting multiple models (Blom and Bar-Shalom 1988, IEEE Transactions on Automatic Control 33) weight them by the
likelihood of their innovations. sigma is the measured noise of the speed, in q at most ``SPEED_FLOOR``: more noise
lowers the bandwidth.

In a train with hauled vehicles the speed of a unit differs from that of the train by waves: e_v has a random part of
PSD S = 2 ``WAVE_SPEED``²/T_w, with the time T_w of a wave through the train, and q the addition omega² S with the
bandwidth omega of the filter. The waves follow the force, so that theta has no meaning there: it is 0.

The variance of the noise is the mean of half the squared difference of consecutive innovations over ``NOISE_TIME``, at
standstill of the measurements: slow errors of the model do not count as noise (covariance matching, Mehra 1972, the
same journal 17).
"""

# mypy: allow-untyped-defs

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_exp
from train_ato.control.algorithms import disturbance_filters
from train_ato.control.algorithms.disturbance_filters import RAMP_TIME, DisturbanceFilters

SPEED_FLOOR = 0.01
"""Standard deviation of the speed up to which the bandwidth is that at the smallest noise [m/s]."""
NOISE_FLOOR = 0.002
"""Smallest standard deviation of the speed [m/s]."""
POSITION_FLOOR = 0.0002
"""Smallest standard deviation of the position [m]: the force changes at an unknown time of a tick."""
NOISE_TIME = 20.0
"""Time over which the noise is averaged [s]."""
SPEED_PRIOR, PRIOR_SAMPLES = 0.05, 2
"""Standard deviation of the speed at the start [m/s], and the number of samples that the priors count for."""
MAX_NOISE = 1.0
"""Largest standard deviation [m, m/s]."""
DISTURBANCE_PRIOR, MASS_PRIOR = 0.01, 0.1
"""Standard deviations of disturbance [m/s²] and error of the mass at the start."""
MASS_DRIFT = 1e-4
"""Standard deviation of the change of the error of the mass in a second."""
MAX_MASS_ERROR = 0.35
"""Largest error of the mass."""
GRADE_CHANGE = 0.02
"""Standard deviation of the change of an unknown grade in a second [m/s²]."""
WAVE_SPEED = 0.1
"""Standard deviation of the speed of a unit against its train with hauled vehicles [m/s]."""
STATES = 5
"""States of a filter."""


@compiled
def mix(states, covariances, chances, chain):
    """Mix states and covariances of the filters for a change from one to another; return nothing.

    Parameters
    ----------
    states : Array, shape (filters, 5)
        Position error [m], speed error [m/s], disturbance [m/s²], error of the mass, rate of the disturbance [m/s³].
    covariances : Array, shape (filters, 5, 5)
        Their covariances.
    chances : Array, shape (filters,)
        Probability of every filter; receives that before the next measurement.
    chain : Array, shape (filters, filters)
        Probability of a change in a period, from filter to filter.
    """
    count = chances.size
    former_states, former, before = states.copy(), covariances.copy(), chances.copy()
    for j in range(count):
        total = 0.0
        for i in range(count):
            total += before[i] * chain[i, j]
        chances[j] = total
        for a in range(STATES):
            states[j, a] = 0.0
            for i in range(count):
                weight = before[i] * chain[i, j] / total
                states[j, a] += weight * former_states[i, a]
        covariances[j] = 0.0
        for i in range(count):
            weight = before[i] * chain[i, j] / total
            for a in range(STATES):
                for b in range(STATES):
                    spread = (former_states[i, a] - states[j, a]) * (former_states[i, b] - states[j, b])
                    covariances[j, a, b] += weight * (former[i, a, b] + spread)


@compiled(uses=(disturbance_filters,))
def predict_motion(state, p, drifts, period, pull, regressor):
    """Advance state and covariance of one filter by a period; arguments as in :func:`filter_step`."""
    h = period
    fade = libm_exp(-h / RAMP_TIME)
    kept = RAMP_TIME * (1.0 - fade)
    risen = kept * state[4]
    total = pull + state[2] + 0.5 * risen + state[3] * regressor
    state[0] += (state[1] + 0.5 * total * h) * h
    state[1] += total * h
    state[2] += risen
    state[4] *= fade
    for j in range(STATES):
        risen = kept * p[4, j]
        gained = h * (p[2, j] + 0.5 * risen + regressor * p[3, j])
        p[0, j] += h * (p[1, j] + 0.5 * gained)
        p[1, j] += gained
        p[2, j] += risen
        p[4, j] *= fade
    for i in range(STATES):
        risen = kept * p[i, 4]
        gained = h * (p[i, 2] + 0.5 * risen + regressor * p[i, 3])
        p[i, 0] += h * (p[i, 1] + 0.5 * gained)
        p[i, 1] += gained
        p[i, 2] += risen
        p[i, 4] *= fade
    for i in range(STATES - 1):
        p[i + 1, i + 1] += drifts[i]


@compiled
def correct(state, p, noise, miss_position, miss_speed):
    """Correct one filter by its innovations; return half of their squared size and the root of their determinant."""
    a, b, c = p[0, 0] + noise[0], p[0, 1], p[1, 1] + noise[1]
    size = a * c - b * b
    row0, row1 = p[0].copy(), p[1].copy()
    for i in range(STATES):
        first = (row0[i] * c - row1[i] * b) / size
        second = (row1[i] * a - row0[i] * b) / size
        state[i] += first * miss_position + second * miss_speed
        for j in range(STATES):
            p[i, j] -= first * row0[j] + second * row1[j]
    for i in range(STATES):
        for j in range(i):
            p[i, j] = p[j, i]
    squared = (c * miss_position - 2.0 * b * miss_speed) * miss_position + a * miss_speed * miss_speed
    return 0.5 * squared / size, math.sqrt(size)


@compiled(uses=(disturbance_filters,))
def filter_step(
    states, covariances, chances, noise, before, drifts, chain, period, weight, position, speed, pull, regressor, mean,
    floor_ratio,
):  # fmt: skip
    """Advance all filters by a period and correct them.

    Parameters
    ----------
    states, covariances
        As in :func:`mix`, before them those of the filter of the mass.
    chances, chain
        As in :func:`mix`.
    noise : Array, shape (2,)
        Variances of the measurements.
    before : Array, shape (2,)
        Last innovations.
    drifts : Array, shape (1 + filters, 4)
        Variance of the change of speed, disturbance, error of the mass and rate of the disturbance in a period.
    period, weight
        Period [s] and weight of the newest sample in the noise.
    position, speed, pull, regressor
        Measured errors [m, m/s], modelled relative acceleration and x [m/s²].
    mean : Array, shape (5,)
        Result: mean of the states of the filters, weighted by their probabilities.
    floor_ratio
        Smallest standard deviation of the position over that of the speed [s].
    """
    mix(states[1:], covariances[1:], chances, chain)
    count = chances.size
    predict_motion(states[0], covariances[0], drifts[0], period, pull, regressor)
    correct(states[0], covariances[0], noise, position - states[0, 0], speed - states[0, 1])
    states[0, 3] = min(max(states[0, 3], -MAX_MASS_ERROR), MAX_MASS_ERROR)
    states[1:, 3] = states[0, 3]
    exponents, roots = np.empty(count), np.empty(count)
    mean_position, mean_speed = 0.0, 0.0
    least = 1e300
    for j in range(count):
        state, covariance = states[1 + j], covariances[1 + j]
        predict_motion(state, covariance, drifts[1 + j], period, pull, regressor)
        miss_position, miss_speed = position - state[0], speed - state[1]
        mean_position += chances[j] * miss_position
        mean_speed += chances[j] * miss_speed
        exponents[j], roots[j] = correct(state, covariance, noise, miss_position, miss_speed)
        least = min(least, exponents[j])
    total = 0.0
    for j in range(count):
        chances[j] *= libm_exp(max(least - exponents[j], -100.0)) / roots[j]
        total += chances[j]
    mean[:] = 0.0
    for j in range(count):
        chances[j] /= total
        for a in range(STATES):
            mean[a] += chances[j] * states[1 + j, a]
    match(noise, before, weight, mean_position, mean_speed, floor_ratio)


@compiled
def match(noise, before, weight, miss_position, miss_speed, floor_ratio):
    """Add a pair of innovations [m, m/s] to the variances of the noise."""
    for i in range(2):
        miss = miss_speed if i == 0 else miss_position
        place = 1 - i
        change = miss - before[place]
        found = noise[place] + weight * (0.5 * change * change - noise[place])
        floor = NOISE_FLOOR if i == 0 else max(floor_ratio * min(math.sqrt(noise[1]), SPEED_FLOOR), POSITION_FLOOR)
        noise[place] = min(max(found, floor * floor), MAX_NOISE * MAX_NOISE)
        before[place] = miss


class MotionObserver:
    """Position error [m], speed error [m/s], disturbance [m/s²] and error of the mass of a train.

    Parameters
    ----------
    period
        Control period [s].
    bandwidth
        omega_o, bandwidth of the disturbance at the smallest noise [rad/s].
    wave_time
        T_w, time of a wave through the train [s]; 0 for a train without hauled vehicles.
    coupled
        False for a train without couplers.
    speed_noise
        Standard deviation of the measured speed at the start [m/s].
    """

    def __init__(
        self,
        period: float,
        bandwidth: float,
        wave_time: float,
        coupled: bool = True,
        speed_noise: float = SPEED_PRIOR,
    ) -> None:
        self._filters = (DisturbanceFilters.coupled if coupled else DisturbanceFilters.free)(period, bandwidth)
        self._speed_prior = max(speed_noise, NOISE_FLOOR)
        self._waves = 2.0 * WAVE_SPEED**2 / wave_time * period if wave_time > 0.0 else 0.0
        self._wave_time, self._period = wave_time, period
        self._samples = NOISE_TIME / period
        self.reset()

    def reset(self) -> None:
        """Restart at the next sample without a disturbance and with the prior noise."""
        count = self._filters.walks.size
        of_mass = 0.0 if self._waves else MASS_PRIOR**2
        prior = [self._filters.position_prior**2, SPEED_PRIOR**2, DISTURBANCE_PRIOR**2, of_mass]
        self._states = np.zeros((1 + count, STATES))
        self._covariances = np.array([np.diag([*prior, 0.0]), *[np.diag([*prior[:3], 0.0, 0.0])] * count])
        self._chances = np.full(count, 1.0 / count)
        self._noise = np.array([self._filters.position_prior**2, self._speed_prior**2])
        self._count = float(PRIOR_SAMPLES)
        self._before = np.zeros(2)
        self._runs = self.stands = False
        self._state, self._mean = [0.0] * STATES, np.zeros(STATES)
        drift = [self._waves, GRADE_CHANGE**2 * self._period, 0.0 if self._waves else MASS_DRIFT**2 * self._period, 0.0]
        self._drifts = np.array([drift] + [[self._waves, 0.0, 0.0, 0.0]] * count)
        self.mass_known = 0.0

    def set_simulated(self, waves: float) -> None:
        """Restart without a disturbance to estimate, for the deviation of a train from its simulation.

        Parameters
        ----------
        waves
            Standard deviation of the speed of a unit against its train beyond the simulated waves [m/s].
        """
        still = np.zeros_like(self._filters.walks)
        self._filters = replace(self._filters, walks=still, rates=still)
        if self._wave_time > 0.0:
            self._waves = 2.0 * waves**2 / self._wave_time * self._period
        self.reset()
        self._covariances[:, 2, 2] = self._drifts[0, 1] = 0.0

    @property
    def position_error(self) -> float:
        """Estimate of the position error [m]."""
        return self._state[0]

    @property
    def speed_error(self) -> float:
        """Estimate of the speed error [m/s]."""
        return self._state[1]

    @property
    def disturbance(self) -> float:
        """Estimate of the disturbance [m/s²]."""
        return self._state[2]

    @property
    def mass_error(self) -> float:
        """Estimate of theta."""
        return self._state[3]

    @property
    def disturbance_rate(self) -> float:
        """Estimate of the rate of the disturbance [m/s³]; 0 for a train with couplers."""
        return self._state[4]

    @property
    def speed_noise(self) -> float:
        """Estimate of the standard deviation of the measured speed [m/s]."""
        return math.sqrt(self._noise[1])

    def restart(self, position: float, speed: float) -> None:
        """Take a sample as position and speed error [m, m/s]; disturbance and error of the mass are held."""
        self._states[:, 4] = self._state[4] = 0.0
        self._states[:, 0], self._states[:, 1] = position, speed
        self._state[:2] = [position, speed]
        self._before[:] = 0.0
        self._runs, self.stands = True, False

    def stand(self, position: float, speed: float, place: float, reference: float) -> None:
        """Take a sample at standstill; a speed inside the noise is 0, and changes of the measurements are noise.

        Parameters
        ----------
        position
            Measured position error [m].
        speed, place
            Measured speed and position of the train [m/s, m].
        reference
            Speed of the reference [m/s].
        """
        self._count = min(self._count + 1.0, max(self._samples, 1.0))
        if self.stands:
            match(self._noise, self._before, 1.0 / self._count, place, speed, self._filters.position_floor)
        self.restart(position, (speed if abs(speed) > 3.0 * self.speed_noise else 0.0) - reference)
        self._before[:] = place, speed
        self.stands = True

    def miss(self) -> None:
        """Restart at the next sample with the present disturbance."""
        self._runs = False

    def step(
        self, position: float, speed: float, pull: float, regressor: float = 0.0, force_change: float = 0.0
    ) -> None:
        """Advance by a period and correct by a measurement.

        Parameters
        ----------
        position, speed
            Measured errors [m, m/s].
        pull
            Mean modelled acceleration over the period minus that of the reference [m/s²].
        regressor
            x, mean acceleration that grows with 1/mass [m/s²].
        force_change
            Change of the measured force over the mass in the period [m/s²]. Its time in the period is not known.
        """
        if not self._runs:
            self.restart(position, speed)
            return
        if self.stands:
            self._before[:], self.stands = 0.0, False
        self._count = min(self._count + 1.0, max(self._samples, 1.0))
        variance = min(float(self._noise[1]), SPEED_FLOOR**2)
        self._drifts[:, 0] = self._waves + (force_change * self._period) ** 2 / 12.0
        walks = self._filters.walks
        self._drifts[1:, 1] = walks * (walks * (variance * self._period**2) + self._waves)
        self._drifts[1:, 3] = self._filters.rates * (variance * self._period**2)
        filter_step(
            self._states, self._covariances, self._chances, self._noise, self._before, self._drifts,
            self._filters.chain, self._period, 1.0 / self._count, position, speed, pull, regressor, self._mean,
            self._filters.position_floor,
        )  # fmt: skip
        self._state = self._mean.tolist()
        self.mass_known = max(0.0, 1.0 - float(self._covariances[0, 3, 3]) / MASS_PRIOR**2)
