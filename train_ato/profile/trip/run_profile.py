"""Profile of a trip: averaged speed of a run, and the last part of the braking to standstill at the stop."""

import math

import numpy as np

from plant_sim.elementary import plain_sum
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array
from train_ato.profile.driver import average_speed
from train_ato.profile.profile import Profile
from train_ato.profile.trip.driven_run import AVERAGE, TripRun
from train_ato.profile.trip.settings import TripSettings

JERK = 0.002
"""Least change of the deceleration at the begin of the last part [m/s³]: 21 kN/s for a train of 10 700 t."""
STRONGEST = 0.2
"""Largest deceleration of the last part [m/s²]."""


def braking_distance(speed: float, deceleration: float, final: float, jerk: float = JERK) -> float:
    """Return the distance to standstill [m] if the deceleration changes to a final one.

    Parameters
    ----------
    speed, deceleration
        State at the begin [m/s, m/s²].
    final, jerk
        Deceleration after the change [m/s²], and its change per second [m/s³].
    """
    duration, slope = _change(speed, deceleration, final, jerk)
    rest = speed - deceleration * duration - slope * duration**2 / 2
    way = speed * duration - deceleration * duration**2 / 2 - slope * duration**3 / 6
    return way + max(rest, 0.0) ** 2 / (2 * final)


def _change(speed: float, deceleration: float, final: float, jerk: float) -> tuple[float, float]:
    """Return duration [s] and slope [m/s³] of the change; it ends at standstill at the latest."""
    slope = math.copysign(jerk, final - deceleration)
    duration = (final - deceleration) / slope
    root = deceleration**2 + 2 * slope * speed
    if root >= 0.0:
        stop = 2 * speed / (deceleration + math.sqrt(root))
        duration = min(duration, stop)
    return duration, slope


def final_deceleration(speed: float, deceleration: float, distance: float, jerk: float = JERK) -> float:
    """Return the final deceleration that stops the train after a distance [m/s²].

    Parameters
    ----------
    speed, deceleration
        State at the begin [m/s, m/s²].
    distance, jerk
        Distance to the stop [m], and change of the deceleration per second [m/s³].

    Raises
    ------
    ValueError
        If no deceleration up to :data:`STRONGEST` does.
    """
    low, high = 1e-4, STRONGEST
    longest, shortest = (braking_distance(speed, deceleration, final, jerk) for final in (low, high))
    if not shortest <= distance <= longest:
        raise ValueError(
            f"no stop after {distance:.1f} m from {3.6 * speed:.1f} km/h; permit a stronger brake, or increase "
            "final_deceleration"
        )
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if braking_distance(speed, deceleration, middle, jerk) > distance else (low, middle)
    return 0.5 * (low + high)


def stop_knots(
    position: float, speed: float, deceleration: float, stop: float, period: float, jerk: float = JERK
) -> tuple[Array, Array, Array]:
    """Return position, speed and acceleration of the knots after a state, up to rest at a stop [m].

    Parameters
    ----------
    position, speed, deceleration
        State of the last knot before [m, m/s, m/s²].
    stop
        Place of standstill [m].
    period
        Time between the knots [s].
    jerk
        Change of the deceleration per second [m/s³].
    """
    final = final_deceleration(speed, deceleration, stop - position, jerk)
    change, slope = _change(speed, deceleration, final, jerk)
    middle = speed - deceleration * change - slope * change**2 / 2
    end = change + max(middle, 0.0) / final
    time = period * np.arange(1, math.ceil(end / period) + 1)
    first = np.minimum(time, change)
    second = np.clip(time - change, 0.0, end - change)
    a = np.where(time < change, -(deceleration + slope * time), -final)
    v = speed - deceleration * first - slope * first**2 / 2 - final * second
    x = speed * first - deceleration * first**2 / 2 - slope * first**3 / 6 + middle * second - final * second**2 / 2
    at_rest = time >= end - 1e-9
    return np.where(at_rest, stop, position + x), np.where(at_rest, 0.0, np.maximum(v, 0.0)), np.where(at_rest, 0.0, a)


FINE_PERIOD = 0.1
"""Period of the knots up to which the acceleration is that of the mean of the train [s]: the tick of most scenarios."""
SLACK_AVERAGE = 20.0
"""Window of the average of the motion of vehicle 0 against the mean of the train, for coarser knots [s]."""
LAST_PART = 1.15
"""Reserve of the length of the last part of the braking: the run is a little faster than the journey."""
FINAL_SHARE, ALMOST_AT_REST, ELECTRIC_SHARE = 1.1, 0.5, 0.25
"""Deceleration of the last part over that of the running resistance at a speed [m/s], and at least over that of the
electric brake at its begin; the electric brake fades."""
MAX_OF_FINAL = 2.0
"""Largest deceleration of the last part over the planned one; the electric brake is not able to keep a larger one."""


class RunProfile:
    """Profile of runs to one stop.

    Parameters
    ----------
    model, settings
        Nominal train on its line, and the limits of the plan.
    stop
        Place of vehicle 0's centre at the stop [m].
    period
        Time between the knots [s].
    """

    def __init__(self, model: TrainModel, settings: TripSettings, stop: float, period: float) -> None:
        self._model, self._settings, self._stop, self._period = model, settings, stop, period
        speed = settings.final_speed
        brake = -settings.brake * plain_sum(model.limits_of_units([speed] * model.n_units)[0])
        resisted = FINAL_SHARE * (model.running_resistance(ALMOST_AT_REST) / model.inertia)
        self._final = settings.final_deceleration or max(resisted, ELECTRIC_SHARE * brake / model.inertia)
        self._strong = (model.running_resistance(speed) + brake) / model.inertia
        self._jerk = max(JERK, self._strong * brake / (model.inertia * speed))  # as the electric brake fades

    def last_part(self) -> float:
        """Return the distance from the end of the journey to the stop [m].

        The profile leaves the run some seconds before the end of the journey, because of the average over time.
        """
        speed, strong = self._settings.final_speed, self._strong
        before = speed + strong * 2 * AVERAGE
        way = braking_distance(before, strong, self._final, self._jerk) - AVERAGE * (before + speed)
        return max(LAST_PART * way, speed**2 / (2 * strong))

    def of(self, run: TripRun) -> tuple[Profile, float]:
        """Return the averaged speed of a run, continued to standstill at the stop, and the time of this last part [s].

        A law multiplies the acceleration by the mass of the train. With the acceleration of vehicle 0 against the mean
        of the train, the command would alternate; fine knots therefore have the acceleration of the mean. Between
        coarser knots the acceleration is that of the speed, and this motion is averaged over a longer time. With
        several power units the profile is the mean alone, and this motion is in the displacements of the units.
        """
        time = np.arange(0.0, run.time[-1] + 1e-9, self._period)
        mean = np.interp(time, run.time, run.mean_speed)
        slack = np.interp(time, run.time, run.speed) - mean
        mean = average_speed(mean, self._period, AVERAGE)
        fine = self._period <= FINE_PERIOD
        slack = average_speed(slack, self._period, AVERAGE if fine else SLACK_AVERAGE) * (self._model.n_units < 2)
        speed = np.maximum(mean + slack, 0.0)
        speed[0] = 0.0
        change = np.gradient(speed, self._period)
        change[0] = 0.0
        steps = self._period * (speed[1:] + speed[:-1]) / 2 - self._period**2 * np.diff(change) / 12
        acceleration = np.gradient(mean, self._period) if fine else change
        acceleration[0] = 0.0
        position = run.position[0] + np.concatenate(([0.0], np.cumsum(steps)))
        kept = self._cut(position, speed, acceleration)
        state = float(position[kept - 1]), float(speed[kept - 1]), -float(acceleration[kept - 1])
        rest = stop_knots(*state, self._stop, self._period, self._jerk)
        columns = [np.concatenate((a[:kept], b)) for a, b in zip((position, speed, acceleration), rest, strict=True)]
        # rounded to 1 µm and 1 nm/s: a short file without a loss of accuracy
        rounded = columns[0].round(6), columns[1].round(9), columns[2].round(9)
        return Profile.uniform(0.0, self._period, *rounded), float(time[kept - 1])

    def _cut(self, position: Array, speed: Array, acceleration: Array) -> int:
        """Return the number of knots before the last part; its deceleration is the nearest to that of the settings."""
        last = position.size - round(2 * AVERAGE / self._period)
        first = last - round(60.0 / self._period)
        found = []
        for kept in range(last, first, -round(1.0 / self._period)):
            state = float(speed[kept - 1]), -float(acceleration[kept - 1])
            try:
                needed = final_deceleration(*state, self._stop - float(position[kept - 1]), self._jerk)
            except ValueError:
                continue
            if needed <= MAX_OF_FINAL * self._final:
                found.append((abs(needed - self._final), kept))
        if not found:
            raise ValueError(
                "final_deceleration: the run is too fast or too slow for the stop; permit a stronger brake or a "
                "larger slew, or change final_deceleration"
            )
        return min(found)[1]
