"""Permitted, target and intervention speed for the dial, from the supervisor or from limits and plan.

The colours follow the speed gauge of the ETCS driver's display (ERA_ERTMS_015560, 8.2.1): grey, yellow at the
indication of a target, orange above the permitted speed, red from the intervention on.  A run without a supervisor has
the speed limits with the margins of the ceiling supervision, and a brake curve with the deceleration of the plan to
every target.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from plant_sim.units import KMH
from train_ato.apps.view.facts import Facts, ProfileCurve
from train_ato.messages.types import Array
from train_ato.supervision.ceiling import ceiling_speeds
from train_ato.supervision.fixed_values import MIN_INDICATION_TIME, FixedValues
from train_ato.supervision.supervisor import SupervisionState

TOLERANCE = 1.0
"""Speed above the permitted one from which a run without a supervisor shows an overspeed [km/h]."""
AHEAD_S = FixedValues().t_driver + MIN_INDICATION_TIME
"""Time before the brake curve at which a target is indicated [s]: SUBSET-026, 3.13.9.3.6."""
STOPPED = 0.1
"""Distance beyond a stop up to which it is the next target [m]."""


@dataclass(frozen=True)
class Guidance:
    """Speeds on the rim of the dial [m/s] and the next target.

    Attributes
    ----------
    permitted, intervention
        Permitted speed and speed of the service-brake intervention; infinite without a limit.
    target_speed, target_distance
        Speed of the most restrictive target [m/s] and its distance [m]; NaN without one.
    state
        State of the supervision, or the same of a run without one.
    """

    permitted: float
    intervention: float
    target_speed: float
    target_distance: float
    state: SupervisionState


def guidance(
    facts: Facts, profile: ProfileCurve | None, front: float, speed: float, limits: Array | None, state: str
) -> Guidance:
    """Return the speeds on the dial.

    Parameters
    ----------
    facts, profile
        Line and plan.
    front, speed
        Front of the train [m] and its speed [m/s].
    limits, state
        Permitted, warning, service-brake and emergency-brake speed of the supervisor [m/s] and its state; None and "".
    """
    places, speeds = targets(facts, profile, front)
    deceleration = math.inf if profile is None else profile.deceleration
    ahead = places - front
    curve = np.sqrt(speeds**2 + 2.0 * np.where(ahead > 0.0, deceleration, 0.0) * np.maximum(ahead, 1e-9))
    nearest = int(curve.argmin()) if places.size else -1
    target = (float(speeds[nearest]), float(places[nearest] - front)) if places.size else (math.nan, math.nan)
    if limits is not None:
        found = {entry.text: entry for entry in SupervisionState}.get(state, SupervisionState.NORMAL)
        return Guidance(float(limits[0]), float(limits[2]), *target, found)
    permitted = min(facts.limit_now(front), float(curve.min(initial=math.inf)))
    if not math.isfinite(permitted):
        return Guidance(math.inf, math.inf, *target, SupervisionState.NORMAL)
    ceiling = ceiling_speeds(permitted)
    near = places.size > 0 and _indicated(deceleration, *target, speed)
    return Guidance(permitted, ceiling.service, *target, _state(speed, permitted, ceiling.service, near=near))


def _indicated(deceleration: float, target_speed: float, distance: float, speed: float) -> bool:
    """Return True if the train at constant speed is above the brake curve of the target after :data:`AHEAD_S`."""
    rest = max(distance - AHEAD_S * speed, 0.0)
    return speed > target_speed and speed > math.sqrt(target_speed**2 + 2.0 * deceleration * rest)


def _state(speed: float, permitted: float, service: float, *, near: bool) -> SupervisionState:
    if speed > service:
        return SupervisionState.SERVICE_BRAKE
    if speed > permitted + TOLERANCE / KMH:
        return SupervisionState.OVERSPEED
    return SupervisionState.INDICATION if near else SupervisionState.NORMAL


def targets(facts: Facts, profile: ProfileCurve | None, front: float) -> tuple[Array, Array]:
    """Return places [m] and speeds [m/s] of the lower limits and of the next stop before the train."""
    lower = np.flatnonzero((facts.limit_places > front) & (facts.limit_speeds < facts.limit_now(front)))
    places, speeds = facts.limit_places[lower], facts.limit_speeds[lower]
    stops = np.zeros(0) if profile is None else profile.stops + facts.nose
    ahead = stops[stops > front - STOPPED][:1]
    return np.append(places, np.maximum(ahead, front)), np.append(speeds, np.zeros(ahead.size))


def delay_at(timetable: ProfileCurve, time: float, position: float) -> float:
    """Return the delay against a timetable [s], > 0 late; 0 during a planned dwell time.

    Parameters
    ----------
    timetable
        First profile of the run.
    time, position
        Time [s] and position of vehicle 0's centre [m].
    """
    reached = timetable.reached
    arrival, departure = (float(timetable.time[_row(reached, position + shift)]) for shift in (-STOPPED, STOPPED))
    exact = float(np.interp(position, reached, timetable.time))
    if departure - arrival > 2.0 * AHEAD_S:  # at a stop of the timetable
        return max(time - departure, 0.0) + min(time - arrival, 0.0)
    return time - exact


def _row(reached: Array, position: float) -> int:
    return min(int(np.searchsorted(reached, position, side="left")), reached.size - 1)
