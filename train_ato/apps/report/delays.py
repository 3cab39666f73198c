"""Delay from command to effect: as found in the log, as set in the scenario, as the law believes it."""

from __future__ import annotations

from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray

from train_ato.links import LinkSpec
from train_ato.report.recording import Recording
from train_ato.report.thin import aligned
from train_ato.types import Array

WINDOWS = 80
"""A run is cut into about so many windows, each at least ``SHORTEST`` and at most ``LONGEST`` [s]."""
SHORTEST, LONGEST = 5.0, 60.0
CANDIDATES = 120
"""Number of delays that are tried."""
UNKNOWN = 5.0
"""Longest delay that is looked for where the scenario names none [s]."""
LIVELY = 0.003
"""A window counts if the force varies in it by this part of the run's range, rms."""
CUT = 0.02
"""A window counts if a limit cut the force during less than this part of it."""
EXPLAINED = 0.8
"""A delay is given where it explains this part of the force's variation."""


def found_delay(time: Array, demand: Array, applied: Array, longest: float, lag: float = 0.0) -> tuple[Array, Array]:
    """Find the time by which the applied force follows the demand, window by window.

    In every window it is the shift of the demand, behind the lag where that is known, that leaves the least squared
    difference, refined between the ticks by a parabola.  The lag counts as a delay of its time constant, as it does
    for forces that change slowly.  Windows in which the force hardly changes, or in which no shift explains it (a
    force at its limit), give none.

    Parameters
    ----------
    time, demand, applied : Array, shape (k,)
        Stamps [s], equally spaced; demand and applied force [N].
    longest
        Longest delay looked for [s].
    lag
        Time constant of the actuators [s]; 0 where it is not known.

    Returns
    -------
    middle, delay : Array, shape (windows,)
        Middle of every window [s] and the delay [s], NaN where there is none.
    """
    if time.size < 8 or not np.isfinite(demand).any():
        return np.empty(0), np.empty(0)
    tick = float(np.median(np.diff(time)))
    demand = _lagged(np.nan_to_num(demand), lag, tick)
    stride = max(1, int(np.ceil(longest / tick / CANDIDATES)))
    step = stride * tick
    demand, applied, time = demand[::stride], applied[::stride], time[::stride]
    shifts = max(2, min(round(longest / step), time.size // 4))
    width = round(float(np.clip((time[-1] - time[0]) / WINDOWS, SHORTEST, LONGEST)) / step)
    edges = np.arange(shifts, time.size, max(1, width), dtype=np.intp)
    if edges.size < 2:
        return np.empty(0), np.empty(0)
    errors = np.array([_window_sums((applied[shifts:] - _shifted(demand, lag, shifts)) ** 2, edges - shifts)
                       for lag in range(shifts)])  # fmt: skip
    counts = np.diff(edges).astype(np.float64)
    best = errors.argmin(axis=0)
    delay = step * _refined(errors, best)
    varied = _variation(applied[shifts:], edges - shifts, counts)
    low, high = np.nanpercentile(applied, (1, 99))
    lively = np.sqrt(varied) > LIVELY * (high - low)
    explained = errors.min(axis=0) / counts < (1 - EXPLAINED) * varied
    inside = best < shifts - 1
    middle = (time[edges[:-1]] + time[edges[1:] - 1]) / 2
    return middle, np.where(lively & explained & inside, lag + delay, np.nan)


def _lagged(values: Array, lag: float, tick: float) -> Array:
    """Return what a first-order lag makes of values held over each tick."""
    if lag <= 0:
        return values
    gain = 1.0 - float(np.exp(-tick / lag))
    steps = accumulate(
        values[:-1].tolist(), lambda force, held: force + gain * (held - force), initial=float(values[0])
    )
    return np.fromiter(steps, dtype=np.float64, count=values.size)


def _shifted(values: Array, lag: int, begin: int) -> Array:
    return values[begin - lag : values.size - lag]


def _window_sums(values: Array, edges: NDArray[np.intp]) -> Array:
    total = np.concatenate(([0.0], np.cumsum(np.nan_to_num(values))))
    return np.asarray([total[b] - total[a] for a, b in pairwise(edges.tolist())])


def _variation(values: Array, edges: NDArray[np.intp], counts: Array) -> Array:
    """Return the variance of every window."""
    mean = _window_sums(values, edges) / counts
    return np.asarray(np.maximum(_window_sums(values**2, edges) / counts - mean**2, 0.0))


def _refined(errors: Array, best: NDArray[np.intp]) -> Array:
    """Return the place of the smallest error between the ticks, by a parabola through three."""
    inner = np.clip(best, 1, errors.shape[0] - 2)
    windows = np.arange(best.size)
    before, here, after = errors[inner - 1, windows], errors[inner, windows], errors[inner + 1, windows]
    bend = before - 2 * here + after
    offset = np.where(bend > 0, 0.5 * (before - after) / np.where(bend > 0, bend, 1.0), 0.0)
    return np.where(best == inner, inner + np.clip(offset, -0.5, 0.5), best)


def set_delay(link: LinkSpec, lag: float, jumps: list[tuple[float, float, float]], time: Array, demand: Array) -> Array:
    """Return the delay of the command link at every tick, mean over the units, and the actuators' lag on top [s].

    Parameters
    ----------
    link
        Delay of the command as in the scenario; jitter counts with its mean.
    lag
        Time constant of the actuators, mean over the units [s].
    jumps
        Time [s], factor and addition [s] of changes made while the train ran.
    time : Array, shape (k,)
        Stamps [s].
    demand : Array, shape (k, units)
        A negative demand takes the delay of the brake.
    """
    traction, brake = link.per_unit(demand.shape[1], "command")
    delay = np.where(demand < 0, brake, traction).mean(axis=1)
    changes = [*jumps] if link.jump is None else [(link.jump.at, link.jump.factor, link.jump.add), *jumps]
    factor, add = np.ones(time.size), np.zeros(time.size)
    for at, times, more in changes:
        factor[time >= at] *= times
        add[time >= at] += more
    delay = np.maximum(0.0, delay * factor + add + link.jitter / 2)
    if link.varying is not None:
        delay = delay + link.varying.amplitude * np.abs(np.sin(link.varying.omega * time + link.varying.phase))
    return np.asarray(delay + lag)


def believed_delay(recording: Recording) -> tuple[Array, Array] | None:
    """Return over time the delay and lag that the law reckons with, mean over the units, as its node said [s]."""
    said = recording.said.get("controller")
    if said is None:
        return None
    lag = said.numbers("lag")
    times, values = [], []
    for row, text in enumerate(said.texts("delay")):
        if text:
            numbers = [float(part) for part in text.strip("[]").split(",") if part.strip()]
            times.append(float(said.time[row]))
            values.append(float(np.mean(numbers or [0.0])) + (float(lag[row]) if lag is not None else 0.0))
    return (np.array(times), np.array(values)) if times else None


def _uncut(recording: Recording, middle: Array, delay: Array) -> tuple[Array, Array]:
    """Leave out the windows in which a limit cut the force: it follows the limit there, at once, not the demand."""
    said = recording.said.get("plant")
    total = said.numbers("saturated") if said is not None else None
    if said is None or total is None or middle.size < 2:
        return middle, delay
    half = float(np.median(np.diff(middle))) / 2
    cut = np.interp(middle + half, said.time, total) - np.interp(middle - half, said.time, total)
    return middle, np.where(cut > CUT * 2 * half, np.nan, delay)


def delays(recording: Recording, jumps: list[tuple[float, float, float]]) -> dict[str, tuple[Array, Array]]:
    """Return what there is of the three delays, each over its own times [s].

    Parameters
    ----------
    recording
        The run.
    jumps
        Changes of the link's delay while the train ran: time [s], factor, addition [s].
    """
    command, applied = recording.of("ato/command", "force"), recording.of("train/measurement", "applied")
    if command is None or applied is None or command[1].shape[1] == 0:
        return {}
    time, demand = command
    force = aligned(time, applied[0], applied[1])
    longest, lag, result = UNKNOWN, 0.0, {}
    if recording.setup is not None:
        lag = float(np.mean(recording.setup.plant.lag))
        known = set_delay(recording.setup.links.command, lag, jumps, time, demand)
        result["delay_set"] = (time, known)
        longest = 2.0 * float(known.max() - lag) + 1.0
    found = _uncut(recording, *found_delay(time, demand.sum(axis=1), force.sum(axis=1), longest, lag))
    if np.isfinite(found[1]).any():
        result["delay"] = found
    if (believed := believed_delay(recording)) is not None:
        result["delay_believed"] = believed
    return result
