"""Generate ``msgs_docs/random_runs.md`` from the spread of the random runs and their measured figures."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from msgs_docs.generate.random_runs import (
    ADHESION,
    COUNT,
    DELAY,
    MEASURED,
    NO_FAULT,
    SCENARIOS,
    SEED,
    SPREAD,
    digest,
    draws,
    measure_draws,
)

PAGE = Path("msgs_docs", "random_runs.md")
"""Path of the page in the repository."""
NAME = "random_runs"
"""Name of the page for ``--measure``."""

INTRODUCTION = """# Random runs

Made by `python -m msgs_docs.generate`; do not edit by hand.

{count} runs of the engine with supervision. Each has a random law with its default gains, a random fault of the
[fault table](faults.md) at a random time ({share:g} % have none), and a random train: the values of the table are drawn
from uniform distributions. Equal seeds give equal runs. `test/test_random_runs.py` makes other runs of the same kind.

    python -m msgs_docs.generate.random_runs --count {count} --seed {seed}

| quantity | smallest | largest |
|---|---|---|
"""
ASSUMPTION = """
The brake force per mass is at least 0.81 of its nominal value, inside the factor `kdry` (0.8) of the braking curves.
The adhesion of the metro train is above the value for its guaranteed deceleration (0.14). Faults of the table with less
brake force or adhesion are left out here.
"""
RESULT = """
## Result

*Beyond*: the front passes the supervised location (100 m behind the stop). *Too fast*: above the ceiling of the
emergency brake with its overshoot. *Intervention*: service or emergency brake of the supervisor. *Failed*: the ATO or a
node failed, and the train was stopped. *Moving at the end*: not at standstill after four times the duration of the
scenario.

| scenario | runs | beyond | too fast | with intervention | failed | moving at the end |
|---|---|---|---|---|---|---|
"""
DISTANCES = """
Distances of the trains at standstill, from the foremost place of the front. A negative distance to the planned stop is
an overrun.

| scenario | to the supervised location: smallest, median, 95 % [m] | to the planned stop: smallest, median, 95 % [m] |
|---|---|---|
"""
FAULTLESS = """
Of the {runs} runs without a fault, {count} have an intervention. One would show gains that are not those of the
train, or a train that differs more from its model than the law permits.
"""


def read_random_runs(root: Path) -> dict[str, Any]:
    """Return the measured summary; empty without one."""
    path = root / MEASURED
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    return found


def measure_random_runs(root: Path) -> None:
    """Make the runs of the page and write their summary."""
    text = json.dumps(measure_draws(COUNT, SEED, os.cpu_count() or 1), indent=1, ensure_ascii=False)
    (root / MEASURED).write_text(text + "\n", encoding="utf-8")


def unmeasured_random_runs(root: Path) -> list[str]:
    """Return one line if the summary is not that of the present runs."""
    if read_random_runs(root).get("runs") == digest(draws(COUNT, SEED)):
        return []
    return [f"{MEASURED}: other runs or none; run python -m msgs_docs.generate --measure {NAME}"]


def page(root: Path) -> str:
    """Return the text of the page."""
    found = read_random_runs(root)
    spread = {**SPREAD, "plant.adhesion (metro)": ADHESION, "links.command.delay, factor": DELAY}
    lines = [INTRODUCTION.format(count=COUNT, seed=SEED, share=100.0 * NO_FAULT).rstrip("\n")]
    lines += [f"| `{key}` | {low:g} | {high:g} |" for key, (low, high) in spread.items()]
    groups: dict[str, Any] = found.get("scenarios", {})
    lines += [ASSUMPTION.rstrip("\n"), RESULT.rstrip("\n")]
    keys = ("runs", "beyond", "too_fast", "interventions", "failed", "moving_at_end")
    lines += [_row(_named(base), *(group[key] for key in keys)) for base, group in groups.items()]
    lines += [_row("all", *(sum(group[key] for group in groups.values()) for key in keys)), DISTANCES.rstrip("\n")]
    lines += [
        _row(_named(base), *(_quantiles(group[key]) for key in ("margin_m", "short_m")))
        for base, group in groups.items()
    ]
    counts = {
        "runs": sum(group["without_fault"] for group in groups.values()),
        "count": sum(group["interventions_without_fault"] for group in groups.values()),
    }
    lines.append(FAULTLESS.format(**counts).rstrip("\n"))
    lines += [f"* run {bad['number']}, {bad['margin_m']:g} m: `{bad['command']}`" for bad in found.get("bad", [])]
    return "\n".join(lines).strip("\n") + "\n"


def _named(base: str) -> str:
    """Return the scenario of runs with its name."""
    return f"{base} (`{SCENARIOS[base][1]}`)"


def _row(*cells: object) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def _quantiles(found: dict[str, float]) -> str:
    return ", ".join(f"{found[key]:g}" for key in ("smallest", "median", "p95")) if found else "-"
