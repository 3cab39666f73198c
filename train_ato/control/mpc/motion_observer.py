"""Kalman filters of motion, disturbance, mass and noise of a train as one mass; `msgs_docs/mpc_derivation.md`."""

import math
from dataclasses import replace

import numpy as np

from train_ato.control.mpc.motion_filters import (
    NOISE_FLOOR,
    SPEED_FLOOR,
    STATES,
    DisturbanceFilters,
    filter_step,
    match,
)

NOISE_TIME = 20.0
"""Time over which the noise is averaged [s]."""
SPEED_PRIOR, PRIOR_SAMPLES = 0.05, 2
"""Standard deviation of the speed at the start [m/s], and the number of samples that the priors count for."""
DISTURBANCE_PRIOR, MASS_PRIOR = 0.01, 0.1
"""Standard deviations of disturbance [m/s²] and error of the mass at the start."""
MASS_DRIFT = 1e-4
"""Standard deviation of the change of the error of the mass in a second."""
GRADE_CHANGE = 0.02
"""Standard deviation of the change of an unknown grade in a second [m/s²]."""
WAVE_SPEED = 0.1
"""Standard deviation of the speed of a unit against its train with hauled vehicles [m/s]."""


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
        self, period: float, bandwidth: float, wave_time: float, *, coupled: bool = True,
        speed_noise: float = SPEED_PRIOR,
    ) -> None:  # fmt: skip
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

        ``waves`` is the standard deviation of the speed of a unit against its train beyond the simulated waves [m/s].
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

    def restart(self, position: float, speed: float, force: float = 0.0) -> None:
        """Take a sample as position and speed error [m, m/s]; disturbance and error of the mass are held.

        The force [N] stretches a train with modes of the couplers.
        """
        self._states[:, 4] = self._state[4] = 0.0
        self._states[:, 0], self._states[:, 1] = position, speed
        self._state[:2] = [position, speed]
        self._before[:] = 0.0
        self._runs, self.stands = True, False

    def stand(
        self, position: float, speed: float, place: float, reference: float, *, moving: bool = False, force: float = 0.0
    ) -> None:
        """Take a sample at standstill; a speed inside the noise is 0, and changes of the measurements are noise.

        The speed is then exact, and the position has the noise of its sample: a motion begins with these variances.
        ``position`` is the measured position error [m], ``speed`` and ``place`` are those of the train [m/s, m],
        ``reference`` is the speed of the reference [m/s]. A sample with ``moving`` is the first one of a train in
        motion: no speed is inside the noise. ``force`` is the total force that stretches the train [N].
        """
        self._count = min(self._count + 1.0, max(self._samples, 1.0))
        if self.stands:
            match(self._noise, self._before, 1.0 / self._count, place, speed, self._filters.position_floor)
        still = not moving and abs(speed) <= 3.0 * self.speed_noise
        self.restart(position, (0.0 if still else speed) - reference, force)
        if not self._waves:  # hauled vehicles do not depart with the unit
            self._covariances[:, :2] = self._covariances[:, :, :2] = 0.0
            self._covariances[:, 0, 0] = self._noise[0]
            self._covariances[:, 1, 1] = 0.0 if still else self._noise[1]
        self._before[:] = place, speed
        self.stands = True

    def miss(self) -> None:
        """Restart at the next sample with the present disturbance."""
        self._runs = False

    def step(
        self, position: float, speed: float, pull: float, regressor: float = 0.0, force_change: float = 0.0,
        force: float = 0.0,
    ) -> None:  # fmt: skip
        """Advance by a period and correct by a measurement of the errors of position and speed [m, m/s].

        ``pull`` is the mean modelled acceleration over the period minus that of the reference, ``regressor`` x, the
        mean acceleration that grows with 1/mass [m/s²]. ``force_change`` is the change of the measured force over the
        mass in the period [m/s²], at an unknown time. ``force`` is the mean total force of the units [N], for modes of
        the couplers.
        """
        if not self._runs:
            self.restart(position, speed)
            return
        if self.stands:
            self._before[:], self.stands = 0.0, False
        self._count = min(self._count + 1.0, max(self._samples, 1.0))
        variance = min(float(self._noise[1]), SPEED_FLOOR**2) * self._period**2
        jolt = self._waves + (force_change * self._period) ** 2 / 12.0
        self._filter(position, speed, pull, regressor, force, (jolt, self._waves, variance))

    def _filter(
        self, position: float, speed: float, pull: float, regressor: float, force: float,
        changes: tuple[float, float, float],
    ) -> None:  # fmt: skip
        """Advance and correct the filters; arguments as in :meth:`step`, ``changes`` as in `disturbance_drift`."""
        filters = self._filters
        filter_step(
            self._states, self._covariances, self._chances, self._noise, self._before, self._drifts, filters.chain,
            self._period, 1.0 / self._count, position, speed, pull, regressor, self._mean, filters.position_floor,
            changes, filters.walks, filters.rates,
        )  # fmt: skip
        self._state = self._mean.tolist()
        self.mass_known = max(0.0, 1.0 - float(self._covariances[0, 3, 3]) / MASS_PRIOR**2)
