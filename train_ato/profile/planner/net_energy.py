"""Net energy of a plan: traction over its efficiency, minus the recovered part of the electric brake, plus auxiliaries.

The electric brake acts first, up to its own envelope; friction brakes do the rest and recover nothing.
"""

import numpy as np

from train_ato.messages.types import Array
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


def section_energy(section: PlanSection, energy: Array) -> float:
    """Return the net energy of a section without a jerk limit and without auxiliaries [J].

    Parameters
    ----------
    energy : Array, shape (n + 1,)
        v²/2 at the places of the section's grid [m²/s²].
    """
    train, steps = section.inputs.train, section.grid.steps
    weights = energy_weights(section.inputs.settings)
    force = section_force(section, energy)
    work = weights.traction * float(np.maximum(force, 0.0) @ steps)
    if weights.recovered == 0.0:
        return work
    speed, columns = np.sqrt(energy[:-1] + energy[1:]), SPEED_STEP * np.arange(train.speed.size)
    electric, braked = np.interp(speed, columns, train.electric), np.maximum(-force, 0.0)
    if section.inputs.places is not None and (acting := braked > 0.0).any():
        middle = 0.5 * (section.grid.places[1:] + section.grid.places[:-1])
        electric[acting] *= section.inputs.places.electric_share(middle[acting], speed[acting])
    return work - weights.recovered * float(np.minimum(braked, electric) @ steps)


def section_force(section: PlanSection, energy: Array) -> Array:
    """Return the mean own force of every cell of a section without a jerk limit [N], > 0 traction.

    Parameters
    ----------
    energy : Array, shape (n + 1,)
        v²/2 at the places of the section's grid [m²/s²].
    """
    train, tables = section.inputs.train, section.tables
    speed = np.sqrt(energy[:-1] + energy[1:])
    resistance = np.interp(speed, SPEED_STEP * np.arange(train.speed.size), train.resistance)
    rate = np.diff(energy) / section.grid.steps + tables.line_mean + tables.air[1] * speed**2
    return np.asarray(rate * train.inertia + resistance)
