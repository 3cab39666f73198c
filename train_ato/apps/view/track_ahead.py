"""Line and plan for the planning area and the elevation profile, sent to the browser once for every profile."""

from __future__ import annotations

from typing import Any

import numpy as np

from plant_sim.units import KMH
from train_ato.apps.view.facts import Facts, ProfileCurve
from train_ato.messages.types import Array

MOST_BRAKINGS = 400
"""Largest number of planned brake applications that are sent."""


def track_ahead(facts: Facts, profile: ProfileCurve | None) -> dict[str, list[Any]]:
    """Return the lists of the display; places are those of the front of the train [m].

    Returns
    -------
    dict
        ``grades``: place, grade [‰] and elevation [m, 0 at the first place]; ``limits``: place and speed [km/h];
        ``stops``: place; ``brakings``: begin and end of the planned brake applications; ``rear``: distance of the
        centre of every vehicle behind the front; ``length`` of the train.
    """
    stops, brakings = (np.zeros(0), np.zeros((0, 2))) if profile is None else (profile.stops, profile.brakings)
    rear = facts.rear + facts.nose if facts.rear.size else np.zeros(0)
    elevations = _elevations(facts.grade_places, facts.grades)
    return {
        "grades": np.column_stack((facts.grade_places, facts.grades, elevations)).round(3).tolist(),
        "limits": np.column_stack((facts.limit_places, KMH * facts.limit_speeds)).round(3).tolist(),
        "stops": (stops + facts.nose).round(3).tolist(),
        "brakings": (brakings[:MOST_BRAKINGS] + facts.nose).round(1).tolist(),
        "rear": rear.round(2).tolist(),
        "length": [facts.length],
        "window": [facts.stop_window],
    }


def _elevations(places: Array, grades: Array) -> Array:
    """Return the elevation [m] at the places where a grade [‰] begins."""
    if not places.size:
        return np.zeros(0)
    return np.concatenate(([0.0], np.cumsum(np.diff(places) * grades[:-1] / 1e3)))
