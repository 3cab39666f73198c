"""Progress of a run on the screen: a bar in a terminal or a notebook, and a line on compilation."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import TextColumn

    from train_ato.judge.result import Progress


COMPILE_NOTE = "Compiling the train's kernel, once on this machine; later runs start at once."
PLANNER_NOTE = "Compiling the planner's kernels, once on this machine; later plans start at once."
UNKEPT_NOTE = "Compiling, as in every run: the cache folder is not writable; set NUMBA_CACHE_DIR to a writable folder."
Report = Callable[[float, str], None]
"""Function of the finished fraction, 0 to 1, and a text."""


def plain_console(**options: Any) -> Console:
    """Return a console that prints every text as it is: without markup, emoji names or highlighting."""
    from rich.console import Console

    return Console(highlight=False, markup=False, emoji=False, **options)


def console() -> Console:
    """Return the console on standard error; standard output is only for results."""
    return plain_console(stderr=True)


def text_column(field: str) -> TextColumn:
    """Return a column of a progress bar with a field of the task as plain text."""
    from rich.progress import TextColumn

    return TextColumn(f"{{task.{field}}}", markup=False)


@contextmanager
def activity(text: str) -> Iterator[Callable[[str], None]]:
    """Show a text with a spinner in a terminal; yield the function that replaces the text."""
    from rich.text import Text

    with console().status(Text(text)) as status:
        yield lambda present: status.update(Text(present))


@contextmanager
def compilation_noted(text: str) -> Iterator[None]:
    """Print a line, once in a process, if kernels are compiled inside the block, as on the first run on a machine."""
    from plant_sim.compiled import on_compilation
    from plant_sim.kernel_cache import kernels_are_kept

    def note() -> None:
        line = text if kernels_are_kept() else UNKEPT_NOTE
        if line not in _printed:
            _printed.add(line)
            console().print(line, soft_wrap=True)

    with on_compilation(note):
        yield


_printed: set[str] = set()
"""Lines on compilation that this process has printed."""


def in_notebook() -> bool:
    """Return True if this process is the kernel of a notebook."""
    module = sys.modules.get("IPython")
    shell = module.get_ipython() if module is not None else None
    return getattr(shell, "kernel", None) is not None


@contextmanager
def share_bar(title: str, *, shown: bool | None = None) -> Iterator[Report]:
    """Show a progress bar; yield the function that updates it with the finished fraction, 0 to 1, and a text.

    Parameters
    ----------
    title
        Text before the bar.
    shown
        Default: if standard error is a terminal or the process is the kernel of a notebook.
    """
    from rich.progress import BarColumn, SpinnerColumn
    from rich.progress import Progress as Bar

    if shown is not False and in_notebook():
        with _notebook_bar(title) as update:
            yield update
        return
    shown = sys.stderr.isatty() if shown is None else shown
    columns = (SpinnerColumn(), text_column("description"), BarColumn(), text_column("fields[state]"))
    with Bar(*columns, console=console(), transient=True, disable=not shown) as bar:
        task = bar.add_task(title, total=1.0, state="")
        yield lambda share, state: bar.update(task, completed=share, state=state)


@contextmanager
def _notebook_bar(title: str) -> Iterator[Report]:
    """Show a bar below the cell of a notebook, without extensions."""
    import html

    display: Any = sys.modules["IPython"].display

    def markup(share: float, state: str) -> Any:
        return display.HTML(f"{html.escape(title)} <progress value='{share:.3f}'></progress> {html.escape(state)}")

    handle = display.display(markup(0.0, ""), display_id=True)
    try:
        yield lambda share, state: handle.update(markup(share, state))
    finally:
        handle.update(display.HTML(""))


@contextmanager
def progress_bar(title: str, *, shown: bool | None = None) -> Iterator[Callable[[Progress], None]]:
    """Show simulated time, real-time factor and remaining time; yield the update function."""
    with share_bar(title, shown=shown) as update:

        def report(progress: Progress) -> None:
            update(
                progress.simulated / progress.duration,
                f"{progress.simulated:.0f} of {progress.duration:.0f} s, {progress.factor:.0f} x real time, "
                f"{progress.remaining:.0f} s left",
            )

        yield report
