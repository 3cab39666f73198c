"""Generate ``msgs_docs/left_out.md``: choices where a paper gives nothing, and their measured sensitivity."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from msgs_docs.generate.equation_page import source_line
from msgs_docs.generate.rows import page_text, read_rows, table_lines, texts, write_rows
from plant_sim.library import consist_path, read_yaml
from train_ato.api.progress import share_bar
from train_ato.control.gains import PRINTED, has_gains
from train_ato.control.registry import LAWS
from train_ato.loop.engine import run_engine
from train_ato.scenario.overlays import overlay
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import RunSetup, prepare


@dataclass(frozen=True)
class ChoiceRun:
    """One run of the engine.

    Attributes
    ----------
    scenario
        ``NAME[:variant+...]`` of a shipped scenario.
    sets
        Assignments of ``--set``.
    consist
        Changed keys in a copy of the train file of the scenario.
    """

    scenario: str
    sets: tuple[str, ...]
    consist: dict[str, Any]

    @property
    def key(self) -> str:
        """Text that is different for every run."""
        return yaml.safe_dump([self.scenario, *self.sets, self.consist], default_flow_style=True, width=10_000).strip()

    def setup(self) -> RunSetup:
        """Return the prepared run, with the printed gains of its law where the scenario gives none."""
        scenario, path = load_scenario(self.scenario, self.sets)
        printed = {"laws": {scenario.law: {"gains": PRINTED}}} if has_gains(LAWS.get(scenario.law)) else {}
        scenario, path = load_scenario(self.scenario, self.sets, printed)
        if self.consist:
            name = scenario.plant.consist
            assert isinstance(name, str)
            changed = overlay(read_yaml(consist_path(name)), self.consist)
            scenario, path = load_scenario(self.scenario, self.sets, {**printed, "plant": {"consist": changed}})
        return prepare(scenario, path)


@dataclass(frozen=True)
class Choice:
    """Choice where a paper gives nothing.

    Attributes
    ----------
    missing, chosen
        Quantity or form that the paper does not give; value or form here.
    where
        Place of the value: ``module:name``, or ``folder/file:text``.
    base
        Name of the run with the choice.
    metric
        Metric of the run.
    others
        Runs with another choice.
    reason
        Reason for a choice without runs.
    """

    missing: str
    chosen: str
    where: str
    base: str = ""
    metric: str = ""
    others: tuple[ChoiceRun, ...] = ()
    reason: str = ""


@dataclass(frozen=True)
class ChoiceTable:
    """Choices of one paper, and its runs with these choices by name."""

    paper: str
    title: str
    bases: dict[str, ChoiceRun]
    choices: tuple[Choice, ...]


def _table(data: dict[str, Any]) -> ChoiceTable:
    bases = {name: ChoiceRun(row["scenario"], tuple(row.get("set", ())), {}) for name, row in data["bases"].items()}
    choices = []
    for row in data["choices"]:
        others = row.pop("others", ())
        runs = tuple(_other(bases[row["base"]], other) for other in others)
        choices.append(Choice(**row, others=runs))
    return ChoiceTable(data["paper"], data["title"], bases, tuple(choices))


def _other(base: ChoiceRun, row: dict[str, Any]) -> ChoiceRun:
    """Return the run of a base with other assignments (``set``), keys of the train (``consist``) or a ``variant``."""
    given, variant = row.get("set", ()), row.get("variant", "")
    more = (given,) if isinstance(given, str) else tuple(given)
    name = base.scenario + ("+" if ":" in base.scenario else ":") + variant if variant else base.scenario
    return ChoiceRun(name, (*base.sets, *more), row.get("consist", {}))


CHOICES = tuple(map(_table, texts("left_out")))

NAME = "left_out"
MEASURED = Path("msgs_docs", "left_out_measured.json")
"""Metrics of the runs by key of the run."""
LOST = "lost"
"""Value of a run that failed."""

Metrics = dict[str, dict[str, float | str]]


def wanted() -> Iterator[tuple[ChoiceRun, str]]:
    """Yield every run with a metric of it; a run can occur with several metrics."""
    for table in CHOICES:
        for choice in table.choices:
            if choice.metric:
                yield from ((run, choice.metric) for run in (table.bases[choice.base], *choice.others))


def measure(root: Path) -> None:
    """Drive all runs and write their metrics."""
    metrics: dict[str, set[str]] = {}
    runs: dict[str, ChoiceRun] = {}
    for run, metric in wanted():
        runs[run.key] = run
        metrics.setdefault(run.key, set()).add(metric)
    found: Metrics = {}
    with share_bar("sensitivities") as report:
        for number, (key, run) in enumerate(runs.items()):
            report(number / len(runs), run.scenario)
            found[key] = drive_choice(run, sorted(metrics[key]))
    write_rows(root / MEASURED, found)


def drive_choice(run: ChoiceRun, metrics: list[str]) -> dict[str, float | str]:
    """Drive a run in the engine and return metrics to three digits, or ``lost``."""
    result = run_engine(run.setup())
    return {name: LOST if result.failure else float(f"{result.summary[name]:.3g}") for name in metrics}


def unmeasured(root: Path) -> list[str]:
    """Return one line per run without a measured metric, and per leftover."""
    found, remedy = read_rows(root / MEASURED), f"run python -m msgs_docs.generate --measure {NAME}"
    missing = {run.key for run, metric in wanted() if metric not in found.get(run.key, {})}
    leftover = found.keys() - {run.key for run, _ in wanted()}
    return [f"choice {key}: not measured; {remedy}" for key in sorted(missing)] + [
        f"choice {key}: no such run; {remedy}" for key in sorted(leftover)
    ]


PAGE = Path("msgs_docs", "left_out.md")
UNITS = {
    "speed_rmse_kmh": "speed error, rms [km/h]",
    "speed_error_max_kmh": "largest speed error [km/h]",
    "position_rmse_m": "position error, rms [m]",
    "position_error_max_m": "largest position error [m]",
    "coupler_buff_max_kn": "largest buff force [kN]",
    "coupler_draft_max_kn": "largest draft force [kN]",
}
"""Metrics of the runs with their units."""
HEADS = ("not in the paper", "choice", "place", "base", "metric", "with the choice", "changed")


def page(root: Path) -> str:
    """Return the text of the page."""
    metrics = read_rows(root / MEASURED)
    lines: list[str] = []
    for table in CHOICES:
        lines += ["", f"## Paper {table.paper}: {table.title}", ""]
        lines += table_lines(("base", "command"), ((name, f"`{command_of(run)}`") for name, run in table.bases.items()))
        lines += ["", *table_lines(HEADS, (_row(choice, table, metrics, root) for choice in table.choices))]
    return page_text(NAME, tables=lines)


def command_of(run: ChoiceRun) -> str:
    """Return the command line of a run without changes of the train."""
    options = [f"--set '{text}'" if " " in text else f"--set {text}" for text in run.sets]
    return " ".join(["train-ato run", run.scenario, "--engine", *options])


def _row(choice: Choice, table: ChoiceTable, metrics: Metrics, root: Path) -> list[str]:
    path, line = source_line(choice.where, root)
    cells = [choice.missing, choice.chosen, f"[{path}:{line}](../{path}#L{line})"]
    if not choice.metric:
        return [*cells, "-", "-", "-", choice.reason]
    base = table.bases[choice.base]
    changed = [f"{_change(run, base)}: {_value(run, choice, metrics)}" for run in choice.others]
    return [*cells, choice.base, UNITS[choice.metric], _value(base, choice, metrics), "<br>".join(changed)]


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
