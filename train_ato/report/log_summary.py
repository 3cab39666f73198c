"""The summary of a run that left none, from its log: killed runs, imported ones."""

from __future__ import annotations

from typing import Any

import numpy as np

from train_ato.history import History
from train_ato.metrics import summarise
from train_ato.report.recording import Recording
from train_ato.report.thin import aligned
from train_ato.run_setup import RunSetup

NEEDED = (
    ("train/cars", "coupler"),
    ("train/measurement", "applied"),
    ("ato/reference", "acceleration"),
    ("ato/command", "force"),
)
"""Topics without which there is no series to sum up."""
OF_COUPLERS = ("coupler_draft_max_kn", "coupler_buff_max_kn")


def completed_summary(recording: Recording) -> dict[str, Any]:
    """Return the summary of a recording, worked out from the log where the run left none.

    A train that is taken as one vehicle has no coupler: there are no figures of any then.
    """
    summary = _whole_summary(recording)
    if recording.setup is None or recording.setup.shape.n_vehicles > 1:
        return summary
    return {key: value for key, value in summary.items() if key not in OF_COUPLERS}


def _whole_summary(recording: Recording) -> dict[str, Any]:
    summary = recording.summary
    if "speed_rmse_kmh" in summary or recording.setup is None:
        return summary
    history = history_of(recording, recording.setup)
    if history is None:
        return summary
    setup = recording.setup
    named = {
        "scenario": setup.scenario.name,
        "controller": setup.controller,
        "observer": setup.observer,
        "compensation": setup.compensation,
        "seed": setup.seed,
        "ticks": int(history.time.size),
        "simulated_s": history.time.size * setup.tick,
    }
    figures = summarise(setup, history)
    if recording.said.get("plant") is None:  # totals over every plant step are not known then
        for key in ("energy_traction_kwh", "energy_regenerated_kwh", "saturated_s"):
            figures.pop(key, None)
        figures["coupler_draft_max_kn"] = float(max(0.0, history.coupler_high.max())) / 1e3
        figures["coupler_buff_max_kn"] = float(min(0.0, history.coupler_low.min())) / 1e3
    return {**named, **figures, **summary}


def history_of(recording: Recording, setup: RunSetup) -> History | None:
    """Return the series of a recording at the stamps of its commands; None where one is missing."""
    if any(recording.of(topic, name) is None for topic, name in NEEDED) or not setup.model.units:
        return None
    cars, measured = recording.topics["train/cars"], recording.topics["train/measurement"]
    reference, command = recording.topics["ato/reference"], recording.topics["ato/command"]
    time = command.time[np.isin(command.time, cars.time) & np.isin(command.time, reference.time)]
    if not time.size:
        return None
    units = list(setup.model.units)
    position, speed, coupler = (aligned(time, cars.time, cars[name]) for name in ("position", "speed", "coupler"))
    n = coupler.shape[1]
    estimate, truth = recording.of("ato/estimate", "force"), recording.of("train/disturbance", "force")
    none = np.zeros((time.size, len(units)))
    return History(
        time=time,
        position=position[:, units],
        velocity=speed[:, units],
        front_position=position[:, 0],
        front_velocity=speed[:, 0],
        coupler_high=coupler.max(axis=1),
        coupler_low=coupler.min(axis=1),
        coupler_some=coupler[:, [0, max(0, (n - 1) // 2), max(0, n - 2)]],
        applied=aligned(time, measured.time, measured["applied"]),
        command=aligned(time, command.time, command["force"]),
        estimate=none if estimate is None else aligned(time, *estimate),
        disturbance=none if truth is None else aligned(time, *truth)[:, units],
        reference_position=aligned(time, reference.time, reference["position"])[:, 0],
        reference_velocity=aligned(time, reference.time, reference["speed"])[:, 0],
        reference_acceleration=aligned(time, reference.time, reference["acceleration"])[:, 0],
        final_position=float(cars["position"][-1, 0]),
        final_velocity=float(cars["speed"][-1, 0]),
        totals=_totals(recording),
    )


def _totals(recording: Recording) -> dict[str, float]:
    """Return the last running totals that the plant told, and how often the profile was planned anew."""
    totals = {"replans": float(max(0, len(recording.profiles) - 1))}
    said = recording.said.get("plant")
    for key in said.values if said is not None else ():
        numbers = said.numbers(key) if said is not None else None
        if numbers is not None:
            totals[key] = float(numbers[np.isfinite(numbers)][-1])
    return totals
