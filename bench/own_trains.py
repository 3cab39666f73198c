"""Random trains and lines of one's own, driven by laws with default parameters under the supervisor.

    python bench/own_trains.py [--trains N] [--first N] [--kinds units,coaches,freight] [--laws mpc,pid] [--every]

Kinds: ``units`` is a multiple unit of 1 to 8 driven cars, ``coaches`` one or two locomotives with 4 to 14 coaches,
``freight`` one or two locomotives with 20 to 80 wagons in draft gears with slack. Uniform: masses, forces, lag .2 to
.6 s, delay .2 to 1 s, noise of the speed up to .03 m/s; in the plant mass .95 to 1.05, resistance .9 to 1.1, gain .95
to 1.05 and delay .8 to 1.25 times those of the model. The line has random grades, speed limits and two or three stops.
mpc runs under `none`, other laws under `preview`. Columns: runs; refused plans; interventions of the supervisor and
takeovers of the braking law; runs that are not tracked; distance from the stops, largest of a run; rms of the speed
error; variation of the command; largest coupler force; the last four as median / largest of the runs.
``--every`` prints a line for every run.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml

import train_ato as ta
from train_ato.apps.check_component.random_trains import random_gear, random_vehicle
from train_ato.control.registry import LAWS
from train_ato.loop.setup import prepare
from train_ato.scenario.scenario import load_scenario

KINDS = ("units", "coaches", "freight")
"""Kinds of trains."""
CARRIED_OUT = ("stop", "rms", "rate", "coupler")
"""Figures of a run with stops."""
AFTER = 30.0
"""Time after the planned arrival at the last stop [s]."""


def train(random: np.random.Generator, kind: str) -> tuple[dict[str, Any], float, float]:
    """Return a train, its acceleration at low speed [m/s²] and its top speed [km/h]."""
    if kind == "units":
        cars, mass, start = int(random.integers(1, 9)), float(random.uniform(25, 60)), float(random.uniform(0.5, 1.2))
        top = float(random.uniform(80, 200))
        types = {"engine": random_vehicle(random, mass, float(random.uniform(15, 26)), 1.1 * start * mass, top)}
        order: list[dict[str, Any]] = [{"type": "engine", "count": cars}]
    else:
        hauled = int(random.integers(20, 81) if kind == "freight" else random.integers(4, 15))
        load = float(random.uniform(40, 100) if kind == "freight" else random.uniform(38, 55))
        engines, mass, top = int(random.integers(1, 3)), float(random.uniform(80, 140)), 90.0
        total = hauled * load + engines * mass
        start = float(random.uniform(0.06, 0.15)) if kind == "freight" else float(random.uniform(0.2, 0.45))
        force = (1.08 * start + 0.03) * total / engines
        types = {
            "engine": random_vehicle(random, mass, 20.0, force, top),
            "wagon": random_vehicle(random, load, 14.0 if kind == "freight" else 26.4, 0.0, top),
        }
        order = [{"type": "engine"}, {"type": "wagon", "count": hauled}]
        if engines == 2:
            order.insert(1 if random.random() < 0.5 else 2, {"type": "engine"})
    found: dict[str, Any] = {
        "schema": "train_ato/consist/1", "name": "own", "vehicle_types": types, "train": order,
        "draft_gears": {"gear": random_gear(random, "clip" if kind == "freight" else "linear")}, "default_gear": "gear",
    }  # fmt: skip
    return found, start, top


def line(random: np.random.Generator, start: float, top: float) -> dict[str, Any]:
    """Return a line with grades that the train climbs, speed limits, and two or three stops."""
    length = float(random.uniform(2500, 6000))
    steepest = min(25.0, 1000.0 * 0.5 * start / 9.81)
    changes, limits = (np.arange(0.0, length, float(random.uniform(*span))) for span in ((300, 900), (900, 1800)))
    stops = [*(length * np.linspace(0.0, 1.0, int(random.integers(2, 4)) + 1)[1:-1]), length]
    return {
        "schema": "train_ato/line/1", "name": "own", "end_km": length / 1000 + 3,
        "grades": [{"at": float(at), "grade_permille": float(random.uniform(-steepest, steepest))} for at in changes],
        "speed_limits": [{"at": float(at), "speed_kmh": float(random.uniform(0.4, 0.9) * top)} for at in limits],
        "stops": [{"at": round(float(at), 1), "name": f"{at:.0f} m", "dwell": 15} for at in stops],
    }  # fmt: skip


def scenario(number: int, kind: str) -> dict[str, Any]:
    """Return the scenario of a random train."""
    random = np.random.default_rng([number, KINDS.index(kind)])
    consist, start, top = train(random, kind)
    track = line(random, start, top)
    begin = round(2.0 + sum_length(consist), 1)
    for stop in track["stops"]:
        stop["at"] += begin
    lag, delay, noise = random.uniform([0.2, 0.2, 0.0], [0.6, 1.0, 0.03]).tolist()
    mass, resistance, gain, later = random.uniform([0.95, 0.9, 0.95, 0.8], [1.05, 1.1, 1.05, 1.25]).tolist()
    return {
        "schema": "train_ato/scenario/1", "name": "own", "duration": 3000, "tick": 0.1, "step": 0.005,
        "plant": {
            "consist": consist, "line": track, "lag": round(lag, 2),
            "sensors": {"velocity_noise": round(noise, 3)},
            "mismatch": {"mass_scale": mass, "resistance_scale": resistance, "actuator_gain": gain},
        },
        "links": {"command": {"delay": round(delay * later, 3)}}, "model": {"delay": round(delay, 3)},
        "profile": {
            "plan": {"begin": begin, "end": track["stops"][-1]["at"], "acceleration": 0.7 * start,
                     "deceleration": 0.7 * start, "jerk": min(0.5, start)},
        },
    }  # fmt: skip


def sum_length(consist: dict[str, Any]) -> float:
    """Return the length of a train [m]."""
    return sum(
        float(consist["vehicle_types"][part["type"]]["length"]) * part.get("count", 1) for part in consist["train"]
    )


def drive(number: int, kind: str, law: str) -> dict[str, Any]:
    """Return the figures of a run; ``problem`` for a refused plan or a failed run."""
    try:
        with TemporaryDirectory() as folder:
            file = Path(folder, "own.yaml")
            file.write_text(yaml.safe_dump(scenario(number, kind)))
            duration = float(prepare(*load_scenario(str(file))).profile.time[-1]) + AFTER
            chosen = {"law": law, "compensation": "none" if law == "mpc" else "preview", "set": {"duration": duration}}
            run = ta.run(str(file), seed=number, progress=False, **chosen)
    except ta.RunInterrupted:
        raise SystemExit(130) from None
    except (ValueError, ta.RunFailed) as error:
        return {"problem": str(error)}
    found = run.metrics
    missed = [abs(row["beyond_m"]) if row["beyond_m"] is not None else float("inf") for row in found["stops"]]
    return {
        "interventions": found["brake_interventions"], "takeovers": found["takeovers"], "tracking": found["tracking"],
        "stop": max(missed), "rms": found["speed_rmse_kmh"] / 3.6, "rate": found["command_variation_kn_per_s"],
        "coupler": max(found["coupler_draft_max_kn"], -found["coupler_buff_max_kn"]),
    }  # fmt: skip


def summary(runs: list[dict[str, Any]]) -> Iterator[str]:
    """Yield the cells of a row of the table."""
    done = [run for run in runs if "problem" not in run]
    yield from (str(len(runs)), str(len(runs) - len(done)))
    yield f"{sum(run['interventions'] for run in done)}, {sum(run['takeovers'] for run in done)}"
    yield str(sum(run["tracking"] != "tracked" for run in done))
    for name, style in zip(CARRIED_OUT, (".3f", ".4f", ".1f", ".0f"), strict=True):
        values = [run[name] for run in done]
        yield f"{median(values):{style}} / {max(values):{style}}" if values else "-"


def main() -> None:
    """Print the table as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trains", type=int, default=20, metavar="N", help="trains of every kind")
    parser.add_argument("--first", type=int, default=1, metavar="N")
    parser.add_argument("--kinds", default=",".join(KINDS), metavar="NAMES")
    parser.add_argument("--laws", default="mpc,pid", metavar="NAMES")
    parser.add_argument("--every", action="store_true")
    options = parser.parse_args()
    kinds, laws = options.kinds.split(","), options.laws.split(",")
    for name, given, known in (("kinds", kinds, KINDS), ("laws", laws, LAWS.names())):
        if unknown := sorted(set(given) - set(known)):
            parser.error(f"--{name} {','.join(unknown)}: unknown; known: {', '.join(known)}")
    heads = (
        "kind | law | runs | refused | interventions, takeovers | not tracked | stop m | rms m/s | kN/s | coupler kN"
    )
    print(f"| {heads} |\n" + "|---" * 10 + "|")
    for kind in kinds:
        for law in laws:
            runs = []
            for number in range(options.first, options.first + max(1, options.trains)):
                runs.append(drive(number, kind, law))
                if options.every:
                    print(f"{kind} {number} {law} {runs[-1]}", file=sys.stderr, flush=True)
            print(f"| {kind} | {law} | {' | '.join(summary(runs))} |", flush=True)


if __name__ == "__main__":
    main()
