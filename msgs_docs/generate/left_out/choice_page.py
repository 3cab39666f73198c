"""Generate ``msgs_docs/left_out.md`` from the choices and their measured sensitivity."""

from __future__ import annotations

from pathlib import Path

import yaml

from msgs_docs.generate.equations.places import source_line
from msgs_docs.generate.left_out.choice import CHOICES, Choice, ChoiceRun, ChoiceTable
from msgs_docs.generate.left_out.runs import NAME, Metrics, read_metrics

PAGE = Path("msgs_docs", "left_out.md")
"""Path of the page in the repository."""
UNITS = {
    "speed_rmse_kmh": "speed error, rms [km/h]",
    "speed_error_max_kmh": "largest speed error [km/h]",
    "position_rmse_m": "position error, rms [m]",
    "position_error_max_m": "largest position error [m]",
    "coupler_buff_max_kn": "largest buff force [kN]",
    "coupler_draft_max_kn": "largest draft force [kN]",
}
"""Metrics of the runs with their units."""

INTRODUCTION = f"""# Choices where the papers give nothing

Made by `python -m msgs_docs.generate`; do not edit by hand.

Each row is a value or a form that a paper does not give, the choice here, and its effect: the metric of a run with the
choice, and of runs with another value (20 % more) or another form. The command of a run is that of the base with the
change: `--set ...`, a variant of the scenario, or `train:`, a key in a copy of the file of the train
(`--set plant.consist=COPY.yaml`). Measured by `python -m msgs_docs.generate --measure {NAME}`.
Equations and their forms: [equations.md](equations.md); claims: [reproduction.md](reproduction.md).
"""


def page(root: Path) -> str:
    """Return the text of the page."""
    metrics = read_metrics(root)
    lines = [INTRODUCTION.rstrip("\n")]
    for table in CHOICES:
        lines += ["", f"## Paper {table.paper}: {table.title}", "", "| base | command |", "|---|---|"]
        lines += [f"| {name} | `{command_of(run)}` |" for name, run in table.bases.items()]
        lines += [
            "",
            "| not in the paper | choice | place | base | metric | with the choice | changed |",
            "|---" * 7 + "|",
        ]
        lines += [_row(choice, table, metrics, root) for choice in table.choices]
    return "\n".join(lines) + "\n"


def command_of(run: ChoiceRun) -> str:
    """Return the command line of a run without changes of the train."""
    options = [f"--set '{text}'" if " " in text else f"--set {text}" for text in run.sets]
    return " ".join(["train-ato run", run.scenario, "--engine", *options])


def _row(choice: Choice, table: ChoiceTable, metrics: Metrics, root: Path) -> str:
    path, line = source_line(choice.where, root)
    cells = [choice.missing, choice.chosen, f"[{path}:{line}](../{path}#L{line})"]
    if choice.metric:
        base = table.bases[choice.base]
        changed = [f"{_change(run, base)}: {_value(run, choice, metrics)}" for run in choice.others]
        cells += [choice.base, UNITS[choice.metric], _value(base, choice, metrics), "<br>".join(changed)]
    else:
        cells += ["-", "-", "-", choice.reason]
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


def _value(run: ChoiceRun, choice: Choice, metrics: Metrics) -> str:
    found = metrics.get(run.key, {}).get(choice.metric, "-")
    return found if isinstance(found, str) else f"{found:g}"


def _change(run: ChoiceRun, base: ChoiceRun) -> str:
    """Return the difference of a run from its base."""
    parts = [f"`{text}`" for text in run.sets[len(base.sets) :]]
    if run.scenario != base.scenario:
        parts.append(f"`{run.scenario}`")
    if run.consist:
        parts.append(f"train: `{yaml.safe_dump(run.consist, default_flow_style=True, width=1000).strip()}`")
    return ", ".join(parts)
