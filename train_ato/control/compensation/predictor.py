"""Predictor: state, reference and feed-forward of the time at which the command takes effect.

The feedback acts on the predicted state, so the delay leaves the loop as far as the model is correct. The estimate of
an observer is part of the prediction.

The commands in flight and the estimated disturbance give the motion of the train over the delay. The delay has
sub-intervals of the length h, and w is the total of the commands that are due in one of them. A newer command that
arrives first replaces older commands::

    F+ = w + (F - w) exp(-h/Ta),   mean force over h: w + (F - w) (1 - exp(-h/Ta)) Ta/h
    v+ = v + (mean force + d - R)/M h,   R = resistance now + its change along the reference

``train: rigid`` moves all units by the same amounts. ``train: chain`` integrates every unit with the linear springs
between the units (every vehicle driven, as in paper 002). The delay is that of the model. With ``delay: estimated`` it
is a number of ticks, at most ``longest``: the number for which the commands sent explain the measured force best.

Needs: any law (`gpc` with ``delay: none``); delay and lag of the model. ``train: chain`` needs every vehicle driven and
linear draft gears without slack; ``delay: estimated`` needs a delay of the model above 0. A rigid prediction does not
improve the control of a long train: see `twin` and `train_predictor`.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_exp, numpy_total, total_of_units
from plant_sim.railway import between_entries
from plant_sim.record import Records, quantity, zeros
from train_ato.control.algorithms.coupled_units import CoupledUnits
from train_ato.control.compensation.base import UnitState
from train_ato.control.compensation.contract import CompensationInput
from train_ato.control.compensation.preview import PreviewFeedforward, PreviewParameters, mean_delay
from train_ato.control.compensation.rigid import RigidForce
from train_ato.control.contract import LawInput, RefusedParameter, choice, flag, parameter
from train_ato.control.law import LawNow, LawUnit, TrainConstants, train_resistance
from train_ato.control.train_model import Actuator, TrainModel, newest_arrived
from train_ato.messages.types import Array

MEMORY_TIME = 60.0
"""Time constant of the error sums of the candidates [s]."""
SWITCH_RATIO = 0.8
"""Error sum of a new delay over that of the present one, below which the estimate switches."""


class DelayEstimate:
    """Bank of candidate delays, each a whole number of ticks, followed by the lag of the model.

    Parameters
    ----------
    model
        The nominal train; its delay is the initial estimate.
    longest
        Largest candidate [s].
    """

    def __init__(self, model: TrainModel, longest: float) -> None:
        self._tick = model.tick
        self._count = math.ceil(longest / model.tick) + 1
        self._lag_decay = math.exp(-model.tick / model.lag) if model.lag > 0.0 else 0.0
        self._error_decay = math.exp(-model.tick / MEMORY_TIME)
        self._first = min(round(float(model.delay.mean()) / model.tick), self._count - 1)
        self.reset()

    def reset(self) -> None:
        """Return to the initial estimate."""
        self._best = self._first
        self._sent: deque[Array] = deque(maxlen=self._count)
        self._modelled = np.zeros(self._count)
        self._error = np.zeros(self._count)

    @property
    def delay(self) -> float:
        """Present estimate [s]."""
        return self._best * self._tick

    def step(self, commands_in_flight: Array, applied: float, ticks: int = 1) -> Array:
        """Update the estimate; return the commands in flight for the estimated delay [N], shape (d', units).

        Parameters
        ----------
        commands_in_flight : Array, shape (d, units)
            Commands sent, one per tick, the last one a tick ago [N].
        applied
            Measured total force [N].
        ticks
            Ticks since the previous call: more than one for a law slower than the loop, or after missed samples.
        """
        for back in range(ticks, 0, -1):
            self._sent.append(np.array(commands_in_flight[-min(back, len(commands_in_flight))]))
            total = [float(command.sum()) for command in reversed(self._sent)]
            commands = np.array(total + [0.0] * (self._count - len(total)))
            self._modelled = commands + (self._modelled - commands) * self._lag_decay
        self._error *= self._error_decay**ticks
        self._error += (applied - self._modelled) ** 2
        best = int(np.argmin(self._error))
        if self._error[best] < SWITCH_RATIO * self._error[self._best]:
            self._best = best
        length = max(1, self._best)
        return np.array(list(self._sent)[-length:])


@dataclass(frozen=True)
class PredictorParameters(PreviewParameters):
    """Parameters of :class:`Predictor`."""

    train: str = choice("one rigid mass, or units coupled by springs", "rigid", "chain")
    delay: str = choice("delay of the model, or estimated", "model", "estimated")
    longest: float = parameter(2.0, "s", 0.0, 10.0, "largest estimated delay")
    disturbance: bool = flag("use the estimate of the observer in the prediction", default=True)


@dataclass(frozen=True)
class PredictionConstants(TrainConstants):
    """Constants of :func:`predict`."""

    tick: float = quantity("s", "time between two commands in flight")
    lag: float = quantity("s", "lag of the actuators")
    disturbance: bool = quantity("", "the estimate of the observer acts over the delay")
    begin: float = quantity("s", "time of the first entry of the resistance along the profile")
    spacing: float = quantity("s", "time between its entries")


class Chain(NamedTuple):
    """Units coupled by springs; without entries for a rigid train.

    Attributes
    ----------
    step : Array, shape (2 units, 3 units)
        Map of positions, speeds and constant forces to positions and speeds a sub-interval later.
    offsets, weights : Array, shape (units,)
        Distance behind the first vehicle [m], and part of the inertia of the train.
    """

    step: Array
    offsets: Array
    weights: Array


NONE_SENT = np.zeros((0, 0))
RIGID = Chain(np.zeros((0, 0)), np.zeros(0), np.zeros(0))


@compiled
def mean_speed(units: Records[LawUnit]) -> float:
    """Return the mean speed of the units [m/s], weighted by their shares."""
    speed: float = 0.0
    for x in units:
        speed += x.share * x.velocity
    return speed


@compiled
def sub_intervals(delay: float, tick: float) -> tuple[int, float]:
    """Return number and length [s] of the sub-intervals of a delay [s]."""
    count = max(1, math.ceil(delay / tick - 1e-9))
    return count, delay / count


@compiled
def predict_train(
    p: PredictionConstants,
    delay: float,
    actuators: Records[Actuator],
    sent: Array,
    along: Array,
    now: LawNow,
    units: Records[LawUnit],
) -> None:
    """Move all units like one rigid mass over a delay [s]; arguments as in :func:`predict`."""
    count, h = sub_intervals(delay, p.tick)
    decay = libm_exp(-h / p.lag) if p.lag > 0.0 else 0.0
    lasting = (1.0 - decay) * p.lag / h
    forces, start, push = np.empty(units.size), mean_speed(units), 0.0
    if p.disturbance:
        for u in range(units.size):
            forces[u] = units[u].disturbance
        push = numpy_total(forces)
    for u in range(units.size):
        forces[u] = units[u].applied
    force = numpy_total(forces)
    base = train_resistance(p, now, start) - between_entries(along, (now.t - p.begin) / p.spacing)
    speed, moved = 0.0, 0.0
    for k in range(count):
        for u in range(units.size):
            a = actuators[u]
            due = newest_arrived(sent, u, (k + 0.5) * h, p.tick, a.forward, a.backward)
            forces[u] = due
            units[u].applied = due + (units[u].applied - due) * decay
        command = numpy_total(forces)
        resistance = base + between_entries(along, (now.t + (k + 0.5) * h - p.begin) / p.spacing)
        pull = (command + (force - command) * lasting + push - resistance) / p.inertia
        moved += (start + speed + 0.5 * pull * h) * h
        speed += pull * h
        force = command + (force - command) * decay
    if start >= 0.0 > start + speed:
        moved, speed = max(moved, 0.0), -start
    for x in units:
        x.position += moved
        x.velocity += speed


@compiled
def predict_chain(
    p: PredictionConstants,
    delay: float,
    chain: Chain,
    actuators: Records[Actuator],
    sent: Array,
    along: Array,
    now: LawNow,
    units: Records[LawUnit],
) -> None:
    """Move the units and the springs between them over a delay [s]; arguments as in :func:`predict`."""
    n, step = units.size, chain.step
    count, h = sub_intervals(delay, p.tick)
    decay = libm_exp(-h / p.lag) if p.lag > 0.0 else 0.0
    lasting = (1.0 - decay) * p.lag / h
    base = train_resistance(p, now, mean_speed(units)) - between_entries(along, (now.t - p.begin) / p.spacing)
    origin = units[0].position + chain.offsets[0]
    state, moved = np.empty(3 * n), np.empty(2 * n)
    for u in range(n):
        state[2 * n + u] = units[u].resistance
        state[u], state[n + u] = units[u].position + chain.offsets[u] - origin, units[u].velocity
    own = numpy_total(state[2 * n :])
    for k in range(count):
        more = base + between_entries(along, (now.t + (k + 0.5) * h - p.begin) / p.spacing) - own
        for u in range(n):
            x = units[u]
            a = actuators[u]
            due = newest_arrived(sent, u, (k + 0.5) * h, p.tick, a.forward, a.backward)
            others = (x.disturbance if p.disturbance else 0.0) - x.resistance - more * chain.weights[u]
            state[2 * n + u] = due + (x.applied - due) * lasting + others
            x.applied = due + (x.applied - due) * decay
        for row in range(2 * n):
            moved[row] = 0.0
            for column in range(3 * n):
                moved[row] += step[row, column] * state[column]
        state[: 2 * n] = moved
    for u in range(n):
        units[u].position, units[u].velocity = state[u] + origin - chain.offsets[u], state[n + u]


@compiled
def predict(
    p: PredictionConstants,
    chain: Chain,
    actuators: Records[Actuator],
    sent: Array,
    along: Array,
    now: LawNow,
    units: Records[LawUnit],
) -> None:
    """Replace measured position, speed and force of the units by those at the effect of the command.

    Parameters
    ----------
    p, actuators
        Constants and delays.
    chain
        Springs between the units, empty for one rigid mass.
    sent : Array, shape (d, units)
        Commands in flight, oldest first [N].
    along : Array, shape (times,)
        Resistance along the profile [N].
    now
        Time, line force at the measured position and shoe force at the effect.
    units
        Measured state, resistance and disturbance of the units.
    """
    delay = mean_delay(actuators, sent)
    if delay <= 0.0:
        return
    if len(chain.weights):
        predict_chain(p, delay, chain, actuators, sent, along, now, units)
    else:
        predict_train(p, delay, actuators, sent, along, now, units)


class Predictor(PreviewFeedforward):
    """State, reference and feed-forward of the time of effect, from the commands in flight."""

    Parameters: ClassVar[type] = PredictorParameters
    predicts: ClassVar[bool] = True

    def __init__(self, parameters: PredictorParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        c0, c1, c2 = model.running
        self.constants, self.now = zeros(PredictionConstants, 1), zeros(LawNow, 1)
        self.units = zeros(LawUnit, model.n_units)
        self.units["share"], self._offsets = model.share, model.offsets.copy()
        self.constants[0] = (model.inertia, c0, c1, c2, model.tick, model.lag, parameters.disturbance, 0.0, 1.0)
        self.along: Array = np.zeros(0)
        self._coupled_units = CoupledUnits(model) if parameters.train == "chain" else None
        self._estimate = None
        self._last_step: float | None = None
        if parameters.delay == "estimated":
            if model.delay.max() <= 0.0:
                reason = "delay: estimated needs an initial delay"
                raise RefusedParameter(reason, "delay: model", "give model.delay a value above 0")
            self._estimate = DelayEstimate(model, parameters.longest)

    def set_profile(self, rigid: RigidForce) -> None:
        """Set the profile."""
        super().set_profile(rigid)
        self.constants["begin"], self.constants["spacing"] = rigid.begin, rigid.spacing
        self.along = rigid.resisting

    def reset(self) -> None:
        """Clear the brake events and the estimated delay."""
        super().reset()
        self._last_step = None
        if self._estimate is not None:
            self._estimate.reset()

    def step(self, inputs: CompensationInput) -> LawInput:
        """Return predicted state, reference and feed-forward of the time of effect."""
        now = inputs.t
        self.shoes.demand(now, inputs.pressure)
        sent, measured = inputs.commands_in_flight, inputs.measurement
        if self._estimate is not None:
            ticks = 1 if self._last_step is None else max(1, round((now - self._last_step) / self.model.tick))
            self._last_step = now
            sent = self._estimate.step(inputs.commands_in_flight, total_of_units(measured.applied), ticks)
            self.actuators["forward"] = self.actuators["backward"] = self._estimate.delay
        delay = mean_delay(self.actuators, sent)
        effect = now + delay
        shoes = self.shoes_along(effect)
        state = UnitState(measured.position, measured.velocity, measured.applied)
        if delay > 0.0:
            state = self._predict(inputs, sent, delay, shoes.total)
        return self.law_input(inputs, effect, self.feedforward(now, shoes.total), shoes, state)

    def _predict(self, inputs: CompensationInput, sent: Array, delay: float, shoes: float) -> UnitState:
        """Return the state of the units after the delay [s]."""
        measured, units, model = inputs.measurement, self.units, self.model
        units["position"], units["velocity"] = measured.position, measured.velocity
        units["applied"], units["disturbance"] = measured.applied, inputs.disturbance
        if self._coupled_units is not None:
            units["resistance"] = model.own_resistance(measured.velocity, measured.position)
        self.now["t"], self.now["train_shoe_force"] = inputs.t, shoes
        self.now["line_force"] = model.line_force(model.front(measured.position))
        predict(self.constants[0], self.chain(delay), self.actuators, sent, self.along, self.now[0], units)
        return UnitState(units["position"].copy(), units["velocity"].copy(), units["applied"].copy())

    def chain(self, delay: float) -> Chain:
        """Return the springs between the units for a delay [s]."""
        if self._coupled_units is None:
            return RIGID
        coupled, (_, h) = self._coupled_units, sub_intervals(delay, self.model.tick)
        return Chain(coupled.step_matrix(h), self._offsets, coupled.weight)

    @property
    def known_delay(self) -> float | None:
        """Mean delay of the model [s]; None for one that is estimated or depends on the sign of the commands."""
        of_sign = (self.actuators["forward"] != self.actuators["backward"]).any()
        return None if self._estimate or of_sign else mean_delay(self.actuators, NONE_SENT)
