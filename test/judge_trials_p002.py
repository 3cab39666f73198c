"""Trials of the judges of paper 002."""

from __future__ import annotations

from typing import Any

import numpy as np
from judge_trials import Trial, edge
from recordings import with_series
from tracking_results import run

from train_ato.papers.claims import Result
from train_ato.papers.p002_freight.cases import DELAYS, OBSERVER_TICKS, RATIOS
from train_ato.papers.p002_freight.checks import GAINS, STIFFNESS_KN

OTHER_FORMS = ("implicit", "levant", "eso")
FASTEST = 2.0 * np.pi * 4 / 6.9
"""Frequency of a position error with whole periods from 3 s to 9.9 s [rad/s]."""


def observed(**changes: float) -> Result:
    """Return figures of accurate observers, with changes."""
    found = {f"{form} {part}": 0.02 for form in ("printed", *OTHER_FORMS) for part in ("d1", "d2", "d1'")}
    found |= {f"{form} {key}": 0.05 for form in ("printed", *OTHER_FORMS) for key in ("settling", "again")}
    return Result(found | changes, None)


def five(
    place: float = 0.0,
    speed: float = 0.0,
    until: float = 40.0,
    stretch: float = 0.0,
    offset: float = 0.0,
    motion: float = 0.0,
    **figures: float,
) -> Result:
    """Return a run of five cars.

    Parameters
    ----------
    place, speed, until
        Position and speed error up to a time [m, m/s, s].
    stretch
        Stretch of every coupler by the positions [m].
    offset
        Speed offset d1 between motion and measured speed [m/s].
    motion
        Rms of an oscillation of the position's rate from 3 s to 9.9 s [m/s].
    """
    recording = run(place, speed, units=5, until=until, duration=30.0, tick=0.01, force=1e6)
    wave = motion * 2**0.5 / FASTEST * np.sin(FASTEST * recording.time)[:, None]
    recording = with_series(
        recording,
        position=recording.position + stretch * np.arange(5) + wave,
        velocity=recording.velocity - offset,
    )
    return Result({"coupler_draft_max_kn": 10.0, "coupler_buff_max_kn": -10.0, **figures}, recording)


def nominal(settling: float = 0.05) -> Result:
    return Result({"settling": settling, "acceleration": 1e6}, None)


def five_or_nominal(gain: bool = False, **figures: Any) -> Result:
    return nominal(**figures) if gain else five(**figures)


def loaded(first: float = 0.0, later: float = 0.0) -> Result:
    """Return a run with stretched couplers after the step at 10 s and after that at 20 s [m]."""
    result = five()
    assert result.recording is not None
    t = result.recording.time
    force = 1e3 * STIFFNESS_KN * np.where(t > 19.0, later, np.where((t >= 10.0) & (t < 11.0), first, 0.0))
    return Result(result.summary, with_series(result.recording, coupler_draft_max=force))


def driven(place: float = 0.01, speed: float = 0.01, coupler: float = 0.1) -> Result:
    """Return a run with errors over all of its time and a largest coupler stretch [m]."""
    return five(place, speed, coupler_draft_max_kn=STIFFNESS_KN * coupler)


TEN, FIFTY = "observers 10 ms", "observers 50 ms"
IDEAL = (
    Trial(
        "the cascaded observer",
        observed,
        {},
        (
            edge("observers 1 ms", "printed settling", 0.49, 0.51),
            edge("observers 1 ms", "implicit settling", 0.49, 0.51, elsewhere=True),
        ),
        elsewhere={"observers 1 ms": {"printed settling": np.nan}},
        others=frozenset(("observers 0.01 ms",)),
    ),
    Trial(
        "the observer is ready",
        observed,
        {},
        (
            *(edge(key, f"printed {part}", 0.099, 0.101) for key in (TEN, FIFTY) for part in ("d1", "d2")),
            *(edge(key, "implicit d1", 0.099, 0.101, elsewhere=True) for key in (TEN, FIFTY)),
        ),
        elsewhere={TEN: {"printed d1": 3.0, "levant d1": 0.5}},
        others=frozenset(f"observers {key}" for key in OBSERVER_TICKS if key not in ("10 ms", "50 ms")),
    ),
    Trial(
        "the derivative of",
        observed,
        {},
        (
            edge("observers 1 ms", "printed d1'", 0.099, 0.101),
            edge("observers 1 ms", "printed again", 0.49, 0.51),
            edge("observers 1 ms", "implicit d1'", 0.099, 0.101, elsewhere=True),
            edge("observers 1 ms", "implicit again", 0.49, 0.51, elsewhere=True),
        ),
        elsewhere={"observers 1 ms": {"printed d1'": 9.0, "levant d1'": 0.5}},
    ),
    Trial(
        "the cars' speed follows",
        five_or_nominal,
        {
            "ideal": {"place": 1.0, "until": 1.7},
            "gain 1.9 from 108 m": {"gain": True},
            "gain 50 from 108 m": {"gain": True, "settling": 1.7},
        },
        (
            edge("gain 50 from 108 m", "settling", 1.37, 1.35),
            edge("gain 50 from 108 m", "settling", 2.03, 2.05),
            edge("ideal", "until", 1.37, 1.33, elsewhere=True),
            edge("ideal", "until", 2.02, 2.06, elsewhere=True),
        ),
        elsewhere={"gain 50 from 108 m": {"settling": 0.05}},
        others=frozenset(("ideal", "gain 1.9 from 108 m")),
    ),
    Trial(
        "the settling time is bounded",
        five_or_nominal,
        {
            **{key: {"place": 1.0, "until": 1.6} for key in ("ideal", "printed order")},
            **{k: {"gain": True} for k in GAINS},
        },
        (
            *(edge(key, "until", 4.4, 4.5) for key in ("ideal", "printed order")),
            *(edge(key, "settling", 0.99 * limit, 1.01 * limit, elsewhere=True) for key, limit in GAINS.items()),
        ),
        elsewhere={"printed order": {"until": 40.0}},
        others=frozenset(GAINS),
    ),
    Trial(
        "position and speed",
        five,
        {},
        (
            edge("ideal", "place", 0.099, 0.101),
            edge("ideal", "offset", 0.239, 0.241),
            edge("ideal", "place", 0.099, 0.101, elsewhere=True),
            edge("ideal", "motion", 0.239, 0.242, elsewhere=True),
        ),
        elsewhere={"ideal": {"offset": 2.0}},
    ),
    Trial(
        "the couplers return",
        loaded,
        {},
        (edge("ideal", "first", 0.099, 0.101), edge("ideal", "later", 0.099, 0.101, elsewhere=True)),
        elsewhere={"ideal": {"first": 0.6}},
    ),
    Trial(
        "the compared method",
        five,
        {"ideal": {"stretch": 150.0}},
        (
            edge("ideal", "stretch", 135.5, 134.5),
            edge("ideal", "stretch", 164.5, 165.5),
            edge("printed order", "stretch", 135.5, 134.5, elsewhere=True),
            edge("printed order", "stretch", 164.5, 165.5, elsewhere=True),
        ),
        elsewhere={"ideal": {"stretch": 0.0}, "printed order": {"stretch": 150.0}},
        others=frozenset(("printed order",)),
    ),
    Trial(
        "faster than",
        five,
        {"ideal": {"place": 1.0, "until": 1.6}, "pd fast": {"place": 1.0, "until": 8.0}},
        (edge("pd fast", "until", 6.65, 6.55), edge("ideal", "until", 2.95, 3.05)),
    ),
)

REAL = (
    Trial(
        "especially suited",
        driven,
        {},
        (
            *(edge(f"print {delay}", "place", 0.269, 0.271) for delay in DELAYS),
            *(edge(f"scaled predicted {delay}", "place", 0.269, 0.271, elsewhere=True) for delay in DELAYS),
        ),
        elsewhere={"print 1.0": {"place": 90.0}},
        others=frozenset(f"{key} {delay}" for key in ("scaled", "scaled predicted") for delay in DELAYS),
    ),
    Trial(
        "goals of the realistic",
        driven,
        {},
        (
            edge("unit 0.3", "place", 0.199, 0.201),
            edge("unit 1.0", "coupler", 0.429, 0.431),
            edge("unit slow 0.6", "place", 0.269, 0.271),
            edge("unit slow 0.8", "speed", 0.0799, 0.0801),
            edge("common x0.75", "place", 0.269, 0.271),
            edge("common x1.25", "coupler", 0.599, 0.601),
            edge("unit undisturbed", "place", 0.0199, 0.0201),
        ),
    ),
    Trial(
        "one law that",
        driven,
        {},
        (
            edge("common damped 0.3", "place", 0.199, 0.201),
            edge("common damped 1.0", "speed", 0.0799, 0.0801),
            edge("common damped 0.6", "coupler", 0.429, 0.431),
            *(edge(f"common damped x{ratio}", "place", 0.269, 0.271) for ratio in RATIOS),
            *(edge(f"common damped x{ratio}", "coupler", 0.599, 0.601) for ratio in RATIOS),
        ),
    ),
)

TRIALS = (*IDEAL, *REAL)
