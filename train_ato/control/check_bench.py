"""Shipped trains, taken as rigid, on which :mod:`train_ato.control.check` lets a law drive."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from plant_sim.library import load_consist, load_line
from train_ato.compensate.contract import Situation
from train_ato.compensate.none import NoCompensation, NoParameters
from train_ato.compensate.rigid import RigidForce
from train_ato.control.contract import LawInput, Preview
from train_ato.model import TrainModel
from train_ato.profile.profile import Profile
from train_ato.types import Array

PERIOD = 0.1
"""Control period of the tests [s]."""
STEPS = 600
"""Length of a run."""


class Bench:
    """A shipped train, taken as rigid, that a law drives along a run of one minute.

    Parameters
    ----------
    name
        Of the consist.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        consist = load_consist(name)
        hauled = len(consist.vehicles) > len(consist.power_units)
        units = len(consist.power_units)
        delay = np.zeros(units)
        sensors = (0,) if hauled else ()
        self.model = TrainModel(consist, load_line("level"), delay, delay, 0.0, PERIOD, sensors)
        self.profile = _run_of_a_minute(self._easy_pull())
        self._see = NoCompensation(NoParameters(), self.model, PERIOD)
        self._see.set_profile(RigidForce(self.model, self.profile))
        self._nothing = np.zeros(units)

    def inputs(self, t: float, place: float, speed: float, applied: Array, horizon: int) -> LawInput:
        """Return what a law is given, the front vehicle's centre at ``place``."""
        model = self.model
        one = np.ones(model.n_units)
        reference = self.profile.at(t)
        position, velocity = place - model.offsets, speed * one
        view = self._see.see(
            Situation(t, position, velocity, applied, self._nothing, np.zeros((0, one.size)), reference[:3], None)
        )
        low, high = model.force_limits(velocity)
        return LawInput(
            t=t,
            position=position,
            velocity=velocity,
            applied=applied,
            reference_position=view.reference_position,
            reference_velocity=view.reference_velocity,
            reference_acceleration=view.reference_acceleration,
            lead=view.lead,
            acting_acceleration=view.acting_acceleration,
            acting_jerk=view.acting_jerk,
            feedforward=view.feedforward,
            preview=Preview(*self.profile.window(t, horizon, PERIOD)),
            disturbance=self._nothing,
            deflection=np.zeros(len(model.sensors)),
            rate=np.zeros(len(model.sensors)),
            coupler_force=self._first_coupler(speed, place, float(applied.sum())),
            shoe_force=self._nothing,
            train_shoe_force=0.0,
            under_way=np.zeros((0, one.size)),
            force_min=low,
            force_max=high,
            saturated=False,
        )

    def drive(self, law: Any, steps: int = STEPS, spoil: range = range(0)) -> tuple[Array, Array]:
        """Let the law drive; return forces, shape (steps, units), and speed errors, shape (steps,).

        In the steps of ``spoil`` all measured speeds are NaN.
        """
        model = self.model
        place, speed, _, _ = self.profile.at(0.0)
        applied = np.zeros(model.n_units)
        forces, errors = np.empty((steps, model.n_units)), np.empty(steps)
        for step in range(steps):
            t = step * PERIOD
            given = self.inputs(t, place, speed, applied, getattr(law, "horizon", 0))
            if step in spoil:
                given = dataclasses.replace(given, velocity=given.velocity * math.nan)
            applied = np.array(law.step(given).force, dtype=np.float64)
            forces[step], errors[step] = applied, speed - self.profile.at(t)[1]
            pull = (float(np.nansum(applied)) - model.running_resistance(speed)) / model.inertia
            place += (speed + 0.5 * pull * PERIOD) * PERIOD
            speed = max(0.0, speed + pull * PERIOD)
        return forces, errors

    def _easy_pull(self) -> float:
        """Return an acceleration that takes a third of what the train can pull or brake, 0.2 m/s² at most."""
        pull = sum(envelope.force(12.0) for envelope in self.model.traction)
        brake = sum(envelope.force(12.0) for envelope in self.model.brake)
        return min(0.2, min(pull, brake) / (3.0 * self.model.inertia))

    def _first_coupler(self, speed: float, place: float, applied: float) -> Array:
        """Return the force of the first coupler of a rigid train [N], if it carries a sensor."""
        model = self.model
        if not model.sensors:
            return np.zeros(0)
        pull = (applied - model.running_resistance(speed)) / model.inertia
        own = float(model.own_resistance(np.array([speed]), np.array([place]))[0])
        return np.array([applied - own - float(model.unit_mass[0]) * pull])


def _run_of_a_minute(pull: float) -> Profile:
    """Return a speed that swings about 10 m/s with the largest acceleration ``pull`` and a period of a minute."""
    swing = pull * 60.0 / (2 * np.pi)
    time_s = np.arange(0.0, STEPS * PERIOD + 20.0, PERIOD)
    phase = 2 * np.pi * time_s / 60.0
    position = 2000.0 + 10.0 * time_s + swing * (1 - np.cos(phase)) * 60.0 / (2 * np.pi)
    return Profile.uniform(0.0, PERIOD, position, 10.0 + swing * np.sin(phase), pull * np.cos(phase))
