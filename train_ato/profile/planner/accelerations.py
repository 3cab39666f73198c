"""Accelerations over the speed for the planner's passes, and the messages for forces that are too small."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from train_ato.messages.types import Array
from train_ato.profile.planner.driving_strategy import SectionInputs
from train_ato.profile.planner.line_tables import PlaceGrid
from train_ato.profile.planner.passes import BRAKE, TRACTION, Reserves, sliding_extreme
from train_ato.profile.planner.settings import PlanSettings
from train_ato.profile.planner.train_tables import SPEED_STEP, TrainTables

STEP_EXCESS = 0.01
"""Relative excess of a mean over an envelope that counts as a step of the envelope."""


@dataclass(frozen=True, slots=True)
class SectionTables:
    """Inputs of the passes for one section.

    Attributes
    ----------
    limit : Array, shape (cells + 1,)
        v²/2 of the speed limit of the whole train at every place [m²/s²].
    line_min, line_mean, line_max : Array, shape (cells,)
        Line force of every cell, divided by the inertia [m/s²].
    air : Array, shape (3, cells)
        Least, own and largest tunnel air of every cell over v² and inertia [1/m].
    rates : Array, shape (4, n)
        Accelerations over the speed, see :func:`acceleration_table` [m/s²].
    reserves : Reserves
        Fractions of traction and brakes that are not used, see :mod:`train_ato.profile.planner.passes`.
    spread : Array, shape (cells,)
        Distance over which the averaging spreads the limits by place, before and after every cell [m].
    """

    limit: Array
    line_min: Array
    line_mean: Array
    line_max: Array
    air: Array
    rates: Array
    reserves: Reserves
    spread: Array

    def reserve(self, side: int, cells: Any, columns: Any) -> Any:
        """Return the reserve of TRACTION or BRAKE in cells at columns of ``rates``."""
        fractions, placed, which = self.reserves
        own = 1.0 - fractions[side, cells]
        return 1.0 - (own * (1.0 - placed[which[cells], side, columns]) if placed.size else own)


def acceleration_table(
    train: TrainTables, settings: PlanSettings, window: float, *, extend_steps: bool = False
) -> Array:
    """Return the rows of the passes [m/s²].

    They are traction minus resistance, brake plus resistance, resistance, and electric brake plus resistance.

    Parameters
    ----------
    window
        Window of the later moving average [s].
    extend_steps
        Extend the lower side of a step of an envelope for the averaging; else both sides are lowered by the mean.
    """
    keep = 1.0 - settings.force_margin
    traction, brake = train.traction, train.brake
    if window > 0:
        up, down = averaging_range(train, settings, window)
        traction = _lowered_for_averaging(traction, up, extend_steps=extend_steps)
        brake = _lowered_for_averaging(brake, down, extend_steps=extend_steps)
    return np.stack(
        (
            (keep * traction - train.resistance) / train.inertia,
            (keep * brake + train.resistance) / train.inertia,
            train.resistance / train.inertia,
            (np.minimum(train.electric, keep * brake) + train.resistance) / train.inertia,
        )
    )


def averaging_range(train: TrainTables, settings: PlanSettings, window: float) -> Array:
    """Return half the range of speeds in a window [s] of traction and of braking [m/s], shape (2, n)."""
    up = np.minimum(settings.acceleration or np.inf, train.traction / train.inertia)
    down = np.minimum(settings.deceleration or np.inf, (train.brake + train.resistance) / train.inertia)
    return np.stack((up, down)) * window / 2


def stall_message(
    inputs: SectionInputs, grid: PlaceGrid, tables: SectionTables, cell: int, speed: float, *, at_rest: bool
) -> str:
    """Return the message of a forward pass that ends in a cell at a speed [m/s]."""
    train = inputs.train
    place = grid.places[cell + (0 if cell == 0 else 1)]
    k = min(int(speed / SPEED_STEP), train.speed.size - 1)
    need = (tables.line_max[cell] * train.inertia + train.resistance[k]) / 1e3
    full = (tables.rates[TRACTION, k] * train.inertia + train.resistance[k]) / 1e3
    have = full * (1.0 - tables.reserve(TRACTION, cell, k))
    starts = cell == 0 and at_rest
    grade = 1e3 * float(tables.line_mean[cell]) * train.inertia / (train.mass * train.gravity)
    where, remedy = "", "reduce the mass or add traction"
    found = _sections(inputs, grid, tables, cell, brakes=False)
    if found and need <= full:
        where = f" in the {found}"
        remedy = "move the stop or the section" if starts else "shorten the section, or pass it faster"
    return (
        f"train '{train.name}' {'cannot start' if starts else 'stalls'} at km {place / 1000:.3f}: grade and curves of "
        f"{grade:.1f} per mille under the train need {need:.0f} kN, traction minus force_margin is {have:.0f} kN"
        f"{where}; {remedy}"
    )


def braking_message(inputs: SectionInputs, grid: PlaceGrid, tables: SectionTables, cell: int, top: Array) -> str:
    """Return the message of a backward pass without a solution in a cell."""
    train = inputs.train
    bound = top[cell + 1 :] >= tables.limit[cell + 1 :] * (1 - 1e-9)
    ahead = cell + 1 + int(np.argmax(bound)) if bound.any() else grid.cells
    steepest = cell + int(np.argmin(tables.line_min[cell:ahead]))
    columns = np.minimum(np.sqrt(2 * np.maximum(top, 0.0)) / SPEED_STEP, train.speed.size - 1).astype(int)[1:]
    weakest = cell + int(np.argmax(tables.reserve(BRAKE, np.arange(cell, ahead), columns[cell:ahead])))
    found = _sections(inputs, grid, tables, weakest, brakes=True)
    steepest = weakest if found else steepest
    grade = 1e3 * float(tables.line_min[steepest]) * train.inertia / (train.mass * train.gravity)
    goal_speed, speed = (float(np.sqrt(2 * max(top[k], 0.0))) for k in (ahead, steepest + 1))
    k = min(int(speed / SPEED_STEP), train.speed.size - 1)
    kept = 1 - tables.reserve(BRAKE, steepest, k)
    have = (tables.rates[BRAKE, k] * train.inertia - train.resistance[k]) / 1e3 * kept
    need = -(train.resistance[k] + float(tables.line_min[steepest]) * train.inertia) / 1e3
    goal = f"the limit of {3.6 * goal_speed:.0f} km/h" if goal_speed > 0.1 else "the stop"
    where = f" in the {found}" if found else ""
    remedy = "move the stop or the section" if found else "add brakes or reduce force_margin"
    return (
        f"train '{train.name}' cannot brake for {goal} at km {grid.places[ahead] / 1000:.3f}: keeping "
        f"{3.6 * speed:.0f} km/h on {grade:.1f} per mille at km {grid.places[steepest] / 1000:.3f} needs {need:.0f} "
        f"kN, the brake force minus force_margin is {have:.0f} kN{where}; {remedy}"
    )


def _sections(inputs: SectionInputs, grid: PlaceGrid, tables: SectionTables, cell: int, *, brakes: bool) -> str:
    """Return the sections that limit the forces in a cell, also by the averaging; empty without one."""
    if inputs.places is None:
        return ""
    first, last = grid.places[[max(cell - 1, 0), min(cell + 2, grid.cells)]] + tables.spread[cell] * np.array([-1, 1])
    fronts = grid.places[(grid.places >= first) & (grid.places <= last)]
    found = [name for front in fronts for name in inputs.places.sections_at(float(front), brakes=brakes)]
    return " and the ".join(dict.fromkeys(found))


def _lowered_for_averaging(force: Array, half_width: Array, *, extend_steps: bool) -> Array:
    """Return an envelope [N] lowered so that its mean over a range of speeds does not exceed the original.

    A straight envelope does not change.  A convex one is lowered by the amount that averaging would add.

    Parameters
    ----------
    half_width
        Half width of the range at every speed [m/s].
    extend_steps
        Extend the lower side of a step over half the range; else both sides are lowered by the mean.
    """
    edges = SPEED_STEP * np.arange(force.size + 1)
    width = np.ceil(half_width / SPEED_STEP) * SPEED_STEP
    excess = _averaging_excess(force, force, half_width)
    steps = excess > STEP_EXCESS * force
    if not extend_steps or not steps.any():
        return np.asarray(np.maximum(force - sliding_extreme(excess, width, edges, True), 0.0))
    width += 2 * SPEED_STEP  # no cell beyond the step within the range of one before it
    lowered = np.minimum(force, -sliding_extreme(np.where(steps, -force, -np.inf), width, edges, True))
    excess = _averaging_excess(lowered, force, half_width) / np.maximum(force, 1e-9)
    return np.asarray(lowered * (1.0 - np.minimum(sliding_extreme(excess, width, edges, True), 1.0)))


def _averaging_excess(force: Array, allowed: Array, half_width: Array) -> Array:
    """Return the excess of the mean of a force over a range of speeds above the allowed one [N], 0 without."""
    n = force.size
    width_cells = np.ceil(half_width / SPEED_STEP).astype(int) + 1
    index = np.arange(n)
    low, high = np.maximum(index - width_cells, 0), np.minimum(index + width_cells, n - 1)
    width_cells = np.minimum(index - low, high - index)
    low, high = index - width_cells, index + width_cells
    total = np.concatenate(([0.0], np.cumsum(force)))
    return np.asarray(np.maximum((total[high + 1] - total[low]) / (high + 1 - low) - allowed, 0.0))
