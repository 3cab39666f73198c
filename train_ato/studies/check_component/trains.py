"""Shipped trains for the contract tests."""

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from plant_sim.library import load_consist, load_line
from train_ato.control.compensation.ahead_train import nominal_copy
from train_ato.control.compensation.contract import CompensationInput
from train_ato.control.compensation.none import NoCompensation
from train_ato.control.compensation.rigid import RigidForce
from train_ato.control.contract import LawInput, NoParameters
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array, Measurement, Reference
from train_ato.profile.profile import Profile

PERIOD = 0.1
"""Control period of the tests [s]."""
PLANT_STEP = 0.005
"""Integration step of a train with couplers [s]."""
STEPS = 600
"""Number of steps of a run."""


@dataclass(frozen=True)
class TrainSample:
    """One step of a simulated train.

    Attributes
    ----------
    state : CompensationInput
        Measured state, reference and commands in flight.
    given : LawInput
        Output of the compensation.
    force : Array, shape (units,)
        Force of the law [N].
    speed_error : float
        Speed minus reference [m/s].
    """

    state: CompensationInput
    given: LawInput
    force: Array
    speed_error: float


class RigidTrain:
    """Train as one mass.

    Parameters
    ----------
    model
        The train.
    place, speed
        Position of vehicle 0's centre [m] and speed [m/s].
    push
        Disturbance on the first vehicle [N], > 0 forward.
    """

    def __init__(self, model: TrainModel, place: float, speed: float, push: float = 0.0) -> None:
        self._model = model
        self._place, self._speed, self._push = place, speed, push

    @property
    def position(self) -> Array:
        """Position of every unit [m], shape (units,)."""
        return self._place - self._model.offsets

    @property
    def velocity(self) -> Array:
        """Speed of every unit [m/s], shape (units,)."""
        return self._speed * np.ones(self._model.n_units)

    def sensor_force(self, applied: float) -> Array:
        """Return the force of the first coupler for the force on the train [N]; empty without a sensor."""
        model = self._model
        if not model.sensors:
            return np.zeros(0)
        own = float(model.own_resistance(np.array([self._speed]), np.array([self._place]))[0])
        return np.array([applied + self._push - own - float(model.unit_mass[0]) * self._acceleration(applied)])

    def advance(self, force: Array) -> None:
        """Advance by a control period with the mean force of every unit [N], shape (units,)."""
        pull = self._acceleration(float(np.nansum(force)))
        self._place += (self._speed + 0.5 * pull * PERIOD) * PERIOD
        self._speed = max(0.0, self._speed + pull * PERIOD)

    def _acceleration(self, applied: float) -> float:
        return (applied + self._push - self._model.running_resistance(self._speed)) / self._model.inertia


class CoupledTrain:
    """Train with all its vehicles and couplers, from the begin of a profile on."""

    def __init__(self, model: TrainModel, profile: Profile) -> None:
        self._train = nominal_copy(model, profile, 0.0, PERIOD, PLANT_STEP)
        self._units, self._sensors = list(model.units), list(model.sensors)

    @property
    def position(self) -> Array:
        """Position of every unit [m], shape (units,)."""
        return np.asarray(self._train.position[self._units])

    @property
    def velocity(self) -> Array:
        """Speed of every unit [m/s], shape (units,)."""
        return np.asarray(self._train.velocity[self._units])

    def sensor_force(self, applied: float) -> Array:
        """Return the force of the couplers with a sensor [N], shape (sensors,)."""
        return np.asarray(self._train.coupler_force[self._sensors])

    def advance(self, force: Array) -> None:
        """Advance by a control period with the mean force of every unit [N], shape (units,)."""
        self._train.advance(np.broadcast_to(force, (self._train.substeps, force.size)))


MovingTrain = RigidTrain | CoupledTrain


class Bench:
    """Shipped train as a rigid body on a profile of one minute.

    Parameters
    ----------
    name
        Name of the consist.
    delay, lag
        Delay of the commands and first-order lag of the actuators [s], of train and model.
    """

    def __init__(self, name: str, delay: float = 0.0, lag: float = 0.0) -> None:
        self.name = name
        consist = load_consist(name)
        hauled = len(consist.vehicles) > len(consist.power_units)
        units = len(consist.power_units)
        delays = np.full(units, delay)
        sensors = (0,) if hauled else ()
        self.model = TrainModel(consist, load_line("level"), delays, delays, lag, PERIOD, sensors)
        self.profile = _profile_of_one_minute(self.moderate_acceleration())
        self.rigid = RigidForce(self.model, self.profile)
        self._none = NoCompensation(NoParameters(), self.model, PERIOD)
        self._none.set_profile(self.rigid)
        self._zeros = np.zeros(units)
        self._no_commands = np.zeros((0, units))

    def state(
        self, t: float, train: MovingTrain, applied: Array, law: Any = None, in_flight: Array | None = None
    ) -> CompensationInput:
        """Return the measured state of the train with the reference of a time.

        Parameters
        ----------
        t
            Time [s].
        train
            The train.
        applied : Array, shape (units,)
            Measured forces [N].
        law
            Law, for its ``horizon`` and ``lookahead_times``; default: none of both.
        in_flight : Array, shape (d, units), optional
            Commands in flight [N]; default: none.
        """
        stamp = round(t * 1e9)
        still = np.zeros(len(self.model.sensors))
        couplers = train.sensor_force(float(applied.sum()))
        measurement = Measurement(stamp, train.position, train.velocity, applied, still, still, couplers)
        reference = Reference(stamp, *self.profile.at(t)[:3])
        low, high = self.model.force_limits(measurement.velocity)
        sent = self._no_commands if in_flight is None else in_flight
        ahead = (getattr(law, "horizon", 0), getattr(law, "lookahead_times", None))
        return CompensationInput(measurement, reference, self._zeros, sent, None, low, high, False, *ahead)

    def state_on_profile(self, step: int, speed_error: float = 0.0, law: Any = None) -> CompensationInput:
        """Return the state in a step on the profile, with a speed error [m/s] and forces of 0."""
        t = step * PERIOD
        place, speed, _, _ = self.profile.at(t)
        length = round(float(self.model.delay.max()) / PERIOD)
        in_flight = np.zeros((length, self.model.n_units))
        train = RigidTrain(self.model, place, max(0.0, speed + speed_error))
        return self.state(t, train, self._zeros, law, in_flight)

    def on_profile(self, step: int, law: Any, speed_error: float = 0.0) -> LawInput:
        """Return the input of a law in a step on the profile, with a speed error [m/s] and forces of 0."""
        return self._none.step(self.state_on_profile(step, speed_error, law))

    def drive(self, law: Any, steps: int = STEPS, spoil: range = range(0)) -> tuple[Array, Array]:
        """Simulate the train under a law.

        Parameters
        ----------
        law
            The law.
        steps
            Number of steps.
        spoil
            Steps in which all measured speeds are NaN.

        Returns
        -------
        forces : Array, shape (steps, units)
            Forces of the law [N].
        errors : Array, shape (steps,)
            Speed errors [m/s].
        """
        samples = list(self.samples(law, steps, spoil))
        return np.array([sample.force for sample in samples]), np.array([sample.speed_error for sample in samples])

    def samples(
        self,
        law: Any,
        steps: int = STEPS,
        spoil: range = range(0),
        *,
        compensation: Any = None,
        train: MovingTrain | None = None,
        pressure: Callable[[float], float | None] = lambda t: None,
    ) -> Iterator[TrainSample]:
        """Simulate the train under a law and yield every step.

        Parameters
        ----------
        law, steps, spoil
            As in :meth:`drive`.
        compensation
            Compensation of the delay; default: none.
        train
            Train at the begin of the profile; default: a rigid one.
        pressure
            Brake-pipe pressure demanded at a time [Pa, s]; the force of the air brake is not simulated.
        """
        model = self.model
        layer = self._none if compensation is None else compensation
        on_command_sent = getattr(layer, "on_command_sent", lambda force: None)
        train = RigidTrain(model, *self.profile.at(0.0)[:2]) if train is None else train
        applied = np.zeros(model.n_units)
        queue = [applied] * round(float(model.delay.max()) / PERIOD)
        decay = math.exp(-PERIOD / model.lag) if model.lag else 0.0
        lasting = (1.0 - decay) * model.lag / PERIOD
        for step in range(steps):
            t = step * PERIOD
            in_flight = np.array(queue) if queue else None
            state = self.state(t, train, applied, law, in_flight)
            state = dataclasses.replace(state, pressure=pressure(t))
            given = layer.step(state)
            seen = dataclasses.replace(given, velocity=given.velocity * math.nan) if step in spoil else given
            force = np.array(law.step(seen).force, dtype=np.float64)
            yield TrainSample(state, given, force, float(train.velocity[0]) - self.profile.at(t)[1])
            on_command_sent(force.copy())
            queue.append(force)
            due = queue.pop(0)
            mean = due + (applied - due) * lasting if lasting else due
            applied = due + (applied - due) * decay if lasting else due
            train.advance(mean)

    def moderate_acceleration(self) -> float:
        """Return a third of the largest acceleration or deceleration of the train, at most 0.2 m/s²."""
        pull = sum(envelope.force(12.0) for envelope in self.model.traction)
        brake = sum(envelope.force(12.0) for envelope in self.model.brake)
        return min(0.2, min(pull, brake) / (3.0 * self.model.inertia))


def _profile_of_one_minute(pull: float) -> Profile:
    """Return a profile with a sinusoidal speed about 10 m/s, a period of 60 s and a largest acceleration [m/s²]."""
    swing = pull * 60.0 / (2 * np.pi)
    time_s = np.arange(0.0, STEPS * PERIOD + 20.0, PERIOD)
    phase = 2 * np.pi * time_s / 60.0
    position = 2000.0 + 10.0 * time_s + swing * (1 - np.cos(phase)) * 60.0 / (2 * np.pi)
    return Profile.uniform(0.0, PERIOD, position, 10.0 + swing * np.sin(phase), pull * np.cos(phase))
