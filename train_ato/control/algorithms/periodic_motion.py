"""Periodic motion of coupled units under a line of the disturbance, with the smallest weighted motion and force rate.

A disturbance b e^(i w t) [m/s²] on every unit, a command u and a motion x e^(i w t), all complex amplitudes::

    Z x = b + u/(1 + i w Ta),   Z = -w² - S - i w D

with the springs S and dampers D between the units over their mass, and u over the mass as well. The motion is exact for
a steady line, for any delay: the command is sent earlier by the delay. The smallest value of the cost of
`unit_deviations.py` in the mean over a period::

    |x|²/POSITION² + |C x|²/COUPLER² + |w u|²/RATE²

C x the coupler forces, is a least-squares problem in x alone with u = (1 + i w Ta) (Z x - b)::

    (Q + g Z*Z) x = g Z* b,   g = w² (1 + w² Ta²)/RATE²

Z has no inverse at an undamped mode of the couplers; the matrix of this equation always has one.
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
COUPLER = 1e5
"""Coupler force with the weight 1 [N]."""
RATE = 0.2
"""Rate of the command over the mass with the weight 1 [m/s³]."""


def periodic_response(units: CoupledUnits, lag: float, frequency: float) -> Array:
    """Return motion x and command over the mass u for unit disturbances, complex, shape (2, units, units).

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
    found = np.array([motion[:n, :n] + 1j * motion[n:, :n], force[:n, :n] + 1j * force[n:, :n]])
    found[1] *= 1.0 + 1j * w * lag
    return found
