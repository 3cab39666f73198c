"""Reward of the environment: costs with physical units, each with a weight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from plant_sim.train import Train
from train_ato.control.parameters import closest
from train_ato.loop.setup import RunSetup


@dataclass(frozen=True)
class Cost:
    """One cost; the reward is minus the sum of weight times cost."""

    name: str
    unit: str
    meaning: str
    weight: float


COSTS = (
    Cost("tracking", "m²/s", "integral of the squared speed error, mean over the units", 1.0),
    Cost("energy", "kWh", "work of the power units in traction minus that of their electric brakes", 0.1),
    Cost("comfort", "m²/s⁵", "integral of the squared jerk of vehicle 0", 0.1),
    Cost("couplers", "kN", "growth of the largest coupler force of the run, draft or buff", 0.01),
    Cost("stop", "m", "at the end: largest stop error, without a stop the distance from the target", 1.0),
    Cost("punctuality", "s", "at the end: delay of arrival, without one from the planned arrival on; early counts too",
         0.1),
)  # fmt: skip
"""All costs with their default weights [1/unit]. Their sums over a run are those of its metrics."""


def weights_of(given: Mapping[str, float] | None) -> dict[str, float]:
    """Return the weights by name; costs that are not given have none, without any given each has its default.

    Raises
    ------
    ValueError
        For an unknown cost or a weight that is not finite.
    """
    known = {cost.name: cost.weight for cost in COSTS}
    for name, weight in (given or {}).items():
        if name not in known:
            raise ValueError(f"reward: unknown cost '{name}'{closest(name, tuple(known))}; use {', '.join(known)}")
        if not np.isfinite(weight):
            raise ValueError(f"reward: {name}: weight {weight} is not finite; give a number")
    return known if given is None else {name: float(weight) for name, weight in given.items()}


@dataclass
class CostCounter:
    """Costs of a run from the true state of its train.

    Attributes
    ----------
    speed, acceleration : float
        Of vehicle 0 at the last tick [m/s, m/s²].
    energy, coupler : float
        Work [J] and largest coupler force [N] up to it.
    """

    speed: float
    acceleration: float = 0.0
    energy: float = 0.0
    coupler: float = 0.0

    def tick(self, train: Train, tick: float) -> dict[str, float]:
        """Return the costs of a tick [s] with the state after it, without ``tracking``."""
        totals, speeds = train.totals, train.velocity
        energy, coupler = totals.traction - totals.regenerated, max(totals.draft_max, -totals.buff_max)
        acceleration = (speeds.item(0) - self.speed) / tick
        jerk = (acceleration - self.acceleration) / tick
        costs = {
            "energy": (energy - self.energy) / 3.6e6,
            "comfort": jerk * jerk * tick,
            "couplers": (coupler - self.coupler) / 1e3,
        }
        self.speed, self.acceleration, self.energy, self.coupler = speeds.item(0), acceleration, energy, coupler
        return costs


def end_costs(setup: RunSetup, metrics: Mapping[str, Any], front: float) -> dict[str, float]:
    """Return the costs of the end of a run.

    Parameters
    ----------
    setup
        The run.
    metrics
        Metrics of the run.
    front
        Position of vehicle 0's centre at the end [m].
    """
    stop, delay = metrics.get("stop_error_max_m"), metrics.get("arrival_delay_max_s")
    late = max(0.0, setup.ticks * setup.tick - float(setup.profile.time[-1]))
    return {
        "stop": abs(front - float(setup.profile.position[-1])) if stop is None else abs(stop),
        "punctuality": late if delay is None else abs(delay),
    }
