"""Panels of the figures of the papers, and their files for print."""

from collections.abc import Collection, Iterable
from pathlib import Path
from string import ascii_lowercase
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from train_ato.log.whole_file import writing
from train_ato.messages.types import Array
from train_ato.papers.claims import FigureFile
from train_ato.report.page_data import kept
from train_ato.report.print_figures import DPI, LONG_RUN_S
from train_ato.report.quantities import COLOURS, GREY

Series = tuple[str, Array, Array]
"""Label, time [s], values."""
POINTS = 8_000
"""Number of points from which a curve is downsampled; its extremes are kept."""
HELD: dict[str, Any] = {"drawstyle": "steps-post"}
"""Style of a command, which is constant between samples."""


def panel_grid(
    caption: str, rows: int, columns: int = 1, *, height: float = 2.4, width: float = 11.0, share: bool = True
) -> tuple[Figure, Any]:
    """Return a figure and its (rows, columns) panels, optionally with one time axis per column.

    The page has the caption; it is not drawn. Height of a row and width of the figure are in inch.
    """
    figure = Figure(figsize=(width, 0.8 + height * rows), layout="constrained")
    figure.set_label(caption)
    return figure, figure.subplots(rows, columns, sharex="col" if share else False, squeeze=False)


def panels(count: int, caption: str, *, height: float = 2.6, shared: bool = True) -> tuple[Figure, list[Axes]]:
    """Return a figure and its panels in one column."""
    figure, axes = panel_grid(caption, count, height=height, share=shared)
    return figure, list(axes[:, 0])


def trace(
    panel: Axes,
    series: Iterable[Series],
    label: str,
    *,
    reference: Series | None = None,
    minutes: bool | None = None,
    first_colour: int = 0,
    **style: Any,
) -> None:
    """Draw series over time with a legend, above a wide grey reference."""
    if reference is not None:
        name, time, values = reference
        in_minutes = time[-1] > LONG_RUN_S if minutes is None else minutes
        panel.plot(time / (60.0 if in_minutes else 1.0), values, label=name, color=GREY, lw=2.6, alpha=0.65)
    for index, (name, time, values) in enumerate(series):
        t, y = thinned(time, values)
        in_minutes = time[-1] > LONG_RUN_S if minutes is None else minutes
        panel.plot(
            t / (60.0 if in_minutes else 1.0),
            y,
            label=name,
            **{"color": COLOURS[(first_colour + index) % len(COLOURS)], "lw": 0.9, **style},
        )
    panel.set_ylabel(label)
    panel.margins(x=0.01, y=0.15)
    panel.legend(loc="upper right", ncols=4, fontsize="small")


def thinned(time: Array, values: Array) -> tuple[Array, Array]:
    """Return at most about :data:`POINTS` points of a curve with all its extremes."""
    rows = kept([values], POINTS)
    return time[rows], values[rows]


def between(series: Iterable[Series], begin: float, end: float) -> list[Series]:
    """Return the parts of series in a time range [s]."""
    parts = [(name, (time >= begin) & (time <= end), time, values) for name, time, values in series]
    return [(name, time[part], values[part]) for name, part, time, values in parts]


def inset(
    panel: Axes,
    series: Iterable[Series],
    begin: float,
    end: float,
    *,
    place: tuple[float, float, float, float],
    reference: Series | None = None,
) -> None:
    """Draw an enlarged time range inside a panel (place: x, y, width, height as fractions of the panel)."""
    small = panel.inset_axes(place)
    for _, time, values in between([] if reference is None else [reference], begin, end):
        small.plot(time, values, color=GREY, lw=2.6, alpha=0.65)
    for index, (_, time, values) in enumerate(between(series, begin, end)):
        small.plot(time, values, color=COLOURS[index % len(COLOURS)], lw=0.9)
    small.set_xlim(begin, end)
    small.set_xlabel("time in s", fontsize="x-small")
    small.tick_params(labelsize="x-small")


def save(figure: Figure, path: Path) -> FigureFile:
    """Write a figure with lettered panels as PNG for print, and as PDF of the same name; return it with its caption."""
    if len(figure.axes) > 1:
        for letter, panel in zip(ascii_lowercase, figure.axes, strict=False):
            panel.set_title(letter, loc="left", fontweight="bold", pad=3)
    with writing(path):
        figure.savefig(path, dpi=DPI)
    with writing(path.with_suffix(".pdf")):
        figure.savefig(path.with_suffix(".pdf"), metadata={"CreationDate": None})
    caption = str(figure.get_label())
    return FigureFile(path, caption[:1].upper() + caption[1:])


def save_grid(
    figure: Figure, axes: Any, path: Path, below: str = "time in s", *, legends: Collection[int] | None = None
) -> FigureFile:
    """Write a grid of panels with an axis label below and legends in the given rows (default: all); return it."""
    for row, panels in enumerate(axes):
        for panel in panels:
            panel.margins(x=0.01)
            if (legends is None or row in legends) and panel.get_legend_handles_labels()[0]:
                panel.legend(loc="best", ncols=4 if len(panels) == 1 else 2, fontsize="small")
    for panel in axes[-1]:
        if not panel.get_xlabel():
            panel.set_xlabel(below)
    return save(figure, path)
