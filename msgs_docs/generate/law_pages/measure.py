"""Runs of the pages: carried out, summarised, drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from train_ato.law_docs.blocks import Block
from train_ato.law_docs.figures import draw_home
from train_ato.law_docs.homes import HOMES
from train_ato.reproduce.claims import Case, Result
from train_ato.reproduce.pool import Finished, WorkerPool

KEPT = ("speed_rmse_kmh", "speed_error_max_kmh", "position_error_max_m", "command_variation_kn_per_s")
WORKERS = 2


def measure(
    chosen: Iterable[Block], folder: Path, report: Callable[[float, str], None]
) -> dict[str, list[dict[str, Any]]]:
    """Carry out the runs of some pages and draw their figures.

    Parameters
    ----------
    chosen
        The blocks whose pages are measured.
    folder
        Where the figures go.
    report
        Takes the share that is done and what was done last.

    Returns
    -------
    dict
        Rows of the tables, by the block's key.

    Raises
    ------
    OSError
        If a run fails.
    """
    pages = [block for block in chosen if block.key in HOMES]
    cases: dict[str, Case] = {}
    for block in pages:
        cases |= {repr(case): case for case in HOMES[block.key].runs.values()}
    results: dict[str, Result] = {}
    with WorkerPool(WORKERS) as pool:
        for message in pool.run(cases.items()):
            if isinstance(message, Finished):
                case, result = cases[message.key], message.result
                if result.failure or result.history is None:
                    raise OSError(f"{command(case)}: {result.failure or 'no complete tick'}")
                results[message.key] = result
                report(len(results) / len(cases), case.scenario)
    found = {}
    for block in pages:
        runs = {label: (case, results[repr(case)]) for label, case in HOMES[block.key].runs.items()}
        found[block.key] = [row(label, case, result) for label, (case, result) in runs.items()]
        draw_home(block, HOMES[block.key], runs, folder / f"{block.page}.png")
    return found


def row(label: str, case: Case, result: Result) -> dict[str, Any]:
    """Return one row of a table: what was run, how to run it again, and its figures to four digits."""
    figures: dict[str, Any] = {key: _rounded(result.summary[key]) for key in KEPT}
    buff, draft = result.summary["coupler_buff_max_kn"], result.summary["coupler_draft_max_kn"]
    figures["couplers"] = f"{buff:.0f} ... {draft:+.0f}" if buff or draft else None
    return {"run": label, "scenario": case.scenario, "command": command(case), **figures}


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")


def command(case: Case) -> str:
    """Return the command line that drives a case."""
    options, settings = [], []
    for key, value in case.changes.items():
        if key in ("controller", "observer", "compensation"):
            options.append(f"--{key} {value}")
        else:
            settings += [f"--set {path}={text}" for path, text in _flat(key, value)]
    return " ".join(["train-ato run", case.scenario, *options, *settings])


def _flat(path: str, value: Any) -> list[tuple[str, str]]:
    if isinstance(value, Mapping):
        return [pair for key, inner in value.items() for pair in _flat(f"{path}.{key}", inner)]
    return [(path, str(value).lower() if isinstance(value, bool) else str(value))]
