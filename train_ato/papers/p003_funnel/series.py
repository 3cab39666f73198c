"""Series of paper 003 beyond the topics: funnels, saturation intervals, errors to another profile."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from train_ato.control.contract import LawInput, Preview
from train_ato.control.laws.funnel import Funnel
from train_ato.control.registry import LAWS
from train_ato.loop.recording import Recording
from train_ato.loop.setup import prepare
from train_ato.messages.types import Array
from train_ato.papers.claims import Case
from train_ato.profile.profile import Profile
from train_ato.scenario.scenario import load_scenario

CUT = 0.999
"""Fraction of the limit from which a command is saturated."""


@lru_cache(maxsize=4)
def _profile(scenario: str) -> Profile:
    return prepare(*load_scenario(scenario)).profile


def off_profile(recording: Recording, scenario: str) -> tuple[Array, Array]:
    """Return position [m] and speed error [m/s] to the profile of another scenario, shape (k,) each."""
    profile = _profile(scenario)
    wanted = np.array([profile.at(float(t))[:2] for t in recording.time])
    return recording.front_position - wanted[:, 0], recording.front_velocity - wanted[:, 1]


def last_saturation(recording: Recording, limit: float) -> tuple[float, float]:
    """Return begin and end of the longest interval with a saturated command, gaps up to 10 s included [s]."""
    cut = np.flatnonzero(np.abs(recording.command).sum(axis=1) >= CUT * limit)
    if cut.size == 0:
        raise ValueError("the force was never at its limit")
    times = recording.time[cut]
    breaks = np.flatnonzero(np.diff(times) > 10.0)
    begins = np.concatenate((times[:1], times[breaks + 1]))
    ends = np.concatenate((times[breaks], times[-1:]))
    longest = int(np.argmax(ends - begins))
    return float(begins[longest]), float(ends[longest])


def boundaries(case: Case, recording: Recording) -> tuple[Array, Array]:
    """Return phi1 [m] and phi2 [m/s] of a run of `funnel` from its recorded inputs, shape (k,) each."""
    setup = case.setup()
    law = LAWS.make("funnel", setup.controller_parameters.get("funnel", {}), setup.model, setup.control_period)
    assert isinstance(law, Funnel)
    low, high = setup.model.force_limits(np.zeros(1))
    nothing = Preview(np.zeros(0), np.zeros(0), np.zeros(0))
    found = np.empty((recording.time.size, 2))
    for k in range(recording.time.size):
        aim, speed, pull = (
            float(series[k])
            for series in (recording.reference_position, recording.reference_velocity, recording.reference_acceleration)
        )
        found[k] = law.state["phi1"][0], law.state["phi2"][0]
        law.step(
            LawInput(
                t=float(recording.time[k]),
                position=recording.position[k],
                velocity=recording.velocity[k],
                applied=recording.applied[k],
                reference_position=np.array([aim]),
                reference_velocity=np.array([speed]),
                reference_acceleration=np.array([pull]),
                delay_to_effect=0.0,
                acceleration_at_effect=pull,
                jerk_at_effect=0.0,
                feedforward=np.zeros(1),
                preview=nothing,
                disturbance=np.zeros(1),
                deflection=np.zeros(0),
                rate=np.zeros(0),
                coupler_force=np.zeros(0),
                shoe_force=np.zeros(1),
                train_shoe_force=0.0,
                commands_in_flight=np.zeros((0, 1)),
                force_min=low,
                force_max=high,
                saturated=False,
            )
        )
    return found[:, 0], found[:, 1]
