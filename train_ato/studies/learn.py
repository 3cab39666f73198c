"""Learning from run to run: repeated or recorded runs of a line give the resistance that repeats by place.

With the measured force F, the resistance W_0 of the nominal model without learned part and its shoe force, every moving
train has::

    v' = (F - W_0)/M - r,   r' = white noise of PSD q

F, v and place of a stamp are measured at the same time, so that no delay is in the balance. A Kalman filter of (v, r)
runs forward, a smoother (Rauch, Tung and Striebel 1965, AIAA Journal 3) backward: r has no phase lag. The
noise of the speed is that of the record. Mean values by place with a triangular weight give r(x).
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from plant_sim.disturbances import shifted
from plant_sim.elementary import random_stream
from train_ato.api.drive import RunMode, drive
from train_ato.api.progress import share_bar
from train_ato.api.run import Run
from train_ato.api.scenario_choice import Changes, GivenScenario, choose_scenario, put_components
from train_ato.api.series_folder import KeptRuns
from train_ato.control.air_brake.shoes import ShoeForecast
from train_ato.control.algorithms.train_constants import wave_time as waves_through
from train_ato.control.learned_resistance import (
    DIGITS,
    MAX_RESISTANCE,
    SCHEMA,
    LearnedResistance,
    learned_text,
    model_hash,
)
from train_ato.control.mpc.motion_observer import WAVE_SPEED
from train_ato.control.observers.force_balance import lag_weight
from train_ato.control.train_model import TrainModel
from train_ato.judge.metric_names import html_table
from train_ato.judge.recording import BRAKE_PIPE_COMMAND, MEASUREMENT, Recording
from train_ato.judge.series import aligned
from train_ato.log.recorded import open_recording
from train_ato.log.run_folder import read_run_folder
from train_ato.log.whole_file import write_whole
from train_ato.messages.types import Array
from train_ato.profile.profile import Profile
from train_ato.program.arguments import check_new_file
from train_ato.program.errors import RunInterrupted, refusing
from train_ato.scenario.scenario import Scenario
from train_ato.scenario.scenario_data import PartCache
from train_ato.scenario.setup import RunSetup, prepare

MOVING = 0.5
"""Speed above which a sample counts [m/s]: the holding brake and the fade of the electric brake are below."""
GRADE_CHANGE = 0.05
"""Standard deviation of the change of r in a second [m/s²]."""
MIN_NOISE = 1e-4
"""Smallest standard deviation of the measured speed [m/s]."""
MIN_STRETCH = 20
"""Number of samples of the shortest stretch of motion that counts."""


Residual = tuple[Array, Array]
"""Places of vehicle 0's centre [m], and the unexplained resistance per inertial mass there [m/s²], > 0 retards."""


def residual_of(recording: Recording, model: TrainModel) -> Residual:
    """Return the resistance of a run that its nominal model does not contain.

    Parameters
    ----------
    recording
        Run with measured position, speed and force.
    model
        Nominal model of the run; its learned resistance is not used.
    """
    model = model.without_learned
    time, measured = recording.time, {}
    for name in ("position", "velocity"):
        found = recording.of(MEASUREMENT, name)
        if found is None:
            raise ValueError(f"{recording.name}: {MEASUREMENT}: no {name}; record this topic")
        measured[name] = aligned(time, *found)
    share = model.share
    speed = np.asarray(measured["velocity"] @ share)
    place = np.asarray((measured["position"] + model.offsets) @ share)
    force = recording.applied.sum(axis=1)
    resisting = model.resisting_forces(place, speed) + _shoe_forces(recording, model, speed)
    hauls = len(model.consist.vehicles) > model.n_units
    wave_time = waves_through(model) if hauls else 0.0
    places, values = [], []
    for begin, end in _stretches(speed):
        steps = np.diff(time[begin:end])
        weight = lag_weight(float(np.median(steps)), model.lag)
        drive = weight * force[begin : end - 1] + (1.0 - weight) * force[begin + 1 : end]
        against = 0.5 * (resisting[begin : end - 1] + resisting[begin + 1 : end])
        pull = (drive - against) / model.inertia
        values.append(smoothed_resistance(speed[begin:end], pull, steps, 2.0 * WAVE_SPEED**2 * wave_time))
        places.append(0.5 * (place[begin : end - 1] + place[begin + 1 : end]))
    if not places:
        raise ValueError(f"{recording.name}: the train does not move above {MOVING:g} m/s; give a run with motion")
    return np.concatenate(places), np.clip(np.concatenate(values), -MAX_RESISTANCE, MAX_RESISTANCE)


def _stretches(speed: Array) -> list[tuple[int, int]]:
    """Return begin and end of every stretch of motion, in samples."""
    moving = np.concatenate(([0], (np.abs(speed) > MOVING).astype(np.int8), [0]))
    edges = np.flatnonzero(np.diff(moving)).reshape(-1, 2)
    return [(int(begin), int(end)) for begin, end in edges if end - begin >= MIN_STRETCH]


def _shoe_forces(recording: Recording, model: TrainModel, speed: Array) -> Array:
    """Return the shoe force of the nominal train from the pressures sent [N], shape (k,)."""
    found = recording.of(BRAKE_PIPE_COMMAND, "pressure") if model.air_brake is not None else None
    if found is None:
        return np.zeros(speed.size)
    shoes, pressures = ShoeForecast(model), aligned(recording.time, *found)[:, 0]
    forces = np.empty(speed.size)
    for k, (t, pressure, v) in enumerate(zip(recording.time.tolist(), pressures.tolist(), speed.tolist(), strict=True)):
        shoes.demand(t, pressure)
        forces[k] = shoes.at(t, v).total
    return forces


def speed_noise(speed: Array) -> float:
    """Return the standard deviation of the noise of a measured speed [m/s], from its second differences."""
    bends = np.abs(speed[2:] - 2.0 * speed[1:-1] + speed[:-2])
    return max(MIN_NOISE, float(np.median(bends)) / (0.6745 * math.sqrt(6.0)))


def smoothed_resistance(speed: Array, pull: Array, steps: Array, waves: float = 0.0) -> Array:
    """Return r in the middle of the steps [m/s²], shape (k - 1,).

    Parameters
    ----------
    speed : Array, shape (k,)
        Measured speed [m/s].
    pull : Array, shape (k - 1,)
        Modelled acceleration over every step [m/s²].
    steps : Array, shape (k - 1,)
        Durations [s].
    waves
        PSD of the speed of the units against the train [m²/s].
    """
    noise = speed_noise(speed) ** 2 + waves / float(np.median(steps))
    count = steps.size
    states, covariances = np.empty((count + 1, 2)), np.empty((count + 1, 3))
    before, predicted = np.empty((count, 2)), np.empty((count, 3))
    v, r, vv, vr, rr = float(speed[0]), 0.0, noise, 0.0, MAX_RESISTANCE**2
    states[0], covariances[0] = (v, r), (vv, vr, rr)
    for k, (h, a, seen) in enumerate(zip(steps.tolist(), pull.tolist(), speed[1:].tolist(), strict=True)):
        v, vv, vr = v + h * (a - r), vv - 2.0 * h * vr + h * h * rr, vr - h * rr
        rr += GRADE_CHANGE**2 * h
        before[k], predicted[k] = (v, r), (vv, vr, rr)
        gain_v, gain_r, miss = vv / (vv + noise), vr / (vv + noise), seen - v
        v, r = v + gain_v * miss, r + gain_r * miss
        vv, vr, rr = (1.0 - gain_v) * vv, (1.0 - gain_v) * vr, rr - gain_r * vr
        states[k + 1], covariances[k + 1] = (v, r), (vv, vr, rr)
    found = np.empty(count + 1)
    found[count] = r
    for k in range(count - 1, -1, -1):
        h = float(steps[k])
        vv, vr, rr = covariances[k].tolist()
        p_vv, p_vr, p_rr = predicted[k].tolist()
        size = p_vv * p_rr - p_vr * p_vr
        c_vv, c_vr, c_rr = vv - h * vr, vr, rr  # covariance of the state with the next one, by rows
        c_rv = vr - h * rr
        miss_v, miss_r = v - float(before[k, 0]), r - float(before[k, 1])
        first, second = (miss_v * p_rr - miss_r * p_vr) / size, (miss_r * p_vv - miss_v * p_vr) / size
        v = float(states[k, 0]) + c_vv * first + c_vr * second
        r = float(states[k, 1]) + c_rv * first + c_rr * second
        found[k] = r
    return np.asarray(0.5 * (found[1:] + found[:-1]))


def by_place(residual: Residual, begin: float, spacing: float, count: int) -> Array:
    """Return r at evenly spaced places [m/s²], shape (count,); NaN outside the run.

    A sample counts at both neighbouring places, with a weight that falls with the distance. Places
    inside the run without a sample are interpolated.
    """
    at = (residual[0] - begin) / spacing
    index = np.floor(at).astype(np.int64)
    part = at - index
    total, weight = np.zeros(count), np.zeros(count)
    for place, share in ((index, 1.0 - part), (index + 1, part)):
        inside = (place >= 0) & (place < count)
        np.add.at(weight, place[inside], share[inside])
        np.add.at(total, place[inside], (share * residual[1])[inside])
    known = np.flatnonzero(weight > 0.0)
    return np.interp(np.arange(count), known, total[known] / weight[known], left=np.nan, right=np.nan)


SPACING = 5.0
"""Distance between the learned values [m]."""
MEMORY = 20
"""Number of the last runs in the average."""
TRIMMED = 5
"""One of so many values is left out on each side, from three runs on at least one: a gust of a single run."""


class RunAverage:
    """Mean resistance of the last runs at evenly spaced places, without the extreme values of every place.

    The estimate of a run does not contain the learned resistance of that run: the average has no feedback.

    Parameters
    ----------
    profile
        Profile of the runs; its places are the range of the values.
    spacing
        Distance between the values [m].
    memory
        Number of the last runs in the average.
    former
        Result of former runs to go on from; it counts as its number of runs.
    """

    def __init__(
        self, profile: Profile, spacing: float = SPACING, memory: int = MEMORY, former: LearnedResistance | None = None
    ) -> None:
        if not 0.5 <= spacing <= 1000.0:
            raise ValueError(f"spacing {spacing:g}: out of range; give 0.5 to 1000 m")
        if not 1 <= memory <= 1000:
            raise ValueError(f"memory {memory}: out of range; give 1 to 1000 runs")
        places = profile.position
        self._spacing = spacing
        self.begin = math.floor(float(places.min()) / spacing) * spacing
        self._count = math.ceil(float(places.max()) / spacing) + 1 - round(self.begin / spacing)
        self._estimates: deque[Array] = deque(maxlen=memory)
        self.runs = 0
        if former is not None:
            where: Array = np.asarray(self.begin + spacing * np.arange(self._count), dtype=np.float64)
            inside = (where >= former.places[0]) & (where <= former.places[-1])
            self._estimates.extend([np.where(inside, former.at(where), np.nan)] * min(former.runs, memory))
            self.runs = former.runs

    def estimate(self, residual: Residual) -> Array:
        """Return the estimate of a run at the places [m/s²], NaN where the run was not."""
        return by_place(residual, self.begin, self._spacing, self._count)

    def add(self, estimate: Array) -> None:
        """Add the estimate of a run."""
        self._estimates.append(estimate)
        self.runs += 1

    def mean(self) -> tuple[float, tuple[float, ...]]:
        """Return the first place that a run has reached [m] and the mean resistance from there on [m/s²], bounded."""
        rising = np.sort(np.array(self._estimates), axis=0)  # NaN last
        number = np.count_nonzero(~np.isnan(rising), axis=0)
        left_out = np.maximum(number // TRIMMED, number >= 3)
        row = np.arange(len(rising))[:, None]
        kept = (row >= left_out) & (row < number - left_out)
        known = np.flatnonzero(number)
        total = np.where(kept, rising, 0.0).sum(axis=0)[known]
        mean = total / (number - 2 * left_out)[known]
        values = np.clip(np.interp(np.arange(known[0], known[-1] + 1), known, mean), -MAX_RESISTANCE, MAX_RESISTANCE)
        begin = self.begin + self._spacing * float(known[0])
        return begin, tuple(round(value, DIGITS) + 0.0 for value in values.tolist())


@dataclass(frozen=True)
class LearnResult:
    """Learned resistance and the runs that gave it.

    Attributes
    ----------
    learned : LearnedResistance
        Result, for the key ``model.learned`` of a scenario.
    metrics : list of dict
        Metrics of every run in order; run k has the resistance learned from the runs before it. The last one has the
        result. Empty for recorded runs.
    unused : dict of str
        Reasons for runs that the result does not contain, by their names.
    interrupted : bool
        True if Ctrl-C ended the runs; the result is that of the finished ones.
    """

    learned: LearnedResistance
    metrics: list[dict[str, Any]] = field(default_factory=list)
    unused: dict[str, str] = field(default_factory=dict)
    interrupted: bool = False

    def _repr_html_(self) -> str:
        rows = [[number, metrics.get("verdict"), metrics.get("speed_rmse_kmh")]
                for number, metrics in enumerate(self.metrics, 1)]  # fmt: skip
        last = f"; last run {self.metrics[-1].get('verdict', 'without criteria')}" if self.metrics else ""
        left = f"; not used: {', '.join(self.unused)}" if self.unused else ""
        return html_table(f"learned from {self.learned.runs} runs{last}{left}", ("run", "verdict", "rms in km/h"), rows)

    @refusing
    def save(self, out: str | Path, *, replace: bool = False) -> Path:
        """Write the learned resistance as YAML and return its path; ``replace``: over a file of that name.

        Raises
        ------
        ValueError
            If the file exists already, has another ending or cannot be written.
        """
        target = Path(out)
        if not replace:
            check_new_file(target, (".yaml", ".yml"))
        write_whole(target, learned_text(self.learned))
        return target


def learn(
    scenario: GivenScenario,
    *,
    runs: int = 5,
    law: Any = None,
    observer: Any = None,
    compensation: Any = None,
    set: Changes | None = None,
    seed: int | None = None,
    spacing: float = SPACING,
    memory: int = MEMORY,
    gust_shift: float = 0.0,
    progress: bool | None = None,
) -> LearnResult:
    """Repeat a scenario and learn the resistance that repeats by place.

    Every run has the next seed, and the resistance learned from the runs before it. One more run has the result.

    Parameters
    ----------
    scenario, law, observer, compensation, set
        As for :func:`train_ato.run`.
    runs
        Number of runs to learn from.
    seed
        Seed of the first run; default: as in the scenario.
    spacing
        Distance between the learned values [m].
    memory
        Number of the last runs in the average.
    gust_shift
        Largest random shift in time of the disturbances that are functions of time, new in every run [s]. With 0 they
        repeat at the same places and are learned like a grade.
    progress
        Show a progress bar; default: in a terminal and in a notebook.

    Returns
    -------
    LearnResult

    Raises
    ------
    ValueError
        Bad input, in one line with the remedy.
    RunFailed
        A run failed, none of the runs is usable, or Ctrl-C ended the first one.

    Examples
    --------
    >>> import train_ato as ta
    >>> found = ta.learn("xuzhou_metro:disturbed", runs=1, set={"duration": 30})
    >>> [round(metrics["speed_rmse_kmh"], 2) for metrics in found.metrics]
    [0.08, 0.03]
    """
    choice = choose_scenario(scenario).changed(set, seed)
    parts = {"law": law, "observer": observer, "compensation": compensation}
    checked = put_components(choice.checked, importable=False, changes=set, **parts)
    return learn_runs(choice.prepare(checked), runs, spacing, memory, gust_shift=gust_shift, shown=progress)


def learn_runs(
    setup: RunSetup,
    runs: int,
    spacing: float = SPACING,
    memory: int = MEMORY,
    *,
    gust_shift: float = 0.0,
    shown: bool | None = None,
    kept: KeptRuns | None = None,
) -> LearnResult:
    """Repeat a prepared run; arguments and errors as :func:`learn`.  Runs that are ``kept`` are not run again."""
    if not 1 <= runs <= 10_000:
        raise ValueError(f"runs {runs}: out of range; give 1 to 10000")
    if not 0.0 <= gust_shift <= 86_400.0:
        raise ValueError(f"gust-shift {gust_shift:g}: out of range; give 0 to 86400 s")
    average = RunAverage(setup.profile, spacing, memory, setup.model.learned)
    parts, path, base = PartCache(), setup.folder / "scenario.yaml", setup.scenario
    stack = f"law {base.law}, observer {base.observer}, compensation {base.compensation}"
    result = LearnResult(setup.model.learned or _empty(setup, spacing))
    with share_bar(f"{setup.scenario.name}, {runs} runs", shown=shown) as report:
        for number in range(runs + 1):
            report(number / (runs + 1), f"run {number + 1} of {runs + 1}")
            name, row = f"run {number + 1}", None if kept is None else kept.find(number)
            if row is None:
                scenario = repeated(setup.scenario, number, result.learned if average.runs else None, gust_shift)
                try:
                    row = _row_of(drive(prepare(scenario, path, parts), RunMode(), shown=False), name, average)
                except KeyboardInterrupt:
                    if not average.runs:
                        raise RunInterrupted("interrupted before the end of a run; nothing is learned") from None
                    return replace(result, interrupted=True)
                if kept is not None:
                    kept.add(number, row)
            result.metrics.append(row["metrics"])
            if number < runs:
                _add(average, row, name, result.unused)
                source = f"{average.runs} runs of {base.name}, {stack}, seeds from {base.seed}"
                result = replace(result, learned=_learned(average, setup, spacing, source))
    return result


def repeated(scenario: Scenario, number: int, learned: LearnedResistance | None, gust_shift: float) -> Scenario:
    """Return the scenario of a repeated run: next seed, learned resistance, other times of the gusts."""
    seed = scenario.seed + number
    update: dict[str, Any] = {"seed": seed, "model": scenario.model.model_copy(update={"learned": learned})}
    if gust_shift > 0.0:
        shift = float(random_stream(seed, "gust shift").uniform(-gust_shift, gust_shift))
        update["plant"] = scenario.plant.model_copy(
            update={"disturbances": shifted(scenario.plant.disturbances, shift)}
        )
    return scenario.model_copy(update=update)


def learn_from(folders: Sequence[Path], spacing: float = SPACING, memory: int = MEMORY) -> LearnResult:
    """Return the resistance learned from recorded runs of one line, in this order.

    Raises
    ------
    ValueError
        If a folder is not a run, or a run is of another line or nominal train than the first one.
    """
    average: RunAverage | None = None
    unused: dict[str, str] = {}
    first: RunSetup | None = None
    for folder in folders:
        setup, metrics = read_run_folder(folder)
        if average is None or first is None:
            first, average = setup, RunAverage(setup.profile, spacing, memory)
            fitting = _empty(setup, spacing)
        try:
            fitting.check_fits(setup.line, setup.model.consist, _hash(setup))
        except ValueError as error:
            raise ValueError(f"{folder}: {error}, or leave this run out") from None
        _add(average, _row_of(Run(metrics, folder), str(folder), average), str(folder), unused)
    assert average is not None and first is not None
    if not average.runs:
        raise ValueError(f"{'; '.join(f'{name}: {reason}' for name, reason in unused.items())}; give other runs")
    source = f"train-ato learn {' '.join(str(folder) for folder in folders)}"
    return LearnResult(_learned(average, first, spacing, source), unused=unused)


def unused_reason(metrics: dict[str, Any]) -> str:
    """Return the reason for which nothing is learned from a run; empty for a usable run."""
    if metrics.get("status", "done") != "done":
        return f"the run is {metrics['status']}"
    if count := metrics.get("brake_interventions"):
        return f"the supervisor has braked {count} times"
    return ""


def _row_of(run: Run, name: str, average: RunAverage) -> dict[str, Any]:
    """Return metrics and estimate of a run as plain data, or the reason for which it is not used."""
    if reason := unused_reason(run.metrics):
        return {"metrics": run.metrics, "unused": reason}
    recording = open_recording(run.path) if run.path is not None else run.recording
    residual = residual_of(replace(recording, name=name), run.setup.model)
    return {"metrics": run.metrics, "unused": "", "estimate": average.estimate(residual).tolist()}


def _add(average: RunAverage, row: dict[str, Any], name: str, unused: dict[str, str]) -> None:
    """Add a run to the average, or the reason for which it is not used."""
    if row["unused"]:
        unused[name] = row["unused"]
    else:
        average.add(np.array(row["estimate"]))


def _hash(setup: RunSetup) -> str:
    return model_hash(setup.model.consist, setup.model.line, over_length=setup.scenario.plant.grade_over_length)


def _empty(setup: RunSetup, spacing: float) -> LearnedResistance:
    """Return a learned resistance of 0 for the line and nominal train of a run."""
    return LearnedResistance(
        schema_=SCHEMA, line=setup.line.name, train=setup.model.consist.name, model=_hash(setup), runs=1,
        begin=float(setup.profile.position[0]), spacing=spacing, resistance=(0.0, 0.0),
    )  # fmt: skip


def _learned(average: RunAverage, setup: RunSetup, spacing: float, source: str) -> LearnedResistance:
    """Return the result of the runs so far, of 0 without one."""
    if not average.runs:
        return _empty(setup, spacing)
    begin, resistance = average.mean()
    update = {"source": source, "runs": average.runs, "begin": begin, "resistance": resistance}
    return _empty(setup, spacing).model_copy(update=update)


FIGURES = {
    "rms m/s": ("speed_rmse_kmh", 1 / 3.6),
    "largest m/s": ("speed_error_max_kmh", 1 / 3.6),
    "position m": ("position_error_max_m", 1.0),
    "stop m": ("stop_error_m", 1.0),
    "kN/s": ("command_variation_kn_per_s", 1.0),
}
"""Columns: metric and factor."""


def learned_rows(result: LearnResult) -> list[dict[str, Any]]:
    """Return a row for every repeated run: number of runs before it that are learned, and its errors."""
    rows: list[dict[str, Any]] = []
    learned = result.learned.runs - (len(result.metrics) - 1 - len(result.unused))
    for number, metrics in enumerate(result.metrics):
        row: dict[str, Any] = {"run": number + 1, "learned from": learned, "seed": metrics["seed"]}
        for heading, (name, factor) in FIGURES.items():
            value = metrics.get(name)
            row[heading] = None if value is None else factor * value
        rows.append(row)
        learned += f"run {number + 1}" not in result.unused
    return rows
