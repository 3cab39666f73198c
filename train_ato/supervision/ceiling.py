"""Ceiling supervision: margins above a speed limit, SUBSET-026, 3.13.9.2 with the fixed values of A.3.1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from plant_sim.units import KMH


@dataclass(frozen=True, slots=True)
class CeilingMargin:
    """Margin above a speed limit: constant, then linear between two limits, then constant [km/h]."""

    margin_min: float
    margin_max: float
    speed_min: float
    speed_max: float

    def above(self, limit: float) -> float:
        """Return the margin [m/s] above a limit [m/s]: 3.13.9.2.3."""
        slope = (self.margin_max - self.margin_min) / (self.speed_max - self.speed_min)
        linear = self.margin_min + slope * max(limit * KMH - self.speed_min, 0.0)
        return min(linear, self.margin_max) / KMH


WARNING_MARGIN = CeilingMargin(4.0, 5.0, 110.0, 140.0)
SERVICE_MARGIN = CeilingMargin(5.5, 10.0, 110.0, 210.0)
EMERGENCY_MARGIN = CeilingMargin(7.5, 15.0, 110.0, 210.0)


class SupervisionSpeeds(NamedTuple):
    """Speeds of the supervision at one position [m/s].

    Attributes
    ----------
    permitted, warning, service, emergency : float
        Permitted speed, and the speeds of warning, service-brake and emergency-brake intervention.
    """

    permitted: float
    warning: float
    service: float
    emergency: float


def ceiling_speeds(limit: float) -> SupervisionSpeeds:
    """Return the ceiling speeds [m/s] for a speed limit [m/s]."""
    return SupervisionSpeeds(
        limit,
        limit + WARNING_MARGIN.above(limit),
        limit + SERVICE_MARGIN.above(limit),
        limit + EMERGENCY_MARGIN.above(limit),
    )
