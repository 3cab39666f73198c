"""Figures for print: the same lines and pictures as on the page, as PNG at 300 dpi or as SVG with text as text."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from train_ato.report.comparison_lines import farthest, run_colours, run_dash
from train_ato.report.digest import Digest
from train_ato.report.lines import Lines
from train_ato.report.plate_parts import (
    DASHES,
    DPI,
    clock_axis,
    draw_lines,
    draw_map,
    draw_track,
    event_legend,
    legend_above,
    save,
    sheet,
    styled,
)
from train_ato.report.quantities import AXES, QUANTITIES
from train_ato.types import Array

FORMATS = ("png", "svg")


def _title(figure: Figure, digest: Digest, text: str) -> None:
    named = digest.summary.get("scenario", digest.label)
    law = digest.facts.get("law")
    figure.suptitle(f"{named}{f', law {law}' if law else ''}: {text}", fontsize=8.5)


def _over_time(digest: Digest, parts: Sequence[tuple[str, str]], title: str) -> Figure | None:
    """Return a figure of some of the run's lines below each other."""
    present = [(name, axis) for name, axis in parts if name in digest.lines]
    if not present:
        return None
    figure, axes = sheet(len(present))
    for panel, (name, axis) in zip(axes, present, strict=True):
        draw_lines(panel, digest.lines[name], axis, digest.events)
        legend_above(panel)
    clock_axis(axes[-1], digest.span[1])
    event_legend(figure, digest.events)
    _title(figure, digest, title)
    return figure


def _with_map(digest: Digest, name: str, parts: Sequence[tuple[str, str]], title: str, what: str) -> Figure | None:
    """Return a heat map with lines below it."""
    present = [(line, axis) for line, axis in parts if line in digest.lines]
    if name not in digest.maps:
        return _over_time(digest, parts, title)
    figure, axes = sheet(1 + len(present), [1.5, *(1.0 for _ in present)])
    signed = name == "couplers"
    rows = "coupler behind vehicle" if signed else "vehicle"
    draw_map(figure, axes[0], digest.maps[name], what, rows, signed=signed)
    for panel, (line, axis) in zip(axes[1:], present, strict=True):
        draw_lines(panel, digest.lines[line], axis, digest.events)
        legend_above(panel)
    clock_axis(axes[-1], digest.span[1])
    event_legend(figure, digest.events)
    _title(figure, digest, title)
    return figure


def _over_distance(digest: Digest) -> Figure | None:
    lines = digest.lines.get("speed")
    if lines is None or "position_km" not in lines.columns:
        return None
    figure, axes = sheet(1 if digest.track is None else 2, None if digest.track is None else [1.3, 0.9])
    panel = axes[0]
    for index, (place, speed) in enumerate(digest.profiles):
        look = QUANTITIES["profile" if index == 0 else "replanned"]
        words = look.words if index < 2 else ""
        panel.plot(place, speed, color=look.colour, lw=0.62 * look.width, ls=DASHES[look.dash], alpha=0.65, label=words)
    if digest.limits is not None:
        look = QUANTITIES["line_limit"]
        panel.plot(*digest.limits, color=look.colour, lw=0.9, ls=DASHES[look.dash], label=look.words)
    driven: dict[str, Array] = {
        name: lines.columns[name] for name in ("speed", "measured_speed", "position_km") if name in lines.columns
    }
    draw_lines(panel, Lines(lines.time, driven), "speed", over="position_km")
    legend_above(panel)
    panel.set_xlabel(AXES["distance"])
    if digest.track is not None:
        panel.set_xlabel("")
        draw_track(axes[1], digest)
    _title(figure, digest, "speed over distance")
    return figure


PLATES: dict[str, Callable[[Digest], Figure | None]] = {
    "speed": lambda digest: _over_time(digest, [("speed", "speed")], "speed"),
    "speed_over_distance": _over_distance,
    "errors": lambda digest: _over_time(
        digest, [("speed_error", "speed_error"), ("position_error", "position_error")], "errors"
    ),
    "forces": lambda digest: _over_time(
        digest, [("forces", "force"), ("unit_forces", "applied force in kN")], "force of the power units"
    ),
    "couplers": lambda digest: _with_map(
        digest, "couplers", [("coupler_extremes", "coupler")], "coupler forces", "coupler force in kN (draft > 0)"
    ),
    "air_brake": lambda digest: _with_map(
        digest, "shoes", [("pipe", "pressure"), ("shoe_force", "shoe_force")], "air brake", "shoe force in kN"
    ),
    "disturbance": lambda digest: _over_time(digest, [("disturbance", "disturbance")], "disturbance"),
    "delay": lambda digest: _over_time(digest, [("delay", "delay")], "delay from command to effect"),
    "energy": lambda digest: _over_time(digest, [("energy", "energy")], "work done on the train"),
}
"""Figures for print by the name of their file; None where a run cannot fill one."""


def write_plates(digest: Digest, folder: Path, kind: str) -> list[Path]:
    """Write every figure that a run can fill.

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
        for name, draw in PLATES.items():
            figure = draw(digest)
            if figure is not None:
                path = folder / f"{name}.{kind}"
                save(figure, path)
                written.append(path)
    return written


COMPARED: tuple[tuple[str, tuple[str, ...], str], ...] = (
    ("speed", ("speed", "measured_speed"), "speed"),
    ("speed_error", ("speed_error",), "speed_error"),
    ("forces", ("applied",), "force"),
    ("coupler_extremes", ("draft", "buff"), "coupler"),
)
"""Panels of the comparison: figure, columns, y axis."""


def comparison_figure(digests: Sequence[Digest], title: str) -> Figure | None:
    """Return several runs over each other: speed, speed error, applied force, coupler extremes."""
    runs = [(digest, colour) for digest, colour in zip(digests, run_colours(len(digests)), strict=True)]
    parts = [part for part in COMPARED if any(part[0] in digest.lines for digest, _ in runs)]
    if not parts:
        return None
    figure, axes = sheet(len(parts))
    for panel, (name, columns, axis) in zip(axes, parts, strict=True):
        for index, (digest, colour) in enumerate(runs):
            lines = digest.lines.get(name)
            if lines is None:
                continue
            if name == "speed" and index == 0 and "profile" in lines.columns:
                look = QUANTITIES["profile"]
                panel.plot(
                    lines.time, lines.columns["profile"], color=look.colour, lw=2.0, alpha=0.65, label=look.words
                )
            label: str | None = digest.label
            for column in columns:
                values = farthest(lines, column)
                if values is not None:
                    panel.plot(lines.time, values, color=colour, lw=0.8, ls=DASHES[run_dash(index)], label=label)
                    label = None
        panel.set_ylabel(AXES[axis])
        panel.margins(x=0.01, y=0.08)
    legend_above(axes[0])
    clock_axis(axes[-1], max(digest.span[1] for digest, _ in runs))
    figure.suptitle(title, fontsize=8.5)
    return figure


def write_comparison(digests: Sequence[Digest], path: Path, title: str, dpi: int = DPI) -> bool:
    """Write the figure of several runs over each other; tell whether there was anything to draw."""
    with styled():
        figure = comparison_figure(digests, title)
        if figure is not None:
            save(figure, path, dpi)
    return figure is not None
