"""Linear law of generalised predictive control for a given model, paper 004, eqs. (18)-(22)."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from train_ato.control.algorithms.diophantine import diophantine, response_and_past
from train_ato.messages.types import Array


class PredictiveSettings(Protocol):
    """Horizons and weight of the cost (12)."""

    @property
    def n(self) -> int:
        """Prediction horizon N."""

    @property
    def nu(self) -> int:
        """Control horizon Nu."""

    @property
    def command_weight(self) -> float:
        """Weight lam of the command [s²]."""

    @property
    def beyond_horizon(self) -> str:
        """Command beyond the control horizon: ``zero`` or ``hold``."""

    @property
    def residual_gain(self) -> str:
        """Lc from the cost (``horizon``), or by (21) (``stationary``)."""


class LinearLaw(NamedTuple):
    """First command of (18): u = scale P w - Fc v - (Hc - 1) u - Lc xi.

    Attributes
    ----------
    tracking : Array, shape (N,)
        P.
    feedback, past : Array
        Fc on the last speeds, Hc - 1 on the last commands.
    residual, scale : float
        Lc and R.
    """

    tracking: Array
    feedback: Array
    past: Array
    residual: float
    scale: float


def linear_law(a: Array, b: Array, p: PredictiveSettings) -> LinearLaw:
    """Return the linear law of (19): Fc = sum P_j F_j, Hc = 1 + z⁻¹ sum P_j H_j, Lc = sum P_j E_j(1) or by (21)."""
    e, f = diophantine(a, p.n)
    g, h = response_and_past(e, b, p.n)
    rows = first_row(g, p)
    feedback, past = rows @ f, rows @ h
    scale = (a.sum() * (1.0 + past.sum()) / b.sum() + feedback.sum()) / rows.sum()
    residual = rows @ np.cumsum(e) if p.residual_gain == "horizon" else (1.0 + past.sum()) / b.sum()
    return LinearLaw(rows, feedback, past, float(residual), float(scale))


def first_row(g: Array, p: PredictiveSettings) -> Array:
    """Return the first row of (G'QG + lam)⁻¹ G'Q, shape (N,)."""
    matrix = np.zeros((p.n, p.nu))
    for column in range(p.nu):
        matrix[column:, column] = g[: p.n - column]
    if p.beyond_horizon == "hold":
        for row in range(p.nu, p.n):
            matrix[row, p.nu - 1] = g[: row - p.nu + 2].sum()
    gain = np.linalg.solve(matrix.T @ matrix + p.command_weight * np.eye(p.nu), matrix.T)
    return np.asarray(gain[0])
