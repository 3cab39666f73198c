"""Figures for print: the figures of the page as PNG at 300 dpi or as SVG with searchable text."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from train_ato.apps.report.comparison_lines import largest_magnitude, run_colours, run_dash
from train_ato.apps.report.curves import Curves
from train_ato.apps.report.page_data import PageData
from train_ato.apps.report.print_parts import (
    DASHES,
    add_print_legend,
    clock_axis,
    draw_lines,
    draw_track,
    over_time,
    save_figure,
    sheet,
    styled,
)
from train_ato.apps.report.quantities import AXES, PANELS, QUANTITIES
from train_ato.messages.types import Array


def _title(data: PageData, text: str) -> str:
    named = data.summary.get("scenario", data.label)
    law = data.facts.get("law")
    return f"{named}{f', law {law}' if law else ''}: {text}"


def _over_distance(data: PageData) -> Figure | None:
    lines = data.curves.get("speed")
    if lines is None or "position_km" not in lines.columns:
        return None
    figure, axes = sheet(1 if data.track is None else 2, None if data.track is None else [1.3, 0.9])
    panel = axes[0]
    for index, (place, speed) in enumerate(data.profiles):
        look = QUANTITIES["profile" if index == 0 else "replanned"]
        words = look.words if index < 2 else ""
        panel.plot(place, speed, color=look.colour, lw=0.62 * look.width, ls=DASHES[look.dash], alpha=0.65, label=words)
    if data.limits is not None:
        look = QUANTITIES["line_limit"]
        panel.plot(*data.limits, color=look.colour, lw=0.9, ls=DASHES[look.dash], label=look.words)
    driven: dict[str, Array] = {
        name: lines.columns[name] for name in ("speed", "measured_speed", "position_km") if name in lines.columns
    }
    draw_lines(panel, Curves(lines.time, driven), "speed", over="position_km")
    add_print_legend(panel)
    panel.set_xlabel(AXES["distance"])
    if data.track is not None:
        panel.set_xlabel("")
        draw_track(axes[1], data)
    figure.suptitle(_title(data, "speed over distance"), fontsize=8.5)
    return figure


PRINT_FIGURES: dict[str, tuple[str, tuple[str, ...], str]] = {
    "speed": ("", ("speed",), "speed"),
    "errors": ("", ("speed_error", "position_error"), "errors"),
    "forces": ("", ("forces", "unit_forces"), "force of the power units"),
    "couplers": ("couplers", ("coupler_extremes",), "coupler forces"),
    "air_brake": ("shoes", ("pipe", "shoe_force"), "air brake"),
    "disturbance": ("", ("disturbance",), "disturbance"),
    "delay": ("", ("delay",), "delay from command to effect"),
    "energy": ("", ("energy",), "work done on the train"),
}
"""Heat map, panels and title of the figures over time by file name."""
DISTANCE = "speed_over_distance"


def write_print_figures(data: PageData, folder: Path, kind: str) -> list[Path]:
    """Write every figure with data.

    Parameters
    ----------
    folder
        Existing folder.
    kind
        ``png`` or ``svg``.

    Returns
    -------
    list of Path
        The files written.
    """
    written = []
    with styled():
        for name in (*PRINT_FIGURES, DISTANCE):
            if name == DISTANCE:
                figure = _over_distance(data)
            else:
                picture, panels, title = PRINT_FIGURES[name]
                heat = (picture, data.maps[picture]) if picture in data.maps else None
                note = f"\n{data.evaluation}" if name == "errors" and data.evaluation else ""
                figure = over_time(data.curves, panels, data.events, data.span[1], _title(data, title) + note, heat)
            if figure is not None:
                path = folder / f"{name}.{kind}"
                save_figure(figure, path)
                written.append(path)
    return written


COMPARED: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("speed", ("speed", "measured_speed")),
    ("speed_error", ("speed_error",)),
    ("forces", ("applied",)),
    ("coupler_extremes", ("draft", "buff")),
)
"""Panels of the comparison: figure, columns."""


@styled()
def comparison_figure(pages: Sequence[PageData], title: str) -> Figure | None:
    """Return a figure of several runs: speed, speed error, applied force, coupler extremes."""
    runs = [(data, colour) for data, colour in zip(pages, run_colours(len(pages)), strict=True)]
    parts = [part for part in COMPARED if any(part[0] in data.curves for data, _ in runs)]
    if not parts:
        return None
    figure, axes = sheet(len(parts))
    for panel, (name, columns) in zip(axes, parts, strict=True):
        for index, (data, colour) in enumerate(runs):
            lines = data.curves.get(name)
            if lines is None:
                continue
            if name == "speed" and index == 0 and "profile" in lines.columns:
                look = QUANTITIES["profile"]
                panel.plot(
                    lines.time, lines.columns["profile"], color=look.colour, lw=2.0, alpha=0.65, label=look.words
                )
            label: str | None = data.label
            for column in columns:
                values = largest_magnitude(lines, column)
                if values is not None:
                    panel.plot(lines.time, values, color=colour, lw=0.8, ls=DASHES[run_dash(index)], label=label)
                    label = None
        panel.set_ylabel(AXES[PANELS[name][0]])
        panel.margins(x=0.01, y=0.08)
    add_print_legend(axes[0])
    clock_axis(axes[-1], max(data.span[1] for data, _ in runs))
    figure.suptitle(title, fontsize=8.5)
    return figure


def write_comparison_figure(pages: Sequence[PageData], path: Path, title: str) -> bool:
    """Write the figure of several runs; return False without data."""
    figure = comparison_figure(pages, title)
    if figure is not None:
        save_figure(figure, path)
    return figure is not None
