"""Ten planted faults: a short metro run, keys that vary, and a requirement that a small part of their space breaks.

The share of the space is measured by ``python studies_done/falsify.py --shares``.  The limits were chosen so that it is about
1 %.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

BASE: dict[str, Any] = {
    "duration": 14,
    "tick": 0.25,
    "step": 0.025,
    "plant.line": {"schema": "train_ato/line/1", "name": "short", "end_km": 2},
    "plant.adhesion": {"kind": "curtius_kniffler", "factor": 1.0},
    "plant.disturbances": [{"kind": "gust", "begin": 4, "end": 60, "acceleration": 0.0, "ramp": 0.5}],
    "links": {"command": {"delay": 0.2}},
    "model": {"delay": 0.2, "lag": 0.4},
    "profile": {
        "limits": {"jerk": 0.6, "acceleration": 0.8, "deceleration": 0.8},
        "phases": [{"accelerate_to_kmh": 15}, {"cruise_for": 0.5}, {"brake_to": 0}],
    },
}
"""Changes of the shipped scenario ``xuzhou_metro``: 15 km/h and a stop in 14 s."""


def limits(low: float, high: float) -> dict[str, float]:
    """Return a range."""
    """Return a range."""
    return {"from": low, "to": high}


MASS = {"plant.mismatch.mass_scale": limits(0.8, 1.3)}
DELAY = {"links.command.delay": limits(0.0, 0.8)}
LAG = {"plant.lag": limits(0.1, 0.8)}
GAIN = {"plant.mismatch.actuator_gain": limits(0.7, 1.2)}
GUST = {"plant.disturbances.0.acceleration": limits(-0.2, 0.2)}
GUST_TIME = {"plant.disturbances.0.begin": limits(1.0, 12.0)}
ADHESION = {"plant.adhesion.factor": limits(0.2, 1.0)}
BRAKE = {"plant.mismatch.electric_brake_scale": limits(0.6, 1.0)}


@dataclass(frozen=True)
class PlantedFault:
    """Name, keys with ranges and requirement of a fault."""

    name: str
    over: dict[str, Any]
    requirement: str


FAULTS: tuple[PlantedFault, ...] = (
    PlantedFault("overspeed by delay and light train", MASS | DELAY, "G speed_error <= 7.83 km/h"),
    PlantedFault("too slow by headwind and heavy train", MASS | GUST, "G speed_error >= -1.67 km/h"),
    PlantedFault("position lost by a late gust", GUST | GUST_TIME | MASS, "G[10,end] abs(position_error) <= 3.26 m"),
    PlantedFault("too slow at low adhesion", ADHESION | MASS | GAIN, "G position_error >= -4.92 m"),
    PlantedFault("overrun by weak brake and tailwind", BRAKE | DELAY | GUST, "G distance_to_stop >= -9.8 m"),
    PlantedFault("jerk by lag and delay", LAG | DELAY | GAIN, "G abs(jerk) <= 1.203 m/s3"),
    PlantedFault(
        "slow recovery", MASS | DELAY | GAIN | GUST,
        "G[0,10] (abs(speed_error) >= 10 km/h -> F[0,3] abs(speed_error) <= 9.8 km/h)",
    ),
    PlantedFault("no stop at the target", GUST | GUST_TIME | DELAY | BRAKE, "F[12,14] abs(distance_to_stop) <= 5.63 m"),
    PlantedFault("position lost by delay, lag and gust", MASS | DELAY | LAG | GUST, "G abs(position_error) <= 12.3 m"),
    PlantedFault("overrun with five causes", MASS | DELAY | LAG | GUST | BRAKE, "G distance_to_stop >= -14.67 m"),
)  # fmt: skip
