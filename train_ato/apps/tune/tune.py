"""Tuning: search for the gains of a law over scenarios and seeds, with held-out runs beside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from train_ato.apps.runs.component_choice import choose_component
from train_ato.apps.runs.scenario_choice import Changes, ScenarioChoice, choose_scenario
from train_ato.apps.tune.gain_runs import HELD_OUT, SEARCHED, gain_tasks
from train_ato.apps.tune.objective import read_weights
from train_ato.apps.tune.optimizers import CmaOptimizer, MakeOptimizer, check_optimizer
from train_ato.apps.tune.tune_plan import TunePlan
from train_ato.apps.tune.tune_result import HISTORY, TuneResult
from train_ato.apps.tune.tune_spec import NO_SPEC, read_tune_spec
from train_ato.control.registry import LAWS
from train_ato.log.run_folder import RunFolder


def tune(
    scenario: str | Path | ScenarioChoice | Sequence[str | Path | ScenarioChoice],
    law: Any,
    *,
    observer: Any = None,
    compensation: Any = None,
    set: Changes | None = None,
    parameters: Sequence[str] | None = None,
    over: str | Path | Mapping[str, Any] | None = None,
    seeds: Sequence[int] | None = None,
    held_out: Sequence[str | Path | ScenarioChoice] = (),
    held_out_seeds: Sequence[int] = (),
    weights: Mapping[str, float] | None = None,
    runs: int = 60,
    jobs: int = 1,
    search_seed: int = 1,
    out: str | Path | None = None,
    progress: bool | None = None,
    optimizer: MakeOptimizer = CmaOptimizer,
) -> TuneResult:
    """Search for the gains of a law with the best runs of one or more scenarios.

    Every candidate is run on every scenario, seed and variation. Its objective is the mean of the average and the worst
    score; the formula of a score is in :mod:`train_ato.apps.tune.objective`. Candidates have three significant digits.
    For one ``search_seed`` the result is the same with every number of jobs. Ctrl-C ends the search: the result has
    the best gains of the complete generations.

    Parameters
    ----------
    scenario
        One or more scenarios of the search.
    law, observer, compensation, set
        As for :func:`train_ato.run`; ``set`` applies to every scenario, also to the held-out ones.
    parameters
        Names of the parameters to vary; default: every numeric one above 0.
    over
        YAML file, or a mapping, with ranges (``over``) and start values (``start``) of the parameters and changes of
        the scenarios (``variations``).
    seeds
        Seeds of the runs; default: that of each scenario.
    held_out, held_out_seeds
        Scenarios and seeds that the search does not use; they are run with the initial and the tuned gains.
    weights
        Weights of the terms ``speed``, ``stop``, ``command``, ``coupler``, ``overspeed``; 0 removes a term.
    runs
        Largest number of simulated runs of the search, in whole generations of six candidates.
    jobs
        Worker processes; 1: this process.
    search_seed
        Seed of the search.
    out
        Folder to make, with overlay scenario, table and history; default: none.
    progress
        Show a progress bar; default: in a terminal and in a notebook.
    optimizer
        Search on the unit cube; default: CMA-ES.

    Returns
    -------
    TuneResult
        Gains, runs before and after, history, overlay scenario.

    Raises
    ------
    ValueError
        Bad input, in one line with the remedy; nothing was started.
    RunFailed
        The run with the law of a scenario failed.
    KeyboardInterrupt
        Ctrl-C before the initial gains were run.

    Examples
    --------
    >>> import train_ato as ta
    >>> tuned = ta.tune("xuzhou_metro", "smc", set={"duration": 20}, parameters=["l1", "ks"], runs=6)
    >>> tuned.score("tuned").objective <= tuned.score("initial").objective
    True
    """
    if optimizer is CmaOptimizer:
        check_optimizer()
    spec = NO_SPEC if over is None else read_tune_spec(over)
    given = [scenario] if isinstance(scenario, (str, Path, ScenarioChoice)) else list(scenario)
    choices = [choose_scenario(name).changed(set, None) for name in given]
    outside = [choose_scenario(name).changed(set, None) for name in held_out]
    if not choices:
        raise ValueError("scenario: none; name one or more")
    parts = {"observer": observer, "compensation": compensation}
    tasks = gain_tasks(choices, law, SEARCHED, seeds, spec.variations, **parts)
    if held_out_seeds:
        tasks += gain_tasks(choices, law, HELD_OUT, held_out_seeds, **parts)
    tasks += gain_tasks(outside, law, HELD_OUT, [*(seeds or ()), *held_out_seeds], **parts)
    if jobs > 1:
        choose_component(LAWS, law).check_importable()
    checked = read_weights([f"{key}={weight}" for key, weight in (weights or {}).items()], "weights")
    plan = TunePlan.of(tasks, choices[0], checked, parameters, spec, runs)
    plan.check_jobs(jobs)
    folder = None if out is None else RunFolder.make(Path(out), "tune", "out")
    try:
        result = plan.execute(optimizer, search_seed, jobs, progress, None if folder is None else folder.path)
        if folder is not None:
            result.write(folder.path)
    except BaseException:
        if folder is not None and not (folder.path / HISTORY).is_file():
            folder.discard()
        raise
    return result
