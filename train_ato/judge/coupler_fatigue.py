"""Fatigue damage of the couplers in a recorded run, alone or relative to another run."""

from dataclasses import dataclass
from typing import Any

from train_ato.judge.recording import TRUTH, Recording
from train_ato.messages.types import Array
from train_ato.profile.trip.plan import SLOPE, coupler_damage

KEYS = ("coupler_damage", "coupler_damage_worst")
"""Damage of all couplers and of the worst one, keys of a summary."""


@dataclass(frozen=True)
class CouplerFatigue:
    """Fatigue of the couplers of a train in one run.

    Attributes
    ----------
    damage : Array, shape (couplers,)
        Damage after Miner; 1 per force cycle with a range of 1 MN.
    range_max : Array, shape (couplers,)
        Largest force of a coupler minus its smallest one [N].
    """

    damage: Array
    range_max: Array

    @property
    def total(self) -> float:
        """Damage of all couplers."""
        return float(self.damage.sum())

    def summary(self) -> dict[str, float | int]:
        """Return damage of all couplers and of the worst one, its number, its range [kN] and the slope."""
        worst = int(self.damage.argmax())
        return {
            KEYS[0]: round(self.total, 4),
            KEYS[1]: round(float(self.damage[worst]), 4),
            "worst_coupler": worst,
            "range_of_worst_kn": round(float(self.range_max[worst]) / 1e3, 1),
            "slope": SLOPE,
        }


def coupler_fatigue(recording: Recording) -> CouplerFatigue | None:
    """Return the fatigue of the couplers at the ticks of a recording with vehicles; None without couplers."""
    found = recording.of(TRUTH, "coupler_force")
    if found is None or found[1].shape[1] < 2:
        return None
    force = found[1][:, :-1]
    return CouplerFatigue(coupler_damage(force), force.max(axis=0) - force.min(axis=0))


def relative_fatigue(run: CouplerFatigue, other: CouplerFatigue) -> dict[str, Any]:
    """Return the damage of another run, and the ratio of a run to it; None if the other one has no damage."""
    ratio = run.total / other.total if other.total > 0.0 else None
    return {"other_coupler_damage": round(other.total, 4), "ratio": None if ratio is None else round(ratio, 4)}
