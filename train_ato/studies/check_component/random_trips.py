"""Trips of random trains under a law with the gains of their models.

A law fits a train if the run is tracked, meets :data:`CRITERIA`, and has no takeover by the braking law. Plant and
model are equal, there is no observer. The compensation is `preview` for a law that uses the feed-forward, `none` for
one that predicts over the delay, else `predictor`.

A train has 1 to 100 vehicles, one or more power units, draft gears of one kind, delay .1 to 1.2 s and lag .2 to .6 s.
All figures are uniform in the given ranges.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from train_ato.control.gains import MODEL
from train_ato.judge.verdict import is_tracked, verdict_line
from train_ato.loop.engine import run_engine
from train_ato.program.errors import RunFailed
from train_ato.scenario.overlays import overlay
from train_ato.scenario.scenario import check_scenario
from train_ato.scenario.scenario_data import PartCache
from train_ato.scenario.setup import prepare

TRAIN_KINDS = ("metro", "multiple unit", "coaches", "freight")
GEAR_KINDS = ("rigid", "linear", "clip", "smoothed", "table")


def random_vehicle(random: np.random.Generator, mass: float, length: float, force: float, top: float) -> dict[str, Any]:
    """Return a vehicle of a mass [t], a length [m], a largest force [kN] (0: not driven) and a top speed [km/h]."""
    base, linear, air = random.uniform([0.9, 0.004, 1e-4], [2.0, 0.01, 5e-4]).tolist()
    found: dict[str, Any] = {
        "mass_t": mass, "length": length, "rotating_mass_factor": float(random.uniform(1.02, 1.1)),
        "resistance": {"n_per_kn_kmh": [base, linear, air]},
    }  # fmt: skip
    if force > 0.0:
        corner = 0.4 * top
        found["traction"] = [{"to_kmh": corner, "force_kn": force}, {"to_kmh": top, "power_kw": force * corner / 3.6}]
        found["brake"] = [{"to_kmh": top, "force_kn": 1.05 * force}]
    return found


def random_gear(random: np.random.Generator, kind: str) -> dict[str, Any]:
    """Return a draft gear of one of :data:`GEAR_KINDS`."""
    if kind == "rigid":
        return {"kind": kind}
    if kind == "linear":
        stiffness = float(random.uniform(8, 30))
        return {"kind": kind, "stiffness_mn_per_m": stiffness, "damping_mns_per_m": 0.02 * stiffness}
    preload, stiffness, slack = random.uniform([30, 2e6, 5], [80, 5e6, 12]).tolist()
    common = {"slack_mm": slack, "damping": 1e5, "stop_stiffness": 2e8}
    clip = {"transition_stiffness": 6e7, "transition_damping": 5e6}
    if kind == "table":
        end = float(random.uniform(1500, 2270))
        return {
            "kind": kind, "deflection": [0.0, 0.08, 0.16], "loading_kn": [preload, preload + 0.35 * end, end],
            "unloading_kn": [0.0, 0.12 * end, 0.35 * end], **common, **clip,
        }  # fmt: skip
    curve = {
        "kind": kind, "stroke": 0.166, "force_at_stroke_kn": 2270, "preload_kn": preload, "preload_length_mm": 2,
        "stiffness": stiffness, "unloading_ratio": 0.3, **common,
    }  # fmt: skip
    return {**curve, **clip} if kind == "clip" else {**curve, "switching_speed": 0.02}


def random_train(random: np.random.Generator, kind: str, gear: str) -> tuple[dict[str, Any], float, float]:
    """Return a train, its acceleration at low speed [m/s²] and its top speed [km/h]."""
    if kind in ("metro", "multiple unit"):
        cars = int(random.integers(1, 9) if kind == "metro" else random.integers(3, 17))
        mass, start = float(random.uniform(25, 60)), float(random.uniform(0.5, 1.1))
        top, length = float(random.uniform(80, 120) if kind == "metro" else random.uniform(140, 250)), 22.0
        driven = [number % 2 == 0 or cars < 3 for number in range(cars)] if random.random() < 0.5 else [True] * cars
        load, force = mass, (1.08 * start + 0.03) * mass * cars / sum(driven)
    else:
        hauled = int(random.integers(10, 97) if kind == "freight" else random.integers(4, 15))
        engines = int(random.integers(1, 5) if kind == "freight" else random.integers(1, 3))
        load = float(random.uniform(25, 100) if kind == "freight" else random.uniform(38, 55))
        mass, top, length = float(random.uniform(80, 140)), 90.0, 14.0 if kind == "freight" else 26.4
        start = float(random.uniform(0.06, 0.15) if kind == "freight" else random.uniform(0.2, 0.45))
        force = (1.08 * start + 0.03) * (hauled * load + engines * mass) / engines
        places = {0, *random.choice(np.arange(1, hauled + engines), engines - 1, replace=False).tolist()}
        driven = [number in places for number in range(hauled + engines)]
    types = {
        "engine": random_vehicle(random, mass, length, force, top),
        "wagon": random_vehicle(random, load, length, 0.0, top),
    }
    found: dict[str, Any] = {
        "schema": "train_ato/consist/1", "name": "own", "vehicle_types": types,
        "train": [{"type": "engine" if each else "wagon"} for each in driven],
        "draft_gears": {"gear": random_gear(random, gear)}, "default_gear": "gear",
    }  # fmt: skip
    return found, start, top


def random_scenario(seed: int, number: int) -> dict[str, Any]:
    """Return a trip of a few minutes of a random train with grades, three speed limits and a stop.

    Five consecutive numbers have the five kinds of draft gears, four the four kinds of trains.
    """
    random = np.random.default_rng([seed, number])
    kind, gear = TRAIN_KINDS[number % len(TRAIN_KINDS)], GEAR_KINDS[number % len(GEAR_KINDS)]
    consist, start, top = random_train(random, kind, gear)
    begin = round(2.0 + sum(consist["vehicle_types"][part["type"]]["length"] for part in consist["train"]), 1)
    speed, pull = min(0.9 * top / 3.6, float(random.uniform(40, 70)) * 0.5 * start), 0.6 * start
    way = (speed * speed / pull + speed * float(random.uniform(60, 90))) * 0.5
    places = begin + 2.0 * way * np.array([0.0, 0.35, 0.65])
    steepest = min(25.0, 1000.0 * 0.3 * start / 9.81)
    grades = np.arange(begin, begin + 2.0 * way, float(random.uniform(300, 600)))
    lag, delay = random.uniform([0.2, 0.1], [0.6, 1.2]).tolist()
    return {
        "schema": "train_ato/scenario/1", "name": "own", "duration": 3000, "tick": 0.1, "step": 0.005, "seed": number,
        "plant": {"consist": consist, "line": {
            "schema": "train_ato/line/1", "name": "own", "end_km": math.ceil((begin + 2.0 * way) / 1000 + 3),
            "grades": [{"at": float(at), "grade_permille": float(random.uniform(-steepest, steepest))}
                       for at in grades],
            "speed_limits": [{"at": float(at), "speed_kmh": round(3.6 * float(random.uniform(0.6, 1.0)) * speed, 1)}
                             for at in places],
            "stops": [{"at": round(begin + 2.0 * way, 1), "name": "stop", "dwell": 15}],
        }, "lag": round(lag, 2)},
        "links": {"command": {"delay": round(delay, 2)}},
        "profile": {"plan": {"begin": begin, "end": round(begin + 2.0 * way, 1), "acceleration": pull,
                             "deceleration": pull, "jerk": min(0.5, start)}},
    }  # fmt: skip


STOP_WINDOW = 0.5
"""Largest stop error [m]."""
CRITERIA = {"stop_window": STOP_WINDOW, "brake_interventions": 0}
"""Criteria of a trip; outcome of tracking and verdict are judged by them."""
FITTING_SHARE = 0.95
"""Least part of the trips that fit."""
AFTER = 30.0
"""Time after the planned arrival [s]."""


@dataclass(frozen=True)
class Trip:
    """Trip of one random train.

    Attributes
    ----------
    train : str
        Number, vehicles, power units, draft gears, delay and lag of the train.
    refused : bool
        The law refuses the train.
    fits : bool
        The law fits the train.
    stop : float
        Stop error [m], infinite without a stop.
    result : str
        Outcome of tracking and verdict as text.
    """

    train: str
    refused: bool
    fits: bool
    stop: float
    result: str


def drive_random_trip(name: str, seed: int, number: int, values: Mapping[str, Any] | None = None) -> Trip:
    """Return the trip of a random train.

    Parameters
    ----------
    name
        Name of a law with ``gains``.
    seed, number
        Of :func:`random_scenario`.
    values
        Parameters that replace those of the model.
    """
    data, path, parts = random_scenario(seed, number), Path(f"random train {number}"), PartCache()
    nominal = prepare(check_scenario(data, path), path, parts)
    model = nominal.model
    gear = data["plant"]["consist"]["draft_gears"]["gear"]["kind"]
    train = f"train {number} ({len(model.consist.vehicles)} vehicles, {model.n_units} units, {gear}, delay "
    train += f"{data['links']['command']['delay']} s, lag {model.lag:g} s)"
    try:
        given = {"gains": MODEL, **(values or {})}
        compensation = _compensation(nominal.law(name, nominal.gains(name, given).values))
        end = round(float(nominal.profile.time[-1]) + AFTER, 1)
        change = {"law": name, "laws": {name: given}, "compensation": compensation, "criteria": CRITERIA}
        setup = prepare(check_scenario(overlay(data, change | {"duration": end}), path), path, parts)
    except ValueError as error:
        return Trip(train, True, False, float("inf"), f"refused: {error}")
    try:
        summary = run_engine(setup).summary
    except RunFailed as error:
        return Trip(train, False, False, float("inf"), str(error))
    beyond = [row["beyond_m"] for row in summary["stops"]]
    stop = max((abs(value) if value is not None else float("inf") for value in beyond), default=float("inf"))
    fits = is_tracked(summary) and summary["verdict"] == "passed" and not summary["takeovers"]
    return Trip(train, False, fits, stop, verdict_line(summary))


def _compensation(law: Any) -> str:
    """Return the compensation for a law."""
    if getattr(law, "uses_feedforward", True):
        return "preview"
    return "none" if getattr(law, "predicts_delay", False) else "predictor"


def random_trips(name: str, count: int, seed: int = 1, values: Mapping[str, Any] | None = None) -> list[Trip]:
    """Return the trips of the random trains 0 to ``count`` - 1; parameters as in :func:`drive_random_trip`."""
    return [drive_random_trip(name, seed, number, values) for number in range(count)]


def trips_text(trips: list[Trip]) -> tuple[bool, str]:
    """Return True if enough of the trips fit, and the result with the worst one."""
    driven = [trip for trip in trips if not trip.refused]
    fitting = sum(trip.fits for trip in driven)
    passed = bool(driven) and fitting >= FITTING_SHARE * len(driven)
    refused = f", {len(trips) - len(driven)} refused" if len(driven) < len(trips) else ""
    worst = min(driven or trips, key=lambda trip: (trip.fits, -trip.stop))
    return passed, f"{fitting} of {len(driven)} fit{refused}; worst: {worst.train}: {worst.result}"
