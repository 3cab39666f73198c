"""Series of paper 000 beyond the topics: estimate of the network and true model error."""

from __future__ import annotations

import numpy as np

from plant_sim.record import fill, zeros
from train_ato.control.law import LawNow, LawUnit
from train_ato.control.laws.rbf_smc import RbfSmc, RbfSmcConstants, RbfSmcParameters, RbfSmcUnit
from train_ato.loop.recording import Recording
from train_ato.messages.types import Array
from train_ato.messages.validity import MAX_FORCE

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
    p, state = zeros(RbfSmcConstants, 1), zeros(RbfSmcUnit, 1)
    now, units = zeros(LawNow, 1), zeros(LawUnit, 1)
    fill(p, parameters, period=period, measured=False, observer_decay=0.0)
    units["force_min"], units["force_max"] = -MAX_FORCE / 4, MAX_FORCE / 4
    found = []
    errors = recording.front_position - recording.reference_position
    rates = recording.front_velocity - recording.reference_velocity
    for units["position"], units["velocity"] in zip(errors, rates, strict=True):
        RbfSmc.form.step(p, state, now, units)
        found.append(float(state["found"][0]))
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
