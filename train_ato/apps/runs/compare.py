"""Comparison of laws: one scenario driven with each of them in the engine."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.apps.runs.comparison import OWN, Compared, Comparison
from train_ato.apps.runs.component_choice import ComponentChoice, choose_component, put_components
from train_ato.apps.runs.drive import RunMode, drive
from train_ato.apps.runs.run import Run
from train_ato.apps.runs.scenario_choice import Changes, ScenarioChoice, choose_scenario
from train_ato.control.registry import LAWS
from train_ato.errors import RunFailed, RunInterrupted
from train_ato.loop.scenario_data import with_start_position
from train_ato.loop.setup import RunSetup
from train_ato.scenario.scenario import Scenario

if TYPE_CHECKING:
    from train_ato.apps.report.page_data import PageData


def compare(
    scenario: str | Path | ScenarioChoice,
    laws: Sequence[Any] | None = None,
    *,
    observer: Any = None,
    compensation: Any = None,
    set: Changes | None = None,
    seed: int | None = None,
    keep: str | Path | None = None,
    progress: bool | None = None,
) -> Comparison:
    """Run a scenario with several laws in the engine.

    A law that does not fit the train, or whose run fails, has a row with the reason; the other laws are run.  The
    column ``gains`` has the source of the parameters of each law.

    Parameters
    ----------
    scenario, observer, compensation, set, seed, progress
        As for :func:`train_ato.run`.
    laws
        Laws, each as ``law`` of :func:`train_ato.run`; default: every registered one.
    keep
        Folder for the runs, with one subfolder per law; default: none.

    Raises
    ------
    ValueError
        Bad input, such as an unknown law, or if no law fits the train.
    RunInterrupted
        Ctrl-C.

    Examples
    --------
    >>> import train_ato as ta
    >>> both = ta.compare("demo", ["pid", "smc"], set={"duration": 20})
    >>> sorted(both.table["status"].items())
    [('pid', 'done'), ('smc', 'done')]
    """
    choice = choose_scenario(scenario).changed(set, seed)
    base = put_components(choice.checked, observer=observer, compensation=compensation, importable=False)
    chosen = _chosen(laws)
    setups, refused = _setups(choice, base, chosen)
    folder = None if keep is None else Path(keep)
    return Comparison(
        choice.name,
        [
            Compared(law.label, {}, "", refused[law.label])
            if law.label in refused
            else _compared(law, setups[law.label], len(setups), folder, progress)
            for law in chosen
        ],
    )


def _chosen(laws: Sequence[Any] | None) -> list[ComponentChoice]:
    """Return the loaded laws with different labels; None for every registered one."""
    if isinstance(laws, str):
        raise ValueError(f"laws '{laws}': give a list, for example ['pid', 'smc']")
    chosen = _labelled([choose_component(LAWS, entry) for entry in (LAWS.loadable() if laws is None else laws)])
    if not chosen:
        raise ValueError("laws: no law; add one, or remove the argument to use all that fit")
    for law in chosen:
        LAWS.get(law.name)
    return chosen


def _labelled(laws: Sequence[ComponentChoice]) -> list[ComponentChoice]:
    """Return the laws with different labels."""
    taken: dict[str, int] = {}
    found = []
    for law in laws:
        taken[law.label] = taken.get(law.label, 0) + 1
        more = f" ({taken[law.label]})" if taken[law.label] > 1 else ""
        found.append(dataclasses.replace(law, label=law.label + more))
    return found


def _setups(
    choice: ScenarioChoice, base: Scenario, laws: Sequence[ComponentChoice]
) -> tuple[dict[str, RunSetup], dict[str, str]]:
    """Prepare one run of the base scenario for each law; return also the reasons of the laws that are refused."""
    setups: dict[str, RunSetup] = {}
    refused: dict[str, str] = {}
    for law in laws:
        scenario = law.put_into(base)
        try:
            if setups:
                first = next(iter(setups.values()))
                start = float(first.profile.position[0])
                setup = dataclasses.replace(first, scenario=with_start_position(scenario, start))
                setup.law(scenario.law)
            else:
                setup = choice.prepare(scenario)
        except ValueError as error:
            refused[law.label] = str(error).partition(f"law '{law.name}'")[2].lstrip(":, ") or str(error)
        else:
            setups[law.label] = setup
    if not setups:
        reasons = "; ".join(f"{label}: {reason}" for label, reason in refused.items())
        raise ValueError(f"{choice.name}: no law fits this train: {reasons}")
    return setups, refused


def _compared(law: ComponentChoice, setup: RunSetup, runs: int, keep: Path | None, shown: bool | None) -> Compared:
    """Run one law; keep only the data of the figures in memory."""
    law.put_into(setup.scenario)  # registers this class, if two classes have one name
    gains = setup.gains(setup.controller).source or OWN
    folder = None if keep is None else keep / re.sub(r"[^\w.()=,+-]+", "-", law.label)
    try:
        run = drive(setup, RunMode(), out=folder, shown=shown, title=law.label, option="keep")
    except RunInterrupted:
        raise
    except RunFailed as error:
        if error.run is None:
            return Compared(law.label, {"status": "failed", "failure": str(error)}, gains, str(error))
        run = error.run
    reason = str(run.metrics.get("failure", ""))
    return Compared(law.label, run.metrics, gains, reason, _page_data(law.label, run, runs))


def _page_data(label: str, run: Run, runs: int) -> PageData:
    """Return the data of the figures; the path of a temporary folder is removed."""
    from train_ato.apps.report.page_data import empty_page_data, page_data, share_of
    from train_ato.log.recorded import open_recording

    try:
        recording = open_recording(run.folder())
    except ValueError as error:
        return empty_page_data(label, run.metrics, str(error))
    reduced = page_data(dataclasses.replace(recording, summary=run.metrics), label, share_of(runs))
    if run.path is None:
        reduced.facts.pop("run", None)
    return reduced
