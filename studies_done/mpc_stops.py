"""Stops of a metro train on random grades, with random delay, gain and speed noise, by mpc and pid.

    python studies_done/mpc_stops.py [--stops N] [--laws mpc,pid] [--seed N]

Every stop is a run of xuzhou_metro from 0 to 50 km/h and back to 0. Uniform: grade -20 to 20 per mille, delay .7 to 1.3
times that of the model, actuator gain .9 to 1.1, speed noise 0 to .03 m/s. The model has the grade (``known``) or a
level line (``unknown``). Columns: largest and mean distance from the target; largest jump of the acceleration at
standstill, as the mean deceleration over the last .25 s before every standstill, where it ends at once; largest
roll-back at the start.
"""

from __future__ import annotations

import argparse
from statistics import fmean
from typing import Any

import numpy as np

import train_ato as ta
from train_ato.judge.verdict import outcomes_text

PROFILE = {"phases": [{"cruise_for": 5}, {"accelerate_to_kmh": 50}, {"cruise_for": 10}, {"brake_to": 0}]}
"""Profile of 66 s."""
LAST = 0.25
"""Time before standstill in which the deceleration is measured [s]."""
RESTS = 1e-4
"""Speed up to which the train is at standstill [m/s]."""
START = 200.0
"""Place of the start [m]: beyond the ends of its line a train has no grade, and so no roll-back."""


def line(grade: float) -> dict[str, Any]:
    """Return a line with a constant grade [per mille]."""
    return {
        "schema": "train_ato/line/1", "name": "slope", "summary": "constant grade", "end_km": 10,
        "grades": [{"at": 0, "grade_permille": grade}], "speed_limits": [{"at": 0, "speed_kmh": 80}],
    }  # fmt: skip


def changes(random: np.random.Generator, known: bool) -> dict[str, Any]:
    """Return the changes of the scenario for one stop."""
    grade, delay, gain, noise = random.uniform([-20.0, 0.7, 0.9, 0.0], [20.0, 1.3, 1.1, 0.03]).tolist()
    return {
        "duration": 66, "profile": {"limits": {"jerk": 0.6, "acceleration": 0.8, "deceleration": 0.8}, **PROFILE},
        "profile.start": START, "plant.line": line(grade), "model.line": line(grade if known else 0.0),
        "links.command.delay": round(0.3 * delay, 3), "model.delay": 0.3,
        "plant.mismatch.actuator_gain": gain, "plant.sensors.velocity_noise": noise,
    }  # fmt: skip


def stop(law: str, changed: dict[str, Any], seed: int) -> tuple[float, float, float, dict[str, Any]]:
    """Return distance from the target [m], jump of the acceleration [m/s²], roll-back [m] and metrics of one run."""
    compensation = "none" if law == "mpc" else "preview"
    run = ta.run("xuzhou_metro", law=law, compensation=compensation, set=changed, seed=seed, progress=False)
    vehicles = run["train/vehicles"]
    speed = vehicles.filter(like="speed_m_s").to_numpy().mean(axis=1)
    place = vehicles.filter(like="position_m").to_numpy().mean(axis=1)
    before = round(LAST / float(vehicles.index[1] - vehicles.index[0]))
    stops = before + np.flatnonzero((np.abs(speed[before:-1]) > RESTS) & (np.abs(speed[before + 1 :]) <= RESTS)) + 1
    error = run.metrics["stop_error_m"]
    missed = float("inf") if error is None else abs(error)
    jump = float(np.abs(speed[stops - before] - speed[stops]).max()) / LAST
    return missed, jump, float(place[0] - place.min()), run.metrics


def main() -> None:
    """Print the table as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stops", type=int, default=40, metavar="N")
    parser.add_argument("--laws", default="mpc,pid", metavar="NAMES")
    parser.add_argument("--seed", type=int, default=1, metavar="N")
    options = parser.parse_args()
    print("| grade | law | stops | outcome | largest m | mean m | jump m/s² | roll-back m |\n" + "|---" * 8 + "|")
    for known in (True, False):
        for law in options.laws.split(","):
            random = np.random.default_rng(options.seed)
            found = [stop(law, changes(random, known), seed) for seed in range(1, 1 + max(1, options.stops))]
            errors, jerks, falls, metrics = zip(*found, strict=True)
            grade = "known" if known else "unknown"
            figures = f"{max(errors):.3f} | {fmean(errors):.3f} | {max(jerks):.3f} | {max(falls):.4f}"
            print(f"| {grade} | {law} | {len(found)} | {outcomes_text(metrics)} | {figures} |", flush=True)


if __name__ == "__main__":
    main()
