"""Planning the rest of a run again from where the train is, with the force that is left.

When the force that is there falls short (saturation, a fault, bad rails) the train lags behind its profile.  Instead
of chasing it, the rest is planned again: at no place faster than the old profile, with what force is left, and still
stopping where the old profile stops.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plant_sim.consist import Consist
from plant_sim.line import Line
from train_ato.plan.line_tables import LineForce, SpeedLimits
from train_ato.plan.planner import Plan, assemble
from train_ato.plan.run import Run
from train_ato.plan.settings import PlanSettings
from train_ato.plan.style import FASTEST, Track
from train_ato.plan.train_tables import AvailableForce, TrainTables
from train_ato.profile.profile import Profile
from train_ato.types import Array

__all__ = ["State", "replan"]

RESTING = 1e-6
"""Speed of a knot at rest [m/s]."""
THERE = 0.01
"""A train at rest this near to a stop is there [m]."""


@dataclass(frozen=True, slots=True)
class State:
    """Where the train is: time of the run [s], vehicle 0's centre [m], its speed [m/s] and acceleration [m/s²]."""

    time: float
    position: float
    velocity: float
    acceleration: float = 0.0


@dataclass(frozen=True, slots=True)
class _Leg:
    """Part of the old profile between two rests: front and speed, and when the rest before it ends."""

    front: Array
    speed: Array
    departure: float
    dwell: float


def replan(
    state: State,
    profile: Profile,
    line: Line,
    consist: Consist,
    settings: PlanSettings | None = None,
    available: AvailableForce | None = None,
    catch_up: bool = False,
) -> Plan:
    """Plan the rest of a profile again.

    Service limits and margin are kept if the stop can be met with them; otherwise the train's own deceleration and
    less and less of the margin are used, down to none, then the limit on the jerk is given up too.

    Parameters
    ----------
    state
        Of the train now; the new profile continues it without a jump.
    profile
        The profile that can no longer be followed; its stops are those of the rest.
    line, consist
        Nominal data.
    settings
        Service limits and margin; journey and timetable in them are not looked at.
    available
        What is left of the train's forces.
    catch_up
        Go faster than the old profile where the line allows it.

    Returns
    -------
    Plan
        Its profile has knots on those of the old one, from ``state.time`` on: ``profile.followed_by(plan.profile)``.

    Raises
    ------
    ValueError
        If even so the rest cannot be driven: the place, and the speed at which the train would pass it.
    """
    settings = settings or PlanSettings()
    asked = settings.model_copy(update={"time": None, "departure": state.time, "begin": None, "end": None})
    margins = [part * asked.force_margin for part in (0.5, 0.2)] if asked.force_margin > 0 else []
    ladder = [asked]
    ladder += [asked.model_copy(update={"deceleration": None, "force_margin": margin}) for margin in (*margins, 0.0)]
    ladder.append(ladder[-1].model_copy(update={"jerk": None}))
    for attempt in ladder[:-1]:
        plan = _attempt(state, profile, line, consist, attempt, available, catch_up)
        if not isinstance(plan, ValueError):
            return plan
    plan = _attempt(state, profile, line, consist, ladder[-1], available, catch_up)
    if isinstance(plan, ValueError):
        raise plan
    return plan


def _attempt(
    state: State,
    profile: Profile,
    line: Line,
    consist: Consist,
    settings: PlanSettings,
    available: AvailableForce | None,
    catch_up: bool,
) -> Plan | ValueError:
    try:
        return _replan(state, profile, line, consist, settings, available, catch_up)
    except ValueError as error:
        return error


def _replan(
    state: State,
    profile: Profile,
    line: Line,
    consist: Consist,
    settings: PlanSettings,
    available: AvailableForce | None,
    catch_up: bool,
) -> Plan:
    train = TrainTables(consist, settings.speed_max, settings.air_brake, settings.point_mass, available)
    force = LineForce(line, train, settings.grade_over_length)
    track = Track(train, force, SpeedLimits(line, train.speed_max), settings)
    front = state.position + train.half
    legs = _legs_left(profile, train.half, state.time, front)
    if not legs:
        raise ValueError(f"nothing is left to plan: the front, at km {front / 1000:.3f}, has reached the profile's end")
    speed = max(state.velocity, 0.0)
    runs = []
    for number, leg in enumerate(legs):
        first = number == 0
        begin = front if first else float(legs[number - 1].front[-1])
        run = Run(
            track, begin, float(leg.front[-1]),
            begin_speed=speed if first else 0.0,
            begin_rate=state.acceleration if first and speed > 0 else 0.0,
            ceiling=None if catch_up else (leg.front, leg.speed),
            late=first and speed > 0,
        )  # fmt: skip
        runs.append(run)

    def departure(number: int, arrival: float) -> float:
        if number == 0:
            return state.time if speed > 0 else max(state.time, legs[0].departure)
        return max(arrival + legs[number].dwell, legs[number].departure)

    return assemble(runs, [FASTEST] * len(runs), settings, line, profile.period, departure, state.time)


def _legs_left(profile: Profile, half: float, time: float, front: float) -> list[_Leg]:
    """Return the parts of a profile that end beyond a place of the front and after a time."""
    moving = np.abs(profile.velocity) > RESTING
    edges = np.flatnonzero(np.diff(np.concatenate(([0], moving.astype(int), [0]))))
    legs: list[_Leg] = []
    last_end = -np.inf
    for first, stop in zip(edges[::2], edges[1::2], strict=True):
        low, high = max(first - 1, 0), min(stop, len(profile) - 1)
        leg_front = profile.position[low : high + 1] + half
        departure = float(profile.time[low])
        dwell = departure - last_end if np.isfinite(last_end) else 0.0
        last_end = float(profile.time[high])
        gone = leg_front[-1] <= front + THERE
        if not gone and np.all(np.diff(leg_front) >= 0):
            legs.append(_Leg(leg_front, profile.velocity[low : high + 1], departure, dwell))
    return [leg for leg in legs if leg.front[-1] > front]
