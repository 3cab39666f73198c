"""Widgets of a recorded run: play, pause, rate, time slider, events, figures of the summary."""

from __future__ import annotations

import html

from bokeh.models import Button, Column, CustomJS, Div, MultiSelect, Row, Select, Slider

from train_ato.apps.report.summary_rows import SUPERVISION, run_groups
from train_ato.apps.report.writing import short_clock
from train_ato.apps.view.recorded import RecordedFeed
from train_ato.apps.view.snapshot import full_clock
from train_ato.apps.view.style import WIDGETS
from train_ato.loop.result import completed_summary

WIDTH = 292
SPEEDS = {"½ ×": 0.5, "1 ×": 1.0, "2 ×": 2.0, "5 ×": 5.0, "10 ×": 10.0, "20 ×": 20.0, "50 ×": 50.0, "100 ×": 100.0}
NAMES = {"controller": "law", "observer": "observer", "compensation": "compensation", "status": "status"}
FIGURES = ("Tracking", SUPERVISION, "Forces in the train", "Energy")
"""Names and groups of figures of the summary shown beside a recorded run."""


class PlaybackControls:
    """Widgets of one browser; the time is common to all browsers."""

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
            sizing_mode="stretch_width", min_width=200, name="time", **sheets,
        )  # fmt: skip
        self._slider.on_change("value", self._dragged)
        self._end = Div(text=f"of {full_clock(end)}", styles={"color": "#8da2b5", "padding-top": "6px"}, width=90)
        self.bar = Row(
            children=[self._play, back, on, self._speed, self._slider, self._end],
            sizing_mode="stretch_width",
            name="bar",
            stylesheets=[":host { flex-wrap: wrap; }"],
        )
        self._events = MultiSelect(
            title=f"events ({len(feed.marks)}); select one to show it",
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
        # The running time must not move a slider during a drag.
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
        """Update the widgets from the feed."""
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
    entries = [(words, str(summary[key])) for key, words in NAMES.items() if summary.get(key) is not None]
    for title, figures in run_groups(summary):
        if title in FIGURES:
            entries += [(row.words, f"{texts[0]} {row.unit}") for row, texts in figures if texts[0] != "–"]
    rows = "".join(f"<tr><td>{words}</td><td>{html.escape(text)}</td></tr>" for words, text in entries)
    return f"<table style='width:100%;font-size:12px;line-height:1.6;white-space:nowrap'>{rows}</table>"
