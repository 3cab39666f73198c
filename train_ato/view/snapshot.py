"""Snapshot of a run and its numbers and texts for the page.

The colours follow the speed gauge of the ETCS driver's display (ERA_ERTMS_015560, 8.2.1): grey, yellow at the
indication of a target, orange above the permitted speed, red from the intervention on.  A run without a supervisor has
the speed limits with the margins of the ceiling supervision, and a brake curve with the deceleration of the plan to
every target.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from plant_sim.units import KMH
from train_ato.control.contract import LawPlan
from train_ato.loop.train_protection import SUPERVISOR
from train_ato.messages.types import Array
from train_ato.supervision.settings import MIN_INDICATION_TIME, FixedValues
from train_ato.supervision.step_function import ceiling_speeds
from train_ato.supervision.supervisor import STANDSTILL_SPEED, SupervisionState
from train_ato.view.facts import Facts, ProfileCurve, plan_words
from train_ato.view.style import GAUGE_COLOURS, NEEDLE

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
    facts: Facts, profile: ProfileCurve | None, front: float, speed: float, *, limits: Array | None, state: str
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
    sign, timetable = timetable.way(time)
    reached, position = timetable.reached, sign * position
    rows = np.minimum(np.searchsorted(reached, position + np.array([-STOPPED, STOPPED])), reached.size - 1)
    arrival, departure = map(float, timetable.time[rows])
    exact = float(np.interp(position, reached, timetable.time))
    if departure - arrival > 2.0 * AHEAD_S:  # at a stop of the timetable
        return max(time - departure, 0.0) + min(time - arrival, 0.0)
    return time - exact


MIN_ARC = 1e-3
"""Smallest angle between two limits on the dial [rad]: Bokeh draws a ring between equal angles as a full ring."""
DIAL_BEGIN, DIAL_SWEEP = math.radians(225.0), math.radians(270.0)
"""Angle of 0 km/h on the speed dial and its clockwise range [rad]."""


@dataclass(frozen=True)
class ProtectionStates:
    """Texts of the states of supervision, train protection and ATO, and of their reasons; "" without one."""

    supervision: str = ""
    supervision_reason: str = ""
    protection: str = ""
    protection_reason: str = ""
    ato: str = ""
    ato_reason: str = ""

    @property
    def reasons(self) -> str:
        """Reasons of all states that are not nominal."""
        known = self.protection_reason in ("", SUPERVISOR)
        train = "" if known else f"train: {self.protection_reason}"
        ato = f"ATO: {self.ato_reason}" if self.ato_reason else ""
        return "; ".join(part for part in (self.supervision_reason, train, ato) if part)


@dataclass(frozen=True)
class Snapshot:
    """State of train and stack at one stamp; SI, arrays front first.

    Attributes
    ----------
    time
        Simulated time [s].
    position, velocity, coupler : Array, shape (n,)
        Position, speed and force of the coupler behind of every vehicle, true values.
    shoe : Array, shape (n,), or None
        Shoe force [N]; None without an air brake.
    applied, command, estimate : Array, shape (units,)
        Forces [N]; NaN without a message.
    reference : tuple of float
        Position, speed and acceleration of the profile.
    pipe, pipe_demand
        Brake-pipe pressure at the head and as demanded [Pa]; NaN without an air brake.
    law, state
        Active law; state of the plant.
    limits : Array, shape (4,), or None
        Permitted, warning, service-brake and emergency-brake speed of the supervisor [m/s]; None without a supervisor.
    states
        States of supervision, train protection and ATO.
    factor
        Simulated seconds per second of wall time.
    plan : LawPlan or None
        Newest plan of the law, with simulation times [s].
    """

    time: float
    position: Array
    velocity: Array
    coupler: Array
    shoe: Array | None
    applied: Array
    command: Array
    estimate: Array
    reference: tuple[float, float, float]
    pipe: float = math.nan
    pipe_demand: float = math.nan
    law: str = ""
    state: str = "running"
    factor: float = math.nan
    limits: Array | None = None
    states: ProtectionStates = ProtectionStates()
    plan: LawPlan | None = None

    @property
    def speed(self) -> float:
        """Speed of vehicle 0 [km/h]."""
        return KMH * float(self.velocity[0])

    @property
    def error(self) -> float:
        """Speed of vehicle 0 minus speed of the profile [km/h]."""
        return self.speed - KMH * self.reference[1]


STRIP = ("time", "speed", "profile", "limit", "error", "applied", "demand", "most", "least", "draft", "buff", "place",
         "permitted", "emergency")  # fmt: skip
"""Columns of the strip charts: s, km/h, kN and km."""
LIMIT_NAMES = ("permitted", "warning", "service", "emergency")
"""Limits of the supervisor, in the order of the message without the estimated speed."""


def strip_row(moment: Snapshot, facts: Facts) -> tuple[float, ...]:
    """Return the values of a snapshot for the strip charts, in the order of :data:`STRIP`."""
    least, most = facts.envelope(abs(float(moment.velocity[0])))
    limit = facts.limit_now(float(moment.position[0]) + facts.nose)
    return (
        moment.time,
        moment.speed,
        KMH * moment.reference[1],
        KMH * limit if math.isfinite(limit) else math.nan,
        moment.error,
        float(moment.applied.sum()) / 1e3,
        float(moment.command.sum()) / 1e3,
        most / 1e3,
        least / 1e3,
        float(moment.coupler.max(initial=0.0)) / 1e3,
        float(moment.coupler.min(initial=0.0)) / 1e3,
        (float(moment.position[0]) + facts.nose) / 1e3,
        math.nan if moment.limits is None else KMH * float(moment.limits[0]),
        math.nan if moment.limits is None else KMH * float(moment.limits[-1]),
    )


def along(moment: Snapshot) -> dict[str, Array]:
    """Return the columns of the forces along the train [kN]: coupler (buff is negative) and shoe force."""
    coupler = moment.coupler / 1e3
    shoe = np.zeros_like(coupler) if moment.shoe is None else moment.shoe / 1e3
    return {"coupler": coupler.astype(np.float32), "shoe": shoe.astype(np.float32)}


def now(moment: Snapshot, facts: Facts, profile: ProfileCurve | None, scale: float) -> dict[str, list[Any]]:
    """Return the row of the driver's display: angles [rad], forces [kN] and formatted texts."""
    front = float(moment.position[0]) + facts.nose
    limit = KMH * facts.limit_now(front)
    known = math.isfinite(limit)
    least, most = facts.envelope(abs(float(moment.velocity[0])))
    sign, way = (1.0, None) if profile is None else profile.way(moment.time)
    ahead = facts if sign > 0.0 else facts.mirrored
    place = sign * float(moment.position[0])
    stop, lower = math.nan if way is None else way.end - place, ahead.next_lower_limit(place + ahead.nose)
    row = {
        "speed_angle": angle(abs(moment.speed), scale),
        "profile_angle": angle(abs(KMH * moment.reference[1]), scale),
        "limit_angle": angle(limit, scale),
        "limited": float(known),
        "applied": float(moment.applied.sum()) / 1e3,
        "demand": float(moment.command.sum()) / 1e3,
        "most": most / 1e3,
        "least": least / 1e3,
        "state": moment.state,
        "law": ", ".join(filter(None, (moment.law, plan_words(moment.plan, moment.time)))),
        "speed_text": f"{moment.speed:.0f}"
        if abs(moment.speed) >= 9.95
        else f"{moment.speed:.1f}".replace("-0.0", "0.0"),
        "clock_text": full_clock(moment.time),
        "profile_text": f"{KMH * moment.reference[1]:.1f}",
        "limit_text": f"{limit:.0f}" if known else "–",
        "error_text": signed(moment.error, 2),
        "place_text": f"{front / 1e3:.3f}" if facts.setup is None else facts.setup.line.post_at(front),
        "stop_text": distance(stop),
        "target_text": "–" if lower is None else f"{KMH * lower[1]:.0f} in {distance(lower[0] - place - ahead.nose)}",
        "applied_text": signed(moment.applied.sum() / 1e3, 0),
        "demand_text": signed(moment.command.sum() / 1e3, 0),
        "draft_text": _extreme(moment.coupler, 1),
        "buff_text": _extreme(moment.coupler, -1),
        "pipe_text": f"{moment.pipe / 1e3:.0f}" if math.isfinite(moment.pipe) else "–",
        "shoe_text": "–" if moment.shoe is None else f"{moment.shoe.sum() / 1e3:.0f}",
        "position_error_text": signed(float(moment.position[0]) - moment.reference[0], 1),
        "factor_text": f"× {moment.factor:.3g}" if math.isfinite(moment.factor) else "",
    }
    row |= _supervised(moment, scale) | _guided(moment, ahead, way, scale, place) | {"front_m": front}
    return {name: [value] for name, value in row.items()}


def _supervised(moment: Snapshot, scale: float) -> dict[str, Any]:
    """Return limits and states of a supervised run: angles [rad] and texts."""
    states, limits = moment.states, moment.limits
    speeds = [math.nan] * len(LIMIT_NAMES) if limits is None else [KMH * float(speed) for speed in limits]
    angles: list[float] = []
    for speed in speeds:
        at = angle(speed if math.isfinite(speed) else scale, scale)
        angles.append(min(at, angles[-1] - MIN_ARC) if angles else at)
    return {
        **{f"{name}_angle": at for name, at in zip(LIMIT_NAMES, angles, strict=True)},
        **{
            f"{name}_text": f"{speed:.1f}" if math.isfinite(speed) else "–"
            for name, speed in zip(LIMIT_NAMES, speeds, strict=True)
        },
        "supervision": states.supervision,
        "ato": states.ato,
        "supervision_text": states.supervision or "–",
        "ato_text": states.ato or "–",
        "reason_text": states.reasons,
    }


def _guided(moment: Snapshot, facts: Facts, profile: ProfileCurve | None, scale: float, place: float) -> dict[str, Any]:
    """Return the speeds on the rim of the dial, the next target and the nearest stop: rad, m, km/h and colours.

    Line, profile and place of vehicle 0's centre [m] are mirrored on a way back.
    """
    front = place + facts.nose
    speed = abs(float(moment.velocity[0]))
    found = guidance(facts, profile, front, speed, limits=moment.limits, state=moment.states.supervision)
    gauge, needle, above = GAUGE_COLOURS[found.state]
    if found.state > SupervisionState.INDICATION and found.permitted >= facts.limit_now(front) - 0.1:
        gauge = GAUGE_COLOURS[SupervisionState.NORMAL][0]  # ceiling supervision, no target
    if found.state == SupervisionState.INDICATION and speed < found.target_speed:
        needle = NEEDLE
    permitted = angle(KMH * found.permitted, scale)
    target = KMH * found.target_speed if math.isfinite(found.target_speed) else 0.0
    limited = math.isfinite(found.permitted)
    stops = np.zeros(0) if profile is None else profile.stops
    offsets = place - stops
    return {
        "needle": needle,
        "gauge_colour": gauge if limited else "#22384c",
        "above_colour": above,
        "above_alpha": 0.3 if found.state <= SupervisionState.INDICATION else 1.0,
        "gauge_angle": permitted if limited else DIAL_BEGIN - MIN_ARC,
        "target_angle": max(angle(target, scale), permitted + MIN_ARC) if limited else DIAL_BEGIN - MIN_ARC / 2,
        "above_angle": min(angle(KMH * found.intervention, scale), permitted - MIN_ARC),
        "hooked": float(limited),
        "guidance": found.state.text,
        "target_m": found.target_distance,
        "target_kmh": KMH * found.target_speed,
        "stop_offset": float(offsets[np.abs(offsets).argmin()]) if offsets.size else math.nan,
    }


def delay_text(timetable: ProfileCurve | None, moment: Snapshot, window: float) -> str:
    """Return the delay against the timetable as text; ``arrived`` at standstill in the window [m] of its end."""
    if timetable is None:
        return "–"
    if abs(timetable.end - float(moment.position[0])) <= window and abs(moment.speed) < STANDSTILL_SPEED * KMH:
        return "arrived"
    return f"{signed(delay_at(timetable, moment.time, float(moment.position[0])), 0)} s"


def where(moment: Snapshot, facts: Facts, profile: ProfileCurve | None) -> dict[str, list[float]]:
    """Return the row for the figures over time and place: km, km/h, s."""
    front = float(moment.position[0]) + facts.nose
    return {
        "place": [front / 1e3],
        "rear": [(front - facts.length) / 1e3],
        "stop": [math.nan if profile is None else (profile.end + facts.nose) / 1e3],
        "speed": [moment.speed],
        "time": [moment.time],
    }


def angle(speed: float, scale: float) -> float:
    """Return the angle of a speed on the dial [rad], both in km/h; a speed beyond the scale is at its end.

    The angle never reaches an end exactly, because Bokeh draws a ring between equal angles as a full ring.
    """
    return DIAL_BEGIN - DIAL_SWEEP * min(max(speed / scale, 1e-3), 1.0 - 1e-3)


def _extreme(coupler: Array, sign: int) -> str:
    """Return the largest draft (sign 1) or buff (-1) [kN] and its vehicle as text."""
    if coupler.size < 2:
        return "–"
    place = int((sign * coupler).argmax())
    force = float(coupler[place]) / 1e3
    return f"{max(sign * force, 0.0):.0f} @ {place}" if sign * force > 0.5 else "0"


def signed(value: float, digits: int) -> str:
    """Return a number with its sign; a number that rounds to zero is +0."""
    return f"{round(value, digits) + 0.0:+.{digits}f}"


def distance(metres: float) -> str:
    """Return a distance as text in m or km."""
    if not math.isfinite(metres):
        return "–"
    return (
        f"{metres / 1e3:.2f} km"
        if abs(metres) >= 999.5
        else f"{metres:.0f} m"
        if abs(metres) >= 20
        else f"{metres:.2f} m"
    )


def full_clock(seconds: float) -> str:
    """Return a time [s] as h:mm:ss.s."""
    tenths = round(seconds * 10)
    return f"{tenths // 36_000}:{tenths // 600 % 60:02d}:{tenths // 10 % 60:02d}.{tenths % 10}"
