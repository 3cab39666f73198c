"""Net energy of a plan: traction over its efficiency, minus the recovered part of the electric brake, plus auxiliaries.

The electric brake acts first, up to its own envelope; friction brakes do the rest and recover nothing.
"""

from __future__ import annotations

import numpy as np

from train_ato.messages.types import Array
from train_ato.profile.planner.driving_strategy import DrivingStrategy
from train_ato.profile.planner.dynamic_programming import EnergyWeights
from train_ato.profile.planner.section import PlanSection
from train_ato.profile.planner.settings import PlanSettings
from train_ato.profile.planner.train_tables import SPEED_STEP


def energy_weights(settings: PlanSettings) -> EnergyWeights:
    """Return cost of traction work and gain of electric-brake work in the net energy [1]."""
    return EnergyWeights(1.0 / settings.efficiency, settings.recovered)


def weighted_energy(traction: float, electric: float, time: float, settings: PlanSettings) -> float:
    """Return the net energy [J].

    Parameters
    ----------
    traction, electric
        Work of traction and of the electric brake [J], both >= 0.
    time
        Time with auxiliary power [s].
    settings
        Efficiency, recovered share and auxiliary power.
    """
    weights = energy_weights(settings)
    return weights.traction * traction - weights.recovered * electric + settings.auxiliary * time


def section_energy(section: PlanSection, strategy: DrivingStrategy) -> float:
    """Return the net energy of a section without a jerk limit and without auxiliaries [J]."""
    traction, electric = section_work(section, strategy)
    weights = energy_weights(section.inputs.settings)
    return weights.traction * traction - weights.recovered * electric


def section_work(section: PlanSection, strategy: DrivingStrategy) -> tuple[float, float]:
    """Return the work of traction and of the electric brake of a section without a jerk limit [J]."""
    energy, train = section.energy_profile(strategy), section.inputs.train
    steps, columns = section.grid.steps, SPEED_STEP * np.arange(train.speed.size)
    speed = np.sqrt(energy[:-1] + energy[1:])
    resistance = np.interp(speed, columns, train.resistance) + section.tables.air[1] * train.inertia * speed**2
    _, mean, _ = section.inputs.force.over_cells(section.grid)
    force: Array = np.diff(energy) / steps * train.inertia + resistance + mean
    braked = np.minimum(np.maximum(-force, 0.0), np.interp(speed, columns, train.electric))
    return float(np.maximum(force, 0.0) @ steps), float(braked @ steps)
