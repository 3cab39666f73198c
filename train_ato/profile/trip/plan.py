"""Trip plan: profile, applications, run of the whole train, and their figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from train_ato.control.air_brake.trip_policy import PlannedApplication
from train_ato.control.force_distribution import SharesAt
from train_ato.control.planned_displacement import DisplacementAt
from train_ato.control.train_model import TrainModel
from train_ato.profile.profile import Profile
from train_ato.profile.trip.driven_run import TripRun
from train_ato.profile.trip.fatigue import coupler_damage
from train_ato.profile.trip.journey import Journey
from train_ato.profile.trip.settings import TripSettings

JOULES_PER_KWH = 3.6e6


@dataclass(frozen=True)
class TripPlan:
    """Planned trip of a long train.

    Attributes
    ----------
    profile : Profile
        Speed profile of vehicle 0's centre.
    applications : tuple of PlannedApplication
        Applications of the air brake, with the planned use of the electric brake.
    run : TripRun
        Run of the nominal train, up to the last part of the braking.
    journey : Journey
        Journey of the reduced model.
    price : float
        Price of time [kWh/s].
    model : TrainModel
        Nominal train on its line.
    settings : TripSettings
        Limits of the plan.
    shares : tuple of SharesAt
        Shares of the power units by place; empty for the fixed ones of the model.
    displacements : tuple of DisplacementAt
        Planned motion of several power units against the profile.
    """

    profile: Profile
    applications: tuple[PlannedApplication, ...]
    run: TripRun
    journey: Journey
    price: float
    model: TrainModel
    settings: TripSettings
    shares: tuple[SharesAt, ...] = ()
    displacements: tuple[DisplacementAt, ...] = ()

    @property
    def running_time(self) -> float:
        """Time from the begin to standstill [s]."""
        return self.profile.end - self.profile.start

    @property
    def coupler_max(self) -> float:
        """Largest coupler force of the nominal train, draft or buff [N]."""
        return max(self.run.totals.draft_max, -self.run.totals.buff_max)

    def cost(self, price: float) -> float:
        """Return the objective for a price of time [kWh/s]: net energy, time and fatigue with their weights [kWh]."""
        totals, settings = self.run.totals, self.settings
        energy = (totals.traction - settings.recovered * totals.regenerated) / JOULES_PER_KWH
        damage = float(coupler_damage(self.run.couplers).sum()) if settings.fatigue_weight > 0.0 else 0.0
        return energy + price * self.running_time + settings.fatigue_weight * damage

    def summary(self) -> dict[str, Any]:
        """Return the figures of the plan, units in the keys."""
        totals, damage = self.run.totals, coupler_damage(self.run.couplers)
        return {
            "running_time_s": round(self.running_time, 1),
            "distance_m": round(float(self.profile.position[-1] - self.profile.position[0]), 1),
            "energy_kwh": round(totals.traction / JOULES_PER_KWH, 1),
            "energy_regenerated_kwh": round(totals.regenerated / JOULES_PER_KWH, 1),
            "energy_air_brake_kwh": round(-totals.air_brake / JOULES_PER_KWH, 1),
            "time_price_kwh_per_s": round(self.price, 4),
            "speed_max_kmh": round(3.6 * float(self.profile.velocity.max()), 2),
            "coupler_draft_max_kn": round(totals.draft_max / 1e3, 1),
            "coupler_buff_max_kn": round(totals.buff_max / 1e3, 1),
            "coupler_damage": round(float(damage.sum()), 4),
            "coupler_damage_worst": round(float(damage.max(initial=0.0)), 4),
            "traction_limit": round(self.settings.traction, 3),
            "slew_kn_per_s": round(self.settings.slew / 1e3, 2),
            "applications": [
                {
                    "apply_km": round(entry.apply / 1e3, 3),
                    "release_km": round(entry.release / 1e3, 3),
                    "reduction_kpa": round(entry.reduction / 1e3, 1),
                    "supply": round(searched.supply, 3),
                }
                for entry, searched in zip(self.applications, self.journey.applications, strict=True)
            ],
        }
