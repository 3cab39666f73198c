"""Nonlinear generalised predictive control, paper 004, eqs. (4)-(22): one loop for the mean speed, or one per unit.

The law predicts the speed over a few long samples, computes the commands with the smallest deviation from the reference
there, and sends the first. The parameters of the model and its residual are identified online.

Per loop, v speed, u command acceleration (force over inertia), every ``sampling`` seconds::

    A(z⁻¹) v(k) = B(z⁻¹) u(k-1) + xi(k-1)                                                        (7)
    I = E_j A + z^-j F_j,  E_j B = G_j + z^-j H_j                                                (13), (14)
    J = sum_j q |v(k+j) - R w(k+j)|² + sum_j lam |u(k+j-1)|²                                     (12)
    U = (G'QG + lam)⁻¹ G'Q [R W - F v(k) - H u(k-1) - L xi(k-1)],  L_j = E_j(1)                  (18)
    (20) has w(k+N); R by (22): A(1) Hc(1) + B(1) Fc(1) = B(1) Rc(1)
    theta += mu x e/(1 + x'x),  e = v - v_hat,  mu = 1 if |e| > 2 Delta, else 0                   (10), (11)
    xi_hat = W s(V z + mu2) + mu1, z the last three v and u, by back-propagation on the residual

Corrections and properties:

* e = w - v_hat, as printed in (10), diverges.
* With a short sampling the horizons N = 3, Nu = 2 are shorter than the delay. A pole is then outside the unit circle
  for any lam: with 1.2 s of delay at 0.4 s and less, with 1.1 s at 0.3 s. ``sampling`` 1.2 s works. Between two samples
  the command is constant.
* Identification on increments of v, A = (1 - z⁻¹) A': the projection on v itself only moves the pole at 1.
* Lc follows from the cost. (21), Hc(1) = B(1) Lc(1), removes the influence of a constant xi (``residual_gain:
  stationary``). The identified parameters stay within ``deviation_limit`` of the nominal ones.
* xi contains resistance, grades and couplers: the network acts as a slow integrator; the raw residual destabilises.
* ``resistance_feedforward: true`` adds the force for the nominal resistance, grades and air brake; u and xi are then
  without it.
* ``beyond_horizon: zero`` is u = 0 after Nu as in the paper; ``hold`` repeats the last command.
* Independent laws on coupled units (``structure: unit``) act against each other through the couplers and are unstable
  on a coupled train.
* Nominal A, B by Padé and zero-order hold from the delay of the model, one set for traction and one for braking.
* The law contains its own delay model: use compensation `none`; with `predictor` set ``delay: none``.
* ``feedforward: true`` adds the feed-forward of the compensation, and v, u and w are the deviations from the reference
  and from this force. Otherwise a command that is constant over a long horizon cuts every corner of the reference.

Gains of the model: ``feedforward: true`` and one command over the horizon N T (nu = 1, ``hold``). For a small command
weight this is the loop kp = 3/((2N + 1) T). It has two thirds of the kp of `pid` on the same train, because a command
lasts for T. T is the dead time theta = delay + lag + period, so that B has the delay within its three terms. If N would
be above 40, T is longer. position_gain = kp/4 is ki = kp²/4. The network learns sixteen times slower than the loop
(learning_rate = kp T/160). Nothing is identified (``identify: none``), because the deviations of a known train are
noise.

Needs: any train; delay and lag of the model, and the reference ahead. The law predicts over the delay by itself.
Therefore `predictor` and `train_predictor` are rejected unless ``delay: none``. Compensations that give only a
feed-forward are rejected unless ``feedforward: true``. The law suits trains that move as one mass. A long train needs a
horizon of 20 s, one command over it, and the known force, as with the gains of the model.
"""

import math
from dataclasses import dataclass
from operator import add, sub
from typing import Any, ClassVar, NamedTuple

import numpy as np

from plant_sim.elementary import dot_of, matrix_product, plain_sum
from train_ato.control.algorithms.loop_gains import Complex, LoopGains, Response
from train_ato.control.algorithms.predictive_law import (
    Increments,
    ResidualNetwork,
    diophantine,
    response_and_past,
    sampled_actuator,
)
from train_ato.control.algorithms.quadratic_program import cholesky, solve_factored
from train_ato.control.contract import LawInput, choice, flag, parameter
from train_ato.control.gains import gains_choice
from train_ato.control.guard import GuardedLaw, is_valid
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array

MIN_LEARNING_SPEED = 0.1
"""Speed up to which nothing is learnt, because friction holds the train [m/s]."""
SAMPLED_SHARE = 2.0 / 3.0
"""Gain of the sampled loop over that of a loop in every control period."""
MAX_HORIZON = 40
"""Largest N of the gains of the model."""


@dataclass(frozen=True)
class GpcParameters:
    """Parameters of :class:`Gpc`."""

    gains: str = gains_choice()
    sampling: float = parameter(
        1.2, "s", 0.0, 10.0, "sampling period, rounded to a multiple of the control period; 0: the control period"
    )
    n: int = parameter(3, "1", 1, 200, "N, prediction horizon")
    nu: int = parameter(2, "1", 1, 200, "Nu, control horizon")
    command_weight: float = parameter(0.1, "s²", 0.0, 1e6, "lam, weight of the command")
    beyond_horizon: str = choice("command beyond the control horizon", "zero", "hold")
    structure: str = choice("one loop on the mean speed, or one per unit", "mean", "unit")
    delay: str = choice("delay in the model of the law", "model", "none")
    identify: str = choice("recursive identification", "none", "increments", "absolute", default="increments")
    dead_zone: float = parameter(0.02, "m/s", 0.0, 10.0, "Delta, largest error that counts as noise")
    use_network: bool = flag("estimate xi by the network", default=True)
    resistance_feedforward: bool = flag("add the force for the nominal resistance; false in the paper", default=False)
    feedforward: bool = flag(
        "control the deviations from the reference; the feed-forward of the compensation is added", default=False
    )
    residual_gain: str = choice("Lc from the horizon, or Lc = Hc(1)/B(1) by (21)", "horizon", "stationary")
    deviation_limit: float = parameter(
        0.5, "1", 0.0, 1e9, "largest deviation of the identified parameters over the norm of B; no limit in the paper"
    )
    learning_rate: float = parameter(0.15, "1", 0.0, 1.0, "learning rate of the network, per sample")
    hidden: int = parameter(6, "1", 1, 50, "hidden neurons of the network")
    position_gain: float = parameter(
        0.0, "1/s", 0.0, 1.0, "gain on the position error, added to the reference; 0 in the paper"
    )


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


def linear_law(a: Array, b: Array, p: GpcParameters) -> LinearLaw:
    """Return the linear law of (19): Fc = sum P_j F_j, Hc = 1 + z⁻¹ sum P_j H_j, Lc = sum P_j E_j(1) or by (21)."""
    e, f = diophantine(a, p.n)
    g, h = response_and_past(e, b, p.n)
    rows = first_row(g, p)
    feedback, past = ((rows[:, None] * part).sum(axis=0) for part in (f, h))
    scale = (a.sum() * (1.0 + past.sum()) / b.sum() + feedback.sum()) / rows.sum()
    residual = dot_of(rows, np.cumsum(e)) if p.residual_gain == "horizon" else (1.0 + past.sum()) / b.sum()
    return LinearLaw(rows, feedback, past, float(residual), float(scale))


def first_row(g: Array, p: GpcParameters) -> Array:
    """Return the first row of (G'QG + lam)⁻¹ G'Q, shape (N,)."""
    matrix = np.zeros((p.n, p.nu))
    for column in range(p.nu):
        matrix[column:, column] = g[: p.n - column]
    if p.beyond_horizon == "hold":
        for row in range(p.nu, p.n):
            matrix[row, p.nu - 1] = g[: row - p.nu + 2].sum()
    cost = matrix_product(np.ascontiguousarray(matrix.T), matrix) + p.command_weight * np.eye(p.nu)
    first = np.eye(1, p.nu)[0]
    solve_factored(cholesky(cost), first)
    return np.asarray((matrix * first).sum(axis=1))


class Gpc(GuardedLaw):
    """Generalised predictive control with identification and a back-propagation network (paper 004)."""

    Parameters: ClassVar[type] = GpcParameters

    @classmethod
    def model_gains(cls, model: TrainModel, period: float) -> dict[str, Any]:
        """Return sampling, horizon and rates with two thirds of the bandwidth of `pid` on the same train.

        Parameters
        ----------
        model
            The train.
        period
            Control period [s].
        """
        loop = LoopGains.of(model, period)
        kp = SAMPLED_SHARE * loop.speed
        longest = max(loop.dead_time, 3.0 / ((2.0 * MAX_HORIZON + 1.0) * kp))
        sampling = min(math.ceil(longest / period - 1e-9) * period, 10.0)
        n = max(3, math.ceil(0.5 * (3.0 / (kp * sampling) - 1.0) - 1e-9))
        return {
            "sampling": sampling, "n": n, "nu": 1, "beyond_horizon": "hold", "command_weight": 1.0,
            "feedforward": True, "identify": "none", "position_gain": kp / 4.0, "learning_rate": kp * sampling / 160.0,
        }  # fmt: skip

    def __init__(self, parameters: GpcParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        p = parameters
        if p.nu > p.n:
            raise ValueError(
                f"nu {p.nu} is longer than n {p.n}; the control horizon cannot exceed the prediction horizon"
            )
        self.uses_feedforward, self.feedforward_hint = p.feedforward, "feedforward: true"
        if p.delay == "model":
            self.predicts_delay, self.delay_hint = True, "delay: none"
        self._every = max(1, round(p.sampling / period))
        self._sampling = self._every * period
        self.horizon = 0 if p.feedforward else math.ceil(p.n * self._every) + 1
        self._single = p.structure == "mean"
        forward, backward, lag = model.delay.tolist(), model.delay_brake.tolist(), model.lag
        if p.delay == "none":
            forward, backward = [0.0] * self.n, [0.0] * self.n
        if self._single:
            forward, backward = [self.mean(forward)], [self.mean(backward)]
        self._mass = [model.inertia] if self._single else (model.inertia * model.share).tolist()
        self._loops = [Loop(p, a, b, lag, self._sampling) for a, b in zip(forward, backward, strict=True)]
        self.clear_state()

    def response(self, predicted: bool) -> Response:
        """Return the response of the nominal law to the speed error, up to half of its sampling frequency."""
        law, sampling, lag, period = self._loops[0].nominal, self._sampling, self.model.lag, self.period
        position = self.parameters.position_gain * law.scale * law.tracking.sum()

        def of(s: Complex, late: Complex) -> tuple[Complex, Complex]:
            acts, z = np.abs(s) * sampling < math.pi, np.exp(-s * sampling)
            feedback, past = np.polyval(law.feedback[::-1], z), 1.0 + z * np.polyval(law.past[::-1], z)
            held = (1.0 - z) / (s * sampling) * late * np.exp(0.5 * s * period)
            return acts * (s * feedback + position) * held, s * (1.0 + lag * s) * np.where(acts, past, 1.0)

        return of

    def clear_state(self) -> None:
        """Clear identified parameters, network and past samples."""
        for loop in self._loops:
            loop.reset()
        self._count = 0
        self._wanted = [0.0] * self.n
        self._known = [0.0] * self.n

    def take_over(self, inputs: LawInput, force: Array) -> None:
        """Begin with past samples of the last command [N] and of the motion that the reference has now.

        The residual begins at the resistance of the nominal train, unless that is among the known forces.
        """
        super().take_over(inputs, force)
        if not is_valid(inputs):
            return
        speeds, acceleration = inputs.velocity.tolist(), float(inputs.reference_acceleration[0])
        if self.uses_feedforward:
            target, acceleration = self.mean(inputs.reference_velocity.tolist()), 0.0
            speeds = [speed - target for speed in speeds]
            self._known = inputs.feedforward.tolist()
        resisting = 0.0 if self.uses_feedforward else self._resistance(inputs)
        if self.parameters.resistance_feedforward and not self.uses_feedforward:
            self._known, resisting = [resisting * share for share in self.share], 0.0
        sent = self._sent()
        if self._single:
            speeds, sent = [self.mean(speeds)], [plain_sum(sent)]
        for loop, speed, last, mass in zip(self._loops, speeds, sent, self._mass, strict=True):
            loop.begin(speed, acceleration, last / mass, -resisting / self.model.inertia)

    def on_missed_sample(self) -> None:
        """Handle a missed sample: the grid of samples continues, with the prediction of the model as measurement."""
        if self._count % self._every == 0:
            sent = [plain_sum(self._sent())] if self._single else self._sent()
            for loop, force, mass in zip(self._loops, sent, self._mass, strict=True):
                loop.coast(force / mass)
        self._count += 1

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force demand of every unit [N]; constant between samples, except for the known forces."""
        if self._count % self._every == 0:
            self._wanted = self._sample(inputs)
        self._count += 1
        if self.uses_feedforward:
            self._known = inputs.feedforward.tolist()
        elif self.parameters.resistance_feedforward:
            resisting = self._resistance(inputs)
            self._known = [resisting * share for share in self.share]
        else:
            return self._wanted
        return list(map(add, self._wanted, self._known))

    def _sent(self) -> list[float]:
        """Return the last command without the known forces [N]."""
        if not (self.uses_feedforward or self.parameters.resistance_feedforward):
            return self._last_force
        return list(map(sub, self._last_force, self._known))

    def _resistance(self, inputs: LawInput) -> float:
        """Return the resisting force of the nominal train on the reference at the time of effect [N]."""
        speed = float(inputs.reference_velocity[0])
        place = self.model.front(inputs.reference_position) + speed * inputs.delay_to_effect
        speed += float(inputs.reference_acceleration[0]) * inputs.delay_to_effect
        return self.model.resisting_force(place, speed, inputs.train_shoe_force)

    def _sample(self, inputs: LawInput) -> list[float]:
        """Return the force demand until the next sample, without the known forces [N]."""
        speeds: list[float] = inputs.velocity.tolist()
        errors: list[float] = (inputs.position - inputs.reference_position).tolist()
        sent, saturated = self._sent(), any(self.saturated)
        if self._single:
            speeds, errors, sent = [self.mean(speeds)], [self.mean(errors)], [plain_sum(sent)]
        held = [saturated or abs(speed) <= MIN_LEARNING_SPEED for speed in speeds]
        if self.uses_feedforward:
            target = self.mean(inputs.reference_velocity.tolist())
            speeds, ahead = [speed - target for speed in speeds], np.zeros(self.parameters.n)
        else:
            ahead = self._ahead(inputs)
        loops = zip(self._loops, speeds, sent, self._mass, errors, held, strict=True)
        accelerations = [
            loop.step(speed, force / mass, ahead - self.parameters.position_gain * error, hold)
            for loop, speed, force, mass, error, hold in loops
        ]
        disturbance = inputs.disturbance.tolist()
        if self._single:
            total = accelerations[0] * self._mass[0] - plain_sum(disturbance)
            return [total * share for share in self.share]
        return [
            wanted * mass - force for wanted, mass, force in zip(accelerations, self._mass, disturbance, strict=True)
        ]

    def _ahead(self, inputs: LawInput) -> Array:
        """Return the reference speed at the next samples [m/s], shape (N,)."""
        preview: list[float] = inputs.preview.velocity.tolist()
        found = np.empty(self.parameters.n)
        now, pull = float(inputs.reference_velocity[0]), float(inputs.reference_acceleration[0])
        for j in range(self.parameters.n):
            later = (j + 1) * self._sampling
            place = (later - inputs.delay_to_effect) / self.period
            found[j] = _between(preview, place) if -0.5 <= place <= len(preview) - 0.5 else now + pull * later
        return found


def _between(values: list[float], place: float) -> float:
    """Return the linear interpolation of a list at a place, exact at its entries."""
    index = round(place)
    if abs(place - index) < 1e-6 or not 0 < place < len(values) - 1:
        return values[index]
    index = int(place)
    return values[index] + (place - index) * (values[index + 1] - values[index])


class Loop:
    """Predictive loop of one speed: model, identification, network and past samples.

    Parameters
    ----------
    parameters
        Parameters of the law.
    forward, backward
        Delay in traction and in braking [s].
    lag
        Lag of the actuator [s].
    sampling
        Sampling period [s].
    """

    def __init__(self, parameters: GpcParameters, forward: float, backward: float, lag: float, sampling: float) -> None:
        self._parameters, self._sampling = parameters, sampling
        self._models = [
            Increments(*sampled_actuator(delay, lag, sampling), parameters.deviation_limit)
            for delay in (forward, backward)
        ]
        self._residual = ResidualNetwork(parameters.hidden)
        self.reset()

    @property
    def nominal(self) -> LinearLaw:
        """The law of the nominal model in traction."""
        return linear_law(*self._models[0].polynomials(), self._parameters)

    def reset(self) -> None:
        """Return to the nominal model and clear the past samples."""
        for model in self._models:
            model.reset()
        self._residual.reset()
        self._laws: list[LinearLaw | None] = [None, None]
        self._speeds: list[float] = []
        self._sent: list[float] = []
        self._xi = 0.0

    def step(self, speed: float, sent: float, ahead: Array, held: bool) -> float:
        """Return the command acceleration [m/s²].

        Parameters
        ----------
        speed
            Measured speed [m/s].
        sent
            Last command as sent [m/s²].
        ahead : Array, shape (N,)
            Reference speed at the next samples [m/s].
        held
            Nothing is learnt, because the last command was at a limit or the train is at rest.
        """
        self._remember(speed, sent)
        side = int(self._sent[0] < 0.0)
        if not held:
            self._learn(side)
        law = self._law(side)
        v, u = np.array(self._speeds[:3]), np.array(self._sent[:2])
        wanted = law.scale * dot_of(law.tracking, ahead) - dot_of(law.feedback, v) - dot_of(law.past, u)
        return wanted - self._xi * law.residual

    def begin(self, speed: float, acceleration: float, sent: float, unmodelled: float) -> None:
        """Set the samples before the first one: a motion with a speed [m/s], an acceleration and a command [m/s²].

        Parameters
        ----------
        speed, acceleration, sent
            Present values [m/s, m/s², m/s²].
        unmodelled
            Acceleration by known forces that the model lacks [m/s²]; the residual begins at its effect in a sample.
        """
        self._speeds = [speed - (k + 1) * self._sampling * acceleration for k in range(4)]
        self._sent = [sent] * 4
        if self._parameters.use_network:
            _, b = self._models[int(sent < 0.0)].polynomials()
            self._xi = plain_sum(b.tolist()) * unmodelled
            self._residual.begin(self._xi)

    def coast(self, sent: float) -> None:
        """Add a sample without measurement: the speed is the prediction of the model, and nothing is learnt."""
        if self._speeds:
            commands = [sent, *self._sent[:3]]
            model = self._models[int(sent < 0.0)]
            self._remember(self._xi - model.miss([0.0, *self._speeds[:3]], commands), sent)

    def _remember(self, speed: float, sent: float) -> None:
        self._speeds = [speed, *self._speeds[:3]] if self._speeds else [speed] * 4
        self._sent = [sent, *self._sent[:3]] if self._sent else [0.0] * 4

    def _learn(self, side: int) -> None:
        p, model = self._parameters, self._models[side]
        left = model.miss(self._speeds, self._sent)
        if p.use_network:
            self._residual.learn(left, p.learning_rate)
            self._xi = self._residual.estimate(self._speeds[:3], self._sent[:3])
        if p.identify != "none":
            one_sided = all((u < 0.0) == (side == 1) for u in self._sent[:3])
            error = left - self._xi
            if one_sided and abs(error) > 2.0 * p.dead_zone:
                model.learn(self._speeds, self._sent, error, absolute=p.identify == "absolute")
                self._laws[side] = None

    def _law(self, side: int) -> LinearLaw:
        """Return the linear law of the present model, computed again after a change of the model."""
        found = self._laws[side]
        if found is None:
            a, b = self._models[side].polynomials()
            found = self._laws[side] = linear_law(a, b, self._parameters)
        return found
