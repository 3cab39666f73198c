"""Figures for print: the figures of the page as PNG at 300 dpi or as SVG with searchable text."""

import io
import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MultipleLocator

from plant_sim.units import number_text
from train_ato.judge.motion_difference import MotionDifference
from train_ato.judge.recording import Recording
from train_ato.judge.result import RunResult
from train_ato.judge.typed_result import TypedResult
from train_ato.log.whole_file import writing
from train_ato.messages.types import Array
from train_ato.program.display_units import display_unit
from train_ato.program.errors import refused_unwritten
from train_ato.report import page_data
from train_ato.report import quantities as q
from train_ato.report.curves import Curves, curves_of, shown_curves
from train_ato.report.events import Event, detect_events
from train_ato.report.words import MODES, driven_laws, evaluation_note
from train_ato.scenario.setup import RunSetup

WIDTH = 6.7
"""Width of a figure [inch]: a text column of 170 mm."""
DPI, SCREEN_DPI = 300, 150
"""Resolution for print and screen [dots per inch]."""
HEIGHT = 1.75
"""Height of a panel [inch]."""
STYLE: dict[str, Any] = q.TABLES["style"]
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
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: _clock(value, hours=hours)))
    axes.set_xlabel(f"time in {'h:min:s' if hours else 'min:s'}")


CLOCK_STEPS = (0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400)
"""Permitted distances of ticks on a time axis [s]; longer ones are whole days."""
MAX_TICKS, DAY = 9, 86_400
"""Largest number of distances on a time axis; a day [s]."""


def _clock(value: float, *, hours: bool) -> str:
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
    kinds = [kind for kind in q.KINDS if any(event.kind == kind for event in events)]
    if kinds:
        key = [Patch(facecolor=q.KINDS[kind].colour, alpha=0.6, label=q.KINDS[kind].words) for kind in kinds]
        columns = _columns([q.KINDS[kind].words for kind in kinds])
        figure.legend(handles=key, loc="outside lower center", ncols=columns, **LEGEND)


def over_time(
    curves: Mapping[str, Curves],
    panels: Sequence[str],
    events: Sequence[Event],
    end: float,
    title: str,
    heat: tuple[str, page_data.HeatMap] | None = None,
    *,
    summary: Mapping[str, Any] = MappingProxyType({}),
) -> Figure | None:
    """Return stacked panels over time below a heat map; None without data.

    Parameters
    ----------
    curves
        Curves by panel.
    panels
        Keys of :data:`train_ato.report.quantities.PANELS`; those without curves are left out.
    end
        Last time [s].
    heat
        Name and picture of the heat map.
    summary
        Content of ``summary.json``: the limits of its criteria are drawn.
    """
    present = [name for name in panels if name in curves]
    heights = [1.5] * (heat is not None) + [LOW.get(name, 1.0) if len(present) > 3 else 1.0 for name in present]
    if not heights:
        return None
    figure, axes = sheet(len(heights), heights)
    if heat is not None:
        draw_map(figure, axes[0], heat[1], q.HEAT[heat[0]])
    for panel, name in zip(axes[len(axes) - len(present) :], present, strict=True):
        draw_lines(panel, curves[name], q.PANELS[name][0], events)
        draw_criterion_limits(panel, name, summary)
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
        axes.fill_between(x, low, high, color=q.GREY, alpha=0.16, lw=0, label="envelope (nominal)")
    drawn = [(column, values) for column, values in lines.columns.items() if column != "position_km"]
    found = q.axis_range(axis, drawn)
    for trace in q.traces_of(lines.columns):
        look, values = trace.look, lines.columns[trace.column]
        if trace.column in q.FILLED:
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
    axes.set_ylabel(_wrapped(q.axis_title(axis)))
    axes.margins(x=0.01, y=0.08)
    margin = 0.08 * max(found.high - found.low, 1e-3)
    if found.far:
        axes.set_ylim(found.low - margin, found.high + margin)
    if found.from_zero:
        axes.set_ylim(0.0, max(found.high, 1e-3) + 2 * margin)


CRITERION_LIMITS: dict[str, tuple[tuple[str, tuple[int, ...], str], ...]] = {
    "speed_error": (("speed_error", (1, -1), "km/h"),),
    "position_error": (("position_error", (1, -1), "m"),),
    "coupler_extremes": (("coupler_draft", (1,), "kN"), ("coupler_buff", (-1,), "kN")),
}
"""Criterion, signs of its limit, and unit by panel."""
NEAR_LIMIT = 1.0
"""Distance of a limit from the lines up to which the axis reaches it, over the height of the axis."""


def draw_criterion_limits(axes: Axes, panel: str, summary: Mapping[str, Any]) -> None:
    """Draw the limits of the criteria; a limit far outside of the lines has its value in the legend only."""
    found = {row["criterion"]: row["limit"] for row in summary.get("criteria") or ()}
    for criterion, signs, own in CRITERION_LIMITS.get(panel, ()):
        if criterion not in found:
            continue
        unit, factor = display_unit(own)
        limit = factor * found[criterion]
        low, high = axes.get_ylim()
        label = f"criterion: {number_text(limit, 4)} {unit}"
        known = label in axes.get_legend_handles_labels()[1]
        for value in (sign * limit for sign in signs):
            if low - NEAR_LIMIT * (high - low) <= value <= high + NEAR_LIMIT * (high - low):
                axes.axhline(value, color=q.VERMILION, lw=0.9, ls=DASHES["dashed"], label="" if known else label)
                label = ""
        if label:
            axes.plot([], [], color=q.VERMILION, lw=0.9, ls=DASHES["dashed"], label=f"{label} (outside)")
        else:
            lines = axes.get_ylim()
            margin = 0.04 * (lines[1] - lines[0])
            ends = [sign * limit for sign in signs]
            axes.set_ylim(min(lines[0], min(ends) - margin), max(lines[1], max(ends) + margin))


def _wrapped(title: str) -> str:
    """Break a long title before its bracket."""
    return title.replace(" (", "\n(") if len(title) > 24 else title


def mark_events(axes: Axes, events: Sequence[Event]) -> None:
    """Mark events without duration by lines, others by tinted bands."""
    for event in events:
        colour = q.KINDS[event.kind].colour
        if event.end is None:
            axes.axvline(event.begin, color=colour, lw=0.6, ls=DASHES["dashed"], alpha=0.9, zorder=0.8)
        else:
            axes.axvspan(event.begin, event.end, color=colour, alpha=0.15, lw=0, zorder=0.5)


def draw_map(figure: Figure, axes: Axes, picture: page_data.HeatMap, heat: q.Heat) -> None:
    """Draw a picture of all vehicles over time, the front of the train on top."""
    count = picture.codes.shape[0]
    values = np.where(picture.codes == page_data.NO_CODE, np.nan, picture.codes * picture.unit)
    colours = ListedColormap(q.buff_to_draft(255) if heat.signed else q.none_to_full(255))
    image = axes.imshow(
        values, aspect="auto", cmap=colours, vmin=-picture.largest if heat.signed else 0.0, vmax=picture.largest,
        extent=(picture.begin, picture.end, count - 0.5, -0.5), interpolation="nearest",
    )  # fmt: skip
    axes.grid(visible=False)
    axes.set_ylabel(heat.rows)
    bar = figure.colorbar(image, ax=axes, pad=0.01, aspect=22)
    bar.set_label(q.axis_title(f"{heat.words} in kN{' (draft > 0)' if heat.signed else ''}"))
    bar.outline.set_linewidth(0.5)


def draw_track(axes: Axes, data: page_data.PageData) -> None:
    """Draw grade and curves over distance, and the height on a second axis."""
    shape = data.track
    assert shape is not None
    axes.fill_between(shape.place, 0.0, shape.grade, step="post", color=q.GREY, alpha=0.5, lw=0, label="grade")
    low = min(0.0, float(shape.grade.min()))
    band = 0.07 * max(float(np.ptp(np.append(shape.grade, 0.0))), 1.0)
    for index, (begin, end, _) in enumerate(shape.curves):
        axes.fill_between(
            [begin, end], low - 2 * band, low - band, color=q.PURPLE, lw=0, label="" if index else "curve"
        )
    axes.set_ylabel(_wrapped(q.axis_title("grade")))
    axes.set_xlabel(q.axis_title("distance"))
    side = axes.twinx()
    look = q.QUANTITIES["height"]
    (line,) = side.plot(shape.place, shape.height, color=look.colour, lw=1.0, label=f"{look.words} (right)")
    side.grid(visible=False)
    side.set_ylabel(q.axis_title("height in m"))
    add_print_legend(axes, [line])


def draw_stations(axes: Axes, stations: Sequence[tuple[float, str]]) -> None:
    """Mark the stations by lines with their names at the lower end."""
    low, high = axes.get_xlim()
    for place, name in stations:
        last = place > high - 0.05 * (high - low)
        axes.axvline(place, color=q.INK, lw=0.6, ls=DASHES["dotted"], zorder=0.8)
        axes.annotate(
            name, (place, 0.02), xycoords=("data", "axes fraction"), xytext=(-2 if last else 2, 0),
            textcoords="offset points", rotation=90, ha="right" if last else "left", va="bottom", fontsize="x-small",
        )  # fmt: skip


UNDATED: dict[str, dict[str, Any]] = {
    ".png": {"Software": None},
    ".svg": {"Date": None, "Creator": None},
    ".pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}
"""Entries with the date or the version of matplotlib that a figure leaves out, by ending; other formats keep theirs."""


@styled()
def save_figure(figure: Figure, path: Path, dpi: int = DPI) -> None:
    """Write a figure in the common style, without date; equal figures result in equal files."""
    ending = path.suffix.lower()
    with writing(path):
        if ending == ".png":  # savefig draws twice: the first picture shows its borders only
            former, figure.dpi = figure.dpi, dpi
            FigureCanvasAgg(figure).print_png(path, metadata=UNDATED[ending])
            figure.dpi = former
        else:
            figure.savefig(path, dpi=dpi, metadata=UNDATED.get(ending))


def shown_figure(figure: Figure, out: str | Path | None) -> Figure:
    """Return a figure for a notebook, after it was written for the screen to ``out``, if that is given."""
    if out is not None:
        save_figure(figure, Path(out), SCREEN_DPI)
    return figure


def write_figure(figure: Figure, path: Path) -> None:
    """Write a figure in its own style and resolution, in the format of the suffix of its path."""
    with refused_unwritten(path, left=path):
        figure.savefig(path)


def _title(data: page_data.PageData, text: str) -> str:
    named = data.summary.get("scenario", data.label)
    law = data.facts.get("law")
    return f"{named}{f', law {law}' if law else ''}: {text}"


def _over_distance(data: page_data.PageData) -> Figure | None:
    lines = data.curves.get("speed")
    if lines is None or "position_km" not in lines.columns:
        return None
    figure, axes = sheet(1 if data.track is None else 2, None if data.track is None else [1.3, 0.9])
    panel = axes[0]
    for index, (place, speed) in enumerate(data.profiles):
        look = q.QUANTITIES["profile" if index == 0 else "replanned"]
        words = look.words if index < 2 else ""
        panel.plot(place, speed, color=look.colour, lw=0.62 * look.width, ls=DASHES[look.dash], alpha=0.65, label=words)
    if data.limits is not None:
        look = q.QUANTITIES["line_limit"]
        panel.plot(*data.limits, color=look.colour, lw=0.9, ls=DASHES[look.dash], label=look.words)
    driven: dict[str, Array] = {
        name: lines.columns[name] for name in ("speed", "measured_speed", "position_km") if name in lines.columns
    }
    draw_lines(panel, Curves(lines.time, driven), "speed", over="position_km")
    draw_stations(panel, data.stations)
    add_print_legend(panel)
    panel.set_xlabel(q.axis_title("distance"))
    if data.track is not None:
        panel.set_xlabel("")
        draw_track(axes[1], data)
    figure.suptitle(_title(data, "speed over distance"), fontsize=8.5)
    return figure


PRINT_FIGURES: dict[str, tuple[str, list[str], str]] = q.TABLES["print"]
"""Heat map, panels and title of the figures over time by file name."""
DISTANCE = "speed_over_distance"


def write_print_figures(data: page_data.PageData, folder: Path, kind: str) -> list[Path]:
    """Write every figure with data.

    Parameters
    ----------
    folder
        Existing folder.
    kind
        ``png`` or ``svg``.
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
                headline = _title(data, title) + note
                figure = over_time(
                    data.curves, panels, data.events, data.span[1], headline, heat, summary=data.summary
                )  # fmt: skip
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
def comparison_figure(pages: Sequence[page_data.PageData], title: str) -> Figure | None:
    """Return a figure of several runs: speed, difference from the first, speed error, force, coupler extremes."""
    runs = [(data, colour) for data, colour in zip(pages, page_data.run_colours(len(pages)), strict=True)]
    parts = [part for part in COMPARED if any(part[0] in data.curves for data, _ in runs)]
    if not parts:
        return None
    differences = page_data.motion_differences(pages)
    figure, axes = sheet(len(parts) + bool(differences))
    if differences:
        _draw_differences(axes.pop(1), differences, runs)
    for panel, (name, columns) in zip(axes, parts, strict=True):
        for index, (data, colour) in enumerate(runs):
            lines = data.curves.get(name)
            if lines is None:
                continue
            if name == "speed" and index == 0 and "profile" in lines.columns:
                look = q.QUANTITIES["profile"]
                panel.plot(
                    lines.time, lines.columns["profile"], color=look.colour, lw=2.0, alpha=0.65, label=look.words
                )
            label: str | None = data.label
            for column in columns:
                values = page_data.largest_magnitude(lines, column)
                if values is not None:
                    panel.plot(
                        lines.time, values, color=colour, lw=0.8, ls=DASHES[page_data.run_dash(index)], label=label
                    )
                    label = None
        panel.set_ylabel(q.axis_title(q.PANELS[name][0]))
        panel.margins(x=0.01, y=0.08)
    add_print_legend(axes[0])
    clock_axis(axes[-1], max(data.span[1] for data, _ in runs))
    figure.suptitle(title, fontsize=8.5)
    return figure


def _draw_differences(
    panel: Axes, differences: Mapping[str, MotionDifference], runs: Sequence[tuple[page_data.PageData, str]]
) -> None:
    """Draw the speed of every later run minus that of the first one."""
    for index, (data, colour) in enumerate(runs):
        if data.label in differences:
            found = differences[data.label]
            lines = page_data.downsampled(
                shown_curves(Curves(found.time, {"speed": found.over_time["speed_kmh"]})), POINTS
            )
            panel.plot(lines.time, lines.columns["speed"], color=colour, lw=0.8, ls=DASHES[page_data.run_dash(index)])
    panel.axhline(0.0, color=runs[0][1], lw=0.8)
    panel.set_ylabel(q.axis_title("speed_difference"))
    panel.margins(x=0.01, y=0.08)


def write_comparison_figure(pages: Sequence[page_data.PageData], path: Path, title: str) -> bool:
    """Write the figure of several runs; return False without data."""
    figure = comparison_figure(pages, title)
    if figure is not None:
        save_figure(figure, path)
    return figure is not None


LONG_RUN_S = 600.0
"""Minimum duration for a time axis in minutes [s]."""
RUN_PANELS = ("speed", "speed_error", "forces", "coupler_extremes", "pipe", "shoe_force")
"""Panels of the figure; panels without data are omitted."""
POINTS = 400_000
"""Numbers in one panel, with the times; a long run has more, which the figure cannot show."""
TITLE_WIDTH = 95
"""Letters in a line of the title."""
MARKED = ("law", "protection", "outside", "scored", "end")
"""Kinds of event marked in the figure."""


def write_run_figure(setup: RunSetup, result: RunResult, folder: Path) -> None:
    """Draw ``figure.png`` into a run folder, if the run has a complete tick."""
    if result.recording is not None:
        figure = run_figure(replace(result.recording, setup=setup, summary=result.summary))
        if figure is not None:
            save_figure(figure, folder / "figure.png", SCREEN_DPI)


@styled()
def run_figure(recording: Recording) -> Figure | None:
    """Return the figure of one run with setup and summary; None without data."""
    recording = recording.within_span()
    curves, _ = curves_of(recording, RUN_PANELS, lambda lines: page_data.downsampled(lines, POINTS))
    events = [event for event in detect_events(recording) if event.kind in MARKED]
    note = evaluation_note(recording.setup.scenario.evaluation) if recording.setup is not None else ""
    lines = [*titles(recording.summary), *([note] if note else [])]
    lines += textwrap.wrap(TypedResult.of(recording.summary).title, TITLE_WIDTH)
    return over_time(curves, RUN_PANELS, events, recording.span[1], "\n".join(lines), summary=recording.summary)


def titles(summary: dict[str, Any]) -> list[str]:
    """Return the lines of the title: scenario and law; mode and early end of the run."""
    head = (
        f"{summary['scenario']}: {driven_laws(summary)}, observer {summary['observer']}, "
        f"compensation {summary['compensation']}, seed {summary['seed']}"
    )
    mode = MODES.get(str(summary.get("mode")), "")
    end = summary["status"].upper() if summary.get("status") in ("interrupted", "failed", "killed") else ""
    more = ", ".join(part for part in (f"mode: {mode}" if mode else "", end) if part)
    return [head, more] if more else [head]
