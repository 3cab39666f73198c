"""What forces do to a train: accelerations over the speed for the passes, and the words where they are not enough."""

from __future__ import annotations

import numpy as np

from train_ato.plan.line_tables import Grid
from train_ato.plan.passes import BRAKE, TRACTION, spread
from train_ato.plan.settings import PlanSettings
from train_ato.plan.train_tables import STEP, TrainTables
from train_ato.types import Array

__all__ = ["acceleration_table", "cannot_brake", "stalls"]


def acceleration_table(
    train: TrainTables, settings: PlanSettings, window: float, reserve: float, brake_reserve: float
) -> Array:
    """Return the rows the passes read: traction less resistance, brake plus resistance, resistance [m/s²].

    Parameters
    ----------
    window
        Time over which the raw run will be averaged [s].
    reserve, brake_reserve
        Parts of traction and brakes left aside besides the margin.
    """
    keep = 1.0 - settings.force_margin
    traction, brake = train.traction, train.brake
    if window > 0:
        up = np.minimum(settings.acceleration or np.inf, train.traction / train.inertia)
        down = np.minimum(settings.deceleration or np.inf, (train.brake + train.resistance) / train.inertia)
        traction = _kept_under_averaging(traction, up * window / 2)
        brake = _kept_under_averaging(brake, down * window / 2)
    return np.stack(
        (
            (keep * (1.0 - reserve) * traction - train.resistance) / train.inertia,
            (keep * (1.0 - brake_reserve) * brake + train.resistance) / train.inertia,
            train.resistance / train.inertia,
        )
    )


def stalls(train: TrainTables, grid: Grid, parts: dict[str, Array], cell: int, at_rest: bool) -> str:
    """Return why the forward pass found no way on from a cell."""
    place = grid.places[cell + (0 if cell == 0 else 1)]
    need = (parts["up"][cell] + train.resistance[0] / train.inertia) * train.inertia / 1e3
    have = (parts["table"][TRACTION, 0] * train.inertia + train.resistance[0]) / 1e3
    what = "cannot start" if cell == 0 and at_rest else "stalls"
    grade = 1e3 * float(parts["flat"][cell]) * train.inertia / (train.mass * train.gravity)
    return (
        f"train '{train.name}' {what} at km {place / 1000:.3f}: grade and curves of {grade:.1f} per mille over the "
        f"train need {need:.0f} kN, traction less its margin gives {have:.0f} kN; lighten the train or add traction"
    )


def cannot_brake(train: TrainTables, grid: Grid, parts: dict[str, Array], cell: int, top: Array) -> str:
    """Return why the backward pass found no speed in a cell from which what lies ahead can be kept."""
    bound = top[cell + 1 :] >= parts["limit"][cell + 1 :] * (1 - 1e-9)
    ahead = cell + 1 + int(np.argmax(bound)) if bound.any() else grid.cells
    steepest = cell + int(np.argmin(parts["down"][cell:ahead]))
    grade = 1e3 * float(parts["down"][steepest]) * train.inertia / (train.mass * train.gravity)
    goal_speed, speed = (float(np.sqrt(2 * max(top[k], 0.0))) for k in (ahead, steepest + 1))
    k = min(int(speed / STEP), train.speed.size - 1)
    have = (parts["table"][BRAKE, k] * train.inertia - train.resistance[k]) / 1e3
    need = -(train.resistance[k] + float(parts["down"][steepest]) * train.inertia) / 1e3
    goal = f"the limit of {3.6 * goal_speed:.0f} km/h" if goal_speed > 0.1 else "the stop"
    return (
        f"{goal} at km {grid.places[ahead] / 1000:.3f} cannot be braked for: to hold "
        f"{3.6 * speed:.0f} km/h on {grade:.1f} per mille at km {grid.places[steepest] / 1000:.3f} "
        f"takes {need:.0f} kN, the brakes of train '{train.name}' less their margin give {have:.0f} kN; add brakes "
        "or reduce force_margin"
    )


def _kept_under_averaging(force: Array, half_width: Array) -> Array:
    """Lower an envelope so that its mean over a span of speeds does not exceed the envelope in the middle.

    Where the envelope is straight nothing changes; where it is convex or jumps down it is lowered by what averaging
    would add.

    Parameters
    ----------
    half_width
        Of the span at every speed [m/s].
    """
    n = force.size
    reach = np.ceil(half_width / STEP).astype(int) + 1
    index = np.arange(n)
    low, high = np.maximum(index - reach, 0), np.minimum(index + reach, n - 1)
    reach = np.minimum(index - low, high - index)
    low, high = index - reach, index + reach
    total = np.concatenate(([0.0], np.cumsum(force)))
    excess = np.maximum((total[high + 1] - total[low]) / (high + 1 - low) - force, 0.0)
    width = np.ceil(half_width / STEP) * STEP
    return np.asarray(np.maximum(force - spread(excess, width, STEP * np.arange(n + 1), True), 0.0))
