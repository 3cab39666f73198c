"""Run of the nominal multi-mass train along a journey, and the profile made from it.

A journey of the reduced model has no longitudinal motion between the vehicles, so that a long train follows it only
with force peaks. The planner therefore drives the nominal train along the journey, with every coupler and cylinder. The
force of the journey is the feed-forward, a small gain acts on the speed error, and the rate of the force is limited::

    u = F(x) + M g dead_band[v_journey(x) - v],   |u'| <= slew

The dead band keeps small differences of the speed, which a short traction and a short braking would not repair without
a loss of energy.

The profile of the plan is the mean speed of all vehicles of this run, averaged over time. The total force of a train
follows from its mean speed without the motion between the vehicles, so that the force along the profile is smooth. It
contains the response of the train to the planned applications. A controller with the same applications needs little
more than the planned force.

Shares of the power units by place that lower the coupler forces of a planned run.

A force d more at a power unit, and less at the next one, shifts the forces of all couplers between the two by d, and
leaves the others as they are. The least d that keeps the forces f_j of these couplers within a band +-L is therefore::

    d = min(L - max f_j, 0) + max(-L - min f_j, 0)       if max f_j - min f_j <= 2 L
    d = -(max f_j + min f_j) / 2                         else

f_j is the force of the run with the present shares. It contains grades, brake waves and draft gears. d is averaged over
time, because commands do not damp the waves in the couplers. Unit i gets d_i - d_(i-1) more. Shares are from 0 to 1, so
that no unit pulls against another. The couplers behind the last unit do not depend on the shares.
"""

from dataclasses import dataclass

import numpy as np

from plant_sim.elementary import plain_sum
from plant_sim.plant_setup import PlantSetup
from plant_sim.totals import Totals
from plant_sim.train import Train
from train_ato.control.force_distribution import ForceDistribution, SharesAt
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array
from train_ato.profile.driver import MAX_STANDSTILL, window_mean
from train_ato.profile.trip.journey import Application, Journey
from train_ato.profile.trip.reduced_train import SectionForces
from train_ato.profile.trip.search import POWER_BRAKING
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
        self._force_places, self._force = middle, window_mean(journey.force, width)
        self._sections = SectionForces(model, TOP_SPEED)

    def force(self, position: float, velocity: float, former: float, *, braked: bool) -> float:
        """Return the next force of the train [N] from position [m], speed [m/s] and present force [N]."""
        settings, model = self._settings, self._model
        wanted = float(np.interp(position, self._force_places, self._force))
        reference = max(float(np.interp(position, self._place, self._speed)), settings.final_speed)
        error, band = reference - velocity, DEAD_BAND * min(1.0, velocity / DEAD_BAND_SPEED)
        wanted += model.inertia * GAIN * (error - min(max(error, -band), band))
        if velocity < settings.final_speed:  # a braking by place would end before it, at a speed a little too low
            wanted = max(wanted, model.resisting_force(position, velocity))
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
    train = Train(model.consist, model.line, setup, step_ns=round(STEP * 1e9), tick_ns=round(PERIOD * 1e9))
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
        reduction = next((a.reduction for a in applications if a.apply <= position < a.release), 0.0)
        force = follower.force(position, velocity, force, braked=reduction > 0.0 or rows[-1][3] > released)
        forces = [force * part for part in share]
        if shares:
            forces = distribution.forces(position, forces, *model.limits_of_units([velocity] * model.n_units))
        train.advance(np.tile(forces, (train.substeps, 1)), None if air is None else air.charged - reduction)
    places, speeds, drives, shoe_forces, means = np.array(rows).T
    return TripRun(
        PERIOD, places, speeds, drives, shoe_forces, means, np.array(couplers), np.array(units), train.totals
    )


SPACING = 200.0
"""Distance between the places of the shares [m]; the search has cells of 100 m."""
WINDOW = 40.0
"""Window of the average of the shifts [s], several periods of the slowest motion between the vehicles."""
BAND = 200e3
"""Coupler force up to which the shares remain [N]: a cycle of this amplitude has a hundredth of the unit damage."""
SMALL_FORCE = 100e3
"""Total force below which the shares approach the former ones [N]."""


def shares_for_run(model: TrainModel, run: TripRun, former: tuple[SharesAt, ...]) -> tuple[SharesAt, ...]:
    """Return the shares by place that centre the coupler forces of a run between the power units.

    Parameters
    ----------
    model
        Nominal train.
    run
        Run of the nominal train with the former shares.
    former
        Shares of the run; empty for the fixed ones of the model.
    """
    moving = np.concatenate(([True], np.diff(run.position) > 0.0))
    position, total = run.position[moving], run.force[moving]
    width = max(1, round(WINDOW / run.period)) | 1
    shift = np.stack([window_mean(column, width) for column in _shifts(model, run.couplers[moving]).T], axis=1)
    added = np.diff(shift, axis=1, prepend=0.0, append=0.0)
    moved = added * (total / (total**2 + SMALL_FORCE**2))[:, None]
    base = _rows(model, former, position)
    shares = np.clip(base + moved, 0.0, 1.0)
    shares /= shares.sum(axis=1, keepdims=True)
    places = np.arange(position[0], position[-1], SPACING)
    table = np.stack([np.interp(places, position, column) for column in shares.T], axis=1).round(3)
    return tuple(
        SharesAt(at=at, shares=tuple(row)) for at, row in zip(places.round(1).tolist(), table.tolist(), strict=True)
    )


def _shifts(model: TrainModel, couplers: Array) -> Array:
    """Return the force from every unit to the next one that keeps the band [N], shape (n, units - 1)."""
    shifts = []
    for front, rear in zip(model.units, model.units[1:], strict=False):
        draft, buff = couplers[:, front:rear].max(axis=1), couplers[:, front:rear].min(axis=1)
        needed = np.minimum(BAND - draft, 0.0) + np.maximum(-BAND - buff, 0.0)
        shifts.append(np.where(draft - buff > 2 * BAND, -0.5 * (draft + buff), needed))
    return np.stack(shifts, axis=1)


def _rows(model: TrainModel, shares: tuple[SharesAt, ...], position: Array) -> Array:
    """Return the shares at positions, shape (n, units)."""
    if not shares:
        return np.tile(model.share, (position.size, 1))
    places = [entry.at for entry in shares]
    table = np.array([entry.shares for entry in shares])
    return np.stack([np.interp(position, places, column) for column in table.T], axis=1)
