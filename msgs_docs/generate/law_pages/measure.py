"""Drive, summarise and draw the demonstration runs of the pages."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from msgs_docs.generate.any_law_page import summary_figures, verdict
from msgs_docs.generate.law_pages.components import Component
from msgs_docs.generate.law_pages.demo_runs import demo_of
from msgs_docs.generate.law_pages.figures import draw_demo
from train_ato.control.gains import PRINTED, has_gains
from train_ato.control.registry import LAWS
from train_ato.papers.claims import Case, Result
from train_ato.papers.pool import Finished, WorkerPool
from train_ato.scenario.scenario import load_scenario

KEPT = ("speed_rmse_kmh", "speed_error_max_kmh", "position_error_max_m", "command_variation_kn_per_s")
WORKERS = 2


def measure(
    chosen: Iterable[Component], folder: Path, report: Callable[[float, str], None]
) -> dict[str, list[dict[str, Any]]]:
    """Execute the runs of some pages and draw their figures.

    Parameters
    ----------
    chosen
        Components of these pages.
    folder
        Folder of the figures.
    report
        Called with the finished share and the name of the last scenario.

    Returns
    -------
    dict
        Rows of the tables by key of the component.

    Raises
    ------
    OSError
        If a run fails.
    """
    demos = [(component, demo_of(component.kind, component.name)) for component in chosen]
    cases = {repr(case): case for _, demo in demos for case in demo.runs.values()}
    results: dict[str, Result] = {}
    with WorkerPool(WORKERS) as pool:
        for message in pool.run(cases.items()):
            if isinstance(message, Finished):
                case, result = cases[message.key], message.result
                if result.failure or result.recording is None:
                    raise OSError(f"{command(case)}: {result.failure or 'no complete tick'}")
                results[message.key] = result
                report(len(results) / len(cases), case.scenario)
    found = {}
    for component, demo in demos:
        runs = {label: (case, results[repr(case)]) for label, case in demo.runs.items()}
        found[component.key] = [row(label, case, result) for label, (case, result) in runs.items()]
        draw_demo(component, demo, runs, folder / f"{component.page}.png")
    return found


def row(label: str, case: Case, result: Result) -> dict[str, Any]:
    """Return one row of a table: label, scenario, command line, outcome and metrics to four digits."""
    figures: dict[str, Any] = {key: _rounded(result.summary[key]) for key in KEPT}
    buff, draft = result.summary["coupler_buff_max_kn"], result.summary["coupler_draft_max_kn"]
    figures["couplers"] = f"{buff:.0f} ... {draft:+.0f}" if buff or draft else None
    found = summary_figures(result.summary)
    found["missed"] = {
        name: value for name, value in found.get("missed", {}).items() if value is not None
    }  # no supervisor
    return {"run": label, "scenario": case.scenario, "command": command(case), "outcome": verdict(found), **figures}


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")


def command(case: Case) -> str:
    """Return the command line of a case."""
    options, settings = [], []
    scenario, _ = load_scenario(case.scenario, changes=dict(case.changes))
    if has_gains(LAWS.get(scenario.law)) and "gains" not in scenario.laws.get(scenario.law, {}):
        settings.append(f"--set laws.{scenario.law}.gains={PRINTED}")
    for key, value in case.changes.items():
        if key in ("law", "observer", "compensation"):
            options.append(f"--{key} {value}")
        else:
            settings += [f"--set {path}={text}" for path, text in _flat(key, value)]
    return " ".join(["train-ato run", case.scenario, *options, *settings])


def _flat(path: str, value: Any) -> list[tuple[str, str]]:
    if isinstance(value, Mapping):
        return [pair for key, inner in value.items() for pair in _flat(f"{path}.{key}", inner)]
    return [(path, str(value).lower() if isinstance(value, bool) else str(value))]
