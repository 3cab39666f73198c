"""Values at the cursor in a line above a figure, so that no tooltip hides the curve."""

from __future__ import annotations

from collections.abc import Sequence

from bokeh.events import MouseLeave, MouseMove, Tap
from bokeh.models import ColumnDataSource, CustomJS

from train_ato.apps.report.quantities import Trace
from train_ato.apps.report.style import Figure

Table = tuple[ColumnDataSource, Sequence[Trace]]
_SHOW = "window.trainAto?.readout(name, tables, cb_obj.x, over)"
_HIDE = "window.trainAto?.readout(name, [], null, over)"


def add_readout(plot: Figure, tables: Sequence[Table], over: str = "time") -> None:
    """Show the values of all lines at the cursor above the figure.

    Parameters
    ----------
    plot
        The figure; the element ``readout-ID`` of the page belongs to it.
    tables
        Tables and the lines of each.
    over
        Column of the horizontal axis: ``time`` [s] or ``position_km``.
    """
    listed = [
        [source, [[t.column, t.look.words, t.look.unit, t.look.digits, t.look.colour] for t in traces]]
        for source, traces in tables
        if traces
    ]
    arguments = {"name": plot.id, "tables": listed, "over": over}
    show = CustomJS(args=arguments, code=_SHOW)
    plot.js_on_event(MouseMove, show)
    plot.js_on_event(Tap, show)
    plot.js_on_event(MouseLeave, CustomJS(args={"name": plot.id, "over": over}, code=_HIDE))
