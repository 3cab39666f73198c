"""Terminal output: tables, and one JSON value with ``--json``; progress bars are in ``apps/runs/progress``."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from typing import Any

from rich.console import Console
from rich.table import Table

from train_ato.apps.runs.progress import COMPILE_NOTE, compilation_noted
from train_ato.apps.runs.summary_table import format_value


def note_compilation() -> None:
    """Load the kernel of the train; print a note if it is compiled, once on every machine."""
    from plant_sim.train import compile_kernel

    with compilation_noted(COMPILE_NOTE):
        compile_kernel()


def print_json(value: Any) -> None:
    """Print one JSON value on standard output."""
    unicode = (sys.stdout.encoding or "").lower().startswith("utf")
    sys.stdout.write(json.dumps(value, indent=2, ensure_ascii=not unicode, allow_nan=False) + "\n")


def print_names(title: str, entries: Iterable[tuple[str, str]]) -> None:
    """Print names with their one-line summaries under a title."""
    result = Table(title=title, title_justify="left", title_style="bold", box=None, show_header=False, pad_edge=False)
    result.add_column(no_wrap=True)
    result.add_column(overflow="fold")
    for name, meaning in entries:
        result.add_row(f"  {name}", meaning)
    Console(highlight=False).print(result)


def print_table(columns: Iterable[str], rows: Iterable[Iterable[Any]], title: str = "") -> None:
    """Print a table on standard output; a table of two columns folds long values."""
    columns = list(columns)
    result = Table(
        title=title or None, title_justify="left", header_style="bold underline", box=None, padding=(0, 2, 0, 0)
    )
    for number, column in enumerate(columns):
        if number == 1 and len(columns) == 2:
            result.add_column(column, justify="right", overflow="fold")
        else:
            result.add_column(column, justify="left" if number == 0 else "right", no_wrap=True)
    for row in rows:
        result.add_row(*(format_value(entry) for entry in row))
    Console(highlight=False).print(result)
