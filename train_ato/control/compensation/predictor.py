"""Predictor: the law sees the train as it will be when the command acts.

Feedback acts on what will be, not on what was: the delay leaves the loop, as far as the model is right. With an
observer it also knows what pushes.

The commands under way are known, so the train's motion over the delay is too, up to the disturbance, which the observer
tells. Over every sub-interval h of the delay, with w the total of the commands due then (a newer command that arrives
first replaces older ones)::

    F+ = w + (F - w) exp(-h/Ta),   mean force over h: w + (F - w) (1 - exp(-h/Ta)) Ta/h
    v+ = v + (mean force + d - R)/M h,   R = resistance now + its change along the reference

``train: rigid`` moves the whole train by the same amounts; ``train: chain`` integrates every unit with the linear
springs between them (every vehicle driven, the train of paper 002). The delay is the model's, or, ``delay: estimated``,
the one among the ticks up to ``longest`` that explains the measured force from the commands sent best.

Needs: any law (`gpc` with ``delay: none``); delay and lag of the model. ``train: chain`` needs every vehicle driven and
linear draft gears without slack; ``delay: estimated`` a first guess above 0. A rigid prediction does not help a long
train: see `twin` and `train_predictor`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from train_ato.compensate.contract import Situation, View
from train_ato.compensate.delay_estimate import DelayEstimate
from train_ato.compensate.preview import Preview, PreviewParameters
from train_ato.control.contract import parameter
from train_ato.control.parts.chain import Chain
from train_ato.control.parts.shares import mean_over_units
from train_ato.types import Array

if TYPE_CHECKING:
    from train_ato.model import TrainModel


@dataclass(frozen=True)
class PredictorParameters(PreviewParameters):
    """Parameters of :class:`Predictor`."""

    train: str = parameter("rigid", "", 0, 0, "one rigid mass, or units joined by springs", choices=("rigid", "chain"))
    delay: str = parameter("model", "", 0, 0, "the model's delay, or estimated", choices=("model", "estimated"))
    longest: float = parameter(2.0, "s", 0.0, 10.0, "largest delay that is looked for when it is estimated")
    disturbance: bool = parameter(True, "", 0, 1, "the observer's estimate acts during the delay as well")


class Predictor(Preview):
    """State, reference and feed-forward of the time the command will act, from the commands under way."""

    Parameters: ClassVar[type] = PredictorParameters
    predicts: ClassVar[bool] = True

    def __init__(self, parameters: PredictorParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        self._chain = Chain(model) if parameters.train == "chain" else None
        self._estimate = None
        self._seen: float | None = None
        if parameters.delay == "estimated":
            if model.delay.max() <= 0.0:
                raise ValueError("delay: estimated needs a first guess: give model.delay a value above 0")
            self._estimate = DelayEstimate(model, parameters.longest)

    def reset(self) -> None:
        """Forget the commands sent."""
        super().reset()
        self._seen = None
        if self._estimate is not None:
            self._estimate.reset()

    def see(self, now: Situation) -> View:
        """Return predicted state, reference and feed-forward of the acting time."""
        self.shoes.tell(now.t, now.pressure)
        sent = now.under_way
        if self._estimate is not None:
            ticks = 1 if self._seen is None else max(1, round((now.t - self._seen) / self.model.tick))
            self._seen = now.t
            sent = self._estimate.step(now.under_way, float(now.applied.sum()), ticks)
            self.forward = self.backward = [self._estimate.delay] * self.model.n_units
        delay = self.mean_delay(now.under_way)
        t = now.t + delay
        place, speed, acceleration, jerk = self.rigid.profile.at(t)
        shoes = self.shoes.at(t, speed)
        position, velocity, applied = now.position, now.velocity, now.applied
        if delay > 0.0:
            position, velocity, applied = self._predict(now, sent, delay, shoes.total)
        return View(
            position=position,
            velocity=velocity,
            applied=applied,
            reference_position=place - self._offsets,
            reference_velocity=speed * self._one,
            reference_acceleration=acceleration * self._one,
            acting_time=t,
            lead=0.0,
            acting_acceleration=acceleration,
            acting_jerk=jerk,
            feedforward=self.led(now.t, shoes.total),
            shoe_force=shoes.own,
            train_shoe_force=shoes.total,
        )

    def _predict(self, now: Situation, sent: Array, delay: float, shoes: float) -> tuple[Array, Array, Array]:
        """Return position, speed and applied force of every unit a delay later."""
        count = max(1, math.ceil(delay / self.model.tick - 1e-9))
        h = delay / count
        due = self._due(sent, count, h)
        keep = math.exp(-h / self.model.lag) if self.model.lag > 0.0 else 0.0
        lasting = (1.0 - keep) * self.model.lag / h
        disturbance = now.disturbance if self.parameters.disturbance else 0.0 * now.disturbance
        resisting = self._resistance(now, count, h, shoes)
        if self._chain is not None:
            own = self.model.own_resistance(now.velocity, now.position)
            more = np.array(resisting) - float(own.sum())
            others = disturbance - own - np.outer(more, self._chain.weight)
            return self._chain.predict(now, due, h, keep, lasting, others)
        force, wanted = float(now.applied.sum()), due.sum(axis=1).tolist()
        push, mass = float(disturbance.sum()), self.model.inertia
        speed, moved = 0.0, 0.0
        start = mean_over_units(self._share, now.velocity.tolist())
        for command, resistance in zip(wanted, resisting, strict=True):
            mean = command + (force - command) * lasting
            pull = (mean + push - resistance) / mass
            moved += (start + speed + 0.5 * pull * h) * h
            speed += pull * h
            force = command + (force - command) * keep
        applied = now.applied
        for row in due:
            applied = row + (applied - row) * keep
        if start >= 0.0 > start + speed:
            moved, speed = max(moved, 0.0), -start
        return now.position + moved, now.velocity + speed, np.asarray(applied)

    def _resistance(self, now: Situation, count: int, h: float, shoes: float) -> list[float]:
        """Return what holds the train back in the middle of every sub-interval [N]."""
        model, rigid = self.model, self.rigid
        speed = mean_over_units(self._share, now.velocity.tolist())
        place = float(now.position[0]) + float(self._offsets[0])
        base = model.running_resistance(speed) + model.line_force(place) + shoes - rigid.resistance(now.t)
        return [base + rigid.resistance(now.t + (k + 0.5) * h) for k in range(count)]

    def _due(self, sent: Array, count: int, h: float) -> Array:
        """Return the command of every unit that is due in the middle of every sub-interval, shape (count, units)."""
        tick = self.model.tick
        oldest = sent.shape[0]
        if oldest == 0:
            return np.zeros((count, self.model.n_units))
        if self.forward == self.backward and min(self.forward) == max(self.forward):
            ages = [self.forward[0] - (k + 0.5) * h for k in range(count)]
            rows = [oldest - min(max(math.ceil(age / tick - 1e-9), 1), oldest) for age in ages]
            return np.asarray(sent[rows])
        due = np.empty((count, self.model.n_units))
        for unit, column in enumerate(sent.T.tolist()):
            forward, backward = self.forward[unit], self.backward[unit]
            for k in range(count):
                due[k, unit] = _newest_arrived(column, (k + 0.5) * h, tick, forward, backward)
        return due


def _newest_arrived(column: list[float], later: float, tick: float, forward: float, backward: float) -> float:
    """Return the newest command that has arrived ``later`` seconds from now; the oldest if none has."""
    for back, command in enumerate(reversed(column), start=1):
        if (backward if command < 0.0 else forward) - back * tick <= later + 1e-9:
            return command
    return column[0]
