"""Generate the page of the site with tuning by symptom, which is made of runs."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

import train_ato as ta
from plant_sim.units import number_text
from train_ato.loop.metric_names import METRICS

Changes = dict[str, Any]
METRO: Changes = {
    "profile": {
        "phases": [
            {"accelerate_to": 15.0, "acceleration": 0.8},
            {"cruise_for": 10.0},
            {"brake_to": 0.0, "acceleration": 0.8},
        ]
    },
    "plant.start": {},
    "duration": 80.0,
}
"""Short drive of the metro train from rest to rest."""


@dataclass(frozen=True)
class Symptom:
    """Symptom of a drive, with a cause and the change that removes it.

    Attributes
    ----------
    symptom, remedy
        Texts of the page.
    cause, change
        Keys of the scenario that make the symptom, and those that remove it.
    metric
        Metric that shows it.
    scenario, drive
        Shipped scenario, and the keys of the short drive.
    """

    symptom: str
    cause: Changes
    remedy: str
    change: Changes
    metric: str
    scenario: str = "xuzhou_metro"
    drive: Changes | None = None


FILE = Path(__file__).with_name("symptoms.yaml")
SYMPTOMS = tuple(Symptom(**row) for row in yaml.safe_load(FILE.read_text(encoding="utf-8")))
"""Rows of the page."""


def both_drives(symptom: Symptom) -> tuple[float, float]:
    """Return the magnitude of the metric with the cause, without and with the change."""
    start = ta.scenario(symptom.scenario).with_({**(symptom.drive or METRO), **symptom.cause})
    runs = (ta.run(start), ta.run(start.with_(symptom.change)))
    values = [run.metrics[symptom.metric] for run in runs]
    return abs(values[0]), abs(values[1])


def symptom_page() -> str:
    """Return the page of the symptoms, with the metric of each before and after the change."""
    text = (
        "# Tune by symptom\n\nEach row is two short drives of this build: one with the cause, one with the cause and "
        "the change. The first line\nof a run, its criteria and the report name the symptom; see "
        "[outcome of tracking](../tracking.md).\n\n"
        "| symptom | cause in this drive | change | keys of the change | metric | before | after |\n"
        "|---|---|---|---|---|---|---|\n"
    )
    for symptom in SYMPTOMS:
        before, after = both_drives(symptom)
        name, unit = METRICS[symptom.metric]
        cause = ", ".join(f"`{key}={value}`" for key, value in symptom.cause.items()) or "none"
        change = ", ".join(f"`{key}={_short(value)}`" for key, value in symptom.change.items() if key != "plant.start")
        cells = (symptom.symptom, cause, symptom.remedy, change, f"{name} in {unit}")
        text += f"| {' | '.join(cells)} | {number_text(before, 3)} | {number_text(after, 3)} |\n"
    return text + (
        "\nThe brakes intervene: the first line of the run has the reason; [supervision](../supervision.md) has the "
        "limit of each. Gains for\nseveral trains and seeds at once: [tuning](../tuning.md).\n"
    )


def _short(value: object) -> str:
    """Return a value in the words of YAML."""
    return re.sub(r"['{}\[\]]", "", str(value))
