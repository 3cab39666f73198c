"""Page of one browser: the figures, their links, and an update 20 times a second."""

from __future__ import annotations

import html
import time
from collections.abc import Sequence
from importlib.resources import files
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from bokeh import models
from bokeh.core.properties import Bool, Int
from bokeh.events import DocumentReady
from bokeh.model import DataModel
from bokeh.plotting import figure
from bokeh.themes import Theme
from jinja2 import Template

from plant_sim.units import KMH
from train_ato.judge.result import completed_summary
from train_ato.report.summary_rows import SUPERVISION, run_groups
from train_ato.report.words import driven_laws
from train_ato.report.writing import short_clock
from train_ato.view.display import Ahead, Strips, add_hover, dial, force_bar, tick_columns
from train_ato.view.facts import Facts, ProfileCurve
from train_ato.view.feed import FRAMES_PER_SECOND, MIN_REACH, MIN_SHOE, Ending, Feed, Mark
from train_ato.view.recorded import RecordedFeed
from train_ato.view.snapshot import LIMIT_NAMES, full_clock
from train_ato.view.style import BUFF, DRAFT, SHOE, SOFT, THEME, WIDGETS

if TYPE_CHECKING:
    from train_ato.view.live import LiveFeed

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
        self._play = models.Button(label="play", width=84, name="play", **sheets)
        self._play.on_click(lambda: feed.set_playing(playing=not feed.playing))
        back = models.Button(label="◀ tick", width=72, name="back", **sheets)
        back.on_click(lambda: self._step(-1))
        on = models.Button(label="tick ▶", width=72, name="on", **sheets)
        on.on_click(lambda: self._step(1))
        self._speed = models.Select(options=[*SPEEDS], value="1 ×", width=92, name="speed", **sheets)
        self._speed.on_change("value", lambda attr, old, name: setattr(feed, "speed", SPEEDS[name]))
        self._slider = models.Slider(
            start=begin, end=max(end, begin + 1e-3), value=begin, step=0.1, show_value=False, title=None,
            sizing_mode="stretch_width", min_width=200, name="time", **sheets,
        )  # fmt: skip
        self._slider.on_change("value", self._dragged)
        self._end = models.Div(
            text=f"of {full_clock(end)}", styles={"color": "#8da2b5", "padding-top": "6px"}, width=90
        )
        self.bar = models.Row(
            children=[self._play, back, on, self._speed, self._slider, self._end],
            sizing_mode="stretch_width",
            name="bar",
            stylesheets=[":host { flex-wrap: wrap; }"],
        )
        self._events = models.MultiSelect(
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
        self.column = models.Column(
            children=[models.Div(text=_summary(feed), width=WIDTH), self._events], width=WIDTH, name="panel"
        )
        # The running time must not move a slider during a drag.
        self._slider.js_on_change("value", models.CustomJS(code="window.trainAtoDragged = Date.now()"))

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
    told = summary | ({"controller": driven_laws(summary)} if summary.get("controller") else {})
    entries = [(words, str(told[key])) for key, words in NAMES.items() if told.get(key) is not None]
    for title, figures in run_groups(summary):
        if title in FIGURES:
            entries += [(row.words, f"{texts[0]} {row.unit}") for row, texts in figures if texts[0] != "–"]
    rows = "".join(
        f"<tr><td>{words}</td><td style='white-space:normal'>{html.escape(text)}</td></tr>" for words, text in entries
    )
    return f"<table style='width:100%;font-size:12px;line-height:1.6;white-space:nowrap'>{rows}</table>"


MAX_BRAKINGS = 400


def track_ahead(facts: Facts, profile: ProfileCurve | None) -> dict[str, list[Any]]:
    """Return the lists of the display; places are those of the front of the train [m].

    Returns
    -------
    dict
        ``grades``: place, grade [‰] and elevation [m, 0 at the first place]; ``limits``: place and speed [km/h];
        ``stops``: place; ``brakings``: begin and end of the planned brake applications; ``rear``: distance of the
        centre of every vehicle behind the front; ``length`` of the train.
    """
    stops, brakings = (np.zeros(0), np.zeros((0, 2))) if profile is None else (profile.stops, profile.brakings)
    rear = facts.rear + facts.nose if facts.rear.size else np.zeros(0)
    places = facts.grade_places
    elevations = np.cumsum(np.append(0.0, np.diff(places) * facts.grades[:-1] / 1e3))[: places.size]
    return {
        "grades": np.column_stack((places, facts.grades, elevations)).round(3).tolist(),
        "limits": np.column_stack((facts.limit_places, KMH * facts.limit_speeds)).round(3).tolist(),
        "stops": (stops + facts.nose).round(3).tolist(),
        "brakings": (brakings[:MAX_BRAKINGS] + facts.nose).round(1).tolist(),
        "rear": rear.round(2).tolist(),
        "length": [facts.length],
        "window": [facts.stop_window],
    }


MAX_MESSAGES = 5
"""Largest number of messages on the page: lines of the message area of ERA_ERTMS_015560, 8.2.3.4."""


def message_rows(
    marks: Sequence[Mark], time: float, acknowledged: frozenset[int], *, live: bool
) -> dict[str, list[Any]]:
    """Return the messages up to a simulated time [s], newest first; those that need an acknowledgement lead.

    Parameters
    ----------
    marks
        Events of the run by rising time.
    time
        Simulated time on the page [s].
    acknowledged
        Numbers of the acknowledged events.
    live
        False: nothing waits for an acknowledgement, since a recorded run has no driver.
    """
    past = [(number, mark) for number, mark in enumerate(marks) if mark.text and mark.time <= time + 1e-9]
    waiting = {number for number, mark in past if live and mark.acknowledge and number not in acknowledged}
    newest = sorted(past, key=lambda entry: (entry[0] in waiting, entry[0]), reverse=True)[:MAX_MESSAGES]
    return {
        "number": [number for number, _ in newest],
        "clock": [short_clock(mark.time) for _, mark in newest],
        "text": [mark.text for _, mark in newest],
        "waiting": [int(number in waiting) for number, _ in newest],
    }


class Along:
    """Coupler and shoe forces of every vehicle.

    Attributes
    ----------
    source
        One row for each vehicle: ``vehicle``, ``coupler`` (kN, of the coupler behind it) and ``shoe`` (kN).
    figures
        Coupler force and, with an air brake, shoe force; the front of the train is on the right.
    reach, shoe_reach : Range1d
        Ranges of the force axes; the page widens them for larger forces.
    """

    def __init__(self, facts: Facts, tools: dict[str, Any]) -> None:
        n = facts.layout.n_vehicles
        zeros = np.zeros((2, n), dtype=np.float32)  # an array for each column, because `patch` writes into it
        self.source = models.ColumnDataSource({"vehicle": np.arange(n), "coupler": zeros[0], "shoe": zeros[1]})
        self._count = n
        span = models.Range1d(n - 0.4, -0.6)
        self.reach = models.Range1d(-MIN_REACH, MIN_REACH)
        self.shoe_reach = models.Range1d(0.0, MIN_SHOE)
        coupler = figure(x_range=span, y_range=self.reach, y_axis_label="coupler kN", name="along", **tools)
        sign = models.LinearColorMapper(palette=[BUFF, DRAFT], low=-1e-6, high=1e-6)
        bars = coupler.vbar(
            x="vehicle", top="coupler", width=0.86, source=self.source, line_color=None,
            fill_color={"field": "coupler", "transform": sign},
        )  # fmt: skip
        add_hover(coupler, bars, [("vehicle", "@vehicle"), ("coupler behind it", "@coupler{+0} kN")])
        coupler.hspan(y=0, line_color=SOFT, line_width=1)
        coupler.yaxis.formatter = models.BasicTickFormatter(use_scientific=False)
        coupler.yaxis.ticker.desired_num_ticks = 5
        coupler.xgrid.visible = False
        self.figures = [coupler]
        if facts.layout.air_brake:
            coupler.xaxis.visible = False
            plot = figure(x_range=span, y_range=self.shoe_reach, y_axis_label="shoes kN", name="shoes", **tools)
            bars = plot.vbar(x="vehicle", top="shoe", width=0.86, source=self.source, fill_color=SHOE, line_color=None)
            add_hover(plot, bars, [("vehicle", "@vehicle"), ("brake shoes", "@shoe{0} kN")])
            plot.yaxis.ticker.desired_num_ticks = 3
            plot.xgrid.visible = False
            self.figures.append(plot)
        self.figures[-1].xaxis.ticker = models.BasicTicker(min_interval=1, num_minor_ticks=0)
        self.figures[-1].xaxis.axis_label = "vehicle (front of the train on the right)"

    def show(self, along: dict[str, Any]) -> None:
        """Show the forces of a snapshot."""
        whole = slice(0, self._count)
        self.source.patch({"coupler": [(whole, along["coupler"])], "shoe": [(whole, along["shoe"])]})


VIEWS_KM = (1, 2, 4, 8)
WINDOWS_S = (60, 180, 600)
"""Choices of the length of line in view [km] and of the time span of the strip charts [s]."""
UNDER_WAY = 2
"""Frames sent but not yet drawn; a slow or hidden browser receives fewer frames, never an old one."""
MARK_PATH = "/mark"
BEAT_MS = 500
"""Wall time between two beats [ms]; the page misses four of them before it reports the loss."""
_TOOLS: dict[str, Any] = {"tools": "", "toolbar_location": None, "sizing_mode": "stretch_both"}
WHERE = ("place", "rear", "stop", "speed", "time")
"""Columns for the figures over time and place, which are drawn less often because they move slowly."""
WHERE_S = 0.19
"""Wall time between two such drawings, and of the forces along the train: every fourth frame of the display."""
WHOLE_S = 1.0
"""Wall time between two drawings of the overview of a live run [s]."""
_EMPTY = {
    **dict.fromkeys(("speed_angle", "profile_angle", "limit_angle"), 3.927),
    **{f"{name}_angle": -0.78 - 1e-3 * place for place, name in enumerate(LIMIT_NAMES)},
    **dict.fromkeys(("applied", "demand", "most", "least", "limited"), 0.0),
    **dict.fromkeys(("gauge_angle", "above_angle"), 3.9),
    "target_angle": 3.91,
    "hooked": 0.0,
    "above_alpha": 0.0,
    "needle": "#c3c3c3",
    "gauge_colour": "#22384c",
    "above_colour": "#22384c",
    "speed_text": "–",
}
"""Row of the display before the first frame."""


class ViewPage:
    """Content of a Bokeh document, updated from a feed.

    Attributes
    ----------
    frames : int
        Frames sent to this browser.
    """

    def __init__(self, document: Any, feed: Feed) -> None:
        self._document = document
        self._feed = feed
        self.frames = 0
        self._drawn = Drawn()
        self._beat = Beat()
        self._shown = self._profile_number = self._strip_number = -1
        self._marks = -1
        self._window = (0.0, 0.0)
        self._now = models.ColumnDataSource({name: [value] for name, value in _EMPTY.items()}, name="now")
        self._where = models.ColumnDataSource({name: [0.0] for name in WHERE}, name="where")
        self._where_at = 0.0
        self._where_due = False
        self._answer = models.ColumnDataSource({"text": [""], "done": [1]}, name="answer")
        self._ending = models.ColumnDataSource(_ending_columns(feed.ending), name="ending")
        self._ended = feed.ending
        self._line = models.ColumnDataSource(_one_row(track_ahead(feed.facts, feed.profile)), name="line")
        self._messages = models.ColumnDataSource(self._message_rows(0.0), name="messages")
        self._whole = models.ColumnDataSource(_one_row(feed.whole()), name="overview")
        self._whole_shown, self._whole_at = (feed.overview.number, len(feed.marks)), 0.0
        self._acknowledgement = Acknowledgement()
        self._acknowledgement.on_change("number", lambda attr, old, new: feed.acknowledge(new))
        self._ticks = models.ColumnDataSource(tick_columns(feed.scale))
        self._scale = feed.scale
        self._several = feed.facts.layout.n_vehicles > 1
        supervised = feed.facts.layout.supervised
        hours = feed.facts.duration >= 3600.0
        self._strips = Strips(self._where, several=self._several, hours=hours, tools=_TOOLS, supervised=supervised)
        self._ahead = Ahead(self._where, self._strips.source, feed.facts, _TOOLS)
        self._along = Along(feed.facts, _TOOLS)
        self._side = self._controls()
        self._fill()
        self.update()
        document.add_periodic_callback(self.update, 500 // FRAMES_PER_SECOND)
        document.add_periodic_callback(self._send_beat, BEAT_MS)
        self._drawn.on_change("ready", lambda attr, old, new: feed.page_opened())

    def _send_beat(self) -> None:
        self._beat.number += 1

    def _controls(self) -> Any:
        """Return the widgets of the panel and the bar; only the needed module is imported."""
        if self._feed.live:
            from train_ato.view.panel import Panel

            return Panel(cast("LiveFeed", self._feed), self._say)

        return PlaybackControls(cast("RecordedFeed", self._feed))

    def _fill(self) -> None:
        """Add the figures to the document, link them and set the style."""
        document, facts = self._document, self._feed.facts
        most = float(facts.most.max()) if facts.most.size else float("nan")
        least = float(facts.least.min()) if facts.least.size else float("nan")
        view = models.RadioButtonGroup(
            labels=[f"{km} km" for km in VIEWS_KM], active=1, name="view", stylesheets=[WIDGETS], height=24
        )
        window = self._window_choice = models.RadioButtonGroup(
            labels=[f"{seconds // 60} min" for seconds in WINDOWS_S], active=1, name="window", stylesheets=[WIDGETS],
            height=24,
        )  # fmt: skip
        window.on_change("active", lambda attr, old, new: self._forget_window())
        roots = [
            dial(self._now, self._ticks, supervised=facts.layout.supervised), force_bar(self._now, most, least),
            *self._ahead.figures[: 1 if self._several else 2],
            *self._strips.figures, *(self._along.figures if self._several else ()),
            self._side.bar, self._side.column, view, window,
        ]  # fmt: skip
        with document.models.freeze():  # bokeh collects all models of a page after every change of one
            for root in roots:
                root._id = f"page-{root.name}"  # equal in every browser: the served page names them before its session
                document.add_root(root)
            self._link(view, window)
            self._dress()

    def _link(self, view: models.RadioButtonGroup, window: models.RadioButtonGroup) -> None:
        """Link sources, figures and choices in the browser."""
        document = self._document
        arguments = {
            "where": self._where, "view": view, "window_": window, "views": VIEWS_KM, "windows": WINDOWS_S,
            "place_range": self._ahead.span, "span": self._strips.span, "live": self._feed.live,
        }  # fmt: skip
        line = models.CustomJS(
            args={"line": self._line, "forces": self._along.source},
            code="const found = {}; for (const name in line.data) found[name] = line.data[name][0];"
            "window.dmi.forces = forces; window.dmi.takeLine(found)",
        )
        whole = models.CustomJS(
            args={"whole": self._whole},
            code="const found = {}; for (const name in whole.data) found[name] = whole.data[name][0];"
            "window.overview.take(found)",
        )
        messages = models.CustomJS(
            args={"messages": self._messages, "acknowledgement": self._acknowledgement},
            code="window.dmi.showMessages(messages.data, acknowledgement)",
        )
        follow = models.CustomJS(args=arguments, code=_asset("page.js"))
        show = models.CustomJS(
            args={
                "now": self._now, "reach": self._along.reach, "shoes": self._along.shoe_reach, "drawn": self._drawn,
                "answer": self._answer, "ending": self._ending, "beat": self._beat, "line": self._line,
                "messages": self._messages, "whole": self._whole,
            },
            code="window.trainAto.take(now.data, reach, shoes, drawn)",
        )  # fmt: skip
        end = models.CustomJS(args={"ending": self._ending}, code="window.trainAto.end(ending.data)")
        ready = models.CustomJS(args={"drawn": self._drawn}, code="drawn.ready = true")
        for action in (whole, follow, show, line, messages, end, ready):
            document.js_on_event(DocumentReady, action)
        self._ending.js_on_change("data", end)
        self._line.js_on_change("data", line)
        self._whole.js_on_change("data", whole)
        # The elevation profile has the places of the figure above it, which is laid out after a change of the window.
        self._ahead.figures[0].js_on_change("inner_width", models.CustomJS(code="window.dmi.draw()"))
        self._messages.js_on_change("data", messages)
        self._beat.js_on_change("number", models.CustomJS(code="window.trainAto.beat()"))
        self._now.js_on_change("data", show)
        self._where.js_on_change("data", follow)
        view.js_on_change("active", follow)
        window.js_on_change("active", follow)
        self._answer.js_on_change(
            "data", models.CustomJS(code="window.trainAto.say(cb_obj.data.text[0], cb_obj.data.done[0])")
        )

    def _dress(self) -> None:
        """Set theme, title and template of the document."""
        document, facts = self._document, self._feed.facts
        document.theme = Theme(json=THEME)
        document.title = f"train_ato: {facts.title}"
        document.template = Template(_asset("page.html"))
        document.template_variables.update(
            facts=facts,
            title=html.escape(facts.title),
            subtitle=html.escape(facts.subtitle),
            live=self._feed.live,
            mark=self._feed.mark,
            mark_path=MARK_PATH,
            style=_asset("page.css"),
            dmi=_asset("dmi.js"),
            elevation=_asset("elevation.js") if self._several else "",
            overview=_asset("overview.js"),
            several=self._several,
            air_brake=facts.layout.air_brake,
            supervised=facts.layout.supervised,
        )

    def _forget_window(self) -> None:
        self._window = (0.0, 0.0)
        self._where_due = True

    def _say(self, done: bool, text: str) -> None:
        """Show the answer of a node, from any thread."""

        def show() -> None:
            self._answer.data = {"text": [text], "done": [int(done)]}

        self._document.add_next_tick_callback(show)

    def update(self) -> None:
        """Send new data; the period is half that of the frames, so that no frame is missed."""
        feed = self._feed
        feed.advance()
        if self._profile_number != feed.profile_number:
            self._profile_number = feed.profile_number
            self._show_profile()
        if self._marks != len(feed.marks):
            self._marks = len(feed.marks)
            self._strips.show_marks(feed.marks)
        self._side.update()
        self._show_whole()
        if self._ended != feed.ending:
            self._ended = feed.ending
            self._ending.data = _ending_columns(feed.ending)
        frame = feed.frame
        if frame is None or self.frames - self._drawn.number >= UNDER_WAY:
            return
        if frame.number != self._shown:
            self._shown = frame.number
            self.frames += 1
            self._now.data = {**frame.now, "number": [self.frames]}
            self._where_due = True
        if self._where_due and time.monotonic() - self._where_at > WHERE_S:
            self._where_at = time.monotonic()
            self._where_due = False
            self._along.show(frame.along)
            self._show_strip(frame.moment.time)
            if (rows := self._message_rows(frame.moment.time)) != self._messages.data:
                self._messages.data = rows
            self._ahead.show_plan(frame.moment.plan, frame.moment.time, feed.facts)
            self._where.data = frame.where

    def _message_rows(self, time: float) -> dict[str, list[Any]]:
        return message_rows(self._feed.marks, time, self._feed.acknowledged, live=self._feed.live)

    def _show_whole(self) -> None:
        """Send the overview again if it is new, at most once a second."""
        feed = self._feed
        newest = (feed.overview.number, len(feed.marks))
        if newest != self._whole_shown and time.monotonic() - self._whole_at > WHOLE_S:
            self._whole_shown, self._whole_at = newest, time.monotonic()
            self._whole.data = _one_row(feed.whole())

    def _show_profile(self) -> None:
        feed = self._feed
        if self._scale != feed.scale:
            self._scale = feed.scale
            self._ticks.data = tick_columns(feed.scale)
        self._ahead.show_limits(feed.facts)
        self._line.data = _one_row(track_ahead(feed.facts, feed.profile))
        if feed.profile is not None:
            self._ahead.show_profile(feed.profile, feed.facts, feed.scale)

    def _show_strip(self, at: float) -> None:
        """Stream the newest rows of a live run; for a recorded run send the part around the time if it is new."""
        feed = self._feed
        if not feed.live:
            width = WINDOWS_S[self._window_choice.active]
            begin, end = self._window
            if not begin + width <= at <= end - width / 2:
                self._window = (at - 2 * width, at + 2 * width)
                self._strips.source.data = cast("RecordedFeed", feed).part(*self._window)
            return
        with feed.lock:
            rows = feed.strip.since(max(0, self._strip_number))
            first = self._strip_number < 0
            self._strip_number = feed.strip.added
        if first:
            self._strips.source.data = rows
        elif rows["time"].size:
            self._strips.source.stream(rows, rollover=feed.strip.rows)


def _one_row(lists: dict[str, list[Any]]) -> dict[str, list[Any]]:
    """Return lists of any length as the columns of one row."""
    return {name: [values] for name, values in lists.items()}


def _ending_columns(ending: Ending | None) -> dict[str, list[str]]:
    """Return the texts of the end of a run; empty before it."""
    found = Ending("") if ending is None else ending
    return {"state": [found.state], "verdict": [found.verdict], "report": [found.report]}


def _asset(name: str) -> str:
    return (files("train_ato") / "view" / name).read_text(encoding="utf-8")


class Beat(DataModel):  # type: ignore[misc]
    """Beat of the server, twice a second; without it the page reports the loss of its server."""

    number = Int(default=0)


class Acknowledgement(DataModel):  # type: ignore[misc]
    """Number of the event that the driver has acknowledged last."""

    number = Int(default=-1)


class Drawn(DataModel):  # type: ignore[misc]
    """Number of the newest frame drawn by the browser; ``ready`` after the figures are there."""

    number = Int(default=0)
    ready = Bool(default=False)
