"""Bokeh figures of events over time: one row per kind for one run, one row per run for several."""

from __future__ import annotations

from collections.abc import Sequence

from bokeh.models import ColumnDataSource, CustomJS, FixedTicker, HoverTool, LegendItem, Range1d

from train_ato.apps.report.event import Event
from train_ato.apps.report.quantities import KINDS
from train_ato.apps.report.style import Figure, Linked, add_page_legend


def event_figure(linked: Linked, events: Sequence[Event]) -> Figure:
    """Return the events over time, one row per kind; hiding a kind hides its marks in all figures."""
    kinds = [kind for kind in KINDS if any(event.kind == kind for event in events)]
    y_range = Range1d(len(kinds) - 0.4, -0.6)
    plot = linked.over_time("", 76 + 22 * len(kinds), marked=False, y_range=y_range)
    plot.yaxis.ticker = FixedTicker(ticks=[])
    plot.ygrid.visible = False
    items = []
    for row, kind in enumerate(kinds):
        moments, stretches = linked.marks[kind]
        colour = KINDS[kind].colour
        dots = plot.scatter(
            x="begin", y=row, source=moments, marker="inverted_triangle", size=11, color=colour, line_color=None
        )
        bars = plot.hbar(y=row, left="begin", right="end", height=0.5, source=stretches, color=colour, line_width=2)
        dots.js_on_change("visible", CustomJS(args={"marks": linked.marked[kind]}, code=_HIDE))
        shown = [dots, bars] if moments.data["begin"] else [bars, dots]
        items.append(LegendItem(label=KINDS[kind].words, renderers=shown))
        for renderer, tips in ((dots, [("at", "@begin{custom}")]), (bars, _FROM_TO)):
            plot.add_tools(
                HoverTool(
                    renderers=[renderer],
                    tooltips=[("", "@text"), *tips],
                    formatters={"@begin": linked.clock(), "@end": linked.clock()},
                )
            )
    add_page_legend(plot, items)
    return plot


def run_events_figure(linked: Linked, runs: Sequence[tuple[str, Sequence[Event]]]) -> Figure:
    """Return the events of several runs, one row per run, one colour per kind."""
    y_range = Range1d(len(runs) - 0.4, -0.6)
    plot = linked.over_time("", 76 + 24 * len(runs), y_range=y_range)
    plot.yaxis.ticker = FixedTicker(ticks=list(range(len(runs))))
    plot.yaxis.major_label_overrides = {row: _short(name) for row, (name, _) in enumerate(runs)}
    plot.ygrid.visible = False
    items = []
    for kind, words in KINDS.items():
        rows = [(row, event) for row, (_, events) in enumerate(runs) for event in events if event.kind == kind]
        if not rows:
            continue
        source = ColumnDataSource(
            {
                "row": [row for row, _ in rows],
                "begin": [event.begin for _, event in rows],
                "end": [event.begin if event.end is None else event.end for _, event in rows],
                "text": [event.text for _, event in rows],
                "run": [runs[row][0] for row, _ in rows],
            }
        )
        bars = plot.hbar(
            y="row", left="begin", right="end", height=0.5, source=source, fill_color=words.colour,
            line_color=words.colour, line_width=3,
        )  # fmt: skip
        items.append(LegendItem(label=words.words, renderers=[bars]))
        tips = [("", "@text"), ("run", "@run"), *_FROM_TO]
        clocks = {"@begin": linked.clock(), "@end": linked.clock()}
        plot.add_tools(HoverTool(renderers=[bars], tooltips=tips, formatters=clocks))
    add_page_legend(plot, items)
    return plot


def _short(name: str) -> str:
    """Return a name shortened to the space beside the axis."""
    return name if len(name) <= 11 else f"{name[:10]}…"


_HIDE = "for (const mark of marks) mark.visible = cb_obj.visible"
_FROM_TO = [("from", "@begin{custom}"), ("to", "@end{custom}")]
