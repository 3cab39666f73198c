"""Prediction by a simulated copy of the whole nominal train (Smith predictor of the multi-mass train).

The law controls a train without delay. This is the train for which the published laws were written.

The copy runs T = tau + Ta ahead of the real train, with ideal actuators and the same brake policy, and is driven by the
commands sent. The law receives the state of the copy, corrected by the difference between the real train and the copy
T ago::

    x_law = x_copy(t + T) + x(t) - x_copy(t)        the same for v;  coupler and shoe forces are those of the copy

The lag counts as additional delay. For the time T nothing damps the mismatch between train and model. On
daqin_heavy_haul `smc` has an RMSE of .009 km/h nominally and .15 with moderate mismatch; `twin` with `pid` has .005 and
.07. A Smith predictor of the rigid train does not improve the control of a long train.

Needs: consist and line of the model, since all vehicles are simulated; any law (`gpc` with ``delay: none``).
"""

from collections import deque
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from plant_sim.elementary import total_of_units
from plant_sim.train import Train
from train_ato.control.air_brake.record_policy import BrakePolicy
from train_ato.control.air_brake.shoes import ShoeForces
from train_ato.control.compensation.ahead_train import nominal_copy
from train_ato.control.compensation.base import CompensationBase, UnitState
from train_ato.control.compensation.contract import CompensationInput
from train_ato.control.compensation.preview import PreviewParameters
from train_ato.control.contract import LawInput, parameter
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array


@dataclass(frozen=True)
class TrainPredictorParameters(PreviewParameters):
    """Parameters of :class:`TrainPredictor`."""

    step: float = parameter(0.005, "s", 1e-4, 0.1, "integration step of the copy")


class TrainPredictor(CompensationBase):
    """State and coupler forces predicted by a simulated copy of the nominal train."""

    Parameters: ClassVar[type] = TrainPredictorParameters
    predicts: ClassVar[bool] = True

    def __init__(self, parameters: TrainPredictorParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        lead = float(model.delay.mean()) * parameters.delay_factor + (model.lag if parameters.lag else 0.0)
        self._units, self._couplers = np.array(model.units, dtype=np.int64), np.array(model.sensors, dtype=np.int64)
        self._ticks = round(lead / period)
        self._lead = self._ticks * period
        self._policy: BrakePolicy | None = None
        self._copy: Train | None = None
        self._sent: Array = np.zeros(model.n_units)
        self._past: deque[tuple[Array, Array]] = deque(maxlen=self._ticks + 1)
        self._start = self._t = 0.0

    def set_brake_policy(self, policy: BrakePolicy) -> None:
        """Set the policy for the air brake of the copy."""
        self._policy = policy if self.model.consist.air_brake is not None else None

    def reset(self) -> None:
        """Discard the copy; the next step starts a new one."""
        super().reset()
        self._copy = None
        self._past.clear()

    def on_command_sent(self, force: Array) -> None:
        """Store the command of this step [N], shape (units,)."""
        self._sent = force

    def step(self, inputs: CompensationInput) -> LawInput:
        """Return the predicted state of the time of effect."""
        t = inputs.t
        copy = self._copy or self._begin(t)
        for _ in range(round((t - self._t) / self.period)):
            self._advance(copy)
        self._t = t
        (position, velocity), (then_position, then_velocity) = self._past[-1], self._past[0]
        measured = inputs.measurement
        state = UnitState(
            position + measured.position - then_position, velocity + measured.velocity - then_velocity, copy.applied
        )
        forces = copy.shoe_force
        shoes = ShoeForces(float(forces.sum()), forces[self._units])
        effect = t + self._lead
        feedforward = self.shared(self.rigid.ahead(effect) + shoes.total)
        couplers = copy.coupler_force[self._couplers]
        return self.law_input(inputs, effect, feedforward, shoes, state, couplers)

    def _begin(self, t: float) -> Train:
        """Start the copy at the reference state and advance it by the lead without a command."""
        self._copy = copy = nominal_copy(self.model, self.rigid.profile, t, self.period, self.parameters.step)
        self._start = self._t = t
        self._sent = np.zeros(self.model.n_units)
        self._demand = np.zeros((copy.substeps, self.model.n_units))
        self._past.append((copy.position[self._units], copy.velocity[self._units]))
        for _ in range(self._ticks):
            self._advance(copy)
        return copy

    def _advance(self, copy: Train) -> None:
        pressure = None
        if self._policy is not None:
            time, force = self._start + copy.time, total_of_units(copy.applied)
            pressure = self._policy.step(time, float(copy.position[0]), float(copy.velocity[0]), force)
        self._demand[:] = self._sent
        copy.advance(self._demand, pressure)
        self._past.append((copy.position[self._units], copy.velocity[self._units]))
