"""One call of ``train-ato reproduce``: which papers, what is run for them, what is left in the folder."""

from __future__ import annotations

import importlib
import json
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import train_ato.reproduce
from train_ato.reproduce.claims import Calculation, Case, Paper, Result
from train_ato.reproduce.judging import Row, cases_of, judge_paper
from train_ato.reproduce.page import overview, section
from train_ato.reproduce.pool import Finished, Moved, WorkerPool

__all__ = ["Judged", "load_paper", "paper_numbers", "reproduce"]


def paper_numbers() -> list[str]:
    """Return the numbers of the papers that are here."""
    modules = (module.name for module in pkgutil.iter_modules(train_ato.reproduce.__path__))
    return sorted(name.removeprefix("paper") for name in modules if name[:5] == "paper" and name[5:].isdigit())


def load_paper(number: str) -> Paper:
    """Return a paper by its number.

    Raises
    ------
    ValueError
        If there is none of that number.
    """
    if number not in paper_numbers():
        raise ValueError(f"paper '{number}': unknown; name one of {', '.join(paper_numbers())} or all")
    paper = importlib.import_module(f"train_ato.reproduce.paper{number}").PAPER
    assert isinstance(paper, Paper)
    return paper


@dataclass(frozen=True)
class Judged:
    """A paper that is done: its rows, its results by key, its figures, and what could not be drawn."""

    paper: Paper
    rows: list[Row]
    results: dict[str, Result]
    figures: list[Path]
    complaints: list[str]


@dataclass
class _Pending:
    """A paper under way."""

    paper: Paper
    wanted: dict[str, str]
    """Key of the paper's case to name of the task."""
    results: dict[str, Result] = field(default_factory=dict)


def reproduce(
    papers: list[Paper],
    folder: Path,
    *,
    full: bool,
    jobs: int,
    done: Callable[[Judged], None],
    progress: Callable[[Moved | Finished, int], None],
    shown: Callable[[Any], str] = str,
) -> None:
    """Run every case of the papers once and judge each paper as soon as its cases are complete.

    Parameters
    ----------
    papers
        In the order in which they are run.
    folder
        Takes ``reproduce.json`` and ``reproduce.md`` (rewritten after every paper), ``cases.json`` and the figures.
    full
        Long cases and claims too.
    jobs
        Worker processes.
    done
        Called with every paper when it is judged.
    progress
        Called with everything that happens and the number of tasks in all.
    shown
        Turns a figure of a table into text.
    """
    pending, tasks = _plan(papers, full)
    rows: list[Row] = []
    sections: dict[str, str] = {}
    summaries: dict[str, dict[str, Any]] = {}
    with WorkerPool(jobs) as pool:
        for event in pool.run(tasks.items()):
            progress(event, len(tasks))
            if isinstance(event, Moved):
                continue
            for entry in [entry for entry in pending if event.key in entry.wanted.values()]:
                entry.results |= {key: event.result for key, task in entry.wanted.items() if task == event.key}
                if len(entry.results) == len(entry.wanted):
                    pending.remove(entry)
                    judged = _judge(entry, folder, full)
                    rows += judged.rows
                    summaries[entry.paper.number] = _figures_of(judged)
                    _write(folder / "reproduce.json", sorted(rows, key=lambda row: row["paper"]))
                    _write(folder / "cases.json", summaries)
                    names = [path.name for path in judged.figures]
                    sections[judged.paper.number] = section(judged.paper, judged.rows, judged.results, names, shown)
                    _write_page(folder, papers, rows, sections, full)
                    done(judged)


def _plan(papers: list[Paper], full: bool) -> tuple[list[_Pending], dict[str, Case | Calculation]]:
    """Return what every paper waits for, and the tasks: equal cases of any papers are one."""
    pending: list[_Pending] = []
    tasks: dict[str, Case | Calculation] = {}
    for paper in papers:
        wanted: dict[str, str] = {}
        for key, case in cases_of(paper, full).items():
            same = next((name for name, known in tasks.items() if known == case), None)
            wanted[key] = same or f"{paper.number} {key}"
            tasks[wanted[key]] = case
        pending.append(_Pending(paper, wanted))
    return pending, tasks


def _judge(entry: _Pending, folder: Path, full: bool) -> Judged:
    paper, results = entry.paper, {key: entry.results[key] for key in entry.wanted}
    rows = judge_paper(paper, results, full)
    try:
        figures, complaints = paper.figures(results, folder), []
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        figures, complaints = [], [f"paper {paper.number}: figures not drawn: {type(error).__name__}: {error}"]
    return Judged(paper, rows, results, figures, complaints)


def _write_page(folder: Path, papers: list[Paper], rows: list[Row], sections: dict[str, str], full: bool) -> None:
    known = {paper.number: paper for paper in papers if paper.number in sections}
    options = (" all" if len(papers) == len(paper_numbers()) else f" {papers[0].number}") + (" --full" if full else "")
    head = overview(rows, known, options)
    (folder / "reproduce.md").write_text("\n".join([head, *(sections[key] for key in sorted(sections))]), "utf-8")


def _figures_of(judged: Judged) -> dict[str, Any]:
    return {
        key: {**result.summary, **({"failure": result.failure} if result.failure else {})}
        for key, result in judged.results.items()
    }


def _write(path: Path, value: Any) -> None:
    path.write_text(json.dumps(value, indent=2, ensure_ascii=False, default=str) + "\n", encoding="utf-8")
