"""Series of paper 003 that no topic carries: funnels, stretches of saturation, errors from another profile."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from train_ato.control.contract import LawInput, Preview
from train_ato.control.laws.funnel import Funnel
from train_ato.control.registry import LAWS
from train_ato.history import History
from train_ato.profile.profile import Profile
from train_ato.reproduce.claims import Case
from train_ato.run_setup import RunSetup, prepare
from train_ato.scenario import load
from train_ato.types import Array

__all__ = ["ALONE", "boundaries", "last_saturation", "off_profile", "setup_of"]

ALONE: Array = np.zeros(1)
"""Offset of the only unit [m]."""
CUT = 0.999
"""A command from this part of the limit on counts as cut."""


def setup_of(case: Case) -> RunSetup:
    """Return the setup of a case."""
    return prepare(*load(case.scenario, changes=dict(case.changes)))


@lru_cache(maxsize=4)
def _profile(scenario: str) -> Profile:
    return prepare(*load(scenario)).profile


def off_profile(history: History, scenario: str) -> tuple[Array, Array]:
    """Return position [m] and speed error [m/s] of a run from another scenario's profile, shape (k,) each."""
    profile = _profile(scenario)
    wanted = np.array([profile.at(float(t))[:2] for t in history.time])
    return history.front_position - wanted[:, 0], history.front_velocity - wanted[:, 1]


def last_saturation(history: History, limit: float) -> tuple[float, float]:
    """Return begin and end of the longest stretch with the command at a limit, gaps of 10 s bridged [s]."""
    cut = np.flatnonzero(np.abs(history.command).sum(axis=1) >= CUT * limit)
    if cut.size == 0:
        raise ValueError("the force was never at its limit")
    times = history.time[cut]
    breaks = np.flatnonzero(np.diff(times) > 10.0)
    begins = np.concatenate((times[:1], times[breaks + 1]))
    ends = np.concatenate((times[breaks], times[-1:]))
    longest = int(np.argmax(ends - begins))
    return float(begins[longest]), float(ends[longest])


def boundaries(case: Case, history: History) -> tuple[Array, Array]:
    """Return phi1 [m] and phi2 [m/s] of a run of `funnel`, shape (k,) each: its law fed once more with what it saw."""
    setup = setup_of(case)
    law = LAWS.make("funnel", setup.controller_parameters.get("funnel", {}), setup.model, setup.control_period)
    assert isinstance(law, Funnel)
    low, high = setup.model.force_limits(np.zeros(1))
    nothing = Preview(np.zeros(0), np.zeros(0), np.zeros(0))
    found = np.empty((history.time.size, 2))
    for k in range(history.time.size):
        aim, speed, pull = (
            float(series[k])
            for series in (history.reference_position, history.reference_velocity, history.reference_acceleration)
        )
        found[k] = law.phi1, law.phi2
        law.step(
            LawInput(
                t=float(history.time[k]),
                position=history.position[k],
                velocity=history.velocity[k],
                applied=history.applied[k],
                reference_position=np.array([aim]),
                reference_velocity=np.array([speed]),
                reference_acceleration=np.array([pull]),
                lead=0.0,
                acting_acceleration=pull,
                acting_jerk=0.0,
                feedforward=np.zeros(1),
                preview=nothing,
                disturbance=np.zeros(1),
                deflection=np.zeros(0),
                rate=np.zeros(0),
                coupler_force=np.zeros(0),
                shoe_force=np.zeros(1),
                train_shoe_force=0.0,
                under_way=np.zeros((0, 1)),
                force_min=low,
                force_max=high,
                saturated=False,
            )
        )
    return found[:, 0], found[:, 1]
