"""Generate the page of the site with tuning by symptom, which is made of runs."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import train_ato as ta
from plant_sim.units import number_text
from train_ato.loop.metric_names import METRICS

Changes = dict[str, Any]


def _hop(speed: float, acceleration: float) -> Changes:
    """Return a profile from rest to rest; speed [m/s], acceleration and deceleration [m/s²]."""
    phases = [
        {"accelerate_to": speed, "acceleration": acceleration},
        {"cruise_for": 10.0},
        {"brake_to": 0.0, "acceleration": 0.8 if acceleration >= 0.5 else acceleration},
    ]
    return {"profile": {"phases": phases}, "plant.start": {}}


METRO = {**_hop(15.0, 0.8), "duration": 80.0}
HEAVY = {**_hop(3.0, 0.1), "duration": 360.0}


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


SYMPTOMS = (
    Symptom(
        "The train stops beyond the target: it is heavier than its model.",
        {"plant.mismatch.mass_scale": 1.3},
        "Let an observer estimate the difference.",
        {"observer": "eso"},
        "stop_error_max_m",
    ),
    Symptom(
        "The train follows the profile late in every change of the force: delay and lag are not compensated.",
        {"compensation": "none"},
        "Use the force of the profile ahead by the dead time.",
        {"compensation": "preview"},
        "speed_error_max_kmh",
    ),
    Symptom(
        "The train follows late in spite of a compensation: the model has another delay than the train.",
        {"links.command.delay": 0.6, "model.delay": 0.0},
        "Give the model the delay that the report identifies.",
        {"model.delay": 0.6},
        "speed_error_max_kmh",
    ),
    Symptom(
        "The command oscillates, `tracking` is `limit cycle` or the stop is missed: the gain is too large for the "
        "dead time.",
        {"laws.pid.kp": 6.0},
        "Use the gains that follow from the model of the train, or search them with `train-ato tune`.",
        {"laws.pid.kp": 1.0},
        "command_variation_kn_per_s",
    ),
    Symptom(
        "The command is noisy: the law amplifies the noise of the measured speed.",
        {"plant.sensors.velocity_noise": 0.05},
        "Filter the speed error; the filter time adds to the dead time.",
        {"laws.pid.filter_time": 0.5},
        "command_variation_kn_per_s",
    ),
    Symptom(
        "The force is at its limit and the train falls behind: the profile needs more than the train has.",
        {"plant.mismatch.traction_scale": 0.6},
        "Plan with less acceleration.",
        _hop(15.0, 0.5),
        "stop_error_max_m",
    ),
    Symptom(
        "The train falls behind by a lack of force that the plan cannot know.",
        {"plant.mismatch.traction_scale": 0.6},
        "Let the profile be planned again on the way.",
        {"replan": {"speed_error": 0.5}},
        "stop_error_max_m",
    ),
    Symptom(
        "The couplers carry too much force: the first ones pull the whole train with the acceleration of the profile.",
        {},
        "Plan with less acceleration.",
        _hop(3.0, 0.02),
        "coupler_draft_max_kn",
        "demo",
        HEAVY,
    ),
)


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
