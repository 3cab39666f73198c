"""Prediction by a copy of the whole nominal train: any law, printed ones too, on a train that answers at once.

Shows a law the train it was written for: one that answers at once.

The copy runs T = tau + Ta ahead of the real train, with ideal actuators and the same brake policy, and is driven by the
commands that are sent. The law sees the copy, put right by what the real train is off from where the copy was T ago
(a Smith predictor of the full multi-mass train; one of the rigid train does not help a long one)::

    x_seen = x_copy(t + T) + x(t) - x_copy(t)       the same for v;  coupler and shoe forces are the copy's

The lag is taken as so much more delay. The mismatch of train and model acts undamped for T: on daqin_heavy_haul `smc`
has an RMSE of .009 km/h nominally and .15 with moderate mismatch, where `twin` with `pid` has .005 and .07.

Needs: the model's consist and line whole, since all its vehicles are simulated; any law (`gpc` with ``delay: none``).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from plant_sim.train import Train
from train_ato.compensate.contract import Situation, View
from train_ato.compensate.copy import nominal_copy
from train_ato.compensate.none import NoCompensation
from train_ato.control.contract import parameter
from train_ato.types import Array

if TYPE_CHECKING:
    from train_ato.brake.policy import BrakePolicy
    from train_ato.model import TrainModel


@dataclass(frozen=True)
class TrainPredictorParameters:
    """Parameters of :class:`TrainPredictor`."""

    lag: bool = parameter(True, "", 0, 1, "predict over the actuators' lag as well as the delay")
    delay_factor: float = parameter(1.0, "1", 0.0, 10.0, "predict over so many times the model's delay")
    step: float = parameter(0.005, "s", 1e-4, 0.1, "integration step of the copy")


class TrainPredictor(NoCompensation):
    """State and coupler forces predicted by a copy of the whole nominal train."""

    Parameters: ClassVar[type] = TrainPredictorParameters
    predicts: ClassVar[bool] = True

    def __init__(self, parameters: TrainPredictorParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        lead = float(model.delay.mean()) * parameters.delay_factor + (model.lag if parameters.lag else 0.0)
        self._ticks = round(lead / period)
        self._lead = self._ticks * period
        self._policy: BrakePolicy | None = None
        self._copy: Train | None = None
        self._sent: Array | None = None
        self._past: deque[tuple[Array, Array]] = deque(maxlen=self._ticks + 1)
        self._start = self._t = 0.0

    def set_brake_policy(self, policy: BrakePolicy) -> None:
        """Take the policy that the copy's own air brake follows."""
        self._policy = policy if self.model.consist.air_brake is not None else None

    def reset(self) -> None:
        """Begin anew with the next step."""
        super().reset()
        self._copy = None
        self._past.clear()

    def sent(self, force: Array) -> None:
        """Take note of the command of this step."""
        self._sent = force

    def see(self, now: Situation) -> View:
        """Return the train as it will be when the command has its effect."""
        if self._copy is None:
            self._begin(now.t)
            self._remember()
        for _ in range(round((now.t - self._t) / self.period)):
            self._advance()
            self._remember()
        self._t = now.t
        copy = self._copy
        assert copy is not None
        units = list(self.model.units)
        position, velocity = self._past[-1]
        then_position, then_velocity = self._past[0]
        place, speed, acceleration, jerk = self.rigid.profile.at(now.t + self._lead)
        shoes = copy.shoe_force
        return View(
            position=position + now.position - then_position,
            velocity=velocity + now.velocity - then_velocity,
            applied=copy.applied,
            reference_position=place - self._offsets,
            reference_velocity=speed * self._one,
            reference_acceleration=acceleration * self._one,
            acting_time=now.t + self._lead,
            lead=0.0,
            acting_acceleration=acceleration,
            acting_jerk=jerk,
            feedforward=self.shared(self.rigid.total(now.t + self._lead) + float(shoes.sum())),
            shoe_force=shoes[units],
            train_shoe_force=float(shoes.sum()),
            coupler_force=copy.coupler_force[list(self.model.sensors)],
        )

    def _begin(self, t: float) -> None:
        """Make the copy as the real train is to be now, and let it run ahead without a command."""
        self._copy = nominal_copy(self.model, self.rigid.profile, t, self.period, self.parameters.step)
        self._start = self._t = t
        self._sent = np.zeros(self.model.n_units)
        for _ in range(self._ticks):
            self._remember()
            self._advance()

    def _remember(self) -> None:
        assert self._copy is not None
        units = list(self.model.units)
        self._past.append((self._copy.position[units], self._copy.velocity[units]))

    def _advance(self) -> None:
        assert self._copy is not None
        assert self._sent is not None
        pressure = None
        if self._policy is not None:
            front = float(self._copy.position[0])
            pressure = self._policy.step(self._start + self._copy.time, front, float(self._copy.velocity[0]))
        self._copy.advance(np.broadcast_to(self._sent, (self._copy.substeps, self._sent.size)), pressure)
