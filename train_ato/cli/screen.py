"""What a person sees: a progress bar, tables, and one JSON value where ``--json`` is given."""

from __future__ import annotations

import json
import math
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, SpinnerColumn, TextColumn
from rich.progress import Progress as Bar
from rich.table import Table

from train_ato.outcome import Progress

COMPILE_NOTE = "Compiling the train's kernel, once on this machine; later runs start at once."
PLANNER_NOTE = "Planning takes a moment; on a machine's first run kernels are compiled for it."
UNKEPT_NOTE = (
    "Compiling, as in every run: neither the package's folder nor the user's cache folder can be written; name one "
    "that can in NUMBA_CACHE_DIR."
)


def console() -> Console:
    """Return the console for people: standard error, so that standard output stays clean for results."""
    return Console(stderr=True, highlight=False)


@contextmanager
def noted_when_slow(text: str) -> Iterator[None]:
    """Print a line when something takes longer than two seconds: on a machine's first run kernels are compiled."""

    def told() -> None:
        compiled = sys.modules.get("plant_sim.compiled")
        kept = compiled is None or compiled.results_are_kept()
        console().print(text if kept else UNKEPT_NOTE, soft_wrap=True)

    note = threading.Timer(2.0, told)
    note.daemon = True
    note.start()
    try:
        yield
    finally:
        note.cancel()


@contextmanager
def progress_bar(title: str) -> Iterator[Any]:
    """Show simulated time, real-time factor and remaining time; yields the function to report with."""
    bar = Bar(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[state]}"),
        console=console(),
        transient=True,
        disable=not sys.stderr.isatty(),
    )
    with bar:
        task = bar.add_task(title, total=1.0, state="")

        def report(progress: Progress) -> None:
            state = (
                f"{progress.simulated:.0f} of {progress.duration:.0f} s, {progress.factor:.0f} x real time, "
                f"{progress.remaining:.0f} s left"
            )
            bar.update(task, completed=progress.simulated / progress.duration, state=state)

        yield report


@contextmanager
def share_bar(title: str) -> Iterator[Callable[[float, str], None]]:
    """Show how much of a work is done; yields the function that takes the share, 0 to 1, and a word on it."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[state]}"))
    with Bar(*columns, console=console(), transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task(title, total=1.0, state="")
        yield lambda share, state: bar.update(task, completed=share, state=state)


def print_json(value: Any) -> None:
    """Print one JSON value on standard output."""
    sys.stdout.write(json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def shown(value: Any) -> str:
    """Return a figure as a person reads it."""
    if value is None:
        return "-"
    if isinstance(value, float):
        if not math.isfinite(value):
            return str(value)
        return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
    return str(value)


def names(title: str, entries: Iterable[tuple[str, str]]) -> None:
    """Print names with one line of meaning each, under a title."""
    result = Table(title=title, title_justify="left", title_style="bold", box=None, show_header=False, pad_edge=False)
    result.add_column(no_wrap=True)
    result.add_column(overflow="fold")
    for name, meaning in entries:
        result.add_row(f"  {name}", meaning)
    Console(highlight=False).print(result)


def table(columns: Iterable[str], rows: Iterable[Iterable[Any]], title: str = "") -> None:
    """Print a table on standard output."""
    result = Table(
        title=title or None, title_justify="left", header_style="bold underline", box=None, padding=(0, 2, 0, 0)
    )
    for number, column in enumerate(columns):
        result.add_column(column, justify="left" if number == 0 else "right", no_wrap=True)
    for row in rows:
        result.add_row(*(shown(entry) for entry in row))
    Console(highlight=False).print(result)
