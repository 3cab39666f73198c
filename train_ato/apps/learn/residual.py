"""Resistance of one recorded run that its nominal model does not contain, over time and by place.

With the measured force F, the resistance W_0 of the nominal model without learned part and its shoe force, every moving
train has::

    v' = (F - W_0)/M - r,   r' = white noise of PSD q

F, v and place of a stamp are measured at the same time, so that no delay is in the balance. A Kalman filter of (v, r)
runs forward, a smoother (Rauch, Tung and Striebel 1965, AIAA Journal 3) backward: r has no phase lag. The
noise of the speed is that of the record. Mean values by place with a triangular weight give r(x).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from train_ato.control.air_brake.shoes import ShoeForecast
from train_ato.control.learned_resistance import LARGEST
from train_ato.control.observers.force_balance import lag_weight
from train_ato.control.train_model import TrainModel
from train_ato.loop.recording import BRAKE_PIPE_COMMAND, MEASUREMENT, Recording
from train_ato.loop.series import aligned
from train_ato.messages.types import Array

MOVING = 0.5
"""Speed above which a sample counts [m/s]: the holding brake and the fade of the electric brake are below."""
GRADE_CHANGE = 0.05
"""Standard deviation of the change of r in a second [m/s²]."""
SMALLEST_NOISE = 1e-4
"""Smallest standard deviation of the measured speed [m/s]."""
SHORTEST = 20
"""Number of samples of the shortest stretch of motion that counts."""


@dataclass(frozen=True)
class Residual:
    """Unexplained resistance at the samples of a run, shape (k,) each.

    Attributes
    ----------
    place : Array
        Place of vehicle 0's centre [m].
    resistance : Array
        Resistance per inertial mass [m/s²], > 0 retards.
    """

    place: Array
    resistance: Array


def residual_of(recording: Recording, model: TrainModel) -> Residual:
    """Return the resistance of a run that its nominal model does not contain.

    Parameters
    ----------
    recording
        Run with measured position, speed and force.
    model
        Nominal model of the run; its learned resistance is not used.

    Raises
    ------
    ValueError
        If the train does not move.
    """
    model = model.without_learned
    time, measured = recording.time, {}
    for name in ("position", "velocity"):
        found = recording.of(MEASUREMENT, name)
        if found is None:
            raise ValueError(f"{recording.name}: {MEASUREMENT}: no {name}; record this topic")
        measured[name] = aligned(time, *found)
    share = model.share
    speed = np.asarray(measured["velocity"] @ share)
    place = np.asarray((measured["position"] + model.offsets) @ share)
    force = recording.applied.sum(axis=1)
    resisting = model.resisting_forces(place, speed) + _shoe_forces(recording, model, speed)
    places, values = [], []
    for begin, end in _stretches(speed):
        steps = np.diff(time[begin:end])
        weight = lag_weight(float(np.median(steps)), model.lag)
        drive = weight * force[begin : end - 1] + (1.0 - weight) * force[begin + 1 : end]
        against = 0.5 * (resisting[begin : end - 1] + resisting[begin + 1 : end])
        values.append(smoothed_resistance(speed[begin:end], (drive - against) / model.inertia, steps))
        places.append(0.5 * (place[begin : end - 1] + place[begin + 1 : end]))
    if not places:
        raise ValueError(f"{recording.name}: the train does not move above {MOVING:g} m/s; give a run with motion")
    return Residual(np.concatenate(places), np.clip(np.concatenate(values), -LARGEST, LARGEST))


def _stretches(speed: Array) -> list[tuple[int, int]]:
    """Return begin and end of every stretch of motion, in samples."""
    moving = np.concatenate(([0], (np.abs(speed) > MOVING).astype(np.int8), [0]))
    edges = np.flatnonzero(np.diff(moving)).reshape(-1, 2)
    return [(int(begin), int(end)) for begin, end in edges if end - begin >= SHORTEST]


def _shoe_forces(recording: Recording, model: TrainModel, speed: Array) -> Array:
    """Return the shoe force of the nominal train from the pressures sent [N], shape (k,)."""
    found = recording.of(BRAKE_PIPE_COMMAND, "pressure") if model.air_brake is not None else None
    if found is None:
        return np.zeros(speed.size)
    shoes, pressures = ShoeForecast(model), aligned(recording.time, *found)[:, 0]
    forces = np.empty(speed.size)
    for k, (t, pressure, v) in enumerate(zip(recording.time.tolist(), pressures.tolist(), speed.tolist(), strict=True)):
        shoes.demand(t, pressure)
        forces[k] = shoes.at(t, v).total
    return forces


def speed_noise(speed: Array) -> float:
    """Return the standard deviation of the noise of a measured speed [m/s], from its second differences."""
    bends = np.abs(speed[2:] - 2.0 * speed[1:-1] + speed[:-2])
    return max(SMALLEST_NOISE, float(np.median(bends)) / (0.6745 * math.sqrt(6.0)))


def smoothed_resistance(speed: Array, pull: Array, steps: Array) -> Array:
    """Return r in the middle of the steps [m/s²], shape (k - 1,).

    Parameters
    ----------
    speed : Array, shape (k,)
        Measured speed [m/s].
    pull : Array, shape (k - 1,)
        Modelled acceleration over every step [m/s²].
    steps : Array, shape (k - 1,)
        Durations [s].
    """
    noise = speed_noise(speed) ** 2
    count = steps.size
    states, covariances = np.empty((count + 1, 2)), np.empty((count + 1, 3))
    before, predicted = np.empty((count, 2)), np.empty((count, 3))
    v, r, vv, vr, rr = float(speed[0]), 0.0, noise, 0.0, LARGEST**2
    states[0], covariances[0] = (v, r), (vv, vr, rr)
    for k, (h, a, seen) in enumerate(zip(steps.tolist(), pull.tolist(), speed[1:].tolist(), strict=True)):
        v, vv, vr = v + h * (a - r), vv - 2.0 * h * vr + h * h * rr, vr - h * rr
        rr += GRADE_CHANGE**2 * h
        before[k], predicted[k] = (v, r), (vv, vr, rr)
        gain_v, gain_r, miss = vv / (vv + noise), vr / (vv + noise), seen - v
        v, r = v + gain_v * miss, r + gain_r * miss
        vv, vr, rr = (1.0 - gain_v) * vv, (1.0 - gain_v) * vr, rr - gain_r * vr
        states[k + 1], covariances[k + 1] = (v, r), (vv, vr, rr)
    found = np.empty(count + 1)
    found[count] = r
    for k in range(count - 1, -1, -1):
        h = float(steps[k])
        vv, vr, rr = covariances[k].tolist()
        p_vv, p_vr, p_rr = predicted[k].tolist()
        size = p_vv * p_rr - p_vr * p_vr
        c_vv, c_vr, c_rr = vv - h * vr, vr, rr  # covariance of the state with the next one, by rows
        c_rv = vr - h * rr
        miss_v, miss_r = v - float(before[k, 0]), r - float(before[k, 1])
        first, second = (miss_v * p_rr - miss_r * p_vr) / size, (miss_r * p_vv - miss_v * p_vr) / size
        v = float(states[k, 0]) + c_vv * first + c_vr * second
        r = float(states[k, 1]) + c_rv * first + c_rr * second
        found[k] = r
    return np.asarray(0.5 * (found[1:] + found[:-1]))


def by_place(residual: Residual, begin: float, spacing: float, count: int) -> Array:
    """Return r at evenly spaced places [m/s²], shape (count,); NaN outside the run.

    A sample counts at the places beside it by its distance. Places inside the run without a sample are interpolated.
    """
    at = (residual.place - begin) / spacing
    index = np.floor(at).astype(np.int64)
    part = at - index
    total, weight = np.zeros(count), np.zeros(count)
    for place, share in ((index, 1.0 - part), (index + 1, part)):
        inside = (place >= 0) & (place < count)
        np.add.at(weight, place[inside], share[inside])
        np.add.at(total, place[inside], (share * residual.resistance)[inside])
    known = np.flatnonzero(weight > 0.0)
    return np.interp(np.arange(count), known, total[known] / weight[known], left=np.nan, right=np.nan)
