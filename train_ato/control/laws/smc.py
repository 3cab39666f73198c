"""Sliding mode with an adaptive reaching law, paper 000, eqs. (18)-(22).

Draws the train onto a surface of position error, its rate and its integral, on which the error dies out by itself. The
forces on the locomotive's own vehicle are measured and cancelled, so the law sees a free mass.

Per unit, e = s - s_d, all in m/s² but u::

    S = e' + l1 e + l2 int e                                                                    (19)
    u = -m [f_hat + d_hat - v_d' + l1 e' + l2 e + xi |S|^alpha sgn S + zeta sgn S + ks S]       (22)
    zeta = kappa tanh(|e|/2)                                                                    (21)
    f_hat = -(FC + W + Fa)/m / (1 + model_error)

``m`` is the mass of the unit's own vehicle, FC what its couplers pull it back with (measured, or from
the neighbours' states where a linear spring joins two units: (22) needs the force of the first coupler, or 184 t would
have to hold 10 684 t), W its own resistance and Fa its own air brake.
``d_hat`` is the observer's force over m.

Corrections and additions:

* ``model_error`` is the paper's "f uncertain by 1 %".
* zeta vanishes at e = 0 and |S|^5 is nothing near 0, so S has no restoring term: ``ks`` adds one (0 is the print).
* the sign has a boundary layer ``phi`` [m/s] (0 is the print).
* the integral of e is clamped and held while the force is at a limit.
* ``equivalent: feedforward`` takes the equivalent control from ``LawInput.feedforward`` and the train's inertia in
  place of the vehicle's: what is left of (22) under lag and delay. With lag and delay T in all, the print is unstable
  for T > m l1/(M l2), 0.17 s on the 10 684 t train. Under ``twin`` l1 = .07, l2 = .002, ks = .02, kappa = .01, phi = 1
  are usable there: M (l1 + ks + kappa/phi) must stay near the wave impedance of the couplers, 1e6 N s/m.

Needs: with ``equivalent: measured`` the force of every coupler beside a power unit: a sensor there, or a linear spring
without slack between two units; a train without is refused by the coupler's name, and so are compensations that give
only a feed-forward. With ``equivalent: feedforward`` any train and no sensor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from train_ato.control.contract import LawInput, parameter
from train_ato.control.parts.couplers import UnitCouplers
from train_ato.control.parts.guard import GuardedLaw
from train_ato.control.parts.sliding import IntegralSurface, adaptive_gain, saturation, sig

if TYPE_CHECKING:
    from train_ato.model import TrainModel


@dataclass(frozen=True)
class SmcParameters:
    """Parameters of :class:`Smc`, the paper's values as defaults but for ``ks``."""

    l1: float = parameter(1.0, "1/s", 0.0, 100.0, "lambda_1, weight of the error in the surface")
    l2: float = parameter(0.1, "1/s²", 0.0, 100.0, "lambda_2, weight of its integral")
    xi: float = parameter(0.005, "m/s²", 0.0, 1e3, "gain of the power reaching term")
    alpha: float = parameter(5.0, "1", 0.1, 10.0, "exponent of the power reaching term")
    kappa: float = parameter(0.05, "m/s²", 0.0, 1e3, "gain of the adaptive switching term")
    ks: float = parameter(0.5, "1/s", 0.0, 100.0, "linear reaching term; 0 is the printed law")
    phi: float = parameter(0.0, "m/s", 0.0, 100.0, "boundary layer of the sign; 0 is the printed law")
    model_error: float = parameter(0.01, "1", -0.5, 10.0, "f_hat = f/(1 + model_error)")
    integral_limit: float = parameter(100.0, "m s", 0.0, 1e6, "clamp of the integral of the position error")
    anti_windup: bool = parameter(True, "", 0, 1, "hold the integral while the force is cut; the print does not")
    equivalent: str = parameter(
        "measured",
        "",
        0,
        0,
        "equivalent control from the coupler sensors, or from the feed-forward",
        choices=("measured", "feedforward"),
    )


class Smc(GuardedLaw):
    """Sliding mode with integral surface and adaptive reaching law (paper 000)."""

    Parameters: ClassVar[type] = SmcParameters

    def __init__(self, parameters: SmcParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        self._measured = parameters.equivalent == "measured"
        if self._measured:
            self.leaves_feedforward = "this law measures its equivalent control: set its equivalent: feedforward"
        self._couplers = UnitCouplers(model)
        if self._measured and self._couplers.missing:
            raise ValueError(
                f"needs the force measured at {self._couplers.refusal()}, or {model.unit_mass[0] / 1e3:.0f} t would "
                f"have to hold {model.mass / 1e3:.0f} t: fit the sensors or set its equivalent: feedforward"
            )
        self._mass = model.unit_inertia.tolist() if self._measured else (model.inertia * model.share).tolist()
        p = parameters
        self._surfaces = [IntegralSurface(p.l1, p.l2, period, p.integral_limit) for _ in range(self.n)]

    def forget(self) -> None:
        """Empty the integrals."""
        for surface in self._surfaces:
            surface.reset()

    def missed(self) -> None:
        """Do not integrate across the gap."""
        for surface in self._surfaces:
            surface.missed()

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force wanted [N]."""
        errors = (inputs.position - inputs.reference_position).tolist()
        rates = (inputs.velocity - inputs.reference_velocity).tolist()
        equivalent = self.equivalent(inputs)
        disturbance = inputs.disturbance.tolist()
        wanted = []
        for unit, (error, rate) in enumerate(zip(errors, rates, strict=True)):
            held = self.cut[unit] and self.parameters.anti_windup
            surface = self._surfaces[unit].step(error, rate, held)
            pull = self.reaching(error, rate, surface) + self.learnt(unit, error, rate, surface)
            wanted.append(equivalent[unit] - disturbance[unit] - self._mass[unit] * pull)
        return wanted

    def learnt(self, unit: int, error: float, rate: float, surface: float) -> float:
        """Return delta_hat, what a network adds to f_hat [m/s²]; 0 here."""
        return 0.0

    def reaching(self, error: float, rate: float, surface: float) -> float:
        """Return l1 e' + l2 e and the reaching terms of (21) [m/s²]."""
        p = self.parameters
        switching = adaptive_gain(error, p.kappa) * saturation(surface, p.phi)
        return float(p.l1 * rate + p.l2 * error + p.ks * surface + p.xi * sig(surface, p.alpha) + switching)

    def equivalent(self, inputs: LawInput) -> list[float]:
        """Return m (v_d' - f_hat) [N], or the feed-forward that takes its place."""
        if not self._measured:
            known: list[float] = inputs.feedforward.tolist()
            return known
        own = self.model.own_resistance(inputs.velocity, inputs.position).tolist()
        shoes = inputs.shoe_force.tolist()
        pulls = self._couplers.pull(inputs.position.tolist(), inputs.velocity.tolist(), inputs.coupler_force.tolist())
        trust = 1.0 / (1.0 + self.parameters.model_error)
        return [
            mass * inputs.acting_acceleration + (pull + resisting + shoe) * trust
            for mass, pull, resisting, shoe in zip(self._mass, pulls, own, shoes, strict=True)
        ]
