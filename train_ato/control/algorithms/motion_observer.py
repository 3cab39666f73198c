"""Kalman filter of position error, speed error and disturbance of a train as one mass, with measured noise.

    e_p' = e_v,   e_v' = (F - W)/M - v_d' + d,   d' = white noise of PSD omega_o⁴ sigma² Tc

F is the measured force, W the resistance of the model. The PSD of d' gives the bandwidth omega_o at the smallest noise
sigma (``SPEED_FLOOR``) of the speed; more noise lowers it. The variance of the noise is the mean of half the squared
difference of consecutive innovations over ``NOISE_TIME``: slow errors of the model do not count as noise (covariance
matching, Mehra 1972, IEEE Transactions on Automatic Control 17).
"""

# mypy: allow-untyped-defs

from __future__ import annotations

import math

import numpy as np

from plant_sim.compiled import compiled

SPEED_FLOOR = 0.01
"""Smallest standard deviation of the speed [m/s]; resolution of a wheel sensor."""
POSITION_FLOOR = 0.005
"""Smallest standard deviation of the position [m]."""
NOISE_TIME = 20.0
"""Time over which the noise is averaged [s]."""
SPEED_PRIOR, POSITION_PRIOR, PRIOR_SAMPLES = 0.05, 0.05, 20
"""Standard deviations at the start [m/s, m], and the number of samples that they count for."""
MAX_NOISE = 1.0
"""Largest standard deviation [m, m/s]."""


@compiled
def filter_step(state, covariance, noise, before, drifts, period, weight, position, speed, pull):
    """Advance the filter by a period and correct it.

    Parameters
    ----------
    state : Array, shape (3,)
        Position error [m], speed error [m/s], disturbance [m/s²].
    covariance : Array, shape (3, 3)
        Covariance of the state.
    noise : Array, shape (2,)
        Variances of the measurements.
    before : Array, shape (2,)
        Last innovations.
    drifts : Array, shape (2,)
        Variance of the change of speed and of disturbance in a period that the model does not explain.
    period, weight
        Period [s] and weight of the newest sample in the noise.
    position, speed, pull
        Measured errors [m, m/s], modelled relative acceleration [m/s²].
    """
    total = pull + state[2]
    state[0] += (state[1] + 0.5 * total * period) * period
    state[1] += total * period
    p, h = covariance, period
    for j in range(3):
        p[0, j] += h * p[1, j] + 0.5 * h * h * p[2, j]
        p[1, j] += h * p[2, j]
    for i in range(3):
        p[i, 0] += h * p[i, 1] + 0.5 * h * h * p[i, 2]
        p[i, 1] += h * p[i, 2]
    p[1, 1] += drifts[0]
    p[2, 2] += drifts[1]
    miss_position, miss_speed = position - state[0], speed - state[1]
    _match(noise, before, weight, miss_position, miss_speed)
    a = p[0, 0] + noise[0]
    b = p[0, 1]
    c = p[1, 1] + noise[1]
    size = a * c - b * b
    row0, row1 = p[0].copy(), p[1].copy()
    for i in range(3):
        first = (p[i, 0] * c - p[i, 1] * b) / size
        second = (p[i, 1] * a - p[i, 0] * b) / size
        state[i] += first * miss_position + second * miss_speed
        for j in range(3):
            p[i, j] -= first * row0[j] + second * row1[j]
    for i in range(3):
        for j in range(i):
            p[i, j] = p[j, i]


@compiled
def _match(noise, before, weight, miss_position, miss_speed):
    """Add a pair of innovations to the variances of the noise."""
    for i in range(2):
        miss = miss_position if i == 0 else miss_speed
        floor = POSITION_FLOOR if i == 0 else SPEED_FLOOR
        change = miss - before[i]
        found = noise[i] + weight * (0.5 * change * change - noise[i])
        noise[i] = min(max(found, floor * floor), MAX_NOISE * MAX_NOISE)
        before[i] = miss


class MotionObserver:
    """Position error [m], speed error [m/s] and disturbance [m/s²] of a train.

    Parameters
    ----------
    period
        Control period [s].
    bandwidth
        omega_o, bandwidth of the disturbance at the smallest noise [rad/s].
    waves
        Bandwidth with which the speed follows the measurement, for motion that one mass does not have [rad/s].
    """

    def __init__(self, period: float, bandwidth: float, waves: float) -> None:
        self._drifts = np.array([(waves * SPEED_FLOOR * period) ** 2, (bandwidth**2 * SPEED_FLOOR * period) ** 2])
        self._period = period
        self._samples = NOISE_TIME / period
        self.reset()

    def reset(self) -> None:
        """Restart at the next sample without a disturbance and with the prior noise."""
        self._state = np.zeros(3)
        self._covariance = np.diag([POSITION_PRIOR**2, SPEED_PRIOR**2, 1e-4])
        self._noise = np.array([POSITION_PRIOR**2, SPEED_PRIOR**2])
        self._count = float(PRIOR_SAMPLES)
        self._before = np.zeros(2)
        self._runs = False

    @property
    def position_error(self) -> float:
        """Estimate of the position error [m]."""
        return float(self._state[0])

    @property
    def speed_error(self) -> float:
        """Estimate of the speed error [m/s]."""
        return float(self._state[1])

    @property
    def disturbance(self) -> float:
        """Estimate of the disturbance [m/s²]."""
        return float(self._state[2])

    @property
    def speed_noise(self) -> float:
        """Estimate of the standard deviation of the measured speed [m/s]."""
        return math.sqrt(self._noise[1])

    def restart(self, position: float, speed: float) -> None:
        """Take a sample as position and speed error [m, m/s]; the disturbance is held."""
        self._state[0], self._state[1] = position, speed
        self._before[:] = 0.0
        self._runs = True

    def miss(self) -> None:
        """Restart at the next sample with the present disturbance."""
        self._runs = False

    def step(self, position: float, speed: float, pull: float) -> None:
        """Advance by a period and correct by a measurement.

        Parameters
        ----------
        position, speed
            Measured errors [m, m/s].
        pull
            Mean modelled acceleration over the period minus that of the reference [m/s²].
        """
        if not self._runs:
            self.restart(position, speed)
            return
        self._count = min(self._count + 1.0, max(self._samples, 1.0))
        filter_step(
            self._state, self._covariance, self._noise, self._before, self._drifts, self._period, 1.0 / self._count,
            position, speed, pull,
        )  # fmt: skip
