"""Series that paper 000 shows and no topic carries: what the network estimates, and what it should."""

from __future__ import annotations

import numpy as np

from train_ato.control.laws.rbf_smc import RbfSmcParameters
from train_ato.control.parts.rbf import CENTRES, Weights, bells
from train_ato.control.parts.sliding import IntegralSurface
from train_ato.history import History
from train_ato.types import Array

__all__ = ["LOCOMOTIVE", "disturbance_40", "network_estimate", "speed_error", "unexplained"]

LOCOMOTIVE = 184e3
"""Mass of vehicle 0 [kg]."""


def speed_error(history: History) -> Array:
    """Return v - v_d of the locomotive [km/h], shape (k,)."""
    return np.asarray(3.6 * (history.front_velocity - history.reference_velocity))


def network_estimate(history: History, parameters: RbfSmcParameters, period: float) -> Array:
    """Return delta_hat of a run of `rbf_smc` [m/s²], shape (k,): its network fed with the errors it had.

    The parts are the law's own (surface, bells, weights), so that the series is the one it used, as long as the force
    was not at a limit.
    """
    surface = IntegralSurface(parameters.l1, parameters.l2, period, parameters.integral_limit)
    weights = Weights([0.0] * len(CENTRES), parameters.weight_limit)
    centres = [parameters.spread * centre for centre in CENTRES]
    errors = (history.front_position - history.reference_position).tolist()
    rates = (history.front_velocity - history.reference_velocity).tolist()
    found = []
    for off, rate_off in zip(errors, rates, strict=True):
        error, rate = off, rate_off
        s = surface.step(error, rate, False)
        if parameters.clip:
            reach = parameters.spread
            error, rate = min(max(error, -reach), reach), min(max(rate, -reach), reach)
        hidden = bells((error, rate), centres, parameters.width)
        found.append(weights.output(hidden))
        weights.learn(parameters.gamma * s * period, hidden)
    return np.array(found)


def disturbance_40(history: History, period: float) -> Array:
    """Return sigma_0/m_0 of (40), first power of the speed, in the middle of every tick [m/s²], shape (k,)."""
    t, v = history.time + 0.5 * period, history.front_velocity
    return np.asarray(0.002 + 0.001 * np.sin(t + 1) + 0.0003 * v * (np.sin(2 * t + 2) + np.cos(3 * t + 1)))


def unexplained(history: History, period: float, model_error: float, disturbance: Array | None = None) -> Array:
    """Return what f_hat does not explain of the locomotive's motion [m/s²], shape (k,), the last entry repeated.

    From the motion itself: f = v' - u/m_0 - sigma_0/m_0 over every tick (ideal actuator: the command is what acts),
    delta = f - f/(1 + model_error), to which the disturbance is added if there is one.
    """
    outside = np.zeros(history.time.size) if disturbance is None else disturbance
    acceleration = np.diff(history.front_velocity) / period
    f = acceleration - history.command[:-1, 0] / LOCOMOTIVE - outside[:-1]
    result = f * model_error / (1.0 + model_error) + outside[:-1]
    return np.append(result, result[-1])
