"""Damping of the motion of coupled units against their train, on the state after the delay.

A plan for one mass leaves the motion between driven vehicles on soft couplers undamped. The deviations of the units
from the mean of the train, weighted by mass, are advanced by the springs between the units
(:class:`train_ato.control.algorithms.coupled_units.CoupledUnits`) with the measured forces, and corrected by the part
``FILTER`` omega_u Tc of their difference from the measurement. This is stable for every train, because springs and
dampers do not add energy. Over the delay the commands in flight act. With the deviations x_i, v_i after the delay and
the disturbance d_i of an observer::

    F_i = -m_i (omega_u v_i + (omega_u/2)² x_i) - (d_i - m_i/M sum d)

The forces add to 0, so that they do not change the motion of the train. Both gains together are a double pole
at -omega_u/2 of a unit without springs.
"""

# mypy: allow-untyped-defs

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.summation import plain_dot, plain_sum
from train_ato.control.algorithms import predictive_plan
from train_ato.control.algorithms.coupled_units import CoupledUnits
from train_ato.control.algorithms.predictive_plan import newest_arrived
from train_ato.control.parameters import RefusedParameter

if TYPE_CHECKING:
    from train_ato.control.contract import LawInput
    from train_ato.control.train_model import TrainModel
    from train_ato.messages.types import Array

FILTER = 1.0
"""Bandwidth of the filter of the deviations over omega_u."""


@compiled(uses=(predictive_plan,))
def commands_due(sent, actuators, tick, due):
    """Compute the command of every unit that is due in the middle of every tick of the delay [N].

    Parameters
    ----------
    sent : Array, shape (d, units)
        Commands sent, oldest first [N].
    actuators : Array, shape (3, units)
        Delay in traction and braking [s], share of the force.
    tick
        s.
    due : Array, shape (ticks, units)
        Result [N].
    """
    for k in range(due.shape[0]):
        for i in range(due.shape[1]):
            due[k, i] = newest_arrived(sent, i, (k + 0.5) * tick, tick, actuators[0, i], actuators[1, i])


class UnitDeviations:
    """Forces against the deviations of the units from the mean of their train.

    Parameters
    ----------
    model
        The nominal train.
    omega
        omega_u, gain on a deviation of the speed [rad/s].
    period
        Control period [s].
    first_weight
        Weight of the first force of a period in its mean.

    Raises
    ------
    RefusedParameter
        If a vehicle is not driven or a draft gear is not a linear spring without slack.
    """

    def __init__(self, model: TrainModel, omega: float, period: float, first_weight: float) -> None:
        self._units = CoupledUnits(model)
        self._weight: list[float] = self._units.weight.tolist()
        self._offsets = model.offsets
        self._tick, self._lag = model.tick, model.lag
        self._gains = (omega, 0.25 * omega * omega)
        self._map = self._units.step_matrix(period)
        self._part = min(1.0, FILTER * omega * period)
        self._mean_weight = first_weight
        self.reset()

    def reset(self) -> None:
        """Restart at the next measurement."""
        self._state: Array | None = None
        self._applied: Array = np.zeros(self._units.n)

    @classmethod
    def of(cls, model: TrainModel, omega: float, period: float, first_weight: float) -> UnitDeviations | None:
        """Return the damping for a train, or None if the train has no such units."""
        if model.n_units < 2:
            return None
        try:
            return cls(model, omega, period, first_weight)
        except RefusedParameter:
            return None

    def forces(self, inputs: LawInput, sent: Array, actuators: Array, ticks: int) -> list[float]:
        """Return the added force of every unit [N]; their sum is 0.

        Parameters
        ----------
        inputs
            Inputs of the law, with the measured state.
        sent : Array, shape (d, units)
            Commands in flight, oldest first [N].
        actuators : Array, shape (3, units)
            Delay in traction and braking [s], share of the force.
        ticks
            Number of ticks of the longest delay.
        """
        own = self._between(inputs.disturbance)
        applied = inputs.applied
        measured = np.concatenate(
            (self._deviations(inputs.position + self._offsets), self._deviations(inputs.velocity))
        )
        if self._state is None:
            self._state = measured
        else:
            mean = self._mean_weight * self._applied + (1.0 - self._mean_weight) * applied
            advanced = self._map.dot(np.concatenate((self._state, self._between(mean) + own)))
            self._state = advanced + self._part * (measured - advanced)
        self._applied = applied
        n = own.size
        places, speeds = self._state[:n] - self._offsets, self._state[n:]
        if ticks:
            due = np.empty((ticks, n))
            commands_due(sent, actuators, self._tick, due)
            decay = math.exp(-self._tick / self._lag) if self._lag > 0.0 else 0.0
            lasting = (1.0 - decay) * self._lag / self._tick
            places, speeds, _ = self._units.predict(
                places, speeds, applied, due, self._tick, decay, lasting, np.tile(own, (ticks, 1))
            )
        on_speed, on_place = self._gains
        wanted = on_speed * self._deviations(speeds) + on_place * self._deviations(places + self._offsets)
        forces: list[float] = (-self._units.mass * wanted - own).tolist()
        return forces

    def _deviations(self, values: Array) -> Array:
        """Return values of the units minus their mean, weighted by mass, shape (units,)."""
        return values - plain_dot(self._weight, values.tolist())

    def _between(self, forces: Array) -> Array:
        """Return forces minus those that move the train without deviations [N], shape (units,)."""
        return forces - plain_sum(forces.tolist()) * self._units.weight
