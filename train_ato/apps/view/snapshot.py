"""One moment of a run, and how it is written for the page: numbers that glyphs are bound to, and texts."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from train_ato.types import Array
from train_ato.view.facts import KMH, Facts, Profile
from train_ato.view.style import NEEDLE, OVERSPEED

OVER = 1.0
"""Speed over the limit from which it is shown as an overspeed [km/h]."""
DIAL_BEGIN, DIAL_SWEEP = math.radians(225.0), math.radians(270.0)
"""Angle of 0 on the speed dial, and what it sweeps clockwise to its end."""


@dataclass(frozen=True)
class Moment:
    """State of train and stack at one stamp; SI, arrays front first.

    Attributes
    ----------
    time
        Simulated time [s].
    position, velocity, coupler : Array, shape (n,)
        Truth of every vehicle.
    shoe : Array, shape (n,), or None
        Shoe force [N], None without an air brake.
    applied, command, estimate : Array, shape (units,)
        Forces [N]; NaN where the topic has not come.
    reference : tuple of float
        Position, speed, acceleration of the profile now.
    pipe, pipe_demand
        Brake-pipe pressure at the head and as demanded [Pa]; NaN without an air brake.
    law, state
        Law in charge; what the plant says of itself.
    factor
        Simulated seconds per second of wall time.
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
    notes: dict[str, str] = field(default_factory=dict)

    @property
    def speed(self) -> float:
        """Speed of vehicle 0 [km/h]."""
        return KMH * float(self.velocity[0])

    @property
    def error(self) -> float:
        """Speed of vehicle 0 less that of the profile [km/h]."""
        return self.speed - KMH * self.reference[1]


STRIP = ("time", "speed", "profile", "limit", "error", "applied", "demand", "most", "least", "draft", "buff", "place")
"""Columns of the strip charts: s, km/h, kN and km."""


def strip_row(moment: Moment, facts: Facts) -> tuple[float, ...]:
    """Return the values of the strip charts at a moment, in the order of :data:`STRIP`."""
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
    )


def along(moment: Moment) -> dict[str, Array]:
    """Return the columns of the force strip along the train [kN]: draft, buff (negative) and shoe force."""
    coupler = moment.coupler / 1e3
    shoe = np.zeros_like(coupler) if moment.shoe is None else moment.shoe / 1e3
    return {"coupler": coupler.astype(np.float32), "shoe": shoe.astype(np.float32)}


def now(moment: Moment, facts: Facts, profile: Profile | None, scale: float) -> dict[str, list[Any]]:
    """Return the one row that the driver's display is bound to: speeds in km/h, places in km, texts ready to read."""
    front = float(moment.position[0]) + facts.nose
    limit = KMH * facts.limit_now(front)
    known = math.isfinite(limit)
    over = known and moment.speed > limit + OVER
    least, most = facts.envelope(abs(float(moment.velocity[0])))
    stop = math.nan if profile is None else profile.end - float(moment.position[0])
    row = {
        "speed_angle": angle(abs(moment.speed), scale),
        "profile_angle": angle(abs(KMH * moment.reference[1]), scale),
        "limit_angle": angle(limit, scale),
        "limited": float(known),
        "needle": OVERSPEED if over else NEEDLE,
        "applied": float(moment.applied.sum()) / 1e3,
        "demand": float(moment.command.sum()) / 1e3,
        "most": most / 1e3,
        "least": least / 1e3,
        "state": moment.state,
        "law": moment.law,
        "speed_text": f"{moment.speed:.0f}"
        if abs(moment.speed) >= 9.95
        else f"{moment.speed:.1f}".replace("-0.0", "0.0"),
        "clock_text": clock(moment.time),
        "profile_text": f"{KMH * moment.reference[1]:.1f}",
        "limit_text": f"{limit:.0f}" if known else "–",
        "error_text": signed(moment.error, 2),
        "place_text": f"{front / 1e3:.3f}",
        "stop_text": distance(stop),
        "target_text": _target(facts, front),
        "applied_text": signed(moment.applied.sum() / 1e3, 0),
        "demand_text": signed(moment.command.sum() / 1e3, 0),
        "draft_text": _extreme(moment.coupler, 1),
        "buff_text": _extreme(moment.coupler, -1),
        "pipe_text": f"{moment.pipe / 1e3:.0f}" if math.isfinite(moment.pipe) else "–",
        "shoe_text": "–" if moment.shoe is None else f"{moment.shoe.sum() / 1e3:.0f}",
        "lag_text": signed(float(moment.position[0]) - moment.reference[0], 1),
        "factor_text": f"× {moment.factor:.3g}" if math.isfinite(moment.factor) else "",
    }
    return {name: [value] for name, value in row.items()}


def where(moment: Moment, facts: Facts, profile: Profile | None) -> dict[str, list[float]]:
    """Return the one row that the figures over time and place follow: km, km/h, s."""
    front = float(moment.position[0]) + facts.nose
    return {
        "place": [front / 1e3],
        "rear": [(front - facts.length) / 1e3],
        "stop": [math.nan if profile is None else (profile.end + facts.nose) / 1e3],
        "speed": [moment.speed],
        "time": [moment.time],
    }


def angle(speed: float, scale: float) -> float:
    """Return where a speed stands on the dial [rad], both in km/h; at its end for what is beyond.

    It stays clear of both ends by a hair, because a ring between equal angles is drawn as a whole one.
    """
    return DIAL_BEGIN - DIAL_SWEEP * min(max(speed / scale, 1e-3), 1.0 - 1e-3)


def _target(facts: Facts, front: float) -> str:
    """Return the next lower limit and how far it is."""
    target = facts.next_lower_limit(front)
    return "–" if target is None else f"{KMH * target[1]:.0f} in {distance(target[0] - front)}"


def _extreme(coupler: Array, sign: int) -> str:
    """Return the largest draft (sign 1) or buff (-1) along the train and behind which vehicle it is."""
    if coupler.size < 2:
        return "–"
    place = int((sign * coupler).argmax())
    force = float(coupler[place]) / 1e3
    return f"{max(sign * force, 0.0):.0f} @ {place}" if sign * force > 0.5 else "0"


def signed(value: float, digits: int) -> str:
    """Return a number with its sign; what rounds to zero is +0."""
    return f"{round(value, digits) + 0.0:+.{digits}f}"


def distance(metres: float) -> str:
    """Return a distance as a driver reads it."""
    if not math.isfinite(metres):
        return "–"
    return (
        f"{metres / 1e3:.2f} km"
        if abs(metres) >= 999.5
        else f"{metres:.0f} m"
        if abs(metres) >= 20
        else f"{metres:.2f} m"
    )


def clock(seconds: float) -> str:
    """Return a time as h:mm:ss.s."""
    tenths = round(seconds * 10)
    return f"{tenths // 36_000}:{tenths // 600 % 60:02d}:{tenths // 10 % 60:02d}.{tenths % 10}"
