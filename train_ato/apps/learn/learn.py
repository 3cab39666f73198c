"""Learning from run to run: repeated or recorded runs of a line give the resistance that repeats by place."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from plant_sim.disturbances import shifted
from plant_sim.streams import random_stream
from train_ato.apps.learn.residual import Residual, by_place, residual_of
from train_ato.apps.runs.component_choice import put_components
from train_ato.apps.runs.drive import RunMode, drive
from train_ato.apps.runs.progress import share_bar
from train_ato.apps.runs.run import Run
from train_ato.apps.runs.scenario_choice import Changes, ScenarioChoice, choose_scenario
from train_ato.arguments import check_new_file
from train_ato.control.learned_resistance import DIGITS, LARGEST, SCHEMA, LearnedResistance, learned_text, model_hash
from train_ato.errors import RunInterrupted
from train_ato.log.recorded import open_recording
from train_ato.log.run_folder import read_run_folder
from train_ato.log.whole_file import write_whole
from train_ato.loop.part_cache import PartCache
from train_ato.loop.setup import RunSetup, prepare
from train_ato.messages.types import Array
from train_ato.profile.profile import Profile
from train_ato.scenario.scenario import Scenario

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

    Raises
    ------
    ValueError
        For a spacing or memory out of range.
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

    def add(self, residual: Residual) -> None:
        """Add a run."""
        self._estimates.append(by_place(residual, self.begin, self._spacing, self._count))
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
        values = np.clip(np.interp(np.arange(known[0], known[-1] + 1), known, mean), -LARGEST, LARGEST)
        begin = self.begin + self._spacing * float(known[0])
        return begin, tuple(round(value, DIGITS) + 0.0 for value in values.tolist())


__all__ = ["LearnResult", "learn", "learn_from", "learn_runs", "repeated", "unused_reason"]


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

    def save(self, path: str | Path) -> Path:
        """Write the learned resistance as YAML and return its path.

        Raises
        ------
        ValueError
            If the file exists already, has another ending or cannot be written.
        """
        target = Path(path)
        check_new_file(target, (".yaml", ".yml"))
        write_whole(target, learned_text(self.learned))
        return target


def learn(
    scenario: str | Path | ScenarioChoice,
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
        Seed of the first run; default: that of the scenario.
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
    checked = put_components(choice.checked, law=law, observer=observer, compensation=compensation, importable=False)
    return learn_runs(choice.prepare(checked), runs, spacing, memory, gust_shift, progress)


def learn_runs(
    setup: RunSetup,
    runs: int,
    spacing: float = SPACING,
    memory: int = MEMORY,
    gust_shift: float = 0.0,
    shown: bool | None = None,
) -> LearnResult:
    """Repeat a prepared run; arguments and errors as :func:`learn`."""
    if not 1 <= runs <= 10_000:
        raise ValueError(f"runs {runs}: out of range; give 1 to 10000")
    if not 0.0 <= gust_shift <= 86_400.0:
        raise ValueError(f"gust-shift {gust_shift:g}: out of range; give 0 to 86400 s")
    average = RunAverage(setup.profile, spacing, memory, setup.model.learned)
    parts, path = PartCache(), setup.folder / "scenario.yaml"
    result = LearnResult(setup.model.learned or _empty(setup, spacing))
    with share_bar(f"{setup.scenario.name}, {runs} runs", shown) as report:
        for number in range(runs + 1):
            report(number / (runs + 1), f"run {number + 1} of {runs + 1}")
            scenario = repeated(setup.scenario, number, result.learned if average.runs else None, gust_shift)
            try:
                run = drive(prepare(scenario, path, parts), RunMode(), shown=False)
            except KeyboardInterrupt:
                if not average.runs:
                    raise RunInterrupted("interrupted before the end of a run; nothing is learned") from None
                return replace(result, interrupted=True)
            result.metrics.append(run.metrics)
            if number < runs:
                _add(average, run, f"run {number + 1}", result.unused)
                result = replace(result, learned=_learned(average, setup, spacing, _source(setup, average.runs)))
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
        _add(average, Run(metrics, folder), str(folder), unused)
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


def _add(average: RunAverage, run: Run, name: str, unused: dict[str, str]) -> None:
    """Add a run to the average, or the reason for which it is not used."""
    if reason := unused_reason(run.metrics):
        unused[name] = reason
        return
    recording = open_recording(run.path) if run.path is not None else run.recording
    average.add(residual_of(replace(recording, name=name), run.setup.model))


def _hash(setup: RunSetup) -> str:
    return model_hash(setup.model.consist, setup.model.line, setup.plant.grade_over_length)


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


def _source(setup: RunSetup, runs: int) -> str:
    scenario = setup.scenario
    stack = f"law {scenario.law}, observer {scenario.observer}, compensation {scenario.compensation}"
    return f"{runs} runs of {scenario.name}, {stack}, seeds from {scenario.seed}"
