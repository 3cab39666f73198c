"""Draft gears of a train with wear as one number, 0 for the gears of the model.

Wear softens the springs and smooths the friction surfaces of a draft gear, and it adds slack between gear and coupler.
Here all of these change by the same part ``wear``::

    F0, a1: times 1 - wear;   slack, unloading ratio r: times 1 + wear

The force at the stroke, that of the closed gear, stays. A negative wear is a stiffer gear with more friction and less
slack than the model has.
"""

from __future__ import annotations

from plant_sim import kernel as k
from plant_sim.consist import Consist
from plant_sim.gears import DraftGear, LinearGear, RigidGear, TableGear
from plant_sim.packing import pack_gears
from train_ato.messages.types import Array

CONSTANTS = (k.HALF_SLACK, k.STIFFNESS, k.F0, k.A1, k.A2, k.RATIO)
"""Rows of the draft gears of the kernel that wear changes."""


def worn(gear: DraftGear, wear: float) -> DraftGear:
    """Return a draft gear with wear; a rigid coupler has none.

    Parameters
    ----------
    gear
        Gear of the model.
    wear
        Relative change, above -1 and below 1.
    """
    if isinstance(gear, RigidGear):
        return gear
    changes: dict[str, object] = {"slack": gear.slack * (1.0 + wear)}
    if isinstance(gear, TableGear):
        return gear.model_copy(update=changes)
    changes["stiffness"] = gear.stiffness * (1.0 - wear)
    if not isinstance(gear, LinearGear):
        changes["preload"] = gear.preload * (1.0 - wear)
        changes["unloading_ratio"] = min(gear.unloading_ratio * (1.0 + wear), 1.0)
    return gear.model_copy(update=changes)


def worn_constants(consist: Consist, wear: float) -> Array:
    """Return the rows ``CONSTANTS`` of the draft gears of a train with wear, as the kernel has them.

    Parameters
    ----------
    consist
        Train of the model.
    wear
        Relative change of all its draft gears.
    """
    by_name = {name: worn(consist.draft_gears[name], wear) for name in dict.fromkeys(consist.gear_names)}
    gears, _, _, _ = pack_gears([by_name[name] for name in consist.gear_names], len(consist.vehicles))
    constants: Array = gears[list(CONSTANTS)]
    return constants
