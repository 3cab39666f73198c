"""One call of ``train-ato reproduce``: papers, their runs in worker processes, and the files in the output folder."""

import importlib
import json
import multiprocessing
import queue
import re
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from train_ato.api.search_runs import LostRun, run_outcome, worker_pool
from train_ato.judge.metric_names import format_value
from train_ato.log.versions import source_hash
from train_ato.log.whole_file import write_whole
from train_ato.loop.engine import run_engine
from train_ato.papers import claims as c
from train_ato.papers import paper_packages
from train_ato.papers.claims import Calculation, Case, FigureFile, Paper, Result
from train_ato.report.print_figures import SHEET_SIZE, styled


def load_paper(number: str) -> Paper:
    """Return a paper by its number."""
    packages = paper_packages()
    if number not in packages:
        raise ValueError(f"paper '{number}': unknown; name one of {', '.join(packages)} or all")
    paper = importlib.import_module(f"train_ato.papers.{packages[number]}.claims").PAPER
    assert isinstance(paper, Paper)
    return paper


def with_claim(papers: list[Paper], text: str) -> list[Paper]:
    """Return the papers with the claims whose text contains ``text`` in any case, their cases, and no figures."""
    found = []
    for paper in papers:
        claims = [claim for claim in paper.claims if text.strip() and text.lower() in claim.text.lower()]
        if claims:
            needed = {key for claim in claims for key in claim.cases}
            cases = {key: case for key, case in paper.cases.items() if key in needed}
            found.append(replace(paper, claims=claims, cases=cases, figures=lambda results, folder: [], tables=()))
    if not found:
        numbers = ", ".join(paper.number for paper in papers)
        raise ValueError(f"--claim '{text}': in no claim of {numbers}; give a part of a claim of reproduction.md")
    return found


Row = dict[str, str]
"""One line of ``reproduce.json``: paper, claim, stated, measured, verdict, reason, bounds."""
Task = tuple[str, Case | Calculation]
POLL_S = 0.1
"""Interval at which progress is read [s]."""


@dataclass(frozen=True)
class Moved:
    """Progress of a case, 0 to 1."""

    key: str
    fraction: float


@dataclass(frozen=True)
class Finished:
    """Result of a case."""

    key: str
    result: Result


def carry_out(case: Case | Calculation, progress: Any = None) -> Result:
    """Run one case in this process; an error is in ``failure`` of the result, as one line.

    Parameters
    ----------
    case
        The case.
    progress
        Called with :class:`train_ato.judge.result.Progress` during an engine run.
    """
    try:
        if isinstance(case, Calculation):
            figures, series = case.function(**case.arguments)
            return Result(figures, None, None, series)
        run = run_engine(case.setup(), progress=progress)
        # judges need the series only
        recording = run.recording and replace(run.recording, profiles=(), kept_reports=())
        return Result(run.summary, recording, run.failure)
    except Exception as error:
        return Result({}, None, " ".join(f"{type(error).__name__}: {error}".split()))


def run_cases(tasks: Iterable[Task], jobs: int) -> Generator[Moved | Finished, None, None]:
    """Run tasks in their order in worker processes; yield progress and results. ``close`` kills the processes."""
    moved: Any = multiprocessing.get_context("spawn").Queue()
    tasks = list(tasks)
    with worker_pool(partial(_work, moved), jobs) as submit:
        keys = dict(zip(submit(tasks), (key for key, _ in tasks), strict=True))
        while keys:
            done, _ = wait(keys, timeout=POLL_S, return_when=FIRST_COMPLETED)
            with suppress(queue.Empty):
                while True:
                    yield Moved(*moved.get_nowait())
            for future in done:
                result = run_outcome(future)
                lost = isinstance(result, LostRun)
                yield Finished(keys.pop(future), Result({}, None, result.reason) if lost else result)


def _work(moved: Any, task: Task) -> Result:
    """Run a case in a worker; the queue to the parent must not delay the end of the worker."""
    moved.cancel_join_thread()
    return carry_out(task[1], lambda progress: moved.put((task[0], progress.simulated / progress.duration)))


@dataclass(frozen=True)
class Judged:
    """Judged paper: rows, results by key, figures, and errors of the figures."""

    paper: Paper
    rows: list[Row]
    results: dict[str, Result]
    figures: list[FigureFile]
    complaints: list[str]


@dataclass
class _Pending:
    """Paper with missing results."""

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
) -> list[str]:
    """Run every case of the papers once and judge each paper as soon as its cases are complete.

    A paper that was judged in the folder before, with the same claims by the same code, is not run again.

    Parameters
    ----------
    papers
        Papers in the order of the runs.
    folder
        Output folder: ``reproduce.json``, ``reproduce.md`` (rewritten after every paper), ``cases.json``, one file of
        every judged paper, figures.
    full
        With long cases and claims.
    jobs
        Worker processes.
    done
        Called with every paper when it is judged.
    progress
        Called with everything that happens and the number of tasks in all.

    Returns
    -------
    list of str
        Numbers of the papers that were not run again.
    """
    source = source_hash()
    code = {paper.number: f"{source} {[claim.text for claim in claims_of(paper, full=full)]}" for paper in papers}
    found = {number: kept for number in code if (kept := _kept(folder, number, code[number])) is not None}
    again = sorted(found)
    pending, tasks = _plan([paper for paper in papers if paper.number not in found], full=full)
    with closing(run_cases(tasks.items(), jobs)) as events:
        for event in events:
            progress(event, len(tasks))
            for entry in [] if isinstance(event, Moved) else _completed(pending, event):
                judged = _judge(entry, folder, full=full)
                number = judged.paper.number
                found[number] = {
                    "code": code[number],
                    "rows": judged.rows,
                    "section": section(judged.paper, judged.rows, judged.results, judged.figures),
                    "cases": {
                        key: {**result.summary, **({"failure": result.failure} if result.failure else {})}
                        for key, result in judged.results.items()
                    },
                }
                _write(folder / "reproduce.json", [row for key in sorted(found) for row in found[key]["rows"]])
                _write(folder / "cases.json", {key: one["cases"] for key, one in found.items()})
                _write_page(folder, papers, found, full=full)
                _write(_file_of(folder, number), found[number])
                done(judged)
    return again


def _completed(pending: list[_Pending], event: Finished) -> Iterator[_Pending]:
    """Give a result to the papers that need it; yield and remove those that are complete."""
    for entry in [entry for entry in pending if event.key in entry.wanted.values()]:
        entry.results |= {key: event.result for key, task in entry.wanted.items() if task == event.key}
        if len(entry.results) == len(entry.wanted):
            pending.remove(entry)
            yield entry


def _file_of(folder: Path, number: str) -> Path:
    return folder / f"paper{number}.json"


def _kept(folder: Path, number: str, code: str) -> dict[str, Any] | None:
    """Return the content of the file of a paper, if the same code wrote it."""
    try:
        found = json.loads(_file_of(folder, number).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    same = isinstance(found, dict) and found.get("code") == code and {"rows", "section", "cases"} <= set(found)
    return found if same else None


def _plan(papers: list[Paper], *, full: bool) -> tuple[list[_Pending], dict[str, Case | Calculation]]:
    """Return the pending papers and the tasks; equal cases of all papers are one task."""
    pending: list[_Pending] = []
    tasks: dict[str, Case | Calculation] = {}
    for paper in papers:
        wanted: dict[str, str] = {}
        for key, case in cases_of(paper, full=full).items():
            same = next((name for name, known in tasks.items() if known == case), None)
            wanted[key] = same or f"{paper.number} {key}"
            tasks[wanted[key]] = case
        pending.append(_Pending(paper, wanted))
    return pending, tasks


def _judge(entry: _Pending, folder: Path, *, full: bool) -> Judged:
    paper, results = entry.paper, {key: entry.results[key] for key in entry.wanted}
    rows = judge_paper(paper, results, full=full)
    try:
        with styled(SHEET_SIZE):
            figures, complaints = paper.figures(results, folder), []
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        figures, complaints = [], [f"paper {paper.number}: figures not drawn: {type(error).__name__}: {error}"]
    return Judged(paper, rows, results, figures, complaints)


def _write_page(folder: Path, papers: list[Paper], found: Mapping[str, Mapping[str, Any]], *, full: bool) -> None:
    known = {paper.number: paper for paper in papers if paper.number in found}
    options = (" all" if len(papers) == len(paper_packages()) else f" {papers[0].number}") + (" --full" if full else "")
    head = papers_overview((row for entry in found.values() for row in entry["rows"]), known, options)
    write_whole(folder / "reproduce.md", "\n".join([head, *(found[key]["section"] for key in sorted(found))]))


def _write(path: Path, value: Any) -> None:
    write_whole(path, json.dumps(value, indent=2, ensure_ascii=False, default=str) + "\n")


def cases_of(paper: c.Paper, *, full: bool) -> dict[str, c.Case | c.Calculation]:
    """Return the cases to run, in their order."""
    return {key: case for key, case in paper.cases.items() if full or not case.full_only}


def claims_of(paper: c.Paper, *, full: bool) -> list[c.Claim]:
    """Return the claims to judge: all under ``full``, else those without long cases."""
    short = cases_of(paper, full=False)
    return [claim for claim in paper.claims if full or not (claim.full_only or set(claim.cases) - set(short))]


def judge_paper(paper: c.Paper, results: c.Results, *, full: bool) -> list[Row]:
    """Return one row per claim."""
    return [
        {
            "paper": paper.number,
            "claim": claim.text,
            "stated": claim.stated,
            "measured": judgement.measured,
            "verdict": judgement.verdict.value,
            "reason": judgement.reason,
            "bounds": "; ".join(str(check) for check in judgement.checks),
        }
        for claim in claims_of(paper, full=full)
        for judgement in [_judged(claim, results)]
    ]


def _judged(claim: c.Claim, results: c.Results) -> c.Judgement:
    """Return the judgement; "not reproduced" after a failed run or an error of the judge."""
    needed: Mapping[str, c.Result] = {key: results[key] for key in claim.cases}
    failures = [f"{key}: {result.failure}" for key, result in needed.items() if result.failure]
    if failures and not claim.takes_failures:
        return c.Judgement("-", c.Verdict.NOT_REPRODUCED, "the run failed: " + "; ".join(failures))
    try:
        return claim.judge(needed)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        reason = f"the runs have no figures to judge ({type(error).__name__}: {error})"
        return c.Judgement("-", c.Verdict.NOT_REPRODUCED, "; ".join([*failures, reason]))


INTRODUCTION = Path(__file__).with_name("introduction.md")
FORMER: Mapping[str, tuple[int, int, int]] = {
    "000": (14, 6, 4), "001": (12, 1, 3), "002": (3, 8, 1), "003": (7, 4, 0), "004": (2, 8, 0),
}  # fmt: skip
"""Number of claims by verdict before the bounds had sources."""


def table_rows(table: c.CaseTable, results: c.Results) -> Sequence[Sequence[str]]:
    """Return the rows of a table as text; one row with the reason if a run is missing or failed."""
    try:
        return [[format_value(entry) for entry in row] for row in table.rows(results)]
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        return [(f"not available: {type(error).__name__}: {error}",)]


def papers_overview(rows: Iterable[Row], papers: Mapping[str, c.Paper], options: str) -> str:
    """Return the head of the page: introduction, and number of claims by paper and verdict."""
    counted = Counter((row["paper"], row["verdict"]) for row in rows)
    verdicts = [verdict.value for verdict in c.Verdict]
    lines = [
        (
            f"{number}: {papers[number].title}",
            *(counted[number, verdict] for verdict in verdicts),
            " / ".join(str(count) for count in FORMER.get(number, ())),
        )
        for number in sorted(papers)
    ]
    shares = {
        "better": c.BETTER, "much": c.MUCH_BETTER, "removed": c.REMOVED, "unchanged": c.UNCHANGED, "robust": c.ROBUST,
        "about": c.ABOUT,
    }  # fmt: skip
    head = INTRODUCTION.read_text(encoding="utf-8").format(options=options, **shares)
    return head + "\n" + _table(("paper", *verdicts, "before"), lines)


def section(paper: c.Paper, rows: Iterable[Row], results: c.Results, figures: Iterable[c.FigureFile]) -> str:
    """Return the section of a paper: the rows of its claims, the tables of its cases, the captions of its figures."""
    keys = ("claim", "stated", "measured", "bounds", "verdict", "reason")
    claims = [[by_lines(row[key]) for key in keys] for row in rows]
    parts = [
        f"## Paper {paper.number}: {paper.title}\n",
        _table(("claim", "paper", "here", "bounds", "verdict", "reason"), claims),
    ]
    for table in paper.tables:
        title = " ".join(table.title.split())
        parts += [f"{title}:\n\n{_table(table.columns, table_rows(table, results))}"]
    drawn = [(f"`{figure.path.stem}`", figure.caption) for figure in figures]
    if drawn:
        head = "Figures in the folder of `train-ato reproduce`, as PNG (300 dpi) and PDF:\n\n"
        parts.append(head + _table(("file", "caption"), drawn))
    return "\n".join(parts)


def _table(heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a Markdown table; rows may be shorter than the head."""
    lines = ([" ".join(str(entry).split()).replace("|", "\\|") or "-" for entry in line] for line in rows)
    return "".join(f"| {' | '.join(line)} |\n" for line in (heads, ["---"] * len(heads), *lines))


def by_lines(text: str) -> str:
    """Return a text of a claim with each part up to a semicolon outside of brackets in a line of its own.

    Examples
    --------
    >>> by_lines("rms <= 2 (paper; table 1): 1; largest <= 3 (goal): 2")
    'rms <= 2 (paper; table 1): 1<br>largest <= 3 (goal): 2'
    """
    return re.sub(r"; (?![^(]*\))", "<br>", text)
