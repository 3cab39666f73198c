"""Text of the pages, from docstrings, parameter dataclasses and the figures of the last measurement.

Components with a page of their own: every law, observer and compensation of this package. One without a row in
``demo_runs.yaml`` gets the runs of :func:`default_demo`, so that a new law needs none.
"""

import contextlib
import functools
import inspect
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from msgs_docs.generate.rows import page_text, parameter_cell, table_lines
from plant_sim.library import consist_names, load_consist, load_line
from plant_sim.units import number_text
from train_ato.control.compensation.contract import check_compatible
from train_ato.control.contract import Parameter
from train_ato.control.gains import TABLE
from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS, Registry
from train_ato.control.train_model import TrainModel
from train_ato.judge.metric_names import format_value
from train_ato.papers.claims import Case


@dataclass(frozen=True)
class DemoRun:
    """Runs of one page; the first two are drawn.

    Attributes
    ----------
    runs : dict
        Label and case of every run.
    draw : str
        Upper panel: ``speed`` or ``position`` error.
    lower : str
        Lower panel: ``force`` of all units, or ``estimate`` against the truth.
    span : tuple of float
        Drawn part of the run [s]; None draws all of it.
    """

    runs: Mapping[str, Case]
    draw: str = "speed"
    lower: str = "force"
    span: tuple[float, float] | None = None


METRO = "xuzhou_metro"


def _read_demo(row: dict[str, Any]) -> DemoRun:
    """Return the runs of a row; each is a scenario, or a scenario and its overlay."""
    pairs = {label: (run, {}) if isinstance(run, str) else run for label, run in row.pop("runs").items()}
    if "span" in row:
        row["span"] = tuple(row["span"])
    return DemoRun({label: Case(*pair) for label, pair in pairs.items()}, **row)


FILE = Path(__file__).with_name("demo_runs.yaml")
DEMO_RUNS = {key: _read_demo(row) for key, row in yaml.safe_load(FILE.read_text(encoding="utf-8")).items()}
"""Runs by kind and name of the component."""


def default_demo(kind: str, name: str) -> DemoRun:
    """Return the runs of a component without an entry: on the metro train, beside the baseline of its kind."""
    scenario = f"{METRO}:disturbed"
    if kind == "law":
        return DemoRun({name: Case(scenario, {"law": name}), "pid": Case(scenario, {"law": "pid"})})
    if kind == "observer":
        runs = {name: Case(scenario, {"observer": name}), "none": Case(scenario, {"observer": "none"})}
        return DemoRun(runs, lower="estimate")
    return DemoRun({name: Case(METRO, {"compensation": name}), "preview": Case(METRO, {"compensation": "preview"})})


def demo_of(kind: str, name: str) -> DemoRun:
    """Return the demonstration runs of a component."""
    return DEMO_RUNS.get(f"{kind}/{name}") or default_demo(kind, name)


REGISTRIES = (LAWS, OBSERVERS, COMPENSATIONS)
KIND = {"law": "control law", "observer": "disturbance observer", "compensation": "delay compensation"}


@dataclass(frozen=True)
class Component:
    """A law, an observer or a compensation.

    Attributes
    ----------
    page : str
        File name of its page and figure without ending: its name, with its kind where two kinds share the name.
    """

    registry: Registry
    name: str
    page: str

    @property
    def kind(self) -> str:
        """``law``, ``observer`` or ``compensation``."""
        return self.registry.kind

    @property
    def key(self) -> str:
        """Name among the measured figures."""
        return f"{self.kind}/{self.name}"

    @property
    def cls(self) -> Any:
        """The class."""
        return self.registry.get(self.name)

    @property
    def summary(self) -> str:
        """First line of the class's docstring."""
        return self.registry.summary(self.name)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters, in the order of their declaration."""
        return self.registry.parameters(self.name)

    @property
    def text(self) -> str:
        """Docstring of its module, cleaned: equations, corrections, needs."""
        return inspect.cleandoc(sys.modules[self.cls.__module__].__doc__ or "")

    @property
    def source(self) -> str:
        """File of its module, from the root of the repository."""
        module: str = self.cls.__module__
        return module.replace(".", "/") + ".py"


def components() -> tuple[Component, ...]:
    """Return the components of this package, ordered by kind."""
    found = [(registry, name) for registry in REGISTRIES for name in registry.loadable()]
    ours = [
        (registry, name)
        for registry, name in found
        if ":" not in name and registry.get(name).__module__.startswith("train_ato.")
    ]
    names = [name for _, name in ours]
    return tuple(
        Component(registry, name, name if names.count(name) == 1 else f"{name}_{registry.kind}")
        for registry, name in ours
    )


NEEDS = "Needs: "


def sections(text: str, pages: Mapping[str, str]) -> tuple[str, str, str, str]:
    """Split a component's docstring.

    Parameters
    ----------
    text
        The docstring, cleaned: a title, what the component does, the law itself, ``Needs: ...``.
    pages
        Module to page, for links.

    Returns
    -------
    title, does, law, needs : str
        Markdown; ``law`` and ``needs`` may be empty.
    """
    paragraphs = re.split(r"\n\n+(?! )", text.strip())
    title, rest = " ".join(paragraphs[0].split()), paragraphs[1:]
    needs = [part for part in rest if part.startswith(NEEDS)]
    body = [part for part in rest if not part.startswith(NEEDS)]
    needed = needs[0].removeprefix(NEEDS) if needs else ""
    does, law = (body[0], body[1:]) if body else ("", [])
    return (
        inline(title, pages),
        markdown(does, pages),
        "\n\n".join(markdown(part, pages) for part in law),
        markdown(needed[:1].upper() + needed[1:], pages),
    )


def markdown(paragraph: str, pages: Mapping[str, str]) -> str:
    """Return a paragraph in Markdown; an indented block after it becomes code."""
    lines, result, code = paragraph.splitlines(), [], False
    for line in lines:
        indented = line.startswith("    ") or (code and not line.strip())
        if indented and not code:
            result += ["", "```text"]
        elif code and not indented:
            result += ["```", ""]
        code = indented
        result.append(line.removeprefix("    ") if indented else inline(line, pages))
    if code:
        result.append("```")
    return re.sub(r"\n{3,}", "\n\n", "\n".join(result)).strip()


def inline(line: str, pages: Mapping[str, str]) -> str:
    """Return one line of text: code, links to other pages, no accidental emphasis."""
    line = re.sub(r":mod:`([\w.]+)`", lambda found: _link(found.group(1), pages), line)
    line = re.sub(r":\w+:`~?([\w.]+)`", r"`\1`", line)
    line = re.sub(r"``(.+?)``", r"`\1`", line)
    line = re.sub(r"(?<=\w)\*(?=[\w_])", r"\\*", line)
    return re.sub(r"::$", ":", line)


def _link(module: str, pages: Mapping[str, str]) -> str:
    page = pages.get(module)
    return f"`{module}`" if page is None else f"[`{module.rpartition('.')[2]}`]({page}.md)"


OTHER = {"delay": 0.5, "lag": 0.4, "period": 0.1}
"""Delay, lag and period of a shipped train without fitted gains [s]."""

load = functools.cache(load_consist)


@functools.cache
def shipped(name: str, sensors: tuple[int, ...]) -> TrainModel:
    """Return the model of a shipped train on a level line with the delay of its fitted gains, and coupler sensors."""
    consist = load(name)
    entries = yaml.safe_load(TABLE.read_text(encoding="utf-8"))
    loop = next((entry for entry in entries if name in entry["trains"]), OTHER)
    delay = np.full(len(consist.power_units), loop["delay"])
    return TrainModel(consist, load_line("level"), delay, delay, loop["lag"], loop["period"], sensors)


def refusal(component: Component, train: TrainModel) -> str:
    """Return the reason for which a component with its defaults rejects a train; empty if it accepts it."""
    try:
        component.registry.make(component.name, {}, train, train.tick)
    except ValueError as error:
        return str(error).removeprefix(f"{component.kind} '{component.name}': ")
    return ""


def tried_trains(component: Component) -> list[str]:
    """Return lines with the shipped trains that a component accepts and the reasons for the others."""
    taken, lines = [], []
    for name in consist_names():
        hauled = len(load(name).vehicles) > len(load(name).power_units)
        reason = refusal(component, shipped(name, ()))
        if not reason:
            taken.append(f"`{name}`")
        elif hauled and not refusal(component, shipped(name, (0,))):
            lines.append(f"* `{name}` with a sensor at coupler_0; without: {reason}.")
        else:
            lines.append(f"* `{name}` is rejected: {reason}.")
    everything = len(taken) == len(consist_names())
    head = "Accepts every shipped train." if everything else f"Accepts the shipped trains {', '.join(taken)}."
    return [head, *([""] if lines else []), *lines]


@functools.cache
def conflicts(law: str) -> tuple[tuple[str, str, list[str]], ...]:
    """Return the compensations that reject a law with its default gains: name, reason, trains ([]: all)."""
    made = {}
    for train in consist_names():
        hauled = len(load(train).vehicles) > len(load(train).power_units)
        model = shipped(train, (0,) if hauled else ())
        with contextlib.suppress(ValueError):
            made[train] = LAWS.make(law, {}, model, model.tick)
    found = []
    for name in COMPENSATIONS.loadable():
        reasons = {train: reason for train, each in made.items() if (reason := conflict(law, each, name))}
        if reasons:
            found.append((name, next(iter(reasons.values())), [] if len(reasons) == len(made) else list(reasons)))
    return tuple(found)


def conflict(law: str, made: Any, compensation: str) -> str:
    """Return the reason of a compensation for the refusal of a law; "" if it accepts it."""
    try:
        check_compatible(law, made, compensation, COMPENSATIONS.get(compensation))
    except ValueError as error:
        return str(error).partition("': ")[2]
    return ""


def companions(component: Component) -> list[str]:
    """Return lines with the incompatible components and the reasons."""
    if component.kind == "law":
        reasons: dict[str, list[str]] = {}
        for name, reason, where in conflicts(component.name):
            reasons.setdefault(reason.replace(f"'{name}'", "it"), []).append(f"`{name}`{on_trains(where)}")
        return [f"Rejected with compensation {' or '.join(names)}: {reason}." for reason, names in reasons.items()]
    if component.kind == "compensation":
        found = [
            f"`{law}`{on_trains(where)}"
            for law in LAWS.loadable()
            for name, _, where in conflicts(law)
            if name == component.name
        ]
        return [f"Rejected with the laws {', '.join(found)} with their default gains."] if found else []
    return []


def on_trains(names: list[str]) -> str:
    """Return a list of trains as text; "" for an empty list."""
    return f" (on {', '.join(f'`{name}`' for name in names)})" if names else ""


COLUMNS = (
    ("outcome", "outcome"), ("speed_rmse_kmh", "speed error, rms km/h"), ("speed_error_max_kmh", "largest km/h"),
    ("position_error_max_m", "position error, largest m"), ("command_variation_kn_per_s", "command variation kN/s"),
    ("couplers", "couplers kN"),
)  # fmt: skip
"""Key of a figure and title of its column."""
Measured = Mapping[str, list[Mapping[str, Any]]]


def modules() -> dict[str, str]:
    """Return the page of every module of a component, for links."""
    return {component.cls.__module__: component.page for component in components()}


def page(component: Component, measured: Measured) -> str:
    """Return the page of one component."""
    title, does, law, needs = sections(component.text, modules())
    rows = measured.get(component.key, [])
    return page_text(
        "law",
        component=component,
        kind=KIND[component.kind],
        title=title,
        does=does,
        demo=demo_of(component.kind, component.name),
        rows=rows,
        law=law,
        parameters=parameter_table(component),
        needs=needs,
        trains=tried_trains(component),
        refused=companions(component),
        measured=measured_table(rows),
    )


def parameter_table(component: Component) -> list[str]:
    """Return the table of a component's parameters."""
    entries = component.parameters
    if not entries:
        return ["None."]
    rows = [(f"`{e.name}`", parameter_cell(e.default), e.unit or "-", _range(e), e.meaning) for e in entries]
    return table_lines(("parameter", "default", "unit", "range", "meaning"), rows)


def _range(entry: Parameter) -> str:
    if isinstance(entry.default, bool):
        return "true, false"
    if isinstance(entry.default, str):
        return ", ".join(entry.choices)
    return f"{number_text(entry.low)} ... {number_text(entry.high)}"


def measured_table(rows: list[Mapping[str, Any]]) -> list[str]:
    """Return the table of the measured runs."""
    used = [(key, title) for key, title in COLUMNS if any(row.get(key) is not None for row in rows)]
    cells = ([row["run"], *(format_value(row.get(key)) for key, _ in used)] for row in rows)
    return table_lines(("run", *(title for _, title in used)), cells)


def index(measured: Measured) -> str:
    """Return the index page."""
    tables = {f"{registry.kind.capitalize()}s": _list(registry.kind, measured) for registry in REGISTRIES}
    return page_text("laws", tables=tables, matrix=_matrix())


def _list(kind: str, measured: Measured) -> list[str]:
    lines = []
    for component in components():
        if component.kind != kind:
            continue
        cells = [f"[`{component.name}`]({component.page}.md)", component.summary.rstrip(".")]
        rows = measured.get(component.key, [])
        if rows:
            own, beside = rows[0], rows[1]
            law = re.search(r"--law (\S+)", own["command"])
            other = f" with `{law[1]}`" if law and kind != "law" else ""
            cells += [f"`{own['scenario']}`{other}", _rms(own), beside["run"], _rms(beside)]
        else:
            cells += ["-"] * 4
        lines.append(cells)
    heads = ("name", "description", "demonstration", "rms km/h, outcome", "compared with", "rms km/h, outcome")
    return table_lines(heads, lines)


def _rms(row: Mapping[str, Any]) -> str:
    """Return the speed error of a run [km/h] with its outcome."""
    return ", ".join([format_value(row["speed_rmse_kmh"]), *row.get("outcome", "").split(";")[:1]]).rstrip(", ")


def _matrix() -> list[str]:
    laws = [component.name for component in components() if component.kind == "law"]
    names = [component.name for component in components() if component.kind == "compensation"]
    rows = []
    for law in laws:
        rejected = {name: f"rejected{on_trains(where)}" for name, _, where in conflicts(law)}
        rows.append([f"`{law}`", *(rejected.get(name, "yes") for name in names)])
    return table_lines(("law", *(f"`{name}`" for name in names)), rows)
