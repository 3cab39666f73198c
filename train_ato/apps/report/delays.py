"""Delay from command to effect: identified from the log, set in the scenario, assumed by the law."""

from __future__ import annotations

from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray

from train_ato.loop.recording import COMMAND, MEASUREMENT, Recording
from train_ato.loop.series import aligned
from train_ato.messages.links import LinkSpec
from train_ato.messages.types import Array

WINDOWS = 80
"""Approximate number of time windows; each is ``MIN_WINDOW`` to ``MAX_WINDOW`` [s] long."""
MIN_WINDOW, MAX_WINDOW = 5.0, 60.0
CANDIDATES = 120
"""Number of delays that are evaluated."""
DEFAULT_MAX_DELAY = 5.0
"""Maximum of the search without a scenario [s]."""
MIN_VARIATION = 0.003
"""Minimum rms variation of the force in a window, relative to the range of the run."""
MAX_SATURATED = 0.02
"""Maximum fraction of a window with a saturated force."""
MIN_EXPLAINED = 0.8
"""Minimum fraction of the variance of the force explained by the delay."""


def found_delay(time: Array, demand: Array, applied: Array, longest: float, lag: float = 0.0) -> tuple[Array, Array]:
    """Identify the delay of the applied force behind the demand [s] in time windows.

    The delay is the shift of the lagged demand with the least squared difference, refined between the ticks by a
    parabola.  The lag adds its time constant, the delay of slowly changing forces.  Windows with a nearly constant
    force, or with a force that no shift explains (saturation), have no result.

    Parameters
    ----------
    time, demand, applied : Array, shape (k,)
        Stamps [s], equally spaced; demand and applied force [N].
    longest
        Maximum of the search [s].
    lag
        Time constant of the actuators [s]; 0: unknown.

    Returns
    -------
    middle, delay : Array, shape (windows,)
        Middle of every window [s] and the delay [s]; NaN: no result.
    """
    if time.size < 8 or not np.isfinite(demand).any():
        return np.empty(0), np.empty(0)
    tick = float(np.median(np.diff(time)))
    demand = _lagged(np.nan_to_num(demand), lag, tick)
    stride = max(1, int(np.ceil(longest / tick / CANDIDATES)))
    step = stride * tick
    demand, applied, time = demand[::stride], applied[::stride], time[::stride]
    shifts = max(2, min(round(longest / step), time.size // 4))
    width = round(float(np.clip((time[-1] - time[0]) / WINDOWS, MIN_WINDOW, MAX_WINDOW)) / step)
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
    varying = np.sqrt(varied) > MIN_VARIATION * (high - low)
    explained = errors.min(axis=0) / counts < (1 - MIN_EXPLAINED) * varied
    inside = best < shifts - 1
    middle = (time[edges[:-1]] + time[edges[1:] - 1]) / 2
    return middle, np.where(varying & explained & inside, lag + delay, np.nan)


def _lagged(values: Array, lag: float, tick: float) -> Array:
    """Return the output of a first-order lag for values held over each tick."""
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
    """Return the shift of the smallest error between the ticks, from a parabola through three points."""
    inner = np.clip(best, 1, errors.shape[0] - 2)
    windows = np.arange(best.size)
    before, here, after = errors[inner - 1, windows], errors[inner, windows], errors[inner + 1, windows]
    bend = before - 2 * here + after
    offset = np.where(bend > 0, 0.5 * (before - after) / np.where(bend > 0, bend, 1.0), 0.0)
    return np.where(best == inner, inner + np.clip(offset, -0.5, 0.5), best)


def set_delay(link: LinkSpec, lag: float, jumps: list[tuple[float, float, float]], time: Array, demand: Array) -> Array:
    """Return the delay of the command link plus the lag of the actuators at every tick [s], mean over the power units.

    Parameters
    ----------
    link
        Delay of the command in the scenario; the mean of the jitter is added.
    lag
        Time constant of the actuators, mean over the units [s].
    jumps
        Time [s], factor and addition [s] of the interventions.
    time : Array, shape (k,)
        Stamps [s].
    demand : Array, shape (k, units)
        A negative demand has the delay of the brake.
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


def assumed_delay(recording: Recording) -> tuple[Array, Array] | None:
    """Return time and delay plus lag assumed by the law [s], from its diagnostics, mean over the power units."""
    controller = recording.diagnostics.get("controller")
    if controller is None:
        return None
    lag = controller.numbers("lag")
    times, values = [], []
    for row, text in enumerate(controller.texts("delay")):
        if text:
            numbers = [float(part) for part in text.strip("[]").split(",") if part.strip()]
            times.append(float(controller.time[row]))
            values.append(float(np.mean(numbers or [0.0])) + (float(lag[row]) if lag is not None else 0.0))
    return (np.array(times), np.array(values)) if times else None


def _without_saturation(recording: Recording, middle: Array, delay: Array) -> tuple[Array, Array]:
    """Remove the windows with saturation: there the force follows its limit without delay, not the demand."""
    total = recording.reported("plant", "saturated")
    if total is None or middle.size < 2:
        return middle, delay
    half = float(np.median(np.diff(middle))) / 2
    saturated = np.interp(middle + half, *total) - np.interp(middle - half, *total)
    return middle, np.where(saturated > MAX_SATURATED * 2 * half, np.nan, delay)


def delays(recording: Recording, jumps: list[tuple[float, float, float]]) -> dict[str, Array]:
    """Return the available delays at the stamps of the commands [s].

    Parameters
    ----------
    recording
        The run.
    jumps
        Interventions in the delay of the link: time [s], factor, addition [s].
    """
    command, applied = recording.of(COMMAND, "force"), recording.of(MEASUREMENT, "applied")
    if command is None or applied is None or command[1].shape[1] == 0:
        return {}
    time, demand = command
    force = aligned(time, applied[0], applied[1])
    longest, lag = DEFAULT_MAX_DELAY, 0.0
    result: dict[str, Array] = {}
    if recording.setup is not None:
        lag = float(np.mean(recording.setup.plant.lag))
        known = set_delay(recording.setup.links.command, lag, jumps, time, demand)
        result["delay_set"] = known
        longest = 2.0 * float(known.max() - lag) + 1.0
    found = _without_saturation(recording, *found_delay(time, demand.sum(axis=1), force.sum(axis=1), longest, lag))
    if np.isfinite(found[1]).any():
        middle, delay = found
        result["delay"] = delay[np.searchsorted((middle[1:] + middle[:-1]) / 2, time)]
    if (assumed := assumed_delay(recording)) is not None:
        row = np.searchsorted(assumed[0], time, side="right") - 1
        result["delay_assumed"] = np.where(row >= 0, assumed[1][np.maximum(row, 0)], np.nan)
    return result
