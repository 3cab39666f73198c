"""Base of the delay compensations: profile, air-brake forecast, and the input of the law made from them."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.record import Records, quantity, zeros
from train_ato.control.air_brake.shoes import ShoeForces, ShoeForecast
from train_ato.control.algorithms.limits_ahead import LimitsAhead
from train_ato.control.compensation.contract import CompensationInput
from train_ato.control.compensation.rigid import RigidForce, demand_ahead
from train_ato.control.contract import NO_LOOKAHEAD, LawInput, Lookahead, Preview
from train_ato.control.train_model import Actuator, TrainModel
from train_ato.messages.types import Array

NO_PREVIEW = Preview(np.zeros(0), np.zeros(0), np.zeros(0))
"""Preview of a law that uses none."""


class UnitState(NamedTuple):
    """Position [m], speed [m/s] and applied force [N] of every power unit, each of shape (units,)."""

    position: Array
    velocity: Array
    applied: Array


@dataclass
class AlongProfile:
    """Constants of the feed-forward, for the forces of a profile."""

    begin: float = quantity("s", "time of the first force")
    spacing: float = quantity("s", "time between two forces")
    lag: float = quantity("s", "lag that the feed-forward compensates")


@compiled
def feedforwards(
    all_p: Records[AlongProfile], actuators: Records[Actuator], forces: Array, times: Array, shoes: Array
) -> Array:
    """Return the feed-forward of all units at the times of their commands [N], shape (times, units).

    The delay is that of the sign of the force.

    Parameters
    ----------
    all_p, actuators
        Constants and delays.
    forces : Array, shape (knots,)
        Force of the nominal train along the profile [N].
    times, shoes : Array, shape (times,)
        Times of the commands [s] and shoe force of the train at their effect [N].
    """
    p, found = all_p[0], np.empty((times.size, actuators.size))
    for i in range(times.size):
        force, forward, backward = 0.0, -1.0, -1.0
        for u in range(actuators.size):
            a = actuators[u]
            if a.forward != forward or a.backward != backward:  # mostly the same for all units
                forward, backward = a.forward, a.backward
                force = demand_ahead(forces, p.begin, p.spacing, p.lag, times[i] + forward) + shoes[i]
                if force < 0.0 and backward != forward:
                    force = demand_ahead(forces, p.begin, p.spacing, p.lag, times[i] + backward) + shoes[i]
                    force = min(force, 0.0)
            found[i, u] = a.share * force
    return found


class CompensationBase:
    """Profile, forecast of the shoe forces and force shares; a subclass changes ``step()`` or ``feedforwards()``.

    Parameters
    ----------
    parameters
        Parameters of the subclass.
    model
        The nominal train.
    period
        Control period [s].
    """

    def __init__(self, parameters: Any, model: TrainModel, period: float) -> None:
        self.parameters = parameters
        CompensationBase.bind(self, model, period)

    def bind(self, model: TrainModel, period: float) -> None:
        """Take the model of the train and the control period [s], the start of one with keyword parameters."""
        self.model = model
        self.period = period
        self._along, self.actuators = zeros(AlongProfile, 1), zeros(Actuator, model.n_units)
        self.actuators["share"] = model.share
        self.rigid: RigidForce
        self._limits: LimitsAhead | None = None
        self.shoes = ShoeForecast(model)

    def set_profile(self, rigid: RigidForce) -> None:
        """Set the profile with the forces along it."""
        self.rigid = rigid
        self._along["begin"], self._along["spacing"] = rigid.begin, rigid.spacing

    def reset(self) -> None:
        """Clear the brake events."""
        self.shoes = ShoeForecast(self.model)

    def shoes_along(self, t: float) -> ShoeForces:
        """Return the shoe forces at a time [s] and the speed of the profile then."""
        return self.shoes.at(t, 0.0 if self.shoes.idle else self.rigid.profile.at(t)[1])

    def shared(self, force: float) -> Array:
        """Return a total force split over the units by their shares [N], shape (units,)."""
        return force * self.model.share

    def feedforwards(self, times: Array, shoes: Array) -> Array:
        """Return the feed-forward of the units [N], shape (times, units).

        Parameters
        ----------
        times : Array, shape (times,)
            Times at which the commands are sent [s].
        shoes : Array, shape (times,)
            Shoe force of the train when they take effect [N].
        """
        return np.asarray(feedforwards(self._along, self.actuators, self.rigid.forces, times, shoes))

    def feedforward(self, t: float, shoes: float) -> Array:
        """Return :meth:`feedforwards` at one time, shape (units,)."""
        found: Array = self.feedforwards(np.array([t]), np.array([shoes]))[0]
        return found

    def step(self, inputs: CompensationInput) -> LawInput:
        """Return measured state, reference and feed-forward of the present time."""
        self.shoes.demand(inputs.t, inputs.pressure)
        shoes = self.shoes.at(inputs.t, inputs.reference.velocity)
        return self.law_input(inputs, inputs.t, self.feedforward(inputs.t, shoes.total), shoes)

    def law_input(
        self,
        inputs: CompensationInput,
        effect: float,
        feedforward: Array,
        shoes: ShoeForces,
        predicted: UnitState | None = None,
        coupler_force: Array | None = None,
    ) -> LawInput:
        """Return the input of the law, at the time of the measurement or at that of the effect of the command.

        Parameters
        ----------
        inputs
            Inputs of the step.
        effect
            Time at which the command takes effect [s].
        feedforward : Array, shape (units,)
            Feed-forward of every unit [N].
        shoes
            Shoe forces at the time of the state.
        predicted
            State at the effect, with the reference of that time; default: measured state and present reference.
        coupler_force : Array, shape (sensors,), optional
            Coupler forces at the time of the state [N]; default: the measured ones.
        """
        measurement = inputs.measurement
        profile, horizon, later = self.rigid.profile, inputs.horizon, inputs.lookahead_times
        place, speed, acceleration, jerk = profile.at(effect)
        pull, lead, state = acceleration, 0.0, predicted
        if state is None:
            state = UnitState(measurement.position, measurement.velocity, measurement.applied)
            now = inputs.reference
            place, speed, pull = now.position, now.velocity, now.acceleration
            lead = effect - inputs.t
        return LawInput(
            t=inputs.t,
            position=state.position,
            velocity=state.velocity,
            applied=state.applied,
            reference_position=place - self.model.offsets,
            reference_velocity=np.array([speed] * self.model.n_units),
            reference_acceleration=np.array([pull] * self.model.n_units),
            delay_to_effect=lead,
            acceleration_at_effect=acceleration,
            jerk_at_effect=jerk,
            feedforward=feedforward,
            preview=Preview(*profile.window(effect, horizon, self.period)) if horizon else NO_PREVIEW,
            disturbance=inputs.disturbance,
            deflection=measurement.deflection,
            rate=measurement.rate,
            coupler_force=measurement.force if coupler_force is None else coupler_force,
            shoe_force=shoes.own.copy(),
            train_shoe_force=shoes.total,
            commands_in_flight=inputs.commands_in_flight,
            force_min=inputs.force_min,
            force_max=inputs.force_max,
            saturated=inputs.saturated,
            lookahead=NO_LOOKAHEAD if later is None else self._lookahead(inputs, effect, later),
        )

    def _lookahead(self, inputs: CompensationInput, effect: float, later: Array) -> Lookahead:
        """Return the reference and known forces at the times of the law; the shoe force of the effect lasts."""
        times = inputs.t + later
        position, velocity, acceleration = self.rigid.profile.at_times(times)
        resistance = self.rigid.resistances(times)
        if not self.shoes.idle:
            now = self.shoes.at(inputs.t, inputs.reference.velocity).total
            change = self.shoes_along(effect).total - now
            resistance = resistance + now + change * np.clip(later / max(effect - inputs.t, 1e-9), 0.0, 1.0)
        self._limits = self._limits or LimitsAhead(self.model)
        limit, place_max = self._limits.speed_limit(position), math.inf
        if inputs.authority is not None:
            place_max, permitted = inputs.authority(position)
            limit = np.minimum(limit, permitted)
        low, high = self._limits.force(position, velocity)
        return Lookahead(position, velocity, acceleration, resistance, limit, low, high, position_max=place_max)
