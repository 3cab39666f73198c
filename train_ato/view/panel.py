"""Widgets of a running train: ATO, law, parameters, disturbances, emergency brake, rate, end of the run."""

from collections.abc import Callable
from functools import partial
from typing import Any

from bokeh.models import Button, Checkbox, Column, CustomJSTickFormatter, Div, Row, Select, Slider, Spinner, Widget

from train_ato.loop.train_protection import REQUESTED
from train_ato.scenario.interventions import REQUESTS
from train_ato.view.controls import Tunable, slider_scale
from train_ato.view.live import LiveFeed
from train_ato.view.style import SOFT, WIDGETS

WIDTH = 292
RATES = {
    "½ ×": 0.5, "1 ×": 1.0, "2 ×": 2.0, "5 ×": 5.0, "10 ×": 10.0, "20 ×": 20.0, "50 ×": 50.0,
    "as fast as possible": 0.0,
}  # fmt: skip
"""Rate of the simulation by name; 0 is as fast as possible."""
SHORT = "return String(Number(tick.toPrecision(6)))"
"""Number format with up to six digits and no trailing zeros."""


class Panel:
    """Widgets of one browser; they follow changes by other browsers and nodes.

    Parameters
    ----------
    feed
        The running graph.
    say
        Callback for success and message of a node.
    """

    def __init__(self, feed: LiveFeed, say: Callable[[bool, str], None]) -> None:
        self._feed = feed
        self._say = say
        self._number = -1
        self._widgets: dict[str, list[Any]] = {}
        self._shown_law = ""
        self._following = False
        sheets = {"stylesheets": [WIDGETS]}
        self._law = Select(title="control law", options=[], width=WIDTH, **sheets)
        self._law.on_change("value", lambda attr, old, law: self._set("controller", "law", law))
        self._parameters = Column(children=[], width=WIDTH, name="parameters")
        self._brake = Button(label="EMERGENCY BRAKE", button_type="danger", width=WIDTH, height=44, **sheets)
        self._brake.on_click(lambda: feed.controls.call("emergency_brake", say, not self._applied))
        self._requirements = Div(text="", width=WIDTH, name="requirements", styles={"margin-left": "5px"})
        setup = feed.facts.setup
        required = setup is not None and setup.scenario.criteria.requirements
        shown = [_heading("requirements"), self._requirements] if required else []
        requests = Row(children=[self._call_button(request, 92) for request in REQUESTS])
        ato = [_heading("ATO"), requests] if feed.facts.layout.supervised else []
        self.column = Column(
            children=[
                self._brake, *ato, *shown, _heading("law"), self._law, self._parameters,
                _heading("interventions"), *self._disturbances(),
            ],
            width=WIDTH,
            name="panel",
        )  # fmt: skip
        self._pause = Button(label="pause", width=84, name="pause", **sheets)
        self._pause.on_click(lambda: self._feed.controls.call("pause", self._say, not self._feed.paused))
        self._step = self._call_button("step", 64, "tick")
        self._rate = Select(options=[*RATES], value="1 ×", width=150, name="rate", **sheets)
        self._rate.on_change("value", self._rate_chosen)
        stop = self._call_button("stop", 96, "end the run")
        self._again = Button(label="run again", width=84, name="again", button_type="success", visible=False, **sheets)
        self._again.on_click(feed.request_again)
        self.bar = Row(
            children=[self._pause, self._step, self._rate, stop, self._again],
            name="bar",
            stylesheets=[":host { flex-wrap: wrap; }"],
        )
        self._over = False

    def _call_button(self, service: str, width: int, label: str = "") -> Button:
        """Return the button of a service of the nodes; a refusal is shown with its reason."""
        button = Button(label=label or service, width=width, name=service, stylesheets=[WIDGETS])
        button.on_click(partial(self._feed.controls.call, service, self._say))
        return button

    def _disturbances(self) -> list[Any]:
        """Return the widgets of gusts and delay jumps; their sizes are parameters of the plant."""
        gust, jump = self._call_button("gust", 92), self._call_button("delay_jump", 92, "delay jump")
        force = self._spinner("gust.acceleration", "size [m/s²]", -1.0, 1.0, 0.005)
        duration = self._spinner("gust.duration", "duration [s]", 0.5, 3600.0, 1.0)
        add = self._spinner("delay_jump.add", "added delay [s]", -60.0, 60.0, 0.1)
        factor = self._spinner("delay_jump.factor", "delay factor", 0.0, 1000.0, 0.1)
        return [Row(children=[gust, force, duration]), Row(children=[jump, add, factor])]

    def _spinner(self, name: str, title: str, low: float, high: float, step: float) -> Any:
        spinner = Spinner(
            name=name, title=title, low=low, high=high, step=step, value=0.0, width=92, stylesheets=[WIDGETS]
        )
        spinner.on_change("value_throttled", lambda attr, old, value: self._set("plant", name, value))
        self._widgets[name] = [spinner]
        return spinner

    def _set(self, node: str, name: str, value: Any) -> None:
        """Set a parameter of a node, unless the widget follows the node."""
        if not self._following and value is not None and value != self._feed.controls.value(node, name):
            self._feed.controls.set_parameter(node, name, value, self._answered)

    def _answered(self, done: bool, text: str) -> None:
        """Show an answer; after a rejection the widget returns to the value of the node."""
        if not done:
            self._number = -1
        self._say(done, text)

    @property
    def _applied(self) -> bool:
        """True if an intervention has applied the emergency brake; that of the supervisor has another release."""
        frame = self._feed.frame
        return frame is not None and frame.moment.states.protection_reason == REQUESTED

    def _rate_chosen(self, attr: str, old: str, name: str) -> None:
        if name in RATES:
            self._set("plant", "rate", RATES[name])

    def update(self) -> None:
        """Update the widgets after a change in the nodes; after the end of the run they are disabled."""
        if self._over:
            return
        if self._feed.ending is not None:
            self._over = True
            for root in (self.column, self.bar):
                for widget in root.references():
                    if isinstance(widget, Widget) and widget is not self._again:
                        widget.disabled = True
            self._again.visible = self._feed.repeatable
            return
        live = self._feed.requirements
        if live is not None and self._requirements.text != live.markup:
            self._requirements.text = live.markup
        applied = self._applied
        label = "release the emergency brake" if applied else "EMERGENCY BRAKE"
        if self._brake.label != label:
            self._brake.update(label=label, button_type="warning" if applied else "danger")
        if self._number == self._feed.controls.number:
            return
        self._number = self._feed.controls.number
        self._following = True
        try:
            self._follow()
        finally:
            self._following = False

    def _follow(self) -> None:
        tunables = self._feed.controls.tunables
        law = tunables["controller"].get("law")
        if law is not None:
            if self._law.options != list(law.choices):
                self._law.options = list(law.choices)
            self._law.value = law.value
            if self._shown_law != law.value:
                self._shown_law = law.value
                self._show_parameters(tunables["controller"])
        for node in tunables.values():
            for name, tunable in node.items():
                for widget in self._widgets.get(name, ()):
                    _follow_value(widget, tunable)
                    _explain(widget, tunable)
        fixed = ((self._law, "controller", "law"), (self._rate, "plant", "rate"), (self._pause, "plant", "paused"))
        for widget, owner, name in fixed:
            if name in tunables[owner]:
                _explain(widget, tunables[owner][name])
        paused = bool(self._feed.paused)
        self._pause.label = "resume" if paused else "pause"
        self._step.disabled = not paused
        rate = float(self._feed.controls.value("plant", "rate", 0.0))
        name = next((name for name, value in RATES.items() if value == rate), f"{rate:g} ×")
        if name not in self._rate.options:
            self._rate.options = [*RATES, name]
        self._rate.value = name

    def _show_parameters(self, known: dict[str, Tunable]) -> None:
        """Show the parameters of the active law."""
        mine = [tunable for name, tunable in known.items() if name.startswith(f"{self._shown_law}.")]
        plants = self._feed.controls.tunables["plant"]
        self._widgets = {name: found for name, found in self._widgets.items() if name in plants}
        self._parameters.children = [self._widget(tunable) for tunable in mine]
        for tunable in mine:
            for widget in self._widgets[tunable.name]:
                _explain(widget, tunable)

    def _widget(self, tunable: Tunable) -> Any:
        """Return the widget for a parameter."""
        name = tunable.name
        options: dict[str, Any] = {
            "stylesheets": [WIDGETS], "name": name, "disabled": tunable.read_only,
        }  # fmt: skip
        if tunable.choices:
            words = list(tunable.choices)
            widget = Select(title=tunable.title, options=words, value=tunable.value, width=WIDTH, **options)
            widget.on_change("value", lambda attr, old, value: self._set("controller", name, value))
        elif isinstance(tunable.value, bool):
            widget = Checkbox(label=tunable.title, active=tunable.value, width=WIDTH, **options)
            widget.on_change("active", lambda attr, old, value: self._set("controller", name, value))
        else:
            return self._number_widgets(tunable, options)
        self._widgets[name] = [widget]
        return widget

    def _number_widgets(self, tunable: Tunable, options: dict[str, Any]) -> Any:
        """Return a slider over a part of the range and an input field for the whole range."""
        name, scale = tunable.name, slider_scale(tunable)
        slider = Slider(
            title=tunable.title, value=tunable.value, **scale,
            format=CustomJSTickFormatter(code=SHORT), width=WIDTH - 92, **options,
        )  # fmt: skip
        field = Spinner(value=tunable.value, step=scale["step"], width=80, stylesheets=[WIDGETS])
        slider.on_change("value_throttled", lambda attr, old, value: self._set("controller", name, value))
        field.on_change("value", lambda attr, old, value: self._set("controller", name, value))
        self._widgets[name] = [slider, field]
        return Row(children=[slider, field])


def _follow_value(widget: Any, tunable: Tunable) -> None:
    if isinstance(widget, Checkbox):
        widget.active = tunable.value
        return
    if isinstance(widget, Slider) and not widget.start <= tunable.value <= widget.end:
        widget.update(**slider_scale(tunable))
    if widget.value != tunable.value:
        widget.value = tunable.value


def _explain(widget: Any, tunable: Tunable) -> None:
    """Show the descriptor of a parameter over its widget."""
    text = tunable.explanation
    if widget.html_attributes.get("title") != text:
        widget.html_attributes = {"title": text}


def _heading(text: str) -> Any:
    return Div(
        text=text, styles={"color": SOFT, "font-size": "12px", "letter-spacing": ".06em", "margin": "4px 0 0 5px"}
    )
