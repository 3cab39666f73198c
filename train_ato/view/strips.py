"""The last minutes as strip charts: speed, error, force and coupler forces over the same time."""

from __future__ import annotations

from typing import Any

from bokeh.models import BasicTickFormatter, ColumnDataSource, CustomJSTickFormatter, DataRange1d, Range1d
from bokeh.plotting import figure

from train_ato.view.feed import Mark
from train_ato.view.moment import STRIP
from train_ato.view.style import APPLIED, BUFF, DEMAND, DRAFT, FAINT, LIMIT, MARK, PROFILE, SOFT, TRAIN

HEIGHT = 110
LABEL_STEP, LABEL_LEVELS = 13, 4
"""Labels of what happened stand on so many levels, so many pixels apart."""
_CLOCK = """
    const h = Math.floor(tick / 3600), m = Math.floor(tick / 60) % 60;
    const s = Math.round(tick - 60 * Math.floor(tick / 60));
    const two = (n) => String(n).padStart(2, "0");
    return (h ? h + ":" + two(m) : m) + ":" + two(s);
"""


class Strips:
    """The charts, and what they are fed from.

    Attributes
    ----------
    source
        Rows of :data:`train_ato.view.moment.STRIP`.
    marks
        What happened: time, label, and how high the label stands, so that neighbours do not cover each other.
    span : Range1d
        Times in view [s]; the page moves it.
    figures
        From top to bottom.
    """

    def __init__(self, now: ColumnDataSource, several: bool, tools: dict[str, Any]) -> None:
        self.source = ColumnDataSource({name: [] for name in STRIP})
        self.marks = ColumnDataSource({"time": [], "label": [], "lift": []})
        self.span = Range1d(0.0, 180.0)
        self._now = now
        self._tools = tools
        speed = self._chart("km/h", "strip_speed")
        speed.line("time", "profile", source=self.source, line_color=PROFILE, line_width=3.2, line_alpha=0.7)
        speed.line("time", "limit", source=self.source, line_color=LIMIT, line_width=1.4, line_dash=[6, 4])
        speed.line("time", "speed", source=self.source, line_color=TRAIN, line_width=1.6)
        speed.text(
            x="time", y=0, text="label", source=self.marks, x_offset=4, y_offset="lift", text_color=MARK,
            text_font_size="11px",
        )  # fmt: skip
        error = self._chart("error km/h", "strip_error")
        error.hspan(y=0, line_color=SOFT, line_width=1)
        error.line("time", "error", source=self.source, line_color=TRAIN, line_width=1.4)
        force = self._chart("force kN", "strip_force")
        force.varea("time", "least", "most", source=self.source, fill_color=FAINT, fill_alpha=0.7)
        force.line("time", "demand", source=self.source, line_color=DEMAND, line_width=1.2)
        force.line("time", "applied", source=self.source, line_color=APPLIED, line_width=1.5)
        self.figures = [speed, error, force]
        if several:
            coupler = self._chart("couplers kN", "strip_coupler")
            coupler.varea("time", "buff", "draft", source=self.source, fill_color=SOFT, fill_alpha=0.10)
            coupler.line("time", "draft", source=self.source, line_color=DRAFT, line_width=1.3)
            coupler.line("time", "buff", source=self.source, line_color=BUFF, line_width=1.3)
            coupler.hspan(y=0, line_color=SOFT, line_width=1)
            self.figures.append(coupler)
        for plot in self.figures[:-1]:
            plot.xaxis.visible = False
        self.figures[-1].height += 16

    def show_marks(self, marks: list[Mark]) -> None:
        """Mark what happened."""
        self.marks.data = {
            "time": [mark.time for mark in marks],
            "label": [mark.label for mark in marks],
            "lift": [-2 - LABEL_STEP * (number % LABEL_LEVELS) for number in range(len(marks))],
        }

    def _chart(self, label: str, name: str) -> Any:
        plot = figure(
            height=HEIGHT,
            x_range=self.span,
            y_range=DataRange1d(only_visible=True, range_padding=0.15, min_interval=0.2),
            y_axis_label=label,
            window_axis="x",
            name=name,
            min_border_left=66,
            **self._tools,
        )
        plot.xaxis.formatter = CustomJSTickFormatter(code=_CLOCK)
        plot.yaxis.formatter = BasicTickFormatter(use_scientific=False)
        plot.yaxis.ticker.desired_num_ticks = 4
        plot.vspan(x="time", source=self.marks, line_color=MARK, line_width=1.2, line_dash=[4, 3])
        plot.vspan(x="time", source=self._now, line_color=SOFT, line_width=1)
        return plot
