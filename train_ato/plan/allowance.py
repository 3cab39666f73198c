"""Time allowance: a timetable kept with less energy, by coasting and a reduced cruise.

The fastest run between full traction, cruise, coasting and full braking that needs least traction work has one
parameter, the cruise V (Howlett and Pudney, "Energy-Efficient Train Control", 1995): traction ends at V, and coasting
goes over into braking at the speed U = psi(V)/phi'(V), with phi = v r(v), psi = v² r'(v), r the running resistance.
For V far above the limits U is above them too: the fastest run.  Lowering V spends the allowance, on all runs of the
journey alike.  On real grades the rule for U is not exact; so runs with less coasting are tried as well and the one
that needs least traction work is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from train_ato.plan.run import Run, Style
from train_ato.plan.train_tables import STEP

__all__ = ["spread_allowance"]

COASTING = (0.0, 0.5, 0.8, 1.0, 1.2)
"""Factors tried on how far below V coasting reaches; 0 is a reduced cruise alone."""
EXACT = 0.02
"""A timetable met within this is met [s]."""
ROUNDS = 60
SLOWEST = 0.5
"""No cruise is slower than this [m/s]."""
LEFT_OVER = 1.0
"""Time that may be left over at the last stop where no way of driving takes all of it [s]."""


def spread_allowance(runs: list[Run], time: float) -> Style:
    """Return the style of driving that takes the given time over all runs with the least traction work.

    Raises
    ------
    ValueError
        If the time is too short, or so long that the train would have to crawl.
    """
    least = sum(run.time() for run in runs)
    if time < least - EXACT:
        raise ValueError(
            f"timetable too tight: {time:.1f} s of running between km {runs[0].begin / 1000:.3f} and "
            f"km {runs[-1].end / 1000:.3f}, at least {least:.1f} s are needed; allow {least - time:.1f} s more"
        )
    if time <= least + EXACT:
        return Style()
    candidates = [_search(runs, time, factor) for factor in COASTING]
    candidates.append(_capped(runs, time, Style()))
    if all(time - _time(runs, style) > LEFT_OVER for style in candidates):
        raise ValueError(
            f"timetable too slack: {time:.1f} s of running would need a speed at which the train crawls; wait at a "
            "stop instead"
        )
    return min(candidates, key=lambda style: sum(traction_work(run, style) for run in runs))


def _search(runs: list[Run], time: float, factor: float) -> Style:
    """Return the style of one coasting factor that takes the time; what no cruise spends exactly, a cap spends."""
    train = runs[0].track.train
    cruise = _bisected(runs, time, lambda speed: _style(runs, speed, factor), 4 * train.speed_max)
    return _capped(runs, time, _style(runs, cruise, factor))


def _capped(runs: list[Run], time: float, style: Style) -> Style:
    """Return the style with a cap that spends the time that is left."""
    if time - _time(runs, style) < EXACT:
        return style
    train = runs[0].track.train
    return replace(style, cap=_bisected(runs, time, lambda speed: replace(style, cap=speed), train.speed_max))


def _bisected(runs: list[Run], time: float, style: Callable[[float], Style], fast: float) -> float:
    """Return the slowest speed found that keeps the time; ``fast`` must keep it."""
    slow = SLOWEST
    for _ in range(ROUNDS):
        middle = float(np.sqrt(fast * slow))
        needed = _time(runs, style(middle))
        fast, slow = (middle, slow) if needed <= time else (fast, middle)
        if 0 <= time - needed < EXACT or fast - slow < 1e-9:
            break
    return fast


def _style(runs: list[Run], cruise: float, factor: float) -> Style:
    """Return the style of a cruise V [m/s]."""
    train = runs[0].track.train
    c0, c1, c2 = train.resistance_at(np.array([0.0, 1.0, 2.0])) @ np.array([[1, -1.5, 0.5], [0, 2, -1], [0, -0.5, 0.5]])
    slope, product = c1 + 2 * c2 * cruise, c0 + 2 * c1 * cruise + 3 * c2 * cruise**2
    into_braking = cruise**2 * slope / product if product > 0 else cruise
    coast = np.inf if factor == 0 else max(cruise - factor * (cruise - into_braking), 0.5)
    return Style(cruise, coast)


def _time(runs: list[Run], style: Style) -> float:
    """Return the time of all runs [s]; infinite where the train cannot go so slowly."""
    try:
        return sum(run.time(style) for run in runs)
    except ValueError:
        return np.inf


def traction_work(run: Run, style: Style) -> float:
    """Return the work of traction over a raw run [J]."""
    energy, train = run.raw(style), run.track.train
    steps = run.grid.steps
    speed = np.sqrt(energy[:-1] + energy[1:])
    resistance = np.interp(speed, STEP * np.arange(train.speed.size), train.resistance)
    _, mean, _ = run.track.force.on_cells(run.grid)
    force = np.diff(energy) / steps * train.inertia + resistance + mean
    return float(np.maximum(force, 0.0) @ steps)
