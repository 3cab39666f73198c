"""Panels of the figures of the papers."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from train_ato.apps.report.quantities import COLOURS, GREY
from train_ato.apps.report.run_figure import LONG_RUN_S
from train_ato.messages.types import Array

__all__ = ["COLOURS", "Series", "blank_figure", "inset", "panels", "save_png", "trace"]

Series = tuple[str, Array, Array]
"""Label, time [s], values."""
POINTS = 20_000
"""Number of points from which a curve is downsampled."""


def blank_figure(title: str, rows: int, columns: int, size: tuple[float, float], *, shared: bool) -> tuple[Figure, Any]:
    """Return a figure and its (rows, columns) panels, optionally with one time axis per column."""
    figure = Figure(figsize=size, dpi=110, layout="constrained")
    figure.suptitle(title)
    return figure, figure.subplots(rows, columns, sharex="col" if shared else False, squeeze=False)


def panels(count: int, title: str, *, height: float = 2.6, shared: bool = True) -> tuple[Figure, list[Axes]]:
    """Return a figure and its panels in one column."""
    figure, axes = blank_figure(title, count, 1, (11, 0.8 + height * count), shared=shared)
    return figure, list(axes[:, 0])


def trace(
    panel: Axes,
    series: Iterable[Series],
    label: str,
    *,
    reference: Series | None = None,
    minutes: bool | None = None,
    **style: Any,
) -> None:
    """Draw series over time with a legend, above a wide grey reference."""
    if reference is not None:
        name, time, values = reference
        in_minutes = time[-1] > LONG_RUN_S if minutes is None else minutes
        panel.plot(time / (60.0 if in_minutes else 1.0), values, label=name, color=GREY, lw=2.6, alpha=0.65)
    for index, (name, time, values) in enumerate(series):
        stride = max(1, time.size // POINTS)
        in_minutes = time[-1] > LONG_RUN_S if minutes is None else minutes
        panel.plot(
            time[::stride] / (60.0 if in_minutes else 1.0),
            values[::stride],
            label=name,
            **{"color": COLOURS[index % len(COLOURS)], "lw": 0.9, **style},
        )
    panel.set_ylabel(label)
    panel.margins(x=0.01, y=0.15)
    panel.legend(loc="upper right", ncols=4, fontsize="small")


def inset(
    panel: Axes,
    series: Iterable[Series],
    begin: float,
    end: float,
    place: tuple[float, float, float, float],
    reference: Series | None = None,
) -> None:
    """Draw an enlarged time range inside a panel (place: x, y, width, height as fractions of the panel)."""
    small = panel.inset_axes(place)
    if reference is not None:
        part = (reference[1] >= begin) & (reference[1] <= end)
        small.plot(reference[1][part], reference[2][part], color=GREY, lw=2.6, alpha=0.65)
    for index, (_, time, values) in enumerate(series):
        part = (time >= begin) & (time <= end)
        small.plot(time[part], values[part], color=COLOURS[index % len(COLOURS)], lw=0.9)
    small.set_xlim(begin, end)
    small.set_xlabel("time in s", fontsize="x-small")
    small.tick_params(labelsize="x-small")


def save_png(figure: Figure, folder: Path, name: str) -> Path:
    """Write a figure as PNG and return the file."""
    path = folder / name
    figure.savefig(path)
    return path
