"""Parts of figures for print: sheets, lines with events, heat maps, grades, legends."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MultipleLocator

from train_ato.apps.report.axis_range import axis_range
from train_ato.apps.report.curves import Curves
from train_ato.apps.report.downsample import NO_CODE, HeatMap
from train_ato.apps.report.event import Event
from train_ato.apps.report.page_data import PageData
from train_ato.apps.report.quantities import (
    AXES,
    FAINT,
    FILLED,
    GREY,
    HEAT,
    INK,
    KINDS,
    PANELS,
    PURPLE,
    QUANTITIES,
    Heat,
    buff_to_draft,
    none_to_full,
    traces_of,
)
from train_ato.log.whole_file import writing

WIDTH = 6.7
"""Width of a figure [inch]: a text column of 170 mm."""
DPI, SCREEN_DPI = 300, 150
"""Resolution for print and screen [dots per inch]."""
HEIGHT = 1.75
"""Height of a panel [inch]."""
STYLE: dict[str, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 8.0,
    "axes.labelsize": 8.0,
    "axes.titlesize": 8.5,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "legend.fontsize": 7.5,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "axes.grid": True,
    "grid.color": FAINT,
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "svg.fonttype": "none",
    "svg.hashsalt": "train_ato",
    "axes.unicode_minus": True,
}
"""One style for every figure."""
LOW = {"pipe": 0.6, "shoe_force": 0.6}
"""Panels that are lower than the others where there are many."""
DASHES = {"solid": "-", "dashed": (0, (5, 2)), "dotted": (0, (1.2, 1.4))}


SHEET_SIZE = 10.0
"""Size of text on a sheet of 11 inches, read on a screen [pt]."""


@contextmanager
def styled(size: float = 8.0) -> Iterator[None]:
    """Apply the common style; ``size`` is that of the text [pt]."""
    scale = size / STYLE["font.size"]
    sizes = {key: scale * value for key, value in STYLE.items() if key.endswith("size")}
    with mpl.rc_context({**STYLE, **sizes}):
        yield


class NotebookFigure(Figure):
    """Figure in the common style with a display in notebooks."""

    def _repr_png_(self) -> bytes:
        picture = io.BytesIO()
        with styled():
            self.savefig(picture, format="png", dpi=SCREEN_DPI)
        return picture.getvalue()


def sheet(panels: int, heights: Sequence[float] | None = None) -> tuple[Figure, list[Axes]]:
    """Return an empty figure with stacked panels; heights in units of :data:`HEIGHT`."""
    ratios = list(heights) if heights is not None else [1.0] * panels
    ratios = [1.35] if ratios == [1.0] else ratios
    figure = NotebookFigure(figsize=(WIDTH, HEIGHT * sum(ratios) + 0.75), layout="constrained")
    axes = figure.subplots(panels, 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": ratios})[:, 0]
    return figure, list(axes)


def clock_axis(axes: Axes, end: float) -> None:
    """Set ticks and clock labels of a time axis [s]."""
    hours = end >= 3600.0
    low, high = axes.get_xlim()
    days = DAY * math.ceil((high - low) / MAX_TICKS / DAY)
    step = next((step for step in CLOCK_STEPS if (high - low) / step <= MAX_TICKS), days)
    axes.xaxis.set_major_locator(MultipleLocator(step))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: _clock(value, hours)))
    axes.set_xlabel(f"time in {'h:min:s' if hours else 'min:s'}")


CLOCK_STEPS = (0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400)
"""Permitted distances of ticks on a time axis [s]; longer ones are whole days."""
MAX_TICKS, DAY = 9, 86_400
"""Largest number of distances on a time axis; a day [s]."""


def _clock(value: float, hours: bool) -> str:
    minutes, seconds = divmod(abs(value), 60)
    sign = "−" if value < 0 else ""
    tail = f"{seconds:04.1f}" if round(seconds, 3) % 1 else f"{seconds:02.0f}"
    return f"{sign}{int(minutes) // 60}:{int(minutes) % 60:02d}:{tail}" if hours else f"{sign}{int(minutes)}:{tail}"


def add_print_legend(axes: Axes, extra: Sequence[Any] = ()) -> None:
    """Add the legend above the frame."""
    handles, labels = axes.get_legend_handles_labels()
    handles, labels = [*handles, *extra], [*labels, *(entry.get_label() for entry in extra)]
    if handles:
        axes.legend(
            handles, labels, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=_columns(labels), **LEGEND
        )  # fmt: skip


LEGEND: dict[str, Any] = {
    "frameon": False, "borderaxespad": 0.1, "handlelength": 1.8, "columnspacing": 1.2, "handletextpad": 0.5,
}  # fmt: skip


def _columns(labels: Sequence[str]) -> int:
    """Return the number of legend columns for the width, from the mean width of a letter [inch]."""
    widths = [0.40 + 0.062 * len(label) for label in labels]
    for columns in range(len(labels), 1, -1):
        # matplotlib gives the first columns one row more
        if sum(float(column.max()) for column in np.array_split(np.array(widths), columns)) < WIDTH - 0.8:
            return columns
    return 1


def event_legend(figure: Figure, events: Sequence[Event]) -> None:
    """Add a legend of the event marks below the figure."""
    kinds = [kind for kind in KINDS if any(event.kind == kind for event in events)]
    if kinds:
        key = [Patch(facecolor=KINDS[kind].colour, alpha=0.6, label=KINDS[kind].words) for kind in kinds]
        columns = _columns([KINDS[kind].words for kind in kinds])
        figure.legend(handles=key, loc="outside lower center", ncols=columns, **LEGEND)


def over_time(
    curves: Mapping[str, Curves],
    panels: Sequence[str],
    events: Sequence[Event],
    end: float,
    title: str,
    heat: tuple[str, HeatMap] | None = None,
) -> Figure | None:
    """Return stacked panels over time below a heat map; None without data.

    Parameters
    ----------
    curves
        Curves by panel.
    panels
        Keys of :data:`train_ato.apps.report.quantities.PANELS`; those without curves are left out.
    end
        Last time [s].
    heat
        Name and picture of the heat map.
    """
    present = [name for name in panels if name in curves]
    heights = [1.5] * (heat is not None) + [LOW.get(name, 1.0) if len(present) > 3 else 1.0 for name in present]
    if not heights:
        return None
    figure, axes = sheet(len(heights), heights)
    if heat is not None:
        draw_map(figure, axes[0], heat[1], HEAT[heat[0]])
    for panel, name in zip(axes[len(axes) - len(present) :], present, strict=True):
        draw_lines(panel, curves[name], PANELS[name][0], events)
        add_print_legend(panel)
    clock_axis(axes[-1], end)
    event_legend(figure, events)
    _make_room(figure)
    figure.suptitle(title, fontsize=8.5)
    return figure


def _make_room(figure: Figure) -> None:
    """Increase the height of a figure by the legend rows beyond the usual number."""
    legends = [(axes.get_legend(), 2) for axes in figure.axes] + [(legend, 3) for legend in figure.legends]
    rows = 0
    for legend, usual in legends:
        if legend is not None:
            labels = [text.get_text() for text in legend.get_texts()]
            rows += max(0, -(-len(labels) // _columns(labels)) - usual)
    figure.set_figheight(figure.get_figheight() + LEGEND_ROW * rows)


LEGEND_ROW = 0.16
"""Height of a row of a legend [inch]."""


def draw_lines(axes: Axes, lines: Curves, axis: str, events: Sequence[Event] = (), *, over: str = "time") -> None:
    """Draw the lines of one figure with labels and colours, and the events behind them."""
    x = lines.time if over == "time" else lines.columns[over]
    if over == "time":
        mark_events(axes, events)
    if "envelope_high" in lines.columns:
        low, high = lines.columns["envelope_low"], lines.columns["envelope_high"]
        axes.fill_between(x, low, high, color=GREY, alpha=0.16, lw=0, label="envelope (nominal)")
    drawn = [(column, values) for column, values in lines.columns.items() if column != "position_km"]
    found = axis_range(axis, drawn)
    for trace in traces_of(lines.columns):
        look, values = trace.look, lines.columns[trace.column]
        if trace.column in FILLED:
            axes.fill_between(x, 0.0, values, color=look.colour, alpha=0.2, lw=0)
        dash, alpha = DASHES[look.dash], 0.65 if look.width > 2.5 else 1.0
        axes.plot(
            x,
            values,
            color=look.colour,
            lw=0.62 * look.width,
            ls=dash,
            alpha=alpha,
            label=look.words + found.remark(trace.column),
        )
    axes.set_ylabel(_wrapped(AXES.get(axis, axis)))
    axes.margins(x=0.01, y=0.08)
    margin = 0.08 * max(found.high - found.low, 1e-3)
    if found.far:
        axes.set_ylim(found.low - margin, found.high + margin)
    if found.from_zero:
        axes.set_ylim(0.0, max(found.high, 1e-3) + 2 * margin)


def _wrapped(title: str) -> str:
    """Break a long title before its bracket."""
    return title.replace(" (", "\n(") if len(title) > 24 else title


def mark_events(axes: Axes, events: Sequence[Event]) -> None:
    """Mark events without duration by lines, others by tinted bands."""
    for event in events:
        colour = KINDS[event.kind].colour
        if event.end is None:
            axes.axvline(event.begin, color=colour, lw=0.6, ls=DASHES["dashed"], alpha=0.9, zorder=0.8)
        else:
            axes.axvspan(event.begin, event.end, color=colour, alpha=0.15, lw=0, zorder=0.5)


def draw_map(figure: Figure, axes: Axes, picture: HeatMap, heat: Heat) -> None:
    """Draw a picture of all vehicles over time, the front of the train on top."""
    count = picture.codes.shape[0]
    values = np.where(picture.codes == NO_CODE, np.nan, picture.codes * picture.unit)
    colours = ListedColormap(buff_to_draft(255) if heat.signed else none_to_full(255))
    image = axes.imshow(
        values, aspect="auto", cmap=colours, vmin=-picture.largest if heat.signed else 0.0, vmax=picture.largest,
        extent=(picture.begin, picture.end, count - 0.5, -0.5), interpolation="nearest",
    )  # fmt: skip
    axes.grid(visible=False)
    axes.set_ylabel(heat.rows)
    bar = figure.colorbar(image, ax=axes, pad=0.01, aspect=22)
    bar.set_label(f"{heat.words} in kN{' (draft > 0)' if heat.signed else ''}")
    bar.outline.set_linewidth(0.5)


def draw_track(axes: Axes, data: PageData) -> None:
    """Draw grade and curves over distance, and the height on a second axis."""
    shape = data.track
    assert shape is not None
    axes.fill_between(shape.place, 0.0, shape.grade, step="post", color=GREY, alpha=0.5, lw=0, label="grade")
    low = min(0.0, float(shape.grade.min()))
    band = 0.07 * max(float(np.ptp(np.append(shape.grade, 0.0))), 1.0)
    for index, (begin, end, _) in enumerate(shape.curves):
        axes.fill_between([begin, end], low - 2 * band, low - band, color=PURPLE, lw=0, label="" if index else "curve")
    axes.set_ylabel(_wrapped(AXES["grade"]))
    axes.set_xlabel(AXES["distance"])
    side = axes.twinx()
    look = QUANTITIES["height"]
    (line,) = side.plot(shape.place, shape.height, color=look.colour, lw=1.0, label=f"{look.words} (right)")
    side.grid(visible=False)
    side.set_ylabel("height in m")
    add_print_legend(axes, [line])


@styled()
def save_figure(figure: Figure, path: Path, dpi: int = DPI) -> None:
    """Write a figure in the common style, without date; equal figures result in equal files."""
    with writing(path):
        figure.savefig(path, dpi=dpi, metadata={"Date": None} if path.suffix == ".svg" else {"Software": None})


def write_figure(figure: Figure, path: Path) -> None:
    """Write a figure in its own style and resolution, in the format of the suffix of its path.

    Raises
    ------
    ValueError
        If the file cannot be written.
    """
    try:
        figure.savefig(path)
    except OSError as error:
        with suppress(OSError):
            path.unlink()
        raise ValueError(f"{path}: cannot be written ({error.strerror}); choose another place") from None
