"""Learning from run to run: repeated or recorded runs of a line give the resistance that repeats by place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from plant_sim.disturbances import shifted
from plant_sim.streams import random_stream
from train_ato.apps.learn.average import MEMORY, SPACING, RunAverage
from train_ato.apps.learn.residual import residual_of
from train_ato.apps.runs.component_choice import put_components
from train_ato.apps.runs.drive import RunMode, drive
from train_ato.apps.runs.progress import share_bar
from train_ato.apps.runs.run import Run
from train_ato.apps.runs.scenario_choice import Changes, ScenarioChoice, choose_scenario
from train_ato.arguments import check_new_file
from train_ato.control.learned_resistance import SCHEMA, LearnedResistance, learned_text, model_hash
from train_ato.errors import RunInterrupted
from train_ato.log.recorded import open_recording
from train_ato.log.run_folder import read_run_folder
from train_ato.log.whole_file import write_whole
from train_ato.loop.part_cache import PartCache
from train_ato.loop.setup import RunSetup, prepare
from train_ato.scenario.scenario import Scenario

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
