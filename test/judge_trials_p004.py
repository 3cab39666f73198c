"""Trials of the judges of paper 004."""

from __future__ import annotations

from typing import Any

from judge_trials import Trial, edge
from judge_trials_p003 import on_profile
from tracking_results import tracked

from train_ato.papers.claims import Result
from train_ato.papers.p004_gpc.cases import SAMPLINGS, WEIGHTS

TRAINS = ("half_more", "half_less", "heavy", "light", "noise")
COMFORT = {"stop_error_m": 0.1, "jerk_1s_max": 0.3, "acceleration_max": 0.5, "energy_traction_kwh": 2000.0}


def moving(speed: float = 0.01, place: float = 0.1, **figures: Any) -> Result:
    """Return a run of 100 s with constant errors."""
    result = tracked(place, speed, until=100.0)
    return Result({**result.summary, **COMFORT, **figures}, result.recording)


def long_run(speed: float = 0.01) -> Result:
    """Return a run of 400 s with a constant speed error."""
    return tracked(0.0, speed, until=400.0, duration=400.0)


def limited(place: float = 1.0, off: float = 1.0) -> Result:
    """Return a run with errors to its own reference and to the profile for 225.7 kN [m]."""
    return on_profile(off, 0.0, place, "crh380a_gpc:short")


TRIALS = (
    Trial(
        "more exact than PID",
        moving,
        {"pid long": {"speed": 1.0}},
        (edge("gpc long", "speed", 0.899, 0.901),),
        others=frozenset(("pid long", "pid preview long", "pid clamped long")),
    ),
    Trial(
        "N = 3, Nu = 2",
        moving,
        {},
        (
            *(edge(f"Ts {period}", "speed", 0.0499, 0.0501) for period in SAMPLINGS),
            edge("Ts 1.2", "speed", 0.0499, 0.0501, elsewhere=True),
        ),
        elsewhere={f"Ts {period}": {"speed": 1.0} for period in SAMPLINGS if period != 1.2},
        others=frozenset(f"Ts 0.4 lambda {weight}" for weight in WEIGHTS),
    ),
    Trial(
        "(22) leaves",
        moving,
        {},
        (
            edge("gpc normal", "place", 0.199, 0.201),
            edge("gpc on position", "place", 0.199, 0.201, elsewhere=True),
        ),
        elsewhere={"gpc normal": {"place": 1.3}, "gpc held": {"place": 0.9}},
        others=frozenset(("gpc held", "gpc on position")),
    ),
    Trial(
        "a small jump",
        moving,
        {"pid jump": {"speed": 1.0}},
        (
            edge("gpc absolute jump", "speed", 0.499, 0.501),
            edge("gpc jump", "speed", 0.499, 0.501, elsewhere=True),
        ),
        elsewhere={"gpc absolute jump": {"speed": 0.9}},
        others=frozenset(f"{key} jump" for key in ("gpc", "gpc fixed", "pid", "pid preview")),
    ),
    Trial(
        "after the jump",
        long_run,
        {},
        (
            edge("gpc absolute jump", "speed", 0.0199, 0.0201),
            edge("gpc jump", "speed", 0.0199, 0.0201, elsewhere=True),
            edge(("gpc normal", "gpc absolute jump"), "speed", 0.0499, 0.0501),
        ),
        elsewhere={"gpc absolute jump": {"speed": 0.5}},
        others=frozenset(("gpc jump",)),
    ),
    Trial(
        "the network takes",
        moving,
        {"no network": {"speed": 1.0}},
        (edge("gpc normal", "speed", 0.499, 0.501),),
        others=frozenset(("no network", "raw residual")),
    ),
    Trial(
        "multivariable",
        moving,
        {},
        (edge("per unit", "speed", 0.0499, 0.0501), edge("per unit, free", "speed", 0.0499, 0.0501, elsewhere=True)),
        elsewhere={"per unit": {"speed": 0.3}},
        others=frozenset(("per unit, free", "gpc normal")),
    ),
    Trial(
        "robust",
        moving,
        {},
        (
            *(edge(f"gpc {train}", "speed", 0.0199, 0.0201) for train in TRAINS),
            edge(("gpc normal", *(f"gpc {train}" for train in TRAINS)), "speed", 0.399, 0.401),
        ),
        others=frozenset(f"pid preview {train}" for train in ("normal", *TRAINS)),
    ),
    Trial(
        "punctual",
        moving,
        {},
        (
            edge("gpc long", "stop_error_m", 0.499, 0.501),
            edge("gpc long", "jerk_1s_max", 0.749, 0.751),
            edge("gpc on position", "stop_error_m", -0.499, -0.501, elsewhere=True),
            edge("gpc on position", "jerk_1s_max", 0.749, 0.751, elsewhere=True),
        ),
        elsewhere={"gpc long": {"stop_error_m": 8.0}},
        others=frozenset(("gpc on position",)),
    ),
    Trial(
        "efficient",
        moving,
        {},
        (edge("gpc long", "energy_traction_kwh", 2199.0, 2201.0), edge("gpc long", "speed", 0.399, 0.401)),
        others=frozenset(("pid preview long",)),
    ),
    Trial(
        "goal with 200 kN",
        limited,
        {},
        (
            edge("gpc limited", "place", 11.9, 12.1),
            edge("gpc planned", "off", 11.9, 12.1, elsewhere=True),
            edge("gpc limited", "place", 38.8, 38.6, elsewhere=True),
            edge("gpc limited", "place", 47.2, 47.4, elsewhere=True),
        ),
        elsewhere={"gpc limited": {"place": 43.0}},
        others=frozenset(("gpc planned", "pid limited", "pid preview limited", "pid preview planned")),
    ),
)
