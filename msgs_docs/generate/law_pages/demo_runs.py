"""Demonstration runs of every component: the two runs of its figure and the rows of its table.

A component without a row in ``demo_runs.yaml`` gets the runs of :func:`default_demo`, so that a new law needs none.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

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
