"""Trials of the judges of paper 003."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from judge_trials import Trial, edge
from recordings import with_series
from tracking_results import run, tracked, with_command

from train_ato.loop.setup import prepare
from train_ato.papers.claims import Result
from train_ato.profile.profile import Profile
from train_ato.scenario.scenario import load_scenario

LIMITED = 200e3
MISMATCHES = tuple(f"printed {key}" for key in ("half_more", "later", "lagging", "light"))


def throughout(place: float = 0.01, speed: float = 0.001, until: float = 100.0, **more: Any) -> Result:
    """Return a run of 100 s with errors to its end, unless a time is given."""
    return tracked(place, speed, until=until, **more)


def saturated(place: float = 44.0, speed: float = 4.0, length: float = 77.0, until: float = 100.0) -> Result:
    """Return a run of 100 s that brakes at the limit for a time from 2 s on."""
    result = tracked(place, speed, until=until)
    assert result.recording is not None
    t = result.recording.time
    return with_command(result, np.where((t >= 2.0) & (t <= 2.0 + length), -LIMITED, 0.0))


@cache
def profile(scenario: str) -> Profile:
    """Return the profile of a shipped scenario."""
    return prepare(*load_scenario(scenario)).profile


def on_profile(
    off: float = 1.0, fast: float = 0.1, own: float = 0.01, scenario: str = "crh380a_funnel:short"
) -> Result:
    """Return a run with constant errors to the profile of a scenario [m, m/s] and to its own reference [m]."""
    base = run(tick=0.5)
    wanted = np.array([profile(scenario).at(float(t))[:2] for t in base.time])
    position = wanted[:, 0] + off
    recording = with_series(
        base,
        position=position,
        front_position=position,
        front_velocity=wanted[:, 1] + fast,
        reference_position=position - own,
    )
    return Result({"command_variation_kn_per_s": 1.0}, recording)


def _lost(key: str) -> tuple[Any, ...]:
    return (
        edge(key, "place", 2510.0, 2490.0),
        edge(key, "place", 9990.0, 10_010.0),
        edge(key, "speed", 20.1, 19.9),
        edge(key, "speed", 39.9, 40.1),
    )


TRIALS = (
    Trial(
        "tracking without",
        throughout,
        {},
        (
            edge("printed long", "place", 0.099, 0.101),
            edge("printed long", "speed", 0.0099, 0.0101),
            edge("corrected long", "place", 0.099, 0.101, elsewhere=True),
            edge("corrected long", "speed", 0.0099, 0.0101, elsewhere=True),
        ),
        elsewhere={"printed long": {"place": 0.5}},
        others=frozenset(("corrected long",)),
    ),
    Trial(
        "Theorem 1",
        throughout,
        {"printed long": {"place": 0.001}, "corrected long": {"place": 0.02, "until": 0.9}},
        (
            edge("printed long", "place", 0.00249, 0.00251),
            edge("corrected long", "place", 0.0249, 0.0251, elsewhere=True),
            edge("corrected long", "until", 50.75, 50.8, elsewhere=True),
            edge("corrected long", "speed", 0.0105, 0.0106, elsewhere=True),
        ),
        elsewhere={"printed long": {"place": 0.05}},
        others=frozenset(("corrected long",)),
    ),
    Trial(
        "the delay state",
        throughout,
        {f"{law} no delay state": {"place": 0.1} for law in ("printed", "corrected")},
        (
            edge("printed nominal", "place", 0.0499, 0.0501),
            edge("corrected nominal", "place", 0.0499, 0.0501, elsewhere=True),
        ),
        elsewhere={"printed nominal": {"place": 0.09}},
        others=frozenset(
            (
                *("printed no delay state", "corrected nominal", "corrected no delay state"),
                *("pid nominal", "pid alone"),
            )
        ),
    ),
    Trial(
        "robust to",
        throughout,
        {},
        (
            *(edge(key, "place", 0.0199, 0.0201) for key in (*MISMATCHES, "printed position noise")),
            edge(("printed nominal", *MISMATCHES, "printed position noise"), "place", 0.499, 0.501),
        ),
        others=frozenset(("corrected position noise",)),
    ),
    Trial(
        "goal with 0.05",
        throughout,
        {},
        (
            edge("quiet noise", "command_variation_kn_per_s", 59.9, 60.1),
            edge("quiet noise", "place", 0.499, 0.501),
        ),
        others=frozenset(f"{key} noise" for key in ("printed", "corrected", "pid", "predictor")),
    ),
    Trial(
        "stable in saturation",
        saturated,
        {},
        (
            edge("printed long saturated", "place", 40.1, 39.9),
            edge("printed long saturated", "place", 47.9, 48.1),
            edge("printed long saturated", "speed", 3.21, 3.19),
            edge("printed long saturated", "speed", 4.79, 4.81),
            edge("printed long saturated", "length", 62.0, 61.0),
            edge("printed long saturated", "length", 92.0, 93.0),
        ),
        others=frozenset(("printed long", "pid saturated")),
    ),
    Trial(
        "recovery when",
        saturated,
        {"printed long saturated": {"length": 20.0, "until": 30.0}},
        (edge("printed long saturated", "until", 43.8, 44.3),),
    ),
    Trial(
        "the speed recovers far sooner",
        saturated,
        {"printed long saturated": {"speed": 0.011, "length": 2.0, "until": 10.0}},
        (edge("printed long saturated", "until", 18.0, 18.4),),
    ),
    Trial(
        "without handling",
        throughout,
        {"unhandled long": {"place": 5000.0, "speed": 30.0}},
        _lost("unhandled long"),
        others=frozenset(("unhandled 10 ms", "unhandled", "unhandled clipped", "unhandled aware")),
    ),
    Trial(
        "the same at finer",
        throughout,
        {"unhandled 1 ms": {"place": 5000.0, "speed": 30.0}},
        _lost("unhandled 1 ms"),
        others=frozenset(("unhandled long 10 ms",)),
    ),
    Trial(
        "the dynamic funnel",
        throughout,
        {"printed saturated": {"place": 20.0}, "fixed gains": {"place": 44.0}, "unhandled aware": {"place": 900.0}},
        (
            edge("printed saturated", "place", 21.9, 22.1),
            edge("unhandled aware", "place", 88.1, 87.9, elsewhere=True),
        ),
        elsewhere={"printed saturated": {"place": 44.0}},
        others=frozenset(("fixed gains", "unhandled aware")),
    ),
    Trial(
        "goal at 200 kN",
        on_profile,
        {},
        (
            *(edge(f"predictor {key}", "off", 12.9, 13.1) for key in ("planned", "replanned")),
            *(edge(f"predictor {key}", "fast", 0.99, 1.01) for key in ("planned", "replanned")),
            edge("predictor planned", "own", 0.099, 0.101),
            edge("predictor planned", "off", 12.9, 13.1, elsewhere=True),
            edge("predictor planned", "fast", 0.99, 1.01, elsewhere=True),
            edge("predictor planned", "own", 0.099, 0.101, elsewhere=True),
        ),
        elsewhere={"predictor replanned": {"off": 56.0}},
        others=frozenset(("predictor saturated",)),
    ),
)
