"""Kalman filter of the errors of a train against its simulated copy: mass, running resistance, air brake, draft gears.

The copy follows the reference with the force F_c. F is the measured force. theta are the errors of the model beyond
those that the copy already has. w is the speed error of the train as one mass::

    w' = (F - F_c)/M - (W(v) - W(v_d))/M - sum_k theta_k phi_k/M,   e_v = w + q + s theta_4 + noise
    phi = (M v_d' + W_line, W(v_d), F_shoes, dF)

q is the speed of the unit against its train: the waves in the couplers, which the copy does not have. It is bounded: a
Gauss-Markov process with the standard deviation ``UNIT_SPEED`` and the time ``UNIT_TIME``. If the waves were a random
walk of the speed, the same data would support only much smaller errors. One brake application would then not show an
error of the brake of 8 %. The speed of a disturbance is a random walk of ``DISTURBANCE`` in a second.

theta_4 is the wear of the draft gears (`ahead_train.py`). A second copy has more wear, and a slow force dF ties it to
the first copy. s is its speed against the first copy. Both are per unit of wear. The waves of the second copy are in s,
which hardly changes w. A copy that follows the reference exactly would have only dF. The filter would then take the
answer of the unit for the answer of the whole mass, and find about half of the wear. Where the slack of couplers runs
out there are shocks, which come at other times in the copy. An error of ``SHOCK_TIME`` of their time is noise of
``SHOCK_TIME`` s' times the prior wear. Without this noise the filter follows the fast changes of s and finds two thirds
of the wear.

The forces of the copy contain its waves, so that a train equal to its copy has theta = 0 through every stretch of the
couplers. A rigid balance of forces takes these for errors.
"""

# mypy: allow-untyped-defs

import math
from dataclasses import dataclass

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.record import quantity, zeros
from train_ato.messages.types import Array

UNIT_SPEED, UNIT_TIME = 0.025, 5.0
"""Standard deviation [m/s] and time [s] of the speed of a unit against its train."""
DISTURBANCE = 0.002
"""Standard deviation of the change of the speed by unknown forces in a second [m/s]."""
PRIOR = (0.05, 0.2, 0.1, 0.2)
"""Standard deviations at the start: relative errors of mass, running resistance, air brake; wear of the draft gears."""
BOUNDS = (0.25, 0.6, 0.5, 0.5)
"""Largest relative errors, and largest wear."""
SHOCK_TIME = 1.0
"""Standard deviation of the time at which the slack of a coupler runs out, train against copy [s]."""
WEAR = 3
"""Place of the wear of the draft gears among the errors."""
MIN_NOISE, FIRST_NOISE, MEAN_TIME = 0.002, 0.05, 20.0
"""Smallest and first standard deviation of the measured speed [m/s], and time over which it is averaged [s]."""
SLOWEST = 0.3
"""Speed of the reference from which on the errors are estimated [m/s]: before it the slack of the couplers runs out."""


@dataclass
class SpeedNoise:
    """Noise of the measured speed, and changes of the speeds in a period."""

    variance: float = quantity("m²/s²", "variance of the measured speed")
    miss: float = quantity("m/s", "last innovation")
    drift: float = quantity("m²/s²", "variance of the change of w in a period")
    unit_drift: float = quantity("m²/s²", "variance of the change of q in a period")
    decay: float = quantity("", "part of q that is left after a period")


@compiled
def identification_step(state, covariance, noises, period, pull, known, wave, shock, error):
    """Advance the filter by a period and correct it by the measured speed error.

    Parameters
    ----------
    state : Array, shape (6,)
        w, q [m/s] and theta.
    covariance : Array, shape (6, 6)
        Its covariance.
    noises : Records of SpeedNoise, shape (1,)
        Its noise.
    period
        s.
    pull
        Mean modelled acceleration [m/s²].
    known : Array, shape (4,)
        Mean phi/M [m/s²].
    wave
        Change of the speed of the unit by wear [m/s].
    shock
        Variance of the measured speed by the unknown time of a shock [m²/s²].
    error
        Measured speed error [m/s].
    """
    noise, size, errors = noises[0], state.size, known.size
    rows = covariance.copy()
    for j in range(size):
        for k in range(errors):
            rows[0, j] -= period * known[k] * covariance[2 + k, j]
        rows[1, j] = noise.decay * covariance[1, j]
    for i in range(size):
        first = rows[i, 0]
        for k in range(errors):
            first -= period * known[k] * rows[i, 2 + k]
        covariance[i, 0] = first
        covariance[i, 1] = noise.decay * rows[i, 1]
        for k in range(errors):
            covariance[i, 2 + k] = rows[i, 2 + k]
    covariance[0, 0] += noise.drift
    covariance[1, 1] += noise.unit_drift
    state[0] += period * pull
    for k in range(errors):
        state[0] -= period * known[k] * state[2 + k]
    state[1] *= noise.decay
    shared = covariance[0] + covariance[1] + wave * covariance[size - 1]
    spread = shared[0] + shared[1] + wave * shared[size - 1] + noise.variance + shock
    miss = error - state[0] - state[1] - wave * state[size - 1]
    for i in range(size):
        state[i] += shared[i] / spread * miss
        for j in range(size):
            covariance[i, j] -= shared[i] * shared[j] / spread
    change = miss - noise.miss
    noise.variance += period / MEAN_TIME * (0.5 * change * change - noise.variance)
    noise.variance = max(noise.variance, MIN_NOISE * MIN_NOISE)
    noise.miss = miss


class TrainIdentification:
    """Relative errors of mass, running resistance and air brake of the model of a train, and wear of its gears.

    Parameters
    ----------
    period
        Time between the measurements [s].
    """

    def __init__(self, period: float) -> None:
        self._period = period
        decay = math.exp(-period / UNIT_TIME)
        self._state = np.zeros(6)
        self._covariance = np.diag([1e-4, UNIT_SPEED**2, *(prior * prior for prior in PRIOR)])
        self._noise = zeros(SpeedNoise, 1)
        self._noise[0] = FIRST_NOISE**2, 0.0, DISTURBANCE**2 * period, UNIT_SPEED**2 * (1.0 - decay**2), decay
        self._before: tuple[float, Array, float] | None = None

    @property
    def errors(self) -> list[float]:
        """Relative errors of mass, running resistance and air brake, and wear of the draft gears."""
        found = zip(self._state[2:].tolist(), BOUNDS, strict=True)
        return [min(max(error, -bound), bound) for error, bound in found]

    def miss(self) -> None:
        """Restart the motion at the next sample; the errors are held."""
        self._before = None

    def step(self, speed_error: float, reference: float, pull: float, known: Array, wave: float) -> None:
        """Advance by a period and correct by a measurement.

        Parameters
        ----------
        speed_error
            Measured e_v plus the effect s of the wear that the copy has [m/s].
        reference
            Speed of the reference [m/s]; the errors are held below ``SLOWEST``.
        pull
            Acceleration of the train against the reference for theta = 0 [m/s²].
        known : Array, shape (4,)
            phi/M [m/s²].
        wave
            Change of the speed of the unit by wear s [m/s].
        """
        if reference < SLOWEST:
            self._before = None
            return
        if self._before is None:
            self._state[0], self._state[1] = speed_error, 0.0
        else:
            pull_before, known_before, wave_before = self._before
            shock = SHOCK_TIME * PRIOR[WEAR] * (wave - wave_before) / self._period
            identification_step(
                self._state, self._covariance, self._noise, self._period, 0.5 * (pull_before + pull),
                0.5 * (known_before + known), wave, shock * shock, speed_error,
            )  # fmt: skip
        self._before = (pull, known, wave)
