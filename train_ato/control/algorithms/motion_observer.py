"""Steady Kalman filter of position error, speed error and disturbance of a train as one mass.

    e_p' = e_v,   e_v' = (F - W)/M - v_d' + d,   d' = white noise

F is the measured force, W the resistance of the model. The noise of d is the one with which the filter of a noisy
speed alone has the bandwidth omega_o: PSD omega_o⁴ sigma_v² Tc.
"""

from __future__ import annotations

import numpy as np

from plant_sim.compiled import compiled
from train_ato.messages.types import Array

ITERATIONS = 4000
"""Steps of the Riccati recursion; the slowest filter settles within 1 000."""


@compiled
def filter_gain(period: float, position_noise: float, speed_noise: float, disturbance_noise: float) -> Array:
    """Return the gain of the steady Kalman filter, shape (3, 2).

    Parameters
    ----------
    period
        Control period [s].
    position_noise, speed_noise
        Standard deviations of the measurements [m, m/s].
    disturbance_noise
        Standard deviation of the change of the disturbance in a period [m/s²].
    """
    p = np.zeros((3, 3))
    p[0, 0], p[1, 1], p[2, 2] = position_noise**2, speed_noise**2, 1e-4
    f = np.array([[1.0, period, 0.5 * period * period], [0.0, 1.0, period], [0.0, 0.0, 1.0]])
    gain, moved, ahead = np.zeros((3, 2)), np.zeros((3, 3)), np.zeros((3, 3))
    for _ in range(ITERATIONS):
        for i in range(3):
            for j in range(3):
                moved[i, j] = f[i, 0] * p[0, j] + f[i, 1] * p[1, j] + f[i, 2] * p[2, j]
        for i in range(3):
            for j in range(3):
                ahead[i, j] = moved[i, 0] * f[j, 0] + moved[i, 1] * f[j, 1] + moved[i, 2] * f[j, 2]
        ahead[2, 2] += disturbance_noise**2
        a, b, c = ahead[0, 0] + position_noise**2, ahead[0, 1], ahead[1, 1] + speed_noise**2
        size = a * c - b * b
        for i in range(3):
            gain[i, 0] = (ahead[i, 0] * c - ahead[i, 1] * b) / size
            gain[i, 1] = (ahead[i, 1] * a - ahead[i, 0] * b) / size
        for i in range(3):
            for j in range(3):
                p[i, j] = ahead[i, j] - gain[i, 0] * ahead[0, j] - gain[i, 1] * ahead[1, j]
    return gain


class MotionObserver:
    """Position error [m], speed error [m/s] and disturbance [m/s²] of a train.

    Parameters
    ----------
    period
        Control period [s].
    bandwidth
        omega_o [rad/s].
    position_noise, speed_noise
        Standard deviations of the measurements [m, m/s].
    """

    def __init__(self, period: float, bandwidth: float, position_noise: float, speed_noise: float) -> None:
        drift = bandwidth**2 * speed_noise * period
        self._gain = filter_gain(period, position_noise, speed_noise, drift).tolist()
        self._period = period
        self.reset()

    def reset(self) -> None:
        """Restart at the next sample without a disturbance."""
        self.state: list[float] | None = None
        self.disturbance = 0.0
        self.innovation = 0.0

    def restart(self, position: float, speed: float) -> None:
        """Take a sample as state; the disturbance is held."""
        self.state = [position, speed]
        self.innovation = 0.0

    def miss(self) -> None:
        """Restart at the next sample with the present disturbance."""
        self.state = None

    def step(self, position: float, speed: float, pull: float) -> None:
        """Advance by a period and correct by a measurement.

        Parameters
        ----------
        position, speed
            Measured errors [m, m/s].
        pull
            Mean modelled acceleration over the period minus that of the reference [m/s²].
        """
        if self.state is None:
            self.restart(position, speed)
            return
        h = self._period
        total = pull + self.disturbance
        ahead_position = self.state[0] + (self.state[1] + 0.5 * total * h) * h
        ahead_speed = self.state[1] + total * h
        miss_position, miss_speed = position - ahead_position, speed - ahead_speed
        g = self._gain
        self.state = [
            ahead_position + g[0][0] * miss_position + g[0][1] * miss_speed,
            ahead_speed + g[1][0] * miss_position + g[1][1] * miss_speed,
        ]
        self.disturbance += g[2][0] * miss_position + g[2][1] * miss_speed
        self.innovation = miss_speed
