"""Random trains and lines of one's own under errors of the model: mpc beside pid with preview and gains of the model.

    python studies_done/own_trains.py [--trains 200] [--first 1] [--workers N] [--worst 10] [--every]

The number of a train is the seed of all its figures: 1 to 200 by default, `--first 201 --trains 50` are others.
Consecutive numbers have the classes metro (1 to 8 cars), multiple unit (3 to 16) and freight (1 to 200 vehicles), all
kinds of couplers, and power units in front, at both ends, in the middle or distributed. Uniform: masses, forces, delay
.2 to 1 s, lag .2 to .6 s. The plant has .5 to 1.5 times the delay of the model, .7 to 1.5 of its lag, .85 to 1.15 of
its mass and gain, .8 to 1.2 of its resistance; a third each has noise of the speed up to .03 m/s, traction of .6 to .9,
and a jump of gain, lag, mass or delay on the way. Both laws drive with default parameters under the supervisor.

A train misses if `mpc` is not tracked or the braking law takes over where `pid` is tracked, if its coupler force is
above 1.2 times that of `pid` and above half of 1 000 kN, or if its command varies more under noise. The cause of a miss
is the error of the model without which the train no longer misses, or comes closest to it.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml

import train_ato as ta
from train_ato.studies.check_component.random_trips import GEAR_KINDS, random_gear, random_vehicle
from train_ato.scenario.setup import prepare
from train_ato.scenario.scenario import load_scenario

CLASSES = ("metro", "multiple unit", "freight")
"""Classes of trains."""
PLACES = ("front", "ends", "middle", "distributed")
"""Places of the power units."""
STACKS: dict[str, dict[str, Any]] = {
    "mpc": {"law": "mpc", "compensation": "none"},
    "pid": {"law": "pid", "compensation": "preview", "set": {"laws.pid.gains": "model"}},
}
"""Law, compensation and parameters of the columns."""
HALF_LIMIT = 500.0
"""Coupler force that is no miss [kN]: half of the proof load of a screw coupling of 1 MN, EN 15566."""
COUPLER_RATIO = 1.2
"""Largest ratio of the coupler forces of the two laws."""
AFTER = 30.0
"""Time after the planned arrival at the last stop [s]."""


def driven_places(random: np.random.Generator, place: str, count: int, driven: int) -> list[bool]:
    """Return True for every power unit of a train of ``count`` vehicles."""
    first = {"front": 0, "middle": (count - driven) // 2}.get(place, 0)
    chosen = set(range(first, first + driven))
    if place == "ends":
        rear = driven // 2
        chosen = {*range(driven - rear), *range(count - rear, count)}
    elif place == "distributed":
        chosen = {0, *random.choice(np.arange(1, max(count, 2)), driven - 1, replace=False).tolist()}
    return [number in chosen for number in range(count)]


def train(random: np.random.Generator, kind: str, gear: str, place: str) -> tuple[dict[str, Any], float, float]:
    """Return a train, its acceleration at low speed [m/s²] and its top speed [km/h]."""
    if kind == "freight":
        count = max(1, round(float(np.exp(random.uniform(0.0, np.log(200.0))))))
        driven = min(count, int(random.integers(1, 5)))
        load, mass, top = float(random.uniform(25, 100)), float(random.uniform(80, 140)), 90.0
        start, length = float(random.uniform(0.06, 0.15)), 14.0
    else:
        count = int(random.integers(1, 9) if kind == "metro" else random.integers(3, 17))
        driven = max(1, int(random.integers(1, 4)) * count // 3)
        load = mass = float(random.uniform(25, 60))
        top = float(random.uniform(80, 120) if kind == "metro" else random.uniform(140, 250))
        start, length = float(random.uniform(0.4, 1.1)), 22.0
    total = (count - driven) * load + driven * mass
    types = {
        "engine": random_vehicle(random, mass, length, (1.08 * start + 0.03) * total / driven, top),
        "wagon": random_vehicle(random, load, length, 0.0, top),
    }
    order = [{"type": "engine" if each else "wagon"} for each in driven_places(random, place, count, driven)]
    found: dict[str, Any] = {
        "schema": "train_ato/consist/1", "name": "own", "vehicle_types": types, "train": order,
        "draft_gears": {"gear": random_gear(random, gear)}, "default_gear": "gear",
    }  # fmt: skip
    return found, start, top


def line(random: np.random.Generator, start: float, top: float) -> dict[str, Any]:
    """Return a line with grades that the train climbs, speed limits, and two or three stops."""
    length = float(random.uniform(2500, 6000))
    steepest = min(25.0, 1000.0 * 0.3 * start / 9.81)
    changes, limits = (np.arange(0.0, length, float(random.uniform(*span))) for span in ((300, 900), (900, 1800)))
    stops = [*(length * np.linspace(0.0, 1.0, int(random.integers(2, 4)) + 1)[1:-1]), length]
    return {
        "schema": "train_ato/line/1", "name": "own", "end_km": length / 1000 + 4,
        "grades": [{"at": float(at), "grade_permille": float(random.uniform(-steepest, steepest))} for at in changes],
        "speed_limits": [{"at": float(at), "speed_kmh": float(random.uniform(0.4, 0.9) * top)} for at in limits],
        "stops": [{"at": round(float(at), 1), "name": f"{at:.0f} m", "dwell": 15} for at in stops],
    }  # fmt: skip


def errors(random: np.random.Generator) -> dict[str, Any]:
    """Return the errors of the model by name; ``jump`` is a pair of its kind and factor."""
    low = [0.5, 0.7, 0.85, 0.85, 0.8, 0.6, 0.005]
    high = [1.5, 1.5, 1.15, 1.15, 1.2, 0.9, 0.03]
    values = random.uniform(low, high).tolist()
    found = dict(zip(("delay", "lag", "mass", "gain", "resistance", "traction", "noise"), values, strict=True))
    jump = (("gain", 0.8), ("lag", 1.5), ("mass", 1.1), ("delay", 1.3))[random.integers(4)]
    drawn = (random.random(3) < 1 / 3).tolist()
    for name, kept in zip(("traction", "noise"), drawn, strict=False):
        if not kept:
            del found[name]
    return {**found, "jump": jump} if drawn[2] else found


def scenario(number: int, without: str = "") -> tuple[str, dict[str, Any]]:
    """Return the kind and the scenario of a random train, without one of the errors of its model."""
    random = np.random.default_rng([number])
    kind, gear, place = CLASSES[number % 3], GEAR_KINDS[number % 5], PLACES[number % 4]
    consist, start, top = train(random, kind, gear, place)
    track = line(random, start, top)
    begin = round(2.0 + sum(consist["vehicle_types"][part["type"]]["length"] for part in consist["train"]), 1)
    for stop in track["stops"]:
        stop["at"] += begin
    lag, delay = random.uniform([0.2, 0.2], [0.6, 1.0]).tolist()
    wrong = errors(random)
    wrong.pop(without, None)
    jump, later = wrong.pop("jump", None), round(delay * wrong.get("delay", 1.0), 3)
    noise = wrong.get("noise", 0.0)
    link: dict[str, Any] = {"delay": later}
    jumps = [] if jump is None or jump[0] == "delay" else [{"at": 90, "what": jump[0], "factor": jump[1]}]
    if jump is not None and jump[0] == "delay":
        link["jump"] = {"at": 90, "factor": jump[1]}
    place = place if sum(part["type"] == "engine" for part in consist["train"]) < len(consist["train"]) else "all"
    return f"{kind}, {len(consist['train'])} vehicles, {gear}, {place}", {
        "schema": "train_ato/scenario/1", "name": "own", "duration": 3000, "tick": 0.1, "step": 0.005,
        "plant": {
            "consist": consist, "line": track, "lag": round(lag * wrong.get("lag", 1.0), 3), "jumps": jumps,
            "sensors": {"velocity_noise": round(noise, 3)},
            "mismatch": {"mass_scale": wrong.get("mass", 1.0), "resistance_scale": wrong.get("resistance", 1.0),
                         "actuator_gain": wrong.get("gain", 1.0), "traction_scale": wrong.get("traction", 1.0)},
        },
        "links": {"command": link}, "model": {"delay": round(delay, 3), "lag": round(lag, 3)},
        "profile": {
            "plan": {"begin": begin, "end": track["stops"][-1]["at"], "acceleration": 0.7 * start,
                     "deceleration": 0.7 * start, "jerk": min(0.5, start)},
        },
    }  # fmt: skip


def drive(number: int, law: str, without: str = "", more: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return the figures of a run; ``problem`` for a refused plan or a failed run."""
    kind, data = scenario(number, without)
    figures: dict[str, Any] = {"kind": kind, "noise": data["plant"]["sensors"]["velocity_noise"] > 0.0}
    try:
        with TemporaryDirectory() as folder:
            file = Path(folder, "own.yaml")
            file.write_text(yaml.safe_dump(data))
            duration = float(prepare(*load_scenario(str(file))).profile.time[-1]) + AFTER
            chosen = STACKS[law] | {"set": {**STACKS[law].get("set", {}), **(more or {}), "duration": duration}}
            run = ta.run(str(file), seed=number, progress=False, **chosen)
    except ta.RunInterrupted:
        raise SystemExit(130) from None
    except (ValueError, ta.RunFailed) as error:
        return figures | {"problem": str(error)}
    found = run.metrics
    missed = [abs(row["beyond_m"]) if row["beyond_m"] is not None else float("inf") for row in found["stops"]]
    return figures | {
        "interventions": found["brake_interventions"], "takeovers": found["takeovers"], "outcome": found["tracking"],
        "stop": max(missed), "rms": found["speed_rmse_kmh"] / 3.6, "rate": found["command_variation_kn_per_s"],
        "coupler": max(found["coupler_draft_max_kn"], -found["coupler_buff_max_kn"], 0.0),
    }  # fmt: skip


def missed_by(mpc: dict[str, Any], pid: dict[str, Any]) -> dict[str, float]:
    """Return the excess of every figure in which mpc misses over that of pid; {} for a train without a miss."""
    if "problem" in mpc or "problem" in pid:
        return {}
    found = {}
    if pid["outcome"] == "tracked" and not pid["takeovers"] and (mpc["outcome"] != "tracked" or mpc["takeovers"]):
        found[mpc["outcome"] if mpc["outcome"] != "tracked" else "takeover"] = 10.0
    if mpc["coupler"] > max(HALF_LIMIT, COUPLER_RATIO * pid["coupler"]):
        found["couplers"] = mpc["coupler"] / max(HALF_LIMIT, COUPLER_RATIO * pid["coupler"])
    if mpc["noise"] and mpc["rate"] > pid["rate"]:
        found["variation"] = mpc["rate"] / pid["rate"]
    return found


def pair(number: int, without: str = "") -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the figures of both laws for a train, without one of the errors of its model."""
    return drive(number, "mpc", without), drive(number, "pid", without)


def cause(number: int) -> str:
    """Return the error of the model that makes a train miss."""
    names = (*errors(np.random.default_rng(0)), "traction", "noise", "jump")
    left = {}
    for name in dict.fromkeys(names):
        if scenario(number, name)[1] != scenario(number)[1]:
            left[name] = max(missed_by(*pair(number, name)).values(), default=0.0)
    name = min(left, key=lambda each: left[each])
    return f"{name}: none without it" if left[name] == 0.0 else f"no single error; nearest without {name}"


def summary(runs: list[dict[str, Any]]) -> Iterator[str]:
    """Yield the cells of a row of the table."""
    done = [run for run in runs if "problem" not in run]
    yield from (str(len(runs)), str(len(runs) - len(done)))
    yield f"{sum(run['interventions'] for run in done)}, {sum(run['takeovers'] for run in done)}"
    outcomes = [run["outcome"] for run in done if run["outcome"] != "tracked"]
    yield ", ".join(f"{outcomes.count(name)} {name}" for name in sorted(set(outcomes))) or "-"
    for name, style in (("stop", ".3f"), ("rms", ".4f"), ("rate", ".1f"), ("coupler", ".0f")):
        values = [run[name] for run in done]
        yield f"{median(values):{style}} / {max(values):{style}}" if values else "-"


def main() -> None:
    """Print the tables as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trains", type=int, default=200, metavar="N", help="number of trains (default: 200)")
    parser.add_argument("--first", type=int, default=1, metavar="N", help="first train (default: 1)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N", help="processes")
    parser.add_argument("--worst", type=int, default=10, metavar="N", help="misses whose cause is searched")
    parser.add_argument("--every", action="store_true", help="print the figures of every train")
    options = parser.parse_args()
    numbers = range(options.first, options.first + max(1, options.trains))
    found = {}
    with ProcessPoolExecutor(max(1, options.workers)) as pool:
        for number, both in zip(numbers, pool.map(pair, numbers), strict=True):
            found[number] = both
            if options.every:
                print(f"{number} {both[0]['kind']}\n  mpc {both[0]}\n  pid {both[1]}", file=sys.stderr, flush=True)
        misses = {number: each for number, both in found.items() if (each := missed_by(*both))}
        worst = sorted(misses, key=lambda number: -max(misses[number].values()))[: options.worst]
        causes = list(pool.map(cause, worst))
    print(
        "| class | law | runs | refused | interventions, takeovers | not tracked "
        "| stop m | rms m/s | kN/s | coupler kN |"
    )
    print("|---" * 10 + "|")
    for kind in (*CLASSES, "all"):
        for column, law in enumerate(STACKS):
            runs = [both[column] for both in found.values() if kind == "all" or both[0]["kind"].startswith(kind)]
            print(f"| {kind} | {law} | {' | '.join(summary(runs))} |")
    print(
        f"\n{len(misses)} of {len(found)} trains miss.\n\n"
        "| train | kind | outcome | misses | mpc kN, kN/s | pid | cause |\n" + "|---" * 7 + "|"
    )
    for number, why in zip(worst, causes, strict=True):
        cells = [f"{run['coupler']:.0f}, {run['rate']:.1f}" for run in found[number]]
        what = ", ".join(f"{name} {value:.2f}" if value < 10.0 else name for name, value in misses[number].items())
        kind, outcome = found[number][0]["kind"], found[number][0]["outcome"]
        print(f"| {number} | {kind} | {outcome} | {what} | {' | '.join(cells)} | {why} |")


if __name__ == "__main__":
    main()
