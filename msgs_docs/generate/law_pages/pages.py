"""The pages: text from docstrings and parameter dataclasses, figures as they were measured last."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from train_ato.cli.screen import shown
from train_ato.control.contract import Parameter
from train_ato.law_docs.blocks import KIND, PLURAL, REGISTRIES, Block, blocks
from train_ato.law_docs.fit import companions, misfits, trains
from train_ato.law_docs.homes import HOMES
from train_ato.law_docs.markup import sections

COLUMNS = (
    ("speed_rmse_kmh", "speed error, rms km/h"),
    ("speed_error_max_kmh", "largest km/h"),
    ("position_error_max_m", "position error, largest m"),
    ("command_variation_kn_per_s", "command variation kN/s"),
    ("couplers", "couplers kN"),
)
"""Key of a figure and its column."""
Measured = Mapping[str, list[Mapping[str, Any]]]


def modules() -> dict[str, str]:
    """Return the page of every block's module, for links."""
    return {block.block.__module__: block.page for block in blocks()}


def page(block: Block, measured: Measured) -> str:
    """Return the page of one block."""
    title, does, law, needs = sections(block.text, modules())
    rows = measured.get(block.key, [])
    parts = [f"# {block.name}", f"{title} {_origin(block)}", does]
    if rows:
        parts.append(_figure(block, rows))
    parts += [f"## The {PLURAL[block.kind].rstrip('s')}", law] if law else []
    parts += ["## Parameters", parameter_table(block)]
    parts += ["## What it needs", *([needs] if needs else []), "\n".join(trains(block))]
    if refused := companions(block):
        parts.append("\n".join(refused))
    if rows:
        parts += ["## Measured", measured_table(rows), commands(rows)]
    return "\n\n".join(parts) + "\n"


def _origin(block: Block) -> str:
    kind = KIND[block.kind]
    return (
        f"A {kind}: `{block.kind}: {block.name}`. This page is made from the docstring and the parameters in "
        f"`{block.source}` by `python -m train_ato.law_docs`; do not edit it."
    )


def _figure(block: Block, rows: list[Mapping[str, Any]]) -> str:
    drawn, beside, home = rows[0], rows[1], HOMES[block.key]
    lower = "force of all units" if home.lower == "force" else "estimate and truth"
    caption = f"{home.draw.capitalize()} error and {lower}: {drawn['run']}, beside {beside['run']}"
    return f"![{block.name}]({block.page}.png)\n\n{caption} (`{drawn['scenario']}`)."


def parameter_table(block: Block) -> str:
    """Return the table of a block's parameters."""
    entries = block.parameters
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
    return entry.default if isinstance(entry.default, str) else f"{entry.default:g}"


def _range(entry: Parameter) -> str:
    if isinstance(entry.default, bool):
        return "true, false"
    if isinstance(entry.default, str):
        return ", ".join(entry.choices)
    return f"{entry.low:g} ... {entry.high:g}"


def measured_table(rows: list[Mapping[str, Any]]) -> str:
    """Return the table of the runs that were measured."""
    used = [(key, title) for key, title in COLUMNS if any(row.get(key) is not None for row in rows)]
    lines = ["| run | " + " | ".join(title for _, title in used) + " |", "|---" * (len(used) + 1) + "|"]
    lines += ["| " + " | ".join([row["run"], *(_cell(row.get(key)) for key, _ in used)]) + " |" for row in rows]
    return "\n".join(lines)


def _cell(value: Any) -> str:
    return value if isinstance(value, str) else shown(value)


def commands(rows: list[Mapping[str, Any]]) -> str:
    """Return the commands that drive the runs of a table, in its order."""
    return "In this order:\n\n```sh\n" + "\n".join(row["command"] for row in rows) + "\n```"


def index(measured: Measured) -> str:
    """Return the page that lists all others."""
    parts = [
        "# Laws, observers, compensations",
        "Every law runs with every observer, and with every compensation but for those marked below. These pages are "
        "made from the docstrings, parameters and refusals in the code by `python -m train_ato.law_docs`; figures and "
        "measured tables are made from runs by `python -m train_ato.law_docs --measure`.",
    ]
    for registry in REGISTRIES:
        parts += [f"## {PLURAL[registry.kind].capitalize()}", _list(registry.kind, measured)]
    parts += ["## Which law with which compensation", _matrix()]
    return "\n\n".join(parts) + "\n"


def _list(kind: str, measured: Measured) -> str:
    lines = ["| name | what | at home | rms km/h | beside | rms km/h |", "|---|---|---|---|---|---|"]
    for block in blocks():
        if block.kind != kind:
            continue
        cells = [f"[`{block.name}`]({block.page}.md)", block.summary.rstrip(".")]
        rows = measured.get(block.key, [])
        if rows:
            own, beside = rows[0], rows[1]
            cells += [f"`{own['scenario']}`", shown(own["speed_rmse_kmh"])]
            cells += [beside["run"], shown(beside["speed_rmse_kmh"])]
        else:
            cells += ["-"] * 4
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _matrix() -> str:
    laws = [block.name for block in blocks() if block.kind == "controller"]
    names = [block.name for block in blocks() if block.kind == "compensation"]
    lines = ["| law | " + " | ".join(f"`{name}`" for name in names) + " |", "|---" * (len(names) + 1) + "|"]
    for law in laws:
        refused = dict(misfits(law))
        lines.append(f"| `{law}` | " + " | ".join("refused" if name in refused else "yes" for name in names) + " |")
    note = (
        "With the defaults; `smc` and `rbf_smc` take a feed-forward with `equivalent: feedforward`, `gpc` goes under a "
        "predictor with `delay: none`. A refusal is one line with the reason, before anything starts or while the law "
        "is swapped."
    )
    return "\n".join(lines) + "\n\n" + note
