"""Series of paper 000 beyond the topics: estimate of the network and true model error."""

from __future__ import annotations

import numpy as np

from train_ato.control.algorithms.rbf import RBF_CENTERS, Weights, activations
from train_ato.control.algorithms.sliding import IntegralSurface
from train_ato.control.laws.rbf_smc import RbfSmcParameters
from train_ato.loop.recording import Recording
from train_ato.messages.types import Array

LOCOMOTIVE = 184e3
"""Mass of vehicle 0, m_0 [kg]."""
TRAIN = 10_684e3
"""Mass of the train, M [kg]."""
TRACTION = 760e3
"""Largest force of traction [N]."""


def locomotive_speed_error(recording: Recording) -> Array:
    """Return v - v_d of the locomotive [km/h], shape (k,)."""
    return np.asarray(3.6 * (recording.front_velocity - recording.reference_velocity))


def network_estimate(recording: Recording, parameters: RbfSmcParameters, period: float) -> Array:
    """Return delta_hat of a run of `rbf_smc` [m/s²], shape (k,), from its recorded errors.

    Surface, basis functions and weights are those of the law, so the series is exact while the force is not saturated.
    """
    surface = IntegralSurface(parameters.l1, parameters.l2, period, parameters.integral_limit)
    weights = Weights([0.0] * len(RBF_CENTERS), parameters.weight_limit)
    centres = [parameters.spread * centre for centre in RBF_CENTERS]
    errors = (recording.front_position - recording.reference_position).tolist()
    rates = (recording.front_velocity - recording.reference_velocity).tolist()
    found = []
    for off, rate_off in zip(errors, rates, strict=True):
        error, rate = off, rate_off
        s = surface.step(error, rate, False)
        if parameters.clip:
            reach = parameters.spread
            error, rate = min(max(error, -reach), reach), min(max(rate, -reach), reach)
        hidden = activations((error, rate), centres, parameters.width)
        found.append(weights.output(hidden))
        weights.learn(parameters.gamma * s * period, hidden)
    return np.array(found)


def disturbance_40(recording: Recording, period: float) -> Array:
    """Return sigma_0/m_0 of (40), first power of the speed, at the middle of every tick [m/s²], shape (k,)."""
    t, v = recording.time + 0.5 * period, recording.front_velocity
    return np.asarray(0.002 + 0.001 * np.sin(t + 1) + 0.0003 * v * (np.sin(2 * t + 2) + np.cos(3 * t + 1)))


def unexplained(recording: Recording, period: float, model_error: float, disturbance: Array | None = None) -> Array:
    """Return the acceleration of the locomotive beyond f_hat [m/s²], shape (k,), last entry repeated.

    From the motion: f = v' - u/m_0 - sigma_0/m_0 over every tick (ideal actuator: applied force = command),
    delta = f - f/(1 + model_error), plus the disturbance if any.
    """
    outside = np.zeros(recording.time.size) if disturbance is None else disturbance
    acceleration = np.diff(recording.front_velocity) / period
    f = acceleration - recording.command[:-1, 0] / LOCOMOTIVE - outside[:-1]
    result = f * model_error / (1.0 + model_error) + outside[:-1]
    return np.append(result, result[-1])
