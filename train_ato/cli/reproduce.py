"""``train-ato reproduce``: check the claims of the papers against simulated runs.

Options::

    paper         {papers} or all (default: all)
    --claim TEXT  only claims that contain TEXT, with their cases; no figures
    --full        include the long cases over the whole line
    --jobs N      number of worker processes (default: 2, at most the number of cores)
    --out DIR     new folder (default: runs/reproduce-N)
    --resume DIR  folder of an interrupted command; judged papers are not run again
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from train_ato.cli.screen import note_compilation, print_json
from train_ato.papers import paper_packages
from train_ato.program.arguments import Options
from train_ato.program.errors import RunFailed

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table as Grid

    from train_ato.log.run_folder import RunFolder
    from train_ato.papers.claims import CaseTable
    from train_ato.papers.session import Finished, Judged, Moved

HEADS = (("claim", 5), ("stated", 3), ("measured", 4), ("verdict", 2), ("reason", 6))
"""Columns of the table of claims and their relative widths."""
WIDTH = 160
"""Width of the tables if standard output is not a terminal [characters]."""
COLOURS = {"reproduced": "green", "only in another setting": "yellow", "not reproduced": "red"}

OPTIONS: Options = {
    "paper": {"nargs": "?", "default": "all", "words": {"papers": ", ".join(paper_packages())}},
    "--jobs": {"default": min(2, os.cpu_count() or 1)},
    "--out": {"one_of": "place"},
    "--resume": {"one_of": "place"},
}


def execute(options: argparse.Namespace) -> None:
    """Run the cases of the claims and judge the claims."""
    if not 1 <= options.jobs <= 64:
        raise ValueError(f"--jobs {options.jobs}: out of range; give 1 to 64")
    from train_ato.papers.session import Judged, load_paper, reproduce, with_claim

    numbers = [*paper_packages()] if options.paper == "all" else [options.paper]
    papers = [load_paper(number) for number in numbers]
    if options.claim is not None:
        papers = with_claim(papers, options.claim)
    folder = _folder(options)
    judged: list[Judged] = []

    def take(paper: Judged) -> None:
        judged.append(Judged(paper.paper, paper.rows, {}, paper.figures, paper.complaints))
        _report(paper, folder.path, full=options.full, quiet=options.json)

    try:
        note_compilation()
        with _bar() as progress:
            kept = reproduce(papers, folder.path, full=options.full, jobs=options.jobs, done=take, progress=progress)
    except OSError as error:
        judged_before = sorted(path.stem for path in folder.path.glob("paper*.json"))
        if not judged_before:
            raise
        raise RunFailed(
            f"{error.filename or folder.path}: {error.strerror}; judged: {', '.join(judged_before)}; make room and "
            f"go on with --resume {folder.path}"
        ) from error
    finally:
        if not judged and options.resume is None:
            folder.discard()
    if kept:
        sys.stderr.write(f"papers judged before, not run again: {', '.join(kept)}\n")
    if options.json:
        print_json(json.loads((folder.path / "reproduce.json").read_text(encoding="utf-8")))
    else:
        sys.stdout.write(f"claims, results of all cases and figures in {folder.path}\n")


def _folder(options: argparse.Namespace) -> RunFolder:
    """Return the new folder, or that of the interrupted command."""
    from train_ato.log.run_folder import RunFolder

    if options.resume is None:
        return RunFolder.make(options.out, "reproduce")
    if not any(options.resume.glob("paper*.json")):
        raise ValueError(f"--resume {options.resume}: has no judged paper; name a folder of reproduce, or use --out")
    return RunFolder(options.resume)


@contextmanager
def _bar() -> Iterator[Callable[[Moved | Finished, int], None]]:
    """Show a progress bar of the cases; yield its update function."""
    from train_ato.api.progress import share_bar
    from train_ato.papers.session import Moved

    under_way: dict[str, float] = {}
    ended, begin = 0, time.monotonic()
    with share_bar("cases") as update:

        def report(event: Moved | Finished, total: int) -> None:
            nonlocal ended
            if isinstance(event, Moved):
                under_way[event.key] = event.fraction
            else:
                under_way.pop(event.key, None)
                ended += 1
            state = ", ".join(f"{key} {100 * part:.0f} %" for key, part in under_way.items())
            update(ended / total, f"{ended}/{total}, {time.monotonic() - begin:.0f} s  {state}")

        yield report


def _report(judged: Judged, folder: Path, *, full: bool, quiet: bool) -> None:
    """Print the tables of a paper and write them beside its figures."""
    from train_ato.api.progress import plain_console
    from train_ato.log.whole_file import writing

    path = folder / f"paper{judged.paper.number}.txt"
    with writing(path), path.open("w", encoding="utf-8") as file:
        screens = [plain_console(file=file, width=WIDTH)]
        if not quiet:
            screens.append(plain_console(width=None if sys.stdout.isatty() else WIDTH))
        for screen in screens:
            _print(judged, full=full, screen=screen)
    for complaint in judged.complaints:
        sys.stderr.write(f"train-ato: {complaint}\n")


def _print(judged: Judged, *, full: bool, screen: Console) -> None:
    from rich.table import Table as Grid
    from rich.text import Text

    from train_ato.papers.session import claims_of

    paper = judged.paper
    grid = Grid(title=f"paper {paper.number}: {paper.title}", title_justify="left", expand=True, show_lines=True)
    for (_, share), head in zip(HEADS, ("claim", "paper", "here", "verdict", "reason"), strict=True):
        grid.add_column(head, ratio=share, overflow="fold")
    for row in judged.rows:
        cells = [Text(row[key], style=COLOURS[row[key]] if key == "verdict" else "") for key, _ in HEADS]
        grid.add_row(*cells)
    screen.print(grid)
    left_out = len(paper.claims) - len(claims_of(paper, full=full))
    if left_out:
        screen.print(f"{left_out} more with --full")
    for table in paper.tables:
        screen.print(_grid(table, judged))


def _grid(table: CaseTable, judged: Judged) -> Grid:
    from rich.table import Table as Grid

    from train_ato.papers.session import table_rows

    grid = Grid(title=table.title, title_justify="left")
    for number, head in enumerate(table.columns):
        grid.add_column(head, justify="left" if number == 0 else "right", overflow="fold")
    for row in table_rows(table, judged.results):
        grid.add_row(*row)
    return grid
