"""Sliding mode with an RBF network for the unmodelled part, paper 000, eqs. (23)-(29), (35).

A small network learns from the surface what f_hat leaves out, and is added to it.

The law of :mod:`train_ato.control.laws.smc` with delta_hat added to f_hat::

    u = -m [f_hat + delta_hat + d_hat - v_d' + l1 e' + l2 e + xi |S|^alpha sgn S + zeta sgn S + ks S]      (35)
    delta_hat = W'h(chi),   chi = [e, e'],   h_j = exp(-|chi - c_j|²/(2 b²)),   c_j = .01 (-1 -.5 0 .5 1)  (25), (26)
    W' = +gamma S h                                                                                        (28)

Corrections and additions: network inputs are clipped to the outermost centres (b = 0.005 makes the network blind beyond
0.1 km/h, and bells that learn apart from each other give delta_hat a slope over e that excites the loop; the print is
``clip: false``); weights are bounded and held while the force is at a limit or the measurement is not sound. Without
the linear reaching term ``ks`` the pair S, W is an undamped oscillator of 55 s and the network makes tracking worse.

Needs: what `smc` needs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from train_ato.control.contract import parameter
from train_ato.control.laws.smc import Smc, SmcParameters
from train_ato.control.parts.rbf import CENTRES, Weights, bells

if TYPE_CHECKING:
    from train_ato.model import TrainModel


@dataclass(frozen=True)
class RbfSmcParameters(SmcParameters):
    """Parameters of :class:`RbfSmc`: those of `smc` and the network's."""

    gamma: float = parameter(0.01, "1/s", 0.0, 100.0, "learning rate of the weights")
    spread: float = parameter(0.01, "m, m/s", 1e-6, 100.0, "outermost centre of the five bells")
    width: float = parameter(0.005, "m, m/s", 1e-6, 100.0, "b, width of a bell")
    clip: bool = parameter(True, "", 0, 1, "clip the inputs to the outermost centres; the print does not")
    weight_limit: float = parameter(1.0, "m/s²", 0.0, 1e3, "largest magnitude of a weight")


class RbfSmc(Smc):
    """Sliding mode with a 2-5-1 RBF network for the model's error (paper 000)."""

    Parameters: ClassVar[type] = RbfSmcParameters

    def __init__(self, parameters: RbfSmcParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        self._centres = [parameters.spread * centre for centre in CENTRES]
        self._weights = [Weights([0.0] * len(CENTRES), parameters.weight_limit) for _ in range(self.n)]

    def forget(self) -> None:
        """Empty the integrals and the networks."""
        super().forget()
        for weights in self._weights:
            weights.reset()

    def learnt(self, unit: int, error: float, rate: float, surface: float) -> float:
        """Return delta_hat [m/s²], then learn."""
        p = self.parameters
        if p.clip:
            reach = p.spread
            error, rate = min(max(error, -reach), reach), min(max(rate, -reach), reach)
        hidden = bells((error, rate), self._centres, p.width)
        found = self._weights[unit].output(hidden)
        if not self.cut[unit]:
            self._weights[unit].learn(p.gamma * surface * self.period, hidden)
        return found
