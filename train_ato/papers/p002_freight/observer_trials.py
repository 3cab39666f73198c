"""Accuracy of the cascaded observer of paper 002 and of other observers, at any sampling time.

The train of `freight_consensus:aligned` runs once. Then every observer gets the same measurements. The true values are
those of the paper: d1 (speed offset), d2 (acceleration, with the effect of the offsets on the coupler damping, (5)) and
d1'.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from plant_sim.disturbances import Paper002
from train_ato.control.algorithms.luenberger import LuenbergerObserver
from train_ato.control.algorithms.sliding import sig
from train_ato.control.laws.fixed_time_smc import LARGE, SMALL, alternating
from train_ato.control.observers.cascaded import Cascade, CascadedParameters
from train_ato.control.observers.contract import ObserverInput
from train_ato.control.observers.force_balance import BalanceState, ForceBalance
from train_ato.control.train_model import TrainModel
from train_ato.judge.recording import Recording
from train_ato.loop.engine import run_engine
from train_ato.messages.types import Array
from train_ato.papers.claims import UNSUPERVISED, printed
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import prepare

CARS = 5
DAMPING = 0.01
"""theta = d/m of (5) [1/s]."""
PARAMETERS = CascadedParameters()
SETTLED = 0.1
"""Largest error of a settled estimate, as a fraction of the largest magnitude of the disturbance."""
JUMPS = (10.0, 20.0)
"""Times of the jumps of d21 and d12 [s]."""
STEPS = ((0.0, 12.0), (JUMPS[0], 0.0), (JUMPS[1], -12.0))
"""Steps of the reference speed [s, m/s]."""
MAX_SAMPLES = 3000
"""Number of samples for the figures."""


class EsoPair:
    """Two linear extended-state observers: `eso` on the speed for d2, and that of the law on the position for d1."""

    def __init__(self, period: float, omega: float) -> None:
        self._period = period
        self._place, self._rate = LuenbergerObserver(omega, period), LuenbergerObserver(omega, period)
        self._speed: float | None = None
        self.d1, self.d1_rate, self.d2 = 0.0, 0.0, 0.0

    def step(self, x: float, v: float, acceleration: float) -> None:
        """Take position, speed [m, m/s] and the known acceleration over the last sample [m/s²]."""
        before, last = self.d1, v if self._speed is None else self._speed
        self._speed, self.d1 = v, self._place.step(x, 0.5 * (v + last))
        self.d1_rate, self.d2 = (self.d1 - before) / self._period, self._rate.step(v, acceleration)


Observer = Cascade | EsoPair

FORMS: Mapping[str, Callable[[float], Observer]] = {
    "printed": lambda period: Cascade(CascadedParameters(method="explicit"), period),
    "implicit": lambda period: Cascade(PARAMETERS, period),
    "levant": lambda period: Cascade(CascadedParameters(method="levant"), period),
    "eso": lambda period: EsoPair(period, min(500.0, 1.0 / period)),
}
"""Compared forms; `eso` has the bandwidth 1/sampling time, at most 500 1/s."""


def truth(t: Array) -> tuple[Array, Array, Array]:
    """Return d1 [m/s], d2 [m/s²] and d1' [m/s²] of every car, shape (k, 5)."""
    source, h = Paper002(kind="paper002"), 1e-6

    def offsets(at: Array) -> tuple[Array, Array]:
        outside = source.tick(at, np.ones(CARS))
        assert outside.drift is not None, "the set has speed offsets"
        return outside.force, outside.drift

    matched, d1 = offsets(t)
    padded = np.pad(d1, ((0, 0), (1, 1)), mode="edge")
    return d1, matched + DAMPING * (padded[:, :-2] + padded[:, 2:] - 2 * d1), (offsets(t + h)[1] - d1) / h


@dataclass
class _Drive:
    """Known acceleration over every sample, from the measurements of a run [m/s²], shape (k, cars)."""

    recording: Recording
    model: TrainModel
    period: float

    def known(self) -> Array:
        recording, balance = self.recording, ForceBalance(self.model, "vehicle", 0.0, self.period)
        zeros = np.zeros(CARS)
        result = np.zeros_like(recording.velocity)
        before: list[BalanceState] = []
        rows = zip(recording.position, recording.velocity, recording.applied, strict=True)
        for tick, (place, speed, force) in enumerate(rows):
            now = balance.known(ObserverInput(float(recording.time[tick]), place, speed, force, np.zeros(0), zeros))
            if before:
                result[tick] = [balance.known_rate(a, b) for a, b in zip(before, now, strict=True)]
            before = now
        return result


def _observed(make: Callable[[float], Observer], recording: Recording, known: Array, period: float) -> Array:
    """Return the estimates of d1, d2, d1' of an observer, shape (3, k, cars)."""
    found = np.empty((3, *recording.velocity.shape))
    for car in range(CARS):
        observer = make(period)
        columns = (recording.position[:, car].tolist(), recording.velocity[:, car].tolist(), known[:, car].tolist())
        for tick, sample in enumerate(zip(*columns, strict=True)):
            observer.step(*sample)
            found[:, tick, car] = observer.d1, observer.d2, observer.d1_rate
    return found


def observer_accuracy(tick: float, duration: float, settle: float) -> tuple[dict[str, float], dict[str, Any]]:
    """Run the train once and every observer on its measurements.

    Parameters
    ----------
    tick
        Sampling time of loop and observers [s]; the plant's step as well.
    duration
        Length of the run [s].
    settle
        Begin of the evaluation [s].

    Returns
    -------
    figures
        ``FORM d1``, ``FORM d2``, ``FORM d1'``: rms error of the worst car over the rms of its disturbance from 0 to
        10 s; ``FORM settling``: time after which all estimates of d1 and d2 stay within 10 % of the largest
        magnitude up to 10 s [s]; ``FORM again``: the same after the jump of d21 at 10 s; NaN if never.
    series
        Time, true values and estimates for the figures, downsampled.
    """
    # Only the profile of the run: the whole one would have too many knots at a tick of 0.01 ms.
    steps = [{"at": at, "speed": speed} for at, speed in STEPS if at < duration]
    grid = {"tick": tick, "step": min(tick, 1e-3), "duration": duration}
    changes = {**UNSUPERVISED, **grid, "profile": {"until": duration, "steps": steps}}
    setup = prepare(*printed(*load_scenario("freight_consensus:aligned", changes=changes)))
    outcome = run_engine(setup)
    recording = outcome.recording
    if recording is None or outcome.interrupted:
        raise ValueError(f"observers at {tick:g} s: the run ended early")
    known = _Drive(recording, setup.model, tick).known()
    true = np.stack(truth(recording.time))
    whole = np.stack(truth(np.linspace(0.0, JUMPS[0], 2001, endpoint=False)))
    size, rms = np.abs(whole).max(axis=1), np.sqrt((whole**2).mean(axis=1))
    scored = (recording.time >= settle - 1e-12) & (recording.time < JUMPS[0])
    stride = max(1, recording.time.size // MAX_SAMPLES)
    series: dict[str, Any] = {"time": recording.time[::stride], "truth": true[:, ::stride]}
    figures: dict[str, float] = {}
    for name in FORMS:
        found = _observed(FORMS[name], recording, known, tick)
        series[name] = found[:, ::stride]
        error = found - true
        for row, quantity in enumerate(("d1", "d2", "d1'")):
            part = np.sqrt((error[row, scored] ** 2).mean(axis=0)) / rms[row]
            figures[f"{name} {quantity}"] = float(part.max())
        outside = (np.abs(error[:2]) > SETTLED * size[:2, None]).any(axis=(0, 2))
        for key, begin, end in (("settling", 0.0, JUMPS[0]), ("again", *JUMPS)):
            stretch = (recording.time >= begin) & (recording.time < end)
            if stretch.any():
                figures[f"{name} {key}"] = _last(recording.time[stretch] - begin, outside[stretch])
    return figures, series


def _last(time: Array, outside: Array) -> float:
    """Return the time from which no sample is outside [s]; NaN if the last one is."""
    late = np.flatnonzero(outside)
    if late.size and late[-1] == time.size - 1:
        return float("nan")
    return float(time[late[-1] + 1]) if late.size else float(time[0])


FRACTION = 0.01
"""Integration step as a fraction of the fastest time constant."""
REST = 1e-9
"""A surface below this is 0 [m/s]."""
MAX_TIME = 60.0
"""End of the integration [s]."""


def fixed_time_bound(gain: float) -> tuple[float, float]:
    """Return the paper's bounds of the time to the surface (23) and on it (34) [s], eps = 1, all gains equal."""
    reaching = 1.0 / (2.0 * gain * (1.0 - (SMALL + 1.0) / 2.0)) + 1.0 / (2.0 * gain * ((LARGE + 1.0) / 2.0 - 1.0))
    sliding = math.log(2.0) / gain * (1.0 / (LARGE - 1.0) + 1.0 / (1.0 - SMALL))
    return reaching, sliding


def _reaching(surface: float, gain: float) -> float:
    return float(-gain * (sig(surface, SMALL) + sig(surface, LARGE)))


def nominal_settling(
    gain: float, error: float, rate: float, band: float = 0.01
) -> tuple[dict[str, float], dict[str, Any]]:
    """Integrate the nominal error dynamics.

    Parameters
    ----------
    gain
        alpha1 = beta1 = alpha2 = beta2 [1/s].
    error, rate
        E(0) [m] and E'(0) [m/s].
    band
        Largest error of the settled state [m].

    Returns
    -------
    figures
        ``settling`` (|E| stays within the band) and ``bound``, the sum of (23) and (34) [s]; ``acceleration``, the
        largest |E''| [m/s²].
    series
        ``time``, ``error``, ``acceleration``.
    """
    surface = rate + alternating(error, gain)[0]
    t, settled, largest = 0.0, 0.0, 0.0
    rows = []
    while t < MAX_TIME and (abs(error) > 1e-6 or abs(surface) > REST):
        auxiliary, slope = alternating(error, gain)
        pull = _reaching(surface, gain)
        acceleration = pull - slope * (surface - auxiliary)
        largest = max(largest, abs(acceleration))
        rows.append((t, error, acceleration))
        if abs(error) > band:
            settled = t
        fast = slope + (abs(pull / surface) * LARGE if abs(surface) > REST else 0.0)
        h = FRACTION / fast
        error, surface = _step(error, surface, gain, h)
        t += h
    time, errors, accelerations = np.array(rows).T
    figures = {"settling": settled, "bound": sum(fixed_time_bound(gain)), "acceleration": largest}
    return figures, {"time": time, "error": errors, "acceleration": accelerations}


def _step(error: float, surface: float, gain: float, h: float) -> tuple[float, float]:
    """Return E and S after one step of the midpoint rule; S does not cross 0."""
    half = surface + 0.5 * h * _reaching(surface, gain) if abs(surface) > REST else 0.0
    ahead = surface + h * _reaching(half, gain)
    if abs(surface) <= REST or ahead * surface < 0.0:
        ahead = 0.0
    middle = error + 0.5 * h * (surface - alternating(error, gain)[0])
    return error + h * (half - alternating(middle, gain)[0]), ahead
