"""Nonlinear generalised predictive control, paper 004, eqs. (4)-(22): one loop for the train's mean speed, or per unit.

Predicts the speed over a few long samples, chooses the commands that bring it nearest to the reference there, and sends
the first. Model and unexplained rest are learnt while the train runs.

Per loop, v speed, u command acceleration (force over inertia), every ``sampling`` seconds::

    A(z⁻¹) v(k) = B(z⁻¹) u(k-1) + xi(k-1)                                                        (7)
    I = E_j A + z^-j F_j,  E_j B = G_j + z^-j H_j                                                (13), (14)
    J = sum_j q |v(k+j) - R w(k+j)|² + sum_j lam |u(k+j-1)|²                                     (12)
    U = (G'QG + lam)⁻¹ G'Q [R W - F v(k) - H u(k-1) - L xi(k-1)],  L_j = E_j(1)                  (18)
    (20) has w(k+N); R by (22): A(1) Hc(1) + B(1) Fc(1) = B(1) Rc(1)
    theta += mu x e/(1 + x'x),  e = v - v_hat,  mu = 1 if |e| > 2 Delta, else 0                   (10), (11)
    xi_hat = W s(V z + mu2) + mu1, z the last three v and u, by back-propagation on the residual

Corrections and what decides everything:

* (10) prints e = w - v_hat, which diverges.
* N = 3, Nu = 2 do not see beyond the delay at a short sampling: with 1.2 s of delay a pole is outside the unit circle
  at 0.4 s and less whatever lam is, with 1.1 s at 0.3 s; ``sampling`` 1.2 s works. In between the command is held.
* Identification on increments of v, A = (1 - z⁻¹) A': the projection on v itself only moves the pole at 1.
* xi takes the resistance, grades and couplers: the network acts as a slow integrator; the raw residual destabilises.
* ``modelled: true`` adds the force that the nominal resistance, grades and air brake need; u and xi are of the rest.
* ``beyond: zero`` is the print's u = 0 after Nu; ``hold`` holds the last one.
* Independent laws on coupled units (``loops: unit``) fight over the couplers and are unstable on a coupled train.
* Nominal A, B by Padé and zero-order hold from the model's delay, one set for traction and one for braking.
* Predicts through its own delay model: run it with compensation `none`; under `predictor` set ``delay: none``.

Needs: any train; delay and lag of the model, and the reference ahead (it asks for the preview itself). It predicts over
the delay on its own: under `predictor` and `train_predictor` it is refused unless ``delay: none``. No feed-forward:
compensations that give only that are refused. Meant for trains that answer as one mass; on a long one with a horizon of
20 s, one command held over it, and ``modelled: true`` (`daqin_heavy_haul:tuned`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from train_ato.control.contract import LawInput, parameter
from train_ato.control.parts.diophantine import diophantine, response_and_past, sampled_actuator
from train_ato.control.parts.guard import GuardedLaw
from train_ato.control.parts.identification import Increments, Residual
from train_ato.types import Array

if TYPE_CHECKING:
    from train_ato.model import TrainModel

SLOWEST = 0.1
"""Below this speed nothing is learnt: friction holds the train [m/s]."""


@dataclass(frozen=True)
class GpcParameters:
    """Parameters of :class:`Gpc`."""

    sampling: float = parameter(1.2, "s", 0.0, 10.0, "sampling of the law, rounded to its period; 0: the period")
    n: int = parameter(3, "1", 1, 200, "N, prediction horizon")
    nu: int = parameter(2, "1", 1, 200, "Nu, control horizon")
    lam: float = parameter(0.1, "s²", 0.0, 1e6, "lambda, weight of the command")
    beyond: str = parameter("zero", "", 0, 0, "command beyond the control horizon", choices=("zero", "hold"))
    loops: str = parameter("mean", "", 0, 0, "one loop on the mean speed, or one per unit", choices=("mean", "unit"))
    delay: str = parameter("model", "", 0, 0, "delay in the law's model", choices=("model", "none"))
    identify: str = parameter(
        "increments", "", 0, 0, "recursive identification", choices=("none", "increments", "absolute")
    )
    dead_zone: float = parameter(0.02, "m/s", 0.0, 10.0, "Delta, largest error that is taken for noise")
    unmodelled: bool = parameter(True, "", 0, 1, "estimate xi by the network")
    modelled: bool = parameter(False, "", 0, 1, "add the force that the nominal resistance needs; the print does not")
    rate: float = parameter(0.15, "1", 0.0, 1.0, "learning rate of the network, per sample")
    hidden: int = parameter(6, "1", 1, 50, "hidden neurons of the network")
    position: float = parameter(0.0, "1/s", 0.0, 1.0, "gain on the position error, added to the reference; print 0")


class Gpc(GuardedLaw):
    """Generalised predictive control with identification and a back-propagation network (paper 004)."""

    Parameters: ClassVar[type] = GpcParameters
    leaves_feedforward = "this law brings its own equivalent control: choose pid, rbf_switching_smc or smc for it"

    def __init__(self, parameters: GpcParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        p = parameters
        if p.nu > p.n:
            raise ValueError(f"nu {p.nu} is longer than n {p.n}; the control horizon lies inside the prediction's")
        if p.delay == "model":
            self.predicts_delay = "this law predicts over the delay itself: set gpc.delay: none"
        self._every = max(1, round(p.sampling / period))
        self._sampling = self._every * period
        self.horizon = math.ceil(p.n * self._every) + 1
        self._single = p.loops == "mean"
        forward, backward, lag = model.delay.tolist(), model.delay_brake.tolist(), model.lag
        if p.delay == "none":
            forward, backward = [0.0] * self.n, [0.0] * self.n
        if self._single:
            forward, backward = [self.mean(forward)], [self.mean(backward)]
        self._mass = [model.inertia] if self._single else (model.inertia * model.share).tolist()
        self._loops = [Loop(p, a, b, lag, self._sampling) for a, b in zip(forward, backward, strict=True)]
        self.forget()

    def forget(self) -> None:
        """Forget identified parameters, the network and the past."""
        for loop in self._loops:
            loop.reset()
        self._count = 0
        self._wanted = [0.0] * self.n
        self._resisting = 0.0

    def missed(self) -> None:
        """Keep the samples' grid; where one falls into the gap the model's own prediction stands for it."""
        if self._count % self._every == 0:
            sent = [sum(self._sent())] if self._single else self._sent()
            for loop, force, mass in zip(self._loops, sent, self._mass, strict=True):
                loop.coast(force / mass)
        self._count += 1

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force wanted [N]; between samples the last one, but for the resistance."""
        if self._count % self._every == 0:
            self._wanted = self._sample(inputs)
        self._count += 1
        if not self.parameters.modelled:
            return self._wanted
        self._resisting = self._resistance(inputs)
        return [force + self._resisting * share for force, share in zip(self._wanted, self.share, strict=True)]

    def _sent(self) -> list[float]:
        """Return the last command without what was added for the resistance [N]."""
        if not self.parameters.modelled:
            return self._held
        return [force - self._resisting * share for force, share in zip(self._held, self.share, strict=True)]

    def _resistance(self, inputs: LawInput) -> float:
        """Return what holds the nominal train back where it is to be when the command acts [N]."""
        lead = inputs.lead if 0.0 <= inputs.lead < 100.0 else 0.0
        speed = float(inputs.reference_velocity[0])
        place = float(inputs.reference_position[0] + self.model.offsets[0]) + speed * lead
        speed += float(inputs.reference_acceleration[0]) * lead
        return self.model.running_resistance(speed) + self.model.line_force(place) + inputs.train_shoe_force

    def _sample(self, inputs: LawInput) -> list[float]:
        """Return the force wanted until the next sample, without what is added for the resistance [N]."""
        speeds: list[float] = inputs.velocity.tolist()
        errors: list[float] = (inputs.position - inputs.reference_position).tolist()
        sent, cut = self._sent(), any(self.cut)
        if self._single:
            speeds, errors, sent = [self.mean(speeds)], [self.mean(errors)], [sum(sent)]
        ahead = self._ahead(inputs)
        pushes = [
            loop.step(speed, force / mass, ahead - self.parameters.position * error, cut)
            for loop, speed, force, mass, error in zip(self._loops, speeds, sent, self._mass, errors, strict=True)
        ]
        disturbance = inputs.disturbance.tolist()
        if self._single:
            total = pushes[0] * self._mass[0] - sum(disturbance)
            return [total * share for share in self.share]
        return [push * mass - force for push, mass, force in zip(pushes, self._mass, disturbance, strict=True)]

    def _ahead(self, inputs: LawInput) -> Array:
        """Return the reference speed at the coming samples, shape (N,)."""
        preview: list[float] = inputs.preview.velocity.tolist()
        found = np.empty(self.parameters.n)
        now, pull = float(inputs.reference_velocity[0]), float(inputs.reference_acceleration[0])
        for j in range(self.parameters.n):
            later = (j + 1) * self._sampling
            place = (later - inputs.lead) / self.period
            value = _between(preview, place) if -0.5 <= place <= len(preview) - 0.5 else now + pull * later
            found[j] = value if abs(value) < 1e3 else now
        return found


def _between(values: list[float], place: float) -> float:
    """Return the value at a place between two entries, at an entry exactly."""
    index = round(place)
    if abs(place - index) < 1e-6 or not 0 < place < len(values) - 1:
        return values[index]
    index = int(place)
    return values[index] + (place - index) * (values[index + 1] - values[index])


class Loop:
    """One predictive loop: model, identification, network and past of one speed.

    Parameters
    ----------
    parameters
        Of the law.
    forward, backward
        Delay in traction and braking [s].
    lag
        s.
    sampling
        s.
    """

    def __init__(self, parameters: GpcParameters, forward: float, backward: float, lag: float, sampling: float) -> None:
        self._p = parameters
        self._models = [Increments(*sampled_actuator(delay, lag, sampling)) for delay in (forward, backward)]
        self._residual = Residual(parameters.hidden)
        self.reset()

    def reset(self) -> None:
        """Go back to the nominal model and an empty past."""
        for model in self._models:
            model.reset()
        self._residual.reset()
        self._laws: list[LinearLaw | None] = [None, None]
        self._speeds: list[float] = []
        self._sent: list[float] = []
        self._xi = 0.0

    def step(self, speed: float, sent: float, ahead: Array, cut: bool) -> float:
        """Return the command acceleration [m/s²].

        Parameters
        ----------
        speed
            m/s.
        sent
            Acceleration that the last command asked for, as sent [m/s²].
        ahead : Array, shape (N,)
            Reference speed at the coming samples [m/s].
        cut
            The last command was at a limit: nothing is learnt.
        """
        self._remember(speed, sent)
        side = int(self._sent[0] < 0.0)
        if not cut and abs(speed) > SLOWEST:
            self._learn(side)
        law = self._law(side)
        v, u = np.array(self._speeds[:3]), np.array(self._sent[:2])
        wanted = law.scale * (law.tracking @ ahead) - law.feedback @ v - law.past @ u
        return float(wanted) - self._xi * law.unmodelled

    def coast(self, sent: float) -> None:
        """Take a sample without a measurement: the speed is what the model says, and nothing is learnt."""
        if self._speeds:
            commands = [sent, *self._sent[:3]]
            model = self._models[int(sent < 0.0)]
            self._remember(self._xi - model.miss([0.0, *self._speeds[:3]], commands), sent)

    def _remember(self, speed: float, sent: float) -> None:
        self._speeds = [speed, *self._speeds[:3]] if self._speeds else [speed] * 4
        self._sent = [sent, *self._sent[:3]] if self._sent else [0.0] * 4

    def _learn(self, side: int) -> None:
        p, model = self._p, self._models[side]
        left = model.miss(self._speeds, self._sent)
        if p.unmodelled:
            self._residual.learn(left, p.rate)
            self._xi = self._residual.estimate(self._speeds[:3], self._sent[:3])
        if p.identify != "none":
            one_sided = all((u < 0.0) == (side == 1) for u in self._sent[:3])
            error = left - self._xi
            if one_sided and abs(error) > 2.0 * p.dead_zone:
                model.learn(self._speeds, self._sent, error, p.identify == "absolute")
                self._laws[side] = None

    def _law(self, side: int) -> LinearLaw:
        """Return the law of the present model, worked out anew when the model changed."""
        found = self._laws[side]
        if found is None:
            a, b = self._models[side].polynomials()
            found = self._laws[side] = linear_law(a, b, self._p)
        return found


class LinearLaw(NamedTuple):
    """First command of (18): u = scale P w - Fc v - (Hc - 1) u - Lc xi."""

    tracking: Array
    feedback: Array
    past: Array
    unmodelled: float
    scale: float


def linear_law(a: Array, b: Array, p: GpcParameters) -> LinearLaw:
    """Return the law for A(z⁻¹), B(z⁻¹): Fc = sum P_j F_j, Hc = 1 + z⁻¹ sum P_j H_j, Lc = sum P_j E_j(1), (19)."""
    e, f = diophantine(a, p.n)
    g, h = response_and_past(e, b, p.n)
    rows = first_row(g, p)
    feedback, past = rows @ f, rows @ h
    scale = (a.sum() * (1.0 + past.sum()) / b.sum() + feedback.sum()) / rows.sum()
    return LinearLaw(rows, feedback, past, float(rows @ np.cumsum(e)), float(scale))


def first_row(g: Array, p: GpcParameters) -> Array:
    """Return the first row of (G'QG + lam)⁻¹ G'Q, shape (N,)."""
    matrix = np.zeros((p.n, p.nu))
    for column in range(p.nu):
        matrix[column:, column] = g[: p.n - column]
    if p.beyond == "hold":
        for row in range(p.nu, p.n):
            matrix[row, p.nu - 1] = g[: row - p.nu + 2].sum()
    gain = np.linalg.solve(matrix.T @ matrix + p.lam * np.eye(p.nu), matrix.T)
    return np.asarray(gain[0])
