"""Trip plan: profile, applications, run of the whole train, and their figures.

Fatigue of the couplers: rainflow cycles after ASTM E1049 and their damage after Miner.

The cycles are those of the library `rainflow`. The force is first reduced to its reversals. This does not change the
cycles and is 100 times faster. Damage is relative: the sum of (range / 1 MN)^k over all cycles. Half cycles count half.
k = 5 is the slope of the S-N curve of steel without welds (FKM guideline "Analytical strength assessment").
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from train_ato.control.air_brake.trip_policy import PlannedApplication
from train_ato.control.force_distribution import DisplacementAt, SharesAt
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array
from train_ato.profile.profile import Profile
from train_ato.profile.trip.driven_run import TripRun
from train_ato.profile.trip.journey import Journey
from train_ato.profile.trip.settings import TripSettings

SLOPE = 5.0
"""Slope of the S-N curve of steel without welds."""
REFERENCE_RANGE = 1e6
"""Range of a cycle of damage 1 [N]."""
MIN_RANGE = 20e3
"""Cycles below this range are omitted [N]: 2 % of the reference range, damage 3e-9."""


def coupler_damage(force: Array) -> Array:
    """Return the damage of every coupler, 1 per cycle with a range of 1 MN.

    Parameters
    ----------
    force : Array, shape (n, couplers)
        Coupler forces at increasing times [N].

    Returns
    -------
    Array, shape (couplers,)
        Sum over the cycles of count times (range / 1 MN)^k.
    """
    return np.array([cycle_damage(coupler_cycles(column)) for column in force.T])


def coupler_cycles(force: Array) -> Array:
    """Return range [N] and count of the force cycles of one coupler, without those below 20 kN; shape (cycles, 2).

    ``force`` has its values at increasing times [N], shape (n,).
    """
    import rainflow

    points = reversals(force)
    cycles = np.array([(size, count) for size, _, count, _, _ in rainflow.extract_cycles(points)]).reshape(-1, 2)
    return np.asarray(cycles[cycles[:, 0] >= MIN_RANGE])


def cycle_damage(cycles: Array) -> float:
    """Return the damage of force cycles of :func:`coupler_cycles`, 1 per cycle with a range of 1 MN."""
    return float(((cycles[:, 0] / REFERENCE_RANGE) ** SLOPE * cycles[:, 1]).sum())


def reversals(series: Array) -> Array:
    """Return first and last value and the local extremes of a series."""
    if series.size < 3:
        return series
    step = np.diff(series)
    kept = np.concatenate(([True], step != 0.0))
    values = series[kept]
    turning = np.sign(np.diff(values))
    inner = np.flatnonzero(turning[1:] != turning[:-1]) + 1
    return np.asarray(values[np.concatenate(([0], inner, [values.size - 1]))])


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
