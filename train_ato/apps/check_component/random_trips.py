"""Trips of random trains under a law with the gains of their models.

A law fits a train if the run is tracked, meets :data:`CRITERIA`, and has no takeover by the braking law. Plant and
model are equal, there is no observer. The compensation is `preview` for a law that uses the feed-forward, `none` for
one that predicts over the delay, else `predictor`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from train_ato.apps.check_component.random_trains import random_scenario
from train_ato.control.gains import MODEL
from train_ato.errors import RunFailed
from train_ato.loop.engine import run_engine
from train_ato.loop.part_cache import PartCache
from train_ato.loop.setup import prepare
from train_ato.loop.verdict import is_tracked, verdict_line
from train_ato.scenario.overlays import overlay
from train_ato.scenario.scenario import check_scenario

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
        found = run_engine(setup).summary
    except RunFailed as error:
        return Trip(train, False, False, float("inf"), str(error))
    return _trip(train, found)


def _compensation(law: Any) -> str:
    """Return the compensation for a law."""
    if getattr(law, "uses_feedforward", True):
        return "preview"
    return "none" if getattr(law, "predicts_delay", False) else "predictor"


def _trip(train: str, summary: Mapping[str, Any]) -> Trip:
    beyond = [row["beyond_m"] for row in summary["stops"]]
    stop = max((abs(value) if value is not None else float("inf") for value in beyond), default=float("inf"))
    fits = is_tracked(summary) and summary["verdict"] == "passed" and not summary["takeovers"]
    return Trip(train, False, fits, stop, verdict_line(summary))


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
