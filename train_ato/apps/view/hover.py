"""Values under the pointer: one box beside the figure's line, drawn only while the pointer moves."""

from __future__ import annotations

from typing import Any

from bokeh.models import CustomJSHover, HoverTool

_CLOCK = """
const s = Math.abs(value), h = Math.floor(s / 3600), m = Math.floor(s / 60) % 60;
return (value < 0 ? "-" : "") + `${h}:${String(m).padStart(2, "0")}:${(s % 60).toFixed(1).padStart(4, "0")}`;
"""


def add_hover(plot: Any, renderer: Any, rows: list[tuple[str, str]], *, across: bool = True, clock: str = "") -> None:
    """Add the values of the nearest row of a renderer's source to a figure.

    Parameters
    ----------
    plot, renderer
        Figure, and the glyph whose source has the columns.
    rows
        Name and Bokeh format of every value.
    across
        True: the row at the abscissa of the pointer; False: the glyph under the pointer.
    clock
        Column in seconds that is shown as a time of the run.
    """
    time = [("time", f"@{clock}{{custom}}")] if clock else []
    tool = HoverTool(
        renderers=[renderer],
        tooltips=[*time, *rows],
        formatters={f"@{clock}": CustomJSHover(code=_CLOCK)} if clock else {},
        mode="vline" if across else "mouse",
        # Beside the line, not on it, and in no way under the pointer of a finger.
        attachment="horizontal",
        point_policy="follow_mouse",
        line_policy="nearest",
        muted_policy="ignore",
    )
    plot.add_tools(tool)
