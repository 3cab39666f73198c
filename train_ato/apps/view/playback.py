"""Playing a recorded run back: play and pause, pace, a slider over the whole run, what happened in it."""

from __future__ import annotations

import html

from bokeh.models import Button, Column, CustomJS, Div, MultiSelect, Row, Select, Slider

from train_ato.report.log_summary import completed_summary
from train_ato.report.summary_rows import filled_groups
from train_ato.report.writing import clock as short_clock
from train_ato.view.moment import clock
from train_ato.view.recorded import RecordedFeed
from train_ato.view.style import WIDGETS

WIDTH = 292
SPEEDS = {"½ ×": 0.5, "1 ×": 1.0, "2 ×": 2.0, "5 ×": 5.0, "10 ×": 10.0, "20 ×": 20.0, "50 ×": 50.0, "100 ×": 100.0}
NAMES = {"controller": "law", "observer": "observer", "compensation": "compensation", "status": "ended"}
FIGURES = ("Tracking", "Forces in the train", "Energy")
"""Names and groups of figures of the summary that stand beside a recorded run."""


class Playback:
    """Widgets of one browser; time is the same in all of them."""

    def __init__(self, feed: RecordedFeed) -> None:
        self._feed = feed
        self._following = False
        sheets = {"stylesheets": [WIDGETS]}
        begin, end = feed.span
        self._play = Button(label="play", width=84, name="play", **sheets)
        self._play.on_click(self._toggle)
        back = Button(label="◀ tick", width=72, name="back", **sheets)
        back.on_click(lambda: self._step(-1))
        on = Button(label="tick ▶", width=72, name="on", **sheets)
        on.on_click(lambda: self._step(1))
        self._speed = Select(options=[*SPEEDS], value="1 ×", width=92, name="speed", **sheets)
        self._speed.on_change("value", lambda attr, old, name: setattr(feed, "speed", SPEEDS[name]))
        self._slider = Slider(
            start=begin, end=max(end, begin + 1e-3), value=begin, step=0.1, show_value=False, title=None,
            sizing_mode="stretch_width", name="time", **sheets,
        )  # fmt: skip
        self._slider.on_change("value", self._dragged)
        self._end = Div(text=f"of {clock(end)}", styles={"color": "#8da2b5", "padding-top": "6px"}, width=90)
        self.bar = Row(
            children=[self._play, back, on, self._speed, self._slider, self._end],
            sizing_mode="stretch_width",
            name="bar",
        )
        self._events = MultiSelect(
            title=f"what happened ({len(feed.marks)}); choose one to go there",
            visible=bool(feed.marks),
            options=[(str(number), f"{short_clock(mark.time)}  {mark.text}") for number, mark in enumerate(feed.marks)],
            value=[],
            size=min(18, max(3, len(feed.marks))),
            width=WIDTH,
            name="events",
            **sheets,
        )
        self._events.on_change("value", self._chosen)
        self.column = Column(children=[Div(text=_summary(feed), width=WIDTH), self._events], width=WIDTH, name="panel")
        # A slider that is dragged must not be pulled back by the time that goes on meanwhile.
        self._slider.js_on_change("value", CustomJS(code="window.trainAtoDragged = Date.now()"))

    def _toggle(self) -> None:
        self._feed.set_playing(not self._feed.playing)

    def _step(self, ticks: int) -> None:
        self._feed.playing = False
        self._feed.step(ticks)

    def _dragged(self, attr: str, old: float, value: float) -> None:
        if not self._following:
            self._feed.seek(value)

    def _chosen(self, attr: str, old: list[str], chosen: list[str]) -> None:
        if chosen:
            self._feed.seek(self._feed.marks[int(chosen[0])].time)

    def update(self) -> None:
        """Follow the feed."""
        label = "pause" if self._feed.playing else "play"
        if self._play.label != label:
            self._play.label = label
        if abs(self._slider.value - self._feed.time) >= 0.25 * max(1.0, self._feed.speed):
            self._following = True
            try:
                self._slider.value = self._feed.time
            finally:
                self._following = False


def _summary(feed: RecordedFeed) -> str:
    """Return the figures of the run as a table."""
    summary = completed_summary(feed.recording)
    told = [(words, str(summary[key])) for key, words in NAMES.items() if summary.get(key) is not None]
    for title, figures in filled_groups([summary]):
        if title in FIGURES:
            told += [(row.words, f"{texts[0]} {row.unit}") for row, texts in figures if texts[0] != "–"]
    rows = "".join(f"<tr><td>{words}</td><td>{html.escape(text)}</td></tr>" for words, text in told)
    return f"<table style='width:100%;font-size:12px;line-height:1.6;white-space:nowrap'>{rows}</table>"
