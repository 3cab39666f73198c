"""Text of the pages, from docstrings, parameter dataclasses and the figures of the last measurement."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from msgs_docs.generate.law_pages.compatibility import companions, conflicts, on_trains, trains
from msgs_docs.generate.law_pages.components import KIND, PLURAL, REGISTRIES, Component, components
from msgs_docs.generate.law_pages.demo_runs import demo_of
from msgs_docs.generate.law_pages.markup import sections
from plant_sim.number_text import number_text
from train_ato.apps.runs.summary_table import format_value
from train_ato.control.contract import Parameter

COLUMNS = (
    ("outcome", "outcome"),
    ("speed_rmse_kmh", "speed error, rms km/h"),
    ("speed_error_max_kmh", "largest km/h"),
    ("position_error_max_m", "position error, largest m"),
    ("command_variation_kn_per_s", "command variation kN/s"),
    ("couplers", "couplers kN"),
)
"""Key of a figure and title of its column."""
Measured = Mapping[str, list[Mapping[str, Any]]]


def modules() -> dict[str, str]:
    """Return the page of every module of a component, for links."""
    return {component.cls.__module__: component.page for component in components()}


def page(component: Component, measured: Measured) -> str:
    """Return the page of one component."""
    title, does, law, needs = sections(component.text, modules())
    rows = measured.get(component.key, [])
    parts = [f"# {component.name}", f"{title} {_origin(component)}", does]
    if rows:
        parts.append(_figure(component, rows))
    parts += [f"## The {PLURAL[component.kind].rstrip('s')}", law] if law else []
    parts += ["## Parameters", parameter_table(component)]
    parts += ["## Requirements", *([needs] if needs else []), "\n".join(trains(component))]
    if refused := companions(component):
        parts.append("\n".join(refused))
    if rows:
        parts += ["## Measured", measured_table(rows), commands(rows)]
    return "\n\n".join(parts) + "\n"


def _origin(component: Component) -> str:
    kind = KIND[component.kind]
    return (
        f"A {kind}: `{component.kind}: {component.name}`. This page is generated from docstring and parameters in "
        f"`{component.source}` by `python -m msgs_docs.generate`; do not edit it."
    )


def _figure(component: Component, rows: list[Mapping[str, Any]]) -> str:
    drawn, beside, demo = rows[0], rows[1], demo_of(component.kind, component.name)
    lower = "force of all units" if demo.lower == "force" else "estimate and truth"
    caption = f"{demo.draw.capitalize()} error and {lower}: {drawn['run']}, beside {beside['run']}"
    return f"![{component.name}]({component.page}.png)\n\n{caption} (`{drawn['scenario']}`)."


def parameter_table(component: Component) -> str:
    """Return the table of a component's parameters."""
    entries = component.parameters
    if not entries:
        return "None."
    lines = ["| parameter | default | unit | range | meaning |", "|---|---|---|---|---|"]
    for entry in entries:
        cells = (f"`{entry.name}`", _default(entry), entry.unit or "-", _range(entry), entry.meaning)
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines)


def _default(entry: Parameter) -> str:
    if isinstance(entry.default, bool):
        return str(entry.default).lower()
    return entry.default if isinstance(entry.default, str) else number_text(entry.default)


def _range(entry: Parameter) -> str:
    if isinstance(entry.default, bool):
        return "true, false"
    if isinstance(entry.default, str):
        return ", ".join(entry.choices)
    return f"{number_text(entry.low)} ... {number_text(entry.high)}"


def measured_table(rows: list[Mapping[str, Any]]) -> str:
    """Return the table of the measured runs."""
    used = [(key, title) for key, title in COLUMNS if any(row.get(key) is not None for row in rows)]
    lines = ["| run | " + " | ".join(title for _, title in used) + " |", "|---" * (len(used) + 1) + "|"]
    lines += ["| " + " | ".join([row["run"], *(_cell(row.get(key)) for key, _ in used)]) + " |" for row in rows]
    return "\n".join(lines)


def _cell(value: Any) -> str:
    return value if isinstance(value, str) else format_value(value)


def commands(rows: list[Mapping[str, Any]]) -> str:
    """Return the commands of the runs of a table, in its order."""
    return "Commands, in the order of the table:\n\n```sh\n" + "\n".join(row["command"] for row in rows) + "\n```"


def index(measured: Measured) -> str:
    """Return the index page."""
    parts = [
        "# Laws, observers, compensations",
        "Every law runs with every observer, and with every compensation except those marked below. These pages are "
        "generated from docstrings, parameters and error messages by `python -m msgs_docs.generate`; "
        "figures and measured tables are generated from runs by `python -m msgs_docs.generate --measure`.",
    ]
    for registry in REGISTRIES:
        parts += [f"## {PLURAL[registry.kind].capitalize()}", _list(registry.kind, measured)]
    parts += ["## Which law with which compensation", _matrix()]
    return "\n\n".join(parts) + "\n"


def _list(kind: str, measured: Measured) -> str:
    lines = [
        "| name | description | demonstration | rms km/h, outcome | compared with | rms km/h, outcome |",
        "|---|---|---|---|---|---|",
    ]
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
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _rms(row: Mapping[str, Any]) -> str:
    """Return the speed error of a run [km/h] with its outcome."""
    return ", ".join([format_value(row["speed_rmse_kmh"]), *row.get("outcome", "").split(";")[:1]]).rstrip(", ")


def _matrix() -> str:
    laws = [component.name for component in components() if component.kind == "law"]
    names = [component.name for component in components() if component.kind == "compensation"]
    lines = ["| law | " + " | ".join(f"`{name}`" for name in names) + " |", "|---" * (len(names) + 1) + "|"]
    for law in laws:
        rejected = {name: f"rejected{on_trains(where)}" for name, _, where in conflicts(law)}
        lines.append(f"| `{law}` | " + " | ".join(rejected.get(name, "yes") for name in names) + " |")
    note = (
        "With the default gains of every shipped train. An incompatible pair is rejected with one line that gives the "
        "reason and the nearest choice, before the start or at a change of the law: `smc`, `rbf_smc` and "
        "`fixed_time_smc` use a feed-forward with `equivalent: feedforward`, `funnel` and `gpc` with "
        "`feedforward: true`, and `gpc` accepts a predictor with `delay: none`."
    )
    return "\n".join(lines) + "\n\n" + note
