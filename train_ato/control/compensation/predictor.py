"""Predictor: state, reference and feed-forward of the time at which the command takes effect.

The feedback acts on the predicted state, so the delay leaves the loop as far as the model is correct. The estimate of
an observer is part of the prediction.

The commands in flight and the estimated disturbance give the motion of the train over the delay. Over every
sub-interval h of the delay, with w the total of the commands due then (a newer command that arrives first replaces
older ones)::

    F+ = w + (F - w) exp(-h/Ta),   mean force over h: w + (F - w) (1 - exp(-h/Ta)) Ta/h
    v+ = v + (mean force + d - R)/M h,   R = resistance now + its change along the reference

``train: rigid`` moves all units by the same amounts; ``train: chain`` integrates every unit with the linear springs
between the units (every vehicle driven, as in paper 002). The delay is that of the model; with ``delay: estimated`` it
is the number of ticks, up to ``longest``, for which the commands sent explain the measured force best.

Needs: any law (`gpc` with ``delay: none``); delay and lag of the model. ``train: chain`` needs every vehicle driven and
linear draft gears without slack; ``delay: estimated`` needs a delay of the model above 0. A rigid prediction does not
improve the control of a long train: see `twin` and `train_predictor`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from train_ato.control.algorithms.coupled_units import CoupledUnits
from train_ato.control.algorithms.force_shares import mean_over_units, total_of_units
from train_ato.control.compensation.base import UnitState
from train_ato.control.compensation.contract import CompensationInput
from train_ato.control.compensation.delay_estimate import DelayEstimate
from train_ato.control.compensation.preview import PreviewFeedforward, PreviewParameters
from train_ato.control.contract import LawInput, parameter
from train_ato.control.parameters import RefusedParameter
from train_ato.messages.types import Array

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel


@dataclass(frozen=True)
class PredictorParameters(PreviewParameters):
    """Parameters of :class:`Predictor`."""

    train: str = parameter("rigid", "", 0, 0, "one rigid mass, or units coupled by springs", choices=("rigid", "chain"))
    delay: str = parameter("model", "", 0, 0, "delay of the model, or estimated", choices=("model", "estimated"))
    longest: float = parameter(2.0, "s", 0.0, 10.0, "largest estimated delay")
    disturbance: bool = parameter(True, "", 0, 1, "use the estimate of the observer in the prediction")


class Predictor(PreviewFeedforward):
    """State, reference and feed-forward of the time of effect, from the commands in flight."""

    Parameters: ClassVar[type] = PredictorParameters
    predicts: ClassVar[bool] = True

    def __init__(self, parameters: PredictorParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        self._coupled_units = CoupledUnits(model) if parameters.train == "chain" else None
        self._estimate = None
        self._last_step: float | None = None
        if parameters.delay == "estimated":
            if model.delay.max() <= 0.0:
                reason = "delay: estimated needs an initial delay"
                raise RefusedParameter(reason, "delay: model", "give model.delay a value above 0")
            self._estimate = DelayEstimate(model, parameters.longest)

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
            self.forward = self.backward = [self._estimate.delay] * self.model.n_units
        delay = self.mean_delay(inputs.commands_in_flight)
        effect = now + delay
        shoes = self.shoes_along(effect)
        state = UnitState(measured.position, measured.velocity, measured.applied)
        if delay > 0.0:
            state = self._predict(inputs, state, sent, delay, shoes.total)
        return self.law_input(inputs, effect, self.feedforward(now, shoes.total), shoes, state)

    def _predict(self, inputs: CompensationInput, now: UnitState, sent: Array, delay: float, shoes: float) -> UnitState:
        """Return the state of the units after the delay [s]."""
        count = max(1, math.ceil(delay / self.model.tick - 1e-9))
        h = delay / count
        due = self._due(sent, count, h)
        decay = math.exp(-h / self.model.lag) if self.model.lag > 0.0 else 0.0
        lasting = (1.0 - decay) * self.model.lag / h
        disturbance = inputs.disturbance if self.parameters.disturbance else 0.0 * inputs.disturbance
        resisting = self._resistance(inputs.t, now, count, h, shoes)
        if self._coupled_units is not None:
            own = self.model.own_resistance(now.velocity, now.position)
            more = np.array(resisting) - float(own.sum())
            others = disturbance - own - more[:, None] * self._coupled_units.weight
            return UnitState(*self._coupled_units.predict(*now, due, h, decay, lasting, others))
        force, wanted = total_of_units(now.applied), due.sum(axis=1).tolist()
        push, mass = float(disturbance.sum()), self.model.inertia
        speed, moved = 0.0, 0.0
        start = mean_over_units(self._share, now.velocity.tolist())
        for command, resistance in zip(wanted, resisting, strict=True):
            mean = command + (force - command) * lasting
            pull = (mean + push - resistance) / mass
            moved += (start + speed + 0.5 * pull * h) * h
            speed += pull * h
            force = command + (force - command) * decay
        applied = now.applied
        for row in due:
            applied = row + (applied - row) * decay
        if start >= 0.0 > start + speed:
            moved, speed = max(moved, 0.0), -start
        return UnitState(now.position + moved, now.velocity + speed, np.asarray(applied))

    def _resistance(self, t: float, now: UnitState, count: int, h: float, shoes: float) -> list[float]:
        """Return the resisting force of the train in the middle of every sub-interval [N]."""
        model, rigid = self.model, self.rigid
        speed = mean_over_units(self._share, now.velocity.tolist())
        base = model.resisting_force(model.front(now.position), speed, shoes) - rigid.resistance(t)
        return [base + rigid.resistance(t + (k + 0.5) * h) for k in range(count)]

    def _due(self, sent: Array, count: int, h: float) -> Array:
        """Return the commands that are due in the middle of every sub-interval [N], shape (count, units)."""
        tick = self.model.tick
        oldest = sent.shape[0]
        if oldest == 0:
            return np.zeros((count, self.model.n_units))
        if self.forward == self.backward and min(self.forward) == max(self.forward):
            return np.asarray(sent[_rows_due(oldest, count, self.forward[0], h, tick)])
        due = np.empty((count, self.model.n_units))
        for unit, column in enumerate(sent.T.tolist()):
            forward, backward = self.forward[unit], self.backward[unit]
            for k in range(count):
                due[k, unit] = _newest_arrived(column, (k + 0.5) * h, tick, forward, backward)
        return due


@lru_cache(maxsize=16)  # the same in every tick of a constant delay: 5 us
def _rows_due(oldest: int, count: int, delay: float, h: float, tick: float) -> NDArray[np.intp]:
    """Return the rows of ``oldest`` commands in flight that are due in the middle of every sub-interval."""
    ages = [delay - (k + 0.5) * h for k in range(count)]
    return np.array([oldest - min(max(math.ceil(age / tick - 1e-9), 1), oldest) for age in ages], dtype=np.intp)


def _newest_arrived(column: list[float], later: float, tick: float, forward: float, backward: float) -> float:
    """Return the newest command that has arrived ``later`` seconds from now; the oldest if none has arrived."""
    for back, command in enumerate(reversed(column), start=1):
        if (backward if command < 0.0 else forward) - back * tick <= later + 1e-9:
            return command
    return column[0]
