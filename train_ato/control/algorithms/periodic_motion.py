"""Periodic motion of coupled units under a line of the disturbance, with the smallest weighted motion and force rate.

A disturbance b e^(i w t) [m/s²] on every unit, a command u e^(i w t) over the mass and the motion x e^(i w t), all with
complex amplitudes::

    Z x = b + u/(1 + i w Ta),   Z = -w² - S - i w D

with the springs S and dampers D of the couplers over the masses. The delay is no part of it: the command is sent
earlier by the delay, exactly for a steady line. The cost in the mean over a period is that of `unit_deviations.py`::

    |x|²/POSITION² + |F_c|²/COUPLER² + |w u|²/RATE²

with the coupler forces F_c. With u = (1 + i w Ta) (Z x - b) it is a least-squares problem in x::

    (Q + g Z*Z) x = g Z* b,   g = w² (1 + w² Ta²)/RATE²

Z has no inverse at an undamped mode of the couplers; the matrix of this equation always has one. A motion x that is
large beside b is not robust: with another mass of the train it appears in the estimate of b. The weights of couplers
and rate are therefore higher than those of the regulator.
"""

# mypy: allow-untyped-defs

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from train_ato.control.algorithms.quadratic_program import inverse, matrix_product

if TYPE_CHECKING:
    from train_ato.control.algorithms.coupled_units import CoupledUnits
    from train_ato.messages.types import Array

POSITION = 0.1
"""Deviation of a position with the weight 1 [m]."""
COUPLER = 3e4
"""Coupler force with the weight 1 [N]."""
RATE = 0.3
"""Rate of the command over the mass with the weight 1 [m/s³]."""


def periodic_response(units: CoupledUnits, lag: float, frequency: float) -> Array:
    """Return motion x and acting force over the mass for unit disturbances, complex, shape (2, units, units).

    The command u is (1 + i w Ta) times the acting force.

    Parameters
    ----------
    units
        The coupled units.
    lag
        Lag of the actuators Ta [s].
    frequency
        w [rad/s].
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
