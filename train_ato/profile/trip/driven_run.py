"""Run of the nominal multi-mass train along a journey, and the profile made from it.

A journey of the reduced model has no longitudinal motion between the vehicles; a long train follows it only with force
peaks. The planner therefore drives the nominal train, with every coupler and cylinder, along the journey: force of the
journey as feed-forward, a small gain on the speed error, and a limited rate of the force::

    u = F(x) + M g dead_band[v_journey(x) - v],   |u'| <= slew

The dead band keeps small differences of the speed, which a short traction and a short braking would not repair without
a loss of energy.

The profile of the plan is the mean speed of all vehicles of this run, averaged over time: the total force of a train
follows from its mean speed without the motion between the vehicles, so the force along the profile is smooth. It
contains the response of the train to the planned applications; a controller with the same applications needs little
more than the planned force.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plant_sim.plant_setup import PlantSetup
from plant_sim.summation import plain_sum
from plant_sim.totals import Totals
from plant_sim.train import Train
from train_ato.control.force_distribution import ForceDistribution, SharesAt
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array
from train_ato.profile.trip.journey import Application, Journey
from train_ato.profile.trip.search import POWER_BRAKING
from train_ato.profile.trip.section_forces import SectionForces
from train_ato.profile.trip.settings import TripSettings

PERIOD, STEP = 0.5, 0.005
"""Period of the force and step of the simulated train [s]."""
GAIN = 0.02
"""Acceleration per speed error [1/s]."""
DEAD_BAND, DEAD_BAND_SPEED = 1.0 / 3.6, 40.0 / 3.6
"""Speed error without a correction, and speed below which it decreases in proportion [m/s]."""
SMOOTHING = 200.0
"""Length over which the force of the journey is averaged [m]."""
AVERAGE = 5.0
"""Window of the moving average of the speed, applied three times [s]."""
TOP_SPEED = 200.0 / 3.6
"""End of the tables of the forces in sections [m/s]."""
MAX_STANDSTILL = 60.0
"""Standstill after which the train is unable to continue [s]."""


@dataclass(frozen=True)
class TripRun:
    """Run of the nominal train up to the last part of the braking.

    Attributes
    ----------
    period : float
        Time between samples [s].
    position, speed, force, shoes, mean_speed : Array, shape (n,)
        Vehicle 0's centre [m], its speed [m/s], force of the drives and of the shoes [N], mean speed of the train
        weighted by mass [m/s].
    couplers : Array, shape (n, couplers)
        Coupler forces [N], > 0 draft.
    units : Array, shape (n, units)
        Places of the power units plus their nominal distance behind vehicle 0's centre [m].
    totals : Totals
        Extremes and works of all plant steps.
    """

    period: float
    position: Array
    speed: Array
    force: Array
    shoes: Array
    mean_speed: Array
    couplers: Array
    units: Array
    totals: Totals

    @property
    def time(self) -> Array:
        """Times of the samples [s]."""
        return np.asarray(self.period * np.arange(self.position.size))


class JourneyFollower:
    """Force of the drives along a journey: feed-forward, gain on the speed error, limits of force and rate."""

    def __init__(self, model: TrainModel, settings: TripSettings, journey: Journey) -> None:
        self._model, self._settings = model, settings
        self._place, self._speed = journey.place, journey.speed
        middle = 0.5 * (journey.place[1:] + journey.place[:-1])
        width = max(1, round(SMOOTHING / float(journey.place[1] - journey.place[0]))) | 1
        padded = np.pad(journey.force, width // 2, mode="edge")
        self._force_places, self._force = middle, np.convolve(padded, np.full(width, 1.0 / width), mode="valid")
        self._sections = SectionForces(model, TOP_SPEED)

    def force(self, position: float, velocity: float, former: float, braked: bool) -> float:
        """Return the next force of the train [N] from position [m], speed [m/s] and present force [N]."""
        settings, model = self._settings, self._model
        wanted = float(np.interp(position, self._force_places, self._force))
        reference = max(float(np.interp(position, self._place, self._speed)), settings.final_speed)
        error, band = reference - velocity, DEAD_BAND * min(1.0, velocity / DEAD_BAND_SPEED)
        wanted += model.inertia * GAIN * (error - min(max(error, -band), band))
        low, high = model.limits_of_units([velocity] * model.n_units)
        most = 0.0 if braked else settings.traction * float(np.sum(high))
        if settings.traction_max is not None:
            most = min(most, settings.traction_max)
        least = settings.brake * float(np.sum(low))
        if self._sections.breaks.size:
            traction, brake = self._sections.at(position, velocity, settings.slew)
            most, least = min(most, traction), max(least, -brake)
        wanted = min(max(wanted, least), most)
        change = settings.slew * PERIOD
        return min(max(wanted, former - change), former + change)


def follow_journey(
    model: TrainModel,
    settings: TripSettings,
    journey: Journey,
    applications: tuple[Application, ...],
    shares: tuple[SharesAt, ...] = (),
) -> TripRun:
    """Return the run of the nominal train along a journey, from rest to the end of the journey.

    Parameters
    ----------
    model, settings, journey, applications
        Nominal train, limits, journey and its applications.
    shares
        Shares of the power units by place; empty for the fixed ones of the model.

    Raises
    ------
    ValueError
        If the train is at rest for 60 s before the end.
    """
    setup = PlantSetup.model_validate({"start": {"position": float(journey.place[0])}})
    train = Train(model.consist, model.line, setup, round(STEP * 1e9), round(PERIOD * 1e9))
    follower = JourneyFollower(model, settings, journey)
    air = model.consist.air_brake
    share, distribution = model.share.tolist(), ForceDistribution(shares, model.share.tolist())
    mass = model.inertia
    force, standstill = 0.0, 0.0
    rows: list[tuple[float, float, float, float, float]] = []
    couplers: list[Array] = []
    units: list[Array] = []
    end = float(journey.place[-1])
    released = 0.0 if air is None else POWER_BRAKING * air.braking_factor[-1] * plain_sum(model.consist.friction_forces)
    while True:
        position, velocity = float(train.position[0]), float(train.velocity[0])
        shoes = train.shoe_force
        rows.append((position, velocity, force, float(shoes.sum()), train.momentum / mass))
        couplers.append(train.coupler_force[:-1])
        units.append(train.position[list(model.units)] + model.offsets)
        if position >= end:
            break
        standstill = standstill + PERIOD if velocity < 1e-3 else 0.0
        if standstill > MAX_STANDSTILL:
            raise ValueError(
                f"the train stops at km {position / 1e3:.2f}: the grade is too steep; permit more traction"
            )
        reduction = reduction_at(position, applications)
        force = follower.force(position, velocity, force, reduction > 0.0 or rows[-1][3] > released)
        forces = [force * part for part in share]
        if shares:
            forces = distribution.forces(position, forces, *model.limits_of_units([velocity] * model.n_units))
        train.advance(np.tile(forces, (train.substeps, 1)), None if air is None else air.charged - reduction)
    table = np.array(rows)
    places, speeds, forces, shoe_forces, means = table.T
    return TripRun(
        PERIOD, places, speeds, forces, shoe_forces, means, np.array(couplers), np.array(units), train.totals
    )


def reduction_at(position: float, applications: tuple[Application, ...]) -> float:
    """Return the planned reduction of the brake pipe at a position of vehicle 0's centre [Pa]."""
    for application in applications:
        if application.apply <= position < application.release:
            return application.reduction
    return 0.0
