"""Time allowance: a timetable kept with less energy, by coasting and a reduced cruise.

Traction is used below the switching curve of :mod:`train_ato.plan.value` alone, which follows from one price of time on
all runs of the journey; lowering the price spends the allowance.  The curve is found on a coarse grid and without the
limit on the jerk, so the classical rule is tried beside it: traction ends at one speed V, and coasting goes over into
braking at U = psi(V)/phi'(V), with phi = v r(v), psi = v² r'(v), r the running resistance (Howlett and Pudney,
"Energy-Efficient Train Control", 1995), or with less coasting, down to a reduced cruise alone.  What needs least
traction work is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from train_ato.plan.run import Run
from train_ato.plan.style import FASTEST, Style
from train_ato.plan.train_tables import STEP
from train_ato.plan.value import switching_curve

__all__ = ["spread_allowance"]

COASTING = (0.0, 1.0)
"""Factors tried on how far below V coasting reaches; 0 is a reduced cruise alone."""
EXACT = 0.02
"""A timetable met within this is met [s]."""
NEAR = 0.002
"""Part of the time to which the price of time is searched; the speeds of its curve are scaled for the rest."""
PRICES = (1e-5, 1e4)
"""Between which the price of time is searched [W/kg]."""
SCALES = (0.5, 2.0)
"""Between which the speeds of a switching curve are scaled."""
ROUNDS = 60
SLOWEST = 0.5
"""No cruise is slower than this [m/s]."""
LEFT_OVER = 1.0
"""Time that may be left over at the last stop where no way of driving takes all of it [s]."""

Styles = list[Style]


def spread_allowance(runs: list[Run], time: float) -> Styles:
    """Return the style of driving of every run that takes the given time over all with the least traction work.

    Where even the fastest takes longer, the fastest.

    Raises
    ------
    ValueError
        If the time is so long that the train would have to crawl.
    """
    if time <= sum(run.time() for run in runs) + EXACT:
        return [FASTEST] * len(runs)
    candidates = [_search(runs, time, factor) for factor in COASTING]
    candidates += [_priced(runs, time), _capped(runs, time, [FASTEST] * len(runs))]
    if all(time - _time(runs, styles) > LEFT_OVER for styles in candidates):
        raise ValueError(
            f"timetable too slack: {time:.1f} s of running would need a speed at which the train crawls; wait at a "
            "stop instead"
        )
    return min(candidates, key=lambda styles: sum(map(traction_work, runs, styles)))


def _priced(runs: list[Run], time: float) -> Styles:
    """Return the switching curves of the price of time that takes the time."""
    stretches = [run.stretches() for run in runs]

    def styles(price: float) -> Styles:
        return [Style(curve=switching_curve(stretch, price, STEP)) for stretch in stretches]

    low, high = PRICES
    best = styles(high)
    for _ in range(ROUNDS):
        price = float(np.sqrt(low * high))
        driven = styles(price)
        needed = _time(runs, driven)
        if needed <= time:
            high, best = price, driven
        else:
            low = price
        if abs(needed - time) < NEAR * time or high / low < 1.0001:
            best = driven
            break
    scaled = _bisected(runs, time, lambda scale: [replace(style, scale=scale) for style in best], *SCALES)
    return _capped(runs, time, [replace(style, scale=scaled) for style in best])


def _search(runs: list[Run], time: float, factor: float) -> Styles:
    """Return the style of one coasting factor that takes the time; what no cruise spends exactly, a cap spends."""
    train = runs[0].track.train

    def styles(speed: float) -> Styles:
        return [_style(runs, speed, factor)] * len(runs)

    cruise = _bisected(runs, time, styles, SLOWEST, 4 * train.speed_max)
    return _capped(runs, time, styles(cruise))


def _capped(runs: list[Run], time: float, styles: Styles) -> Styles:
    """Return the styles with a cap that spends the time that is left."""
    if time - _time(runs, styles) < EXACT:
        return styles
    train = runs[0].track.train

    def capped(speed: float) -> Styles:
        return [replace(style, cap=speed) for style in styles]

    return capped(_bisected(runs, time, capped, SLOWEST, train.speed_max))


def _bisected(runs: list[Run], time: float, styles: Callable[[float], Styles], slow: float, fast: float) -> float:
    """Return the slowest value found that keeps the time, from the slow and the fast end; the latter must keep it."""
    for _ in range(ROUNDS):
        middle = float(np.sqrt(fast * slow))
        needed = _time(runs, styles(middle))
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


def _time(runs: list[Run], styles: Styles) -> float:
    """Return the time of all runs [s]; infinite where the train cannot go so slowly."""
    try:
        return sum(run.time(style) for run, style in zip(runs, styles, strict=True))
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
