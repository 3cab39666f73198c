"""Kalman filters of motion, disturbance, mass and noise of a train as one mass; `msgs_docs/mpc_derivation.md`."""

# mypy: allow-untyped-defs

import math
from dataclasses import dataclass, replace

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_exp
from plant_sim.record import quantity, zeros
from train_ato.messages.types import Array

SPEED_FLOOR = 0.01
"""Standard deviation of the speed up to which the bandwidth is that at the smallest noise [m/s]."""
NOISE_FLOOR = 0.002
"""Smallest standard deviation of the speed [m/s]."""
POSITION_FLOOR = 0.0002
"""Smallest standard deviation of the position [m]: the force changes at an unknown time of a tick."""
MAX_NOISE = 1.0
"""Largest standard deviation [m, m/s]."""
MAX_MASS_ERROR = 0.35
"""Largest error of the mass."""
STATES = 5
"""States of a filter."""
SHARES = (1.0, 0.25, 0.0625)
"""Bandwidths of the random walks over omega_o."""
STAY_TIME = 20.0
"""Mean time for which one of the random walks is right [s]."""
RATE_SHARE = 0.2
"""Bandwidth of the rate of the disturbance over omega_o."""
RAMP_TIME = 3.0
"""T_r, time constant of the rate of the disturbance [s]; 118 m of a metro train have 6 s at 20 m/s."""
GUST_TIME, CALM_TIME = 1.0, 20.0
"""Mean times for which the filter of a gust and that of a steady rate are right [s]."""
COUPLED_FLOOR, FREE_FLOOR = 0.5, 0.05
"""Smallest standard deviation of the position over that of the speed, up to that of ``SPEED_FLOOR`` [s]: 5 mm with
couplers, which move a unit in its train, and .5 mm without. More noise of the position is measured."""
COUPLED_PRIOR, FREE_PRIOR = 0.05, 0.0025
"""Standard deviation of the position at the start [m]; a larger one is measured within seconds. ``FREE_PRIOR`` has the
later ratio to that of the speed: with .05 m a fast filter takes an error of the speed of 2 mm/s for motion."""


@dataclass(frozen=True)
class DisturbanceFilters:
    """Filters of the disturbance.

    Attributes
    ----------
    walks : Array, shape (filters,)
        Squares of the bandwidths of the random walks [rad²/s²]; 0: the disturbance changes by its rate only.
    rates : Array, shape (filters,)
        Sixth powers of the bandwidths of the rates [rad⁶/s⁶]; 0: no rate.
    chain : Array, shape (filters, filters)
        Probability of a change in a period, from filter to filter.
    position_floor
        Smallest standard deviation of the position over that of the speed [s].
    position_prior
        Standard deviation of the position at the start [m].
    """

    walks: Array
    rates: Array
    chain: Array
    position_floor: float
    position_prior: float

    @classmethod
    def coupled(cls, period: float, bandwidth: float) -> "DisturbanceFilters":
        """Return random walks for a period [s] and a bandwidth omega_o [rad/s]."""
        count = len(SHARES)
        leave = min(0.5, period / STAY_TIME) / (count - 1)
        chain = np.full((count, count), leave)
        chain[np.arange(count), np.arange(count)] = 1.0 - leave * (count - 1)
        return cls((bandwidth * np.array(SHARES)) ** 2, np.zeros(count), chain, COUPLED_FLOOR, COUPLED_PRIOR)

    @classmethod
    def free(cls, period: float, bandwidth: float) -> "DisturbanceFilters":
        """Return the filters of a gust and of a steady rate for a period [s] and a bandwidth omega_o [rad/s]."""
        ends, begins = (min(0.5, period / time) for time in (GUST_TIME, CALM_TIME))
        chain = np.array([[1.0 - ends, ends], [begins, 1.0 - begins]])
        rates = np.full(2, (RATE_SHARE * bandwidth) ** 6)
        return cls(np.array([bandwidth**2, 0.0]), rates, chain, FREE_FLOOR, FREE_PRIOR)


def motion_by_rate(rate: float, later: float) -> tuple[float, float, float, float]:
    """Return position [m], speed [m/s], disturbance [m/s²] and rate [m/s³] after a time [s] by the rate now alone."""
    fade = math.exp(-later / RAMP_TIME)
    risen = RAMP_TIME * (1.0 - fade)
    speed = RAMP_TIME * (later - risen)
    position = RAMP_TIME * (0.5 * later * later - speed)
    return rate * position, rate * speed, rate * risen, rate * fade


@dataclass
class MotionNoise:
    """Variances of the measurements and of the changes in a period, and the last innovations."""

    position: float = quantity("m²", "variance of the measured position")
    speed: float = quantity("m²/s²", "variance of the measured speed")
    position_miss: float = quantity("m", "last innovation of the position")
    speed_miss: float = quantity("m/s", "last innovation of the speed")
    jolt: float = quantity("m²/s²", "variance of the change of the speed in a period")
    waves: float = quantity("m²/s²", "its part by waves")
    sampled: float = quantity("m²", "variance of the measured speed over a period")


@compiled
def mix(states, covariances, chances, chain):
    """Mix states and covariances of the filters for a change from one to another; return nothing.

    The states are position error [m], speed error [m/s], disturbance [m/s²], and others; here error of the mass and
    rate of the disturbance [m/s³]. ``chances`` receives the probabilities of the filters before the next measurement.
    ``chain`` is the probability of a change in a period, from filter to filter.
    """
    count, size = states.shape
    former_states, former, before = states.copy(), covariances.copy(), chances.copy()
    for j in range(count):
        total = 0.0
        for i in range(count):
            total += before[i] * chain[i, j]
        chances[j] = total
        for a in range(size):
            states[j, a] = 0.0
            for i in range(count):
                weight = before[i] * chain[i, j] / total
                states[j, a] += weight * former_states[i, a]
        covariances[j] = 0.0
        for i in range(count):
            weight = before[i] * chain[i, j] / total
            for a in range(size):
                for b in range(size):
                    spread = (former_states[i, a] - states[j, a]) * (former_states[i, b] - states[j, b])
                    covariances[j, a, b] += weight * (former[i, a, b] + spread)


@compiled
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
    a, b, c = p[0, 0] + noise.position, p[0, 1], p[1, 1] + noise.speed
    size = a * c - b * b
    row0, row1 = p[0].copy(), p[1].copy()
    for i in range(state.size):
        first = (row0[i] * c - row1[i] * b) / size
        second = (row1[i] * a - row0[i] * b) / size
        state[i] += first * miss_position + second * miss_speed
        for j in range(state.size):
            p[i, j] -= first * row0[j] + second * row1[j]
    for i in range(state.size):
        for j in range(i):
            p[i, j] = p[j, i]
    squared = (c * miss_position - 2.0 * b * miss_speed) * miss_position + a * miss_speed * miss_speed
    return 0.5 * squared / size, math.sqrt(size)


@compiled
def weigh(states, chances, exponents, roots, mean):
    """Multiply the probabilities by the likelihoods of the innovations; ``mean`` receives the mean of the states."""
    least = 1e300
    for j in range(chances.size):
        least = min(least, exponents[j])
    total = 0.0
    for j in range(chances.size):
        chances[j] *= libm_exp(max(least - exponents[j], -100.0)) / roots[j]
        total += chances[j]
    mean[:] = 0.0
    for j in range(chances.size):
        chances[j] /= total
        for a in range(mean.size):
            mean[a] += chances[j] * states[j, a]


@compiled
def disturbance_drift(walk, noise):
    """Return the variance of the change of the disturbance in a period [m²/s⁴].

    ``walk`` is the square of the bandwidth of the random walk [rad²/s²].
    """
    return walk * (walk * noise.sampled + noise.waves)


@compiled
def filter_step(
    states, covariances, chances, noises, drifts, chain, period, weight, position, speed, pull, regressor, mean,
    floor_ratio, walks, rates,
):  # fmt: skip
    """Advance all filters by a period [s] and correct them.

    ``states`` and ``covariances`` are as in :func:`mix`, before them those of the filter of the mass. ``noises`` is one
    record of :class:`MotionNoise`, ``weight`` that of the newest sample in the noise, ``floor_ratio`` the smallest
    standard deviation of the position over that of the speed [s]. ``drifts``, shape (1 + filters, 4), are variances of
    the change of speed, disturbance, error of the mass and rate in a period: only those of the filter of the mass but
    the first are an input. ``walks`` and ``rates`` are those of :class:`DisturbanceFilters`. ``position`` and ``speed``
    are the measured errors [m, m/s], ``pull`` and ``regressor`` the modelled relative acceleration and x [m/s²];
    ``mean``, shape (5,), is the result.
    """
    noise = noises[0]
    mix(states[1:], covariances[1:], chances, chain)
    count = chances.size
    drifts[:, 0] = noise.jolt
    for j in range(count):
        drifts[1 + j, 1] = disturbance_drift(walks[j], noise)
        drifts[1 + j, 3] = rates[j] * noise.sampled
    predict_motion(states[0], covariances[0], drifts[0], period, pull, regressor)
    correct(states[0], covariances[0], noise, position - states[0, 0], speed - states[0, 1])
    states[0, 3] = min(max(states[0, 3], -MAX_MASS_ERROR), MAX_MASS_ERROR)
    states[1:, 3] = states[0, 3]
    exponents, roots = np.empty(count), np.empty(count)
    mean_position, mean_speed = 0.0, 0.0
    for j in range(count):
        state, covariance = states[1 + j], covariances[1 + j]
        predict_motion(state, covariance, drifts[1 + j], period, pull, regressor)
        miss_position, miss_speed = position - state[0], speed - state[1]
        mean_position += chances[j] * miss_position
        mean_speed += chances[j] * miss_speed
        exponents[j], roots[j] = correct(state, covariance, noise, miss_position, miss_speed)
    weigh(states[1:], chances, exponents, roots, mean)
    match(noises, weight, mean_position, mean_speed, floor_ratio)


@compiled
def match(noises, weight, miss_position, miss_speed, floor_ratio):
    """Add a pair of innovations [m, m/s] to the variances of the noise."""
    noise = noises[0]
    noise.speed = _averaged(noise.speed, miss_speed - noise.speed_miss, weight, NOISE_FLOOR)
    floor = max(floor_ratio * min(math.sqrt(noise.speed), SPEED_FLOOR), POSITION_FLOOR)
    noise.position = _averaged(noise.position, miss_position - noise.position_miss, weight, floor)
    noise.position_miss, noise.speed_miss = miss_position, miss_speed


@compiled
def _averaged(variance, change, weight, floor):
    """Return the variance of a measurement with the change of its innovation, not below that of a floor."""
    found = variance + weight * (0.5 * change * change - variance)
    return min(max(found, floor * floor), MAX_NOISE * MAX_NOISE)


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

    Attributes
    ----------
    position_error, speed_error, disturbance, mass_error, disturbance_rate : float
        Estimates: m, m/s, m/s², theta, and m/s³, which is 0 for a train with couplers.
    resolution : float
        Smallest step of the measured position, as far as it is seen [m]; its error is uniform.
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
        self._noise = zeros(MotionNoise, 1)
        self._noise["position"], self._noise["speed"] = self._filters.position_prior**2, self._speed_prior**2
        self._count = float(PRIOR_SAMPLES)
        self.resolution = 0.0
        self._runs = self.stands = False
        self._mean = np.zeros(STATES)
        self.position_error = self.speed_error = self.disturbance = self.mass_error = self.disturbance_rate = 0.0
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
    def speed_noise(self) -> float:
        """Estimate of the standard deviation of the measured speed [m/s]."""
        return math.sqrt(self._noise["speed"][0])

    def restart(self, position: float, speed: float, force: float = 0.0) -> None:
        """Take a sample as position and speed error [m, m/s]; disturbance and error of the mass are held.

        The force [N] stretches a train with modes of the couplers.
        """
        self._states[:, 4] = self.disturbance_rate = 0.0
        self._states[:, 0], self._states[:, 1] = position, speed
        self.position_error, self.speed_error = position, speed
        self._noise["position_miss"] = self._noise["speed_miss"] = 0.0
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
            match(self._noise, 1.0 / self._count, place, speed, self._filters.position_floor)
        still = not moving and abs(speed) <= 3.0 * self.speed_noise
        self.restart(position, (0.0 if still else speed) - reference, force)
        if not self._waves:  # hauled vehicles do not depart with the unit
            self._covariances[:, :2] = self._covariances[:, :, :2] = 0.0
            self._covariances[:, 0, 0] = self._noise["position"][0]
            self._covariances[:, 1, 1] = 0.0 if still else self._noise["speed"][0]
        self._noise["position_miss"], self._noise["speed_miss"] = place, speed
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
            self._noise["position_miss"] = self._noise["speed_miss"] = 0.0
            self.stands = False
        self._count = min(self._count + 1.0, max(self._samples, 1.0))
        noise = self._noise
        noise["position"] = max(noise["position"][0], min(self.resolution**2 / 12.0, MAX_NOISE**2))
        noise["sampled"] = min(noise["speed"][0], SPEED_FLOOR**2) * self._period**2
        noise["jolt"], noise["waves"] = self._waves + (force_change * self._period) ** 2 / 12.0, self._waves
        self._filter(position, speed, pull, regressor, force)

    def _filter(self, position: float, speed: float, pull: float, regressor: float, force: float) -> None:
        """Advance and correct the filters; arguments as in :meth:`step`."""
        filters = self._filters
        filter_step(
            self._states, self._covariances, self._chances, self._noise, self._drifts, filters.chain, self._period,
            1.0 / self._count, position, speed, pull, regressor, self._mean, filters.position_floor, filters.walks,
            filters.rates,
        )  # fmt: skip
        self.position_error, self.speed_error, self.disturbance, self.mass_error, self.disturbance_rate = (
            self._mean.tolist()
        )
        self.mass_known = max(0.0, 1.0 - float(self._covariances[0, 3, 3]) / MASS_PRIOR**2)
