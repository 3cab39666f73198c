"""Sliding mode with a switching term learnt by an RBF network, paper 001, eqs. (6)-(14).

A sliding mode switches by its full gain at every crossing of the surface, which causes chattering. Here a network
learns the switching term as a smooth function of the surface.

Per unit, e = x - x_d, s = c e + e' (7), all terms as accelerations, M the unit's share of the inertia of the train::

    u = u_eq + M u_n - d_hat                                                                            (12)
    u_eq = u_ff - M c e'                                        u_ff: v_d', resistance, delay and lag    (9)
    u_n = sum w_j h_j,  h_j = exp(-(q - r_j)²/(2 d²)),  q = clip(s/phi, -1, 1),  r = (-1 -.5 0 .5 1)    (11), (12)
    w_j(0) = -0.9 k_w r_j;  dw_j = -eta Tc s (ds/du) h_j;  w(l) = w(l-1) + dw + alpha (w(l-1) - w(l-2))  (13)
    e''_hat = sum v_j b_j(u(l-1), e''(l-1), e''(l-2)),  dv_j = +eta_v (e'' - e''_hat) b_j                (14)

``switching: sign`` is (9), -k_w sgn(s); ``tanh`` is the smooth form -k_w tanh(s/phi).

Corrections:

* The paper uses measured derivatives and its own a_s' in u_eq, which is unstable (``derivatives: measured``, with the
  coefficients of (5) corrected and the resistance, which (9) lacks). Here u_eq is the feed-forward that the
  compensation computes from the *reference* (`pade`: eq. (5) corrected; `preview`: exact).
* k = -269 is interpreted as kN on 192 t: k_w = 1.40 m/s².
* The printed equations lack the minus sign, h_j and b_j, and use E = e''²/2 as objective and e'' as input, which drifts
  by tens of metres; here E = s²/2. ``objective: printed_acceleration`` is the printed form, to reproduce the drift.
* eta = 0.6 per sample is an integrator of 0.6/Tc; here eta is a rate, multiplied by Tc.
* Inputs and target of the networks are clipped (``clip``), because they would have no response to large errors. Weights
  are bounded, and held while the force is at a limit (``anti_windup``).
* The first input of the identification network is u_n: u of the paper (``rbfi_input: command``) contains the
  acceleration of the profile, to which e'' does not respond.
* The identification network supplies only the sign of ds/du (``sensitivity``). With a delay its inputs and outputs do
  not correspond, so its sign is used only while it has explained e'' for some time; otherwise the physical sign (+) is
  used.

Gains of the model: with the initial weights u_n = -2.07 k_w s/phi near s = 0, so that kp = c + 2.07 k_w/phi and
ki = c 2.07 k_w/phi. From the kp of `pid` on the same train both parts are kp/2, which gives ki = kp²/4, with
phi = 2 m/s. u_n integrates s at the rate 1.77 eta, and s decays at kp/2: eta is a sixteenth of (kp/2)²/1.77. The
weights may add half of the strongest acceleration of the train. ``identify: false``, because with a delay the sign of
ds/du is not in the samples.

Needs: any train; the feed-forward of a compensation (with lag and delay `preview`, `pade`, `twin` or `predictor`; none
for ``derivatives: measured``), inertia and shares; no coupler sensor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from plant_sim.summation import plain_sum
from train_ato.control.algorithms.guard import GuardedLaw
from train_ato.control.algorithms.loop_gains import LoopGains
from train_ato.control.algorithms.rbf import RBF_CENTERS, Weights, activations
from train_ato.control.algorithms.sliding import saturation
from train_ato.control.compensation.pade import pade_coefficients
from train_ato.control.contract import LawInput, parameter
from train_ato.control.gains import gains_choice

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel

INITIAL_WEIGHT = -0.9
"""Initial weight w_j(0) over k_w r_j."""
START_SLOPE = 2.066
"""Slope of -u_n/k_w over s/phi at s = 0 with the initial weights and d = 0.5."""
START_RATE = 1.77
"""Sum of h_j² at s = 0 with d = 0.5: a rate eta of the weights is START_RATE eta of u_n."""


@dataclass(frozen=True)
class RbfSwitchingSmcParameters:
    """Parameters of :class:`RbfSwitchingSmc`."""

    gains: str = gains_choice()
    c: float = parameter(0.4, "1/s", 0.0, 100.0, "weight of the position error in the surface")
    k_w: float = parameter(1.40, "m/s²", 0.0, 100.0, "switching gain")
    phi: float = parameter(2.0, "m/s", 1e-6, 1e3, "surface from which the input of the network is clipped")
    switching: str = parameter(
        "rbf", "", 0, 0, "switching term: learnt, smooth, or a relay", choices=("rbf", "tanh", "sign")
    )
    objective: str = parameter(
        "surface",
        "",
        0,
        0,
        "objective of the learning; printed_acceleration drifts",
        choices=("surface", "printed_acceleration"),
    )
    width: float = parameter(0.5, "1", 1e-3, 100.0, "d, width of the Gaussian functions of RBFC")
    eta: float = parameter(0.05, "1/s²", 0.0, 1e3, "learning rate of RBFC; times Tc per sample")
    alpha: float = parameter(0.05, "1", 0.0, 0.99, "momentum of both networks")
    identify: bool = parameter(True, "", 0, 1, "take the sign of ds/du from RBFI")
    clip: bool = parameter(True, "", 0, 1, "clip inputs and target of the networks to +-1; false in the paper")
    anti_windup: bool = parameter(True, "", 0, 1, "hold the weights while the force is at a limit; false in the paper")
    sensitivity: str = parameter(
        "sign", "", 0, 0, "slope by RBFI in (13): its sign, or its value as in the paper", choices=("sign", "value")
    )
    derivatives: str = parameter(
        "profile", "", 0, 0, "derivatives in u_eq: of the profile, or measured as in the paper",
        choices=("profile", "measured"),
    )  # fmt: skip
    rbfi_input: str = parameter(
        "switching", "", 0, 0, "first input of RBFI: the switching term, or u(l-1) as in the paper",
        choices=("switching", "command"),
    )  # fmt: skip
    eta_v: float = parameter(0.05, "1", 0.0, 1.0, "learning rate of RBFI, per sample")
    weight_limit: float = parameter(3.0, "m/s²", 0.0, 1e3, "largest magnitude of a weight")


class RbfSwitchingSmc(GuardedLaw):
    """Sliding mode with a switching term learnt by an RBF network (paper 001)."""

    Parameters: ClassVar[type] = RbfSwitchingSmcParameters

    @classmethod
    def model_gains(cls, model: TrainModel, period: float) -> dict[str, Any]:
        """Return the parameters with the bandwidth of `pid` on the same train.

        Parameters
        ----------
        model
            The train.
        period
            Control period [s].
        """
        kp, phi = LoopGains.of(model, period).speed, 2.0
        k_w = kp * phi / (2.0 * START_SLOPE)
        strongest = plain_sum(max(t.largest(), b.largest()) for t, b in zip(model.traction, model.brake, strict=True))
        return {
            "c": kp / 2.0, "k_w": k_w, "phi": phi, "eta": kp * kp / (64.0 * START_RATE), "identify": False,
            "weight_limit": k_w + 0.5 * strongest / model.inertia,
        }  # fmt: skip

    def __init__(self, parameters: RbfSwitchingSmcParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        self._mass = (model.inertia * model.share).tolist()
        p = parameters
        start = [INITIAL_WEIGHT * p.k_w * centre for centre in RBF_CENTERS]
        self._control = [Weights(start, p.weight_limit, p.alpha) for _ in range(self.n)]
        self._sensitivity = [Identification(p.eta_v, p.alpha, p.clip) for _ in range(self.n)]
        measured = p.derivatives == "measured"
        self.uses_feedforward, self.feedforward_hint = not measured, "derivatives: profile"
        self._equivalents = [MeasuredEquivalent(model, unit, period) for unit in range(self.n)] if measured else []
        self._literal = p.objective == "printed_acceleration"
        self._literal_input = p.rbfi_input == "command"
        self.clear_state()

    def clear_state(self) -> None:
        """Return to the initial weights."""
        for weights in self._control:
            weights.reset()
        for network in self._sensitivity:
            network.reset()
        for equivalent in self._equivalents:
            equivalent.reset()
        self._rates: list[float] | None = None
        self._pull = [0.0] * self.n

    def on_missed_sample(self) -> None:
        """Handle a missed sample: the difference quotients restart."""
        self._rates = None
        for equivalent in self._equivalents:
            equivalent.reset()

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force demand of every unit [N]."""
        errors = (inputs.position - inputs.reference_position).tolist()
        rates: list[float] = (inputs.velocity - inputs.reference_velocity).tolist()
        known, disturbance = self._known(inputs), inputs.disturbance.tolist()
        wanted = []
        for unit, (error, rate) in enumerate(zip(errors, rates, strict=True)):
            error_acceleration = 0.0 if self._rates is None else (rate - self._rates[unit]) / self.period
            surface = self.parameters.c * error + rate
            command = self._last_force[unit] / self._mass[unit] if self._literal_input else self._pull[unit]
            pull = self._switching(unit, surface, command, error_acceleration)
            self._pull[unit] = pull
            wanted.append(known[unit] - disturbance[unit] + self._mass[unit] * (pull - self.parameters.c * rate))
        self._rates = rates
        return wanted

    def _known(self, inputs: LawInput) -> list[float]:
        """Return u_eq without the term of the speed error for every unit [N]."""
        if not self._equivalents:
            known: list[float] = inputs.feedforward.tolist()
            return known
        units = zip(
            self._equivalents, inputs.velocity.tolist(), inputs.reference_acceleration.tolist(), self._mass, strict=True
        )
        return [
            mass * equivalent.step(speed, wanted, self._last_force[unit] / mass)
            for unit, (equivalent, speed, wanted, mass) in enumerate(units)
        ]

    def _switching(self, unit: int, surface: float, command: float, acceleration: float) -> float:
        """Return u_n [m/s²] and update the weights."""
        p = self.parameters
        if p.switching == "sign":
            return float(-p.k_w * saturation(surface, 0.0))
        if p.switching == "tanh":
            return float(-p.k_w * math.tanh(surface / p.phi))
        gain = self._sensitivity[unit].step(command, acceleration) if p.identify else 1.0
        aim, push = (acceleration, acceleration) if self._literal else (surface / p.phi, surface)
        if p.identify and p.sensitivity == "value":
            gain = self._sensitivity[unit].slope
        hidden = activations((min(max(aim, -1.0), 1.0) if p.clip else aim,), RBF_CENTERS, p.width)
        if not (self.saturated[unit] and p.anti_windup):
            self._control[unit].learn(-p.eta * self.period * push * gain, hidden)
        return self._control[unit].output(hidden)


class Identification:
    """Network RBFI: prediction of e'' from the last command and the last two e''; its slope gives the sign of ds/du.

    Attributes
    ----------
    slope : float
        Derivative of the prediction by the command [1].
    """

    MAX_UNEXPLAINED = 0.2
    """Mean unexplained part of e'' up to which the sign of the network is used."""

    WIDTH = 0.5
    """Width of the Gaussian functions."""

    def __init__(self, rate: float, momentum: float, clip: bool = True) -> None:
        self._rate = rate
        self._reach = 1.0 if clip else math.inf
        self._weights = Weights([0.5 * centre for centre in RBF_CENTERS], 10.0, momentum)
        self.reset()

    def reset(self) -> None:
        """Return to the initial weights."""
        self._weights.reset()
        self._before = (0.0, 0.0)
        self._size, self._missing = 0.0, 0.0
        self.slope = 1.0

    def step(self, command: float, acceleration: float) -> float:
        """Return the sign of ds/du: +1, or -1 if well established.

        Parameters
        ----------
        command
            Last command [m/s²].
        acceleration
            e'' that followed it [m/s²].
        """
        reach = self._reach
        point = [min(max(value, -reach), reach) for value in (command, *self._before)]
        hidden = activations(point, RBF_CENTERS, self.WIDTH)
        miss = min(max(acceleration, -reach), reach) - self._weights.output(hidden)
        self._weights.learn(self._rate * miss, hidden)
        self._before = (acceleration, self._before[0])
        self._size += 0.01 * (acceleration * acceleration - self._size)
        self._missing += 0.01 * (miss * miss - self._missing)
        slope = plain_sum(
            w * h * (centre - point[0]) for w, h, centre in zip(self._weights.values, hidden, RBF_CENTERS, strict=True)
        )
        self.slope = slope / self.WIDTH**2
        explained = self._missing < self.MAX_UNEXPLAINED**2 * self._size
        return -1.0 if explained and slope < 0.0 else 1.0


class MeasuredEquivalent:
    """Equivalent control of (9) from measured derivatives, by backward differences, for one unit.

    With y = v' + w the acceleration by the actuator, w the specific resistance of the nominal train, (5) solved for the
    command is a_s = y - b1 y'' - b2 y' - b3 a_s'; the first y has the acceleration of the profile.

    Parameters
    ----------
    model
        The nominal train.
    unit
        Number of the unit.
    period
        Control period [s].
    """

    def __init__(self, model: TrainModel, unit: int, period: float) -> None:
        self._model, self._period = model, period
        self._coefficients = pade_coefficients(model.lag, float(model.delay[unit]))
        self.reset()

    def reset(self) -> None:
        """Restart at the next sample with derivatives of 0."""
        self._speeds: list[float] = []
        self._actuated: list[float] = []
        self._sent: list[float] = []

    def step(self, speed: float, wanted: float, sent: float) -> float:
        """Return the equivalent control for a speed [m/s], v_d' and the last command [m/s²] in m/s²."""
        h, resistance = self._period, self._model.running_resistance(speed) / self._model.inertia
        self._speeds = [speed, *self._speeds[:1]]
        self._sent = [sent, *self._sent[:1]]
        if len(self._speeds) == 2:
            rate = (self._speeds[0] - self._speeds[1]) / h
            self._actuated = [rate + resistance, *self._actuated[:2]]
        if len(self._actuated) < 3:
            return wanted + resistance
        y0, y1, y2 = self._actuated
        b1, b2, b3 = self._coefficients
        command_rate = (self._sent[0] - self._sent[1]) / h
        return wanted + resistance - b1 * (y0 - 2.0 * y1 + y2) / (h * h) - b2 * (y0 - y1) / h - b3 * command_rate
