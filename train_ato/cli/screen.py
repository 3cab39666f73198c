"""Terminal output: tables, and one JSON value with ``--json``; progress bars are in ``api/progress``.

A text is printed as it is: names and headers of a user may contain brackets, which are markup for rich.
"""

from __future__ import annotations

import io
import json
import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from typing import TYPE_CHECKING, Any, TextIO

from train_ato.program.display_units import shown_data, shown_table

if TYPE_CHECKING:
    from rich.table import Table


FILE_WIDTH = 100_000
"""Width of a table in a pipe or a file: no cell is folded or cut [characters]."""
_standard_output: list[TextIO] = []
"""Standard output of the command that runs with ``--json``; empty without the option."""


@contextmanager
def kept_for_result(*, as_json: bool) -> Iterator[None]:
    """Keep standard output for the one JSON value of ``--json``: what a law prints in the block goes to stderr.

    Worker processes inherit descriptor 1, which therefore is that of stderr in the block.
    """
    if not as_json:
        yield
        return
    sys.stdout.flush()
    before, kept = sys.stdout, os.dup(1)
    result = before
    with suppress(AttributeError, OSError):  # a stream without a descriptor
        if before.fileno() == 1:
            result = os.fdopen(os.dup(1), "w", encoding=before.encoding, errors=before.errors)
    _standard_output.append(result)
    os.dup2(2, 1)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        _standard_output.pop()
        with suppress(OSError):
            before.flush()
        os.dup2(kept, 1)
        os.close(kept)
        if result is not before:
            with suppress(OSError):  # of a closed pipe: printing has raised it
                result.close()


def note_compilation() -> None:
    """Load the kernel of the train; print a note if it is compiled, once on every machine."""
    from plant_sim.train import compile_kernel
    from train_ato.api.progress import COMPILE_NOTE, compilation_noted

    with compilation_noted(COMPILE_NOTE):
        compile_kernel()


def print_json(value: Any) -> None:
    """Print one JSON value on standard output."""
    stream = _standard_output[-1] if _standard_output else sys.stdout
    unicode = (stream.encoding or "").lower().startswith("utf")
    stream.write(json.dumps(shown_data(value), indent=2, ensure_ascii=not unicode, allow_nan=False) + "\n")
    stream.flush()


def print_result(data: Any, text: str, *, as_json: bool) -> None:
    """Print a result on standard output: its data as one JSON value, or its text."""
    if as_json:
        print_json(data)
    else:
        sys.stdout.write(text)


def print_names(title: str, entries: Iterable[tuple[str, ...]]) -> None:
    """Print names with their one-line summaries, and further columns, under a title."""
    from rich.table import Table

    result = Table(box=None, show_header=False, pad_edge=False)
    rows = list(entries)
    for _ in rows[0] if rows else ():
        result.add_column(overflow="fold")
    for name, *columns in rows:
        result.add_row(f"  {name}", *columns)
    _print(result, title)


def print_table(
    columns: Iterable[str], rows: Iterable[Iterable[Any]], title: str = "", keys: Iterable[str] = ()
) -> None:
    """Print a table on standard output; in a narrow terminal long cells are folded.

    Parameters
    ----------
    keys
        Keys of the columns with their units, for headings without.
    """
    from rich.table import Table

    from train_ato.judge.metric_names import format_value

    columns, rows = shown_table(columns, rows, keys)
    result = Table(header_style="bold underline", box=None, padding=(0, 2, 0, 0))
    for number, column in enumerate(columns):
        result.add_column(column, justify="left" if number == 0 else "right", overflow="fold")
    for row in rows:
        result.add_row(*(format_value(entry) for entry in row))
    _print(result, title)


def kilometre_cell(km: float) -> tuple[str, float]:
    """Return the cell of a table for a place [km], to the metre."""
    return f"{km:.3f}", km


def _print(table: Table, title: str) -> None:
    """Print a title and a table: as wide as the terminal, or as wide as the table off a terminal."""
    from rich.text import Text

    from train_ato.api.progress import plain_console

    if sys.stdout.isatty():
        screen = plain_console()
        if title:
            screen.print(Text(title, style="bold"))
        screen.print(table)
        return
    text = io.StringIO()
    plain_console(file=text, width=FILE_WIDTH).print(table)
    lines = [title] if title else []
    lines += [line.rstrip() for line in text.getvalue().splitlines()]
    sys.stdout.write("\n".join(lines) + "\n")
