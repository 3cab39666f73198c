"""Trials of the judges of paper 000."""

from __future__ import annotations

from typing import Any

import numpy as np
from judge_trials import Trial, edge
from recordings import with_series
from reproduce_results import result, series

from train_ato.papers.claims import Result
from train_ato.papers.p000_heavy_haul.cases import PERIOD
from train_ato.papers.p000_heavy_haul.series import LOCOMOTIVE, disturbance_40, unexplained

COUNT = 8000
PHASE = 2.0 * np.pi * 20.0 * np.arange(COUNT) / COUNT
WAVE, ACROSS = np.sin(PHASE), np.cos(PHASE)
LAWS = ("smc", "smc_ndo", "rbf", "rbf_ndo", "smc_ks", "rbf_ks")
TRAINS = ("nominal", "disturbed", "mismatch", "strong")
TWINS = tuple(f"twin_pid {train}" for train in TRAINS)


def tracked(rms: float = 0.01, largest: float = 0.05, **more: Any) -> Result:
    return result(speed_rmse_kmh=rms, speed_error_max_kmh=largest, **more)


def swinging(kmh: float = 0.1, force: float = 0.0, largest: float | None = None) -> Result:
    """Return a run with an oscillating speed error and command, with its figures."""
    run = series(kmh / 3.6 * WAVE, force * WAVE)
    return result(run, speed_rmse_kmh=kmh / 2**0.5, speed_error_max_kmh=kmh if largest is None else largest)


def shaped(low: float = -0.1, high: float = 0.1, likeness: float = -1.0) -> Result:
    """Return a run with a range of the speed error and a correlation of error and force."""
    error = np.where(WAVE > 0.0, high, -low) * WAVE / 3.6
    return result(series(error, 1e6 * (likeness * error / error.std() + (1.0 - likeness**2) ** 0.5 * 2**0.5 * ACROSS)))


def modelled(error: float = 4e-5) -> Result:
    """Return a run at constant speed whose force leaves this acceleration to the network, which has learnt nothing."""
    return result(series(np.zeros(COUNT), np.full(COUNT, error * LOCOMOTIVE * 1.01 / 0.01)))


def observed(share: float = 0.05) -> Result:
    """Return a run whose estimate misses the truth by a share of its deviation."""
    run = series(np.zeros(COUNT), np.zeros(COUNT))
    truth = unexplained(run, PERIOD, 0.01, disturbance_40(run, PERIOD))
    return result(with_series(run, estimate=LOCOMOTIVE * (truth + share * truth.std())))


def _disturbed(names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{name} disturbed" for name in names)


def _improvement(what: str, suffix: str, low: tuple[float, float], high: tuple[float, float]) -> Trial:
    """Return the trial of a stated improvement; rms over that of SMC within and beyond its tolerance."""
    figures = {"smc": 1.0, "smc_ndo": 0.1, "rbf": 3.0, "rbf_ndo": 0.72, "smc_ks": 1.0, "rbf_ks": 0.72}
    good = {f"{key}{suffix}": {"rms": value} for key, value in figures.items()}
    printed, with_ks = f"rbf_ndo{suffix}", f"rbf_ks{suffix}"
    return Trial(
        f"RBFNN-SMC with NDO is more accurate than SMC {what}",
        tracked,
        good,
        (
            edge(printed, "rms", *low),
            edge(printed, "rms", *high),
            edge(with_ks, "rms", *low, elsewhere=True),
            edge(with_ks, "rms", *high, elsewhere=True),
        ),
        elsewhere={printed: {"rms": 0.05}},
        others=frozenset(f"{key}{suffix}" for key in ("smc_ndo", "rbf", "smc_ks", "rbf_ks")),
    )


def _goal(train: str, label: str, rms: float, largest: float) -> Trial:
    key = f"twin_pid {train}"
    edges = (edge(key, "rms", 0.99 * rms, 1.01 * rms), edge(key, "largest", 0.99 * largest, 1.01 * largest))
    return Trial(f"goal with lag 0.4 s and delay 0.8 s, twin + PID: {label}", tracked, {}, edges)


IDEAL = (
    Trial(
        "speed error of RBFNN-SMC",
        swinging,
        {},
        (edge("rbf", "kmh", 0.149, 0.151), edge("rbf_ndo", "kmh", 0.149, 0.151)),
    ),
    Trial("speed error of SMC", swinging, {}, (edge("smc", "kmh", 0.199, 0.201),)),
    Trial(
        "speed error of PID",
        shaped,
        {},
        (
            edge("pid", "low", -0.274, -0.276),
            edge("pid", "high", 0.154, 0.156),
            edge("pid", "likeness", -0.905, -0.895),
        ),
    ),
    Trial(
        "RBFNN-SMC tracks best",
        tracked,
        {"pid": {"rms": 0.1}, "smc": {"rms": 0.02}, "smc_ks": {"rms": 0.02}},
        (
            edge("rbf", "rms", 0.0179, 0.0181),
            edge("smc", "rms", 0.0899, 0.0901),
            edge("rbf_ks", "rms", 0.0179, 0.0181, elsewhere=True),
            edge("smc_ks", "rms", 0.0899, 0.0901, elsewhere=True),
        ),
        elsewhere={"rbf": {"rms": 0.03}},
        others=frozenset(("pid", "rbf_ndo", "rbf_ks", "smc_ks")),
    ),
    _improvement("without disturbance", "", (0.78, 0.785), (0.675, 0.67)),
    _improvement("under disturbance (40)", " disturbed", (0.767, 0.77), (0.655, 0.65)),
    Trial(
        "RMSE with NDO unchanged",
        tracked,
        {},
        (
            edge("rbf_ndo disturbed", "rms", 0.01099, 0.01101),
            edge("rbf_ndo disturbed", "rms", 0.00901, 0.00899),
            edge("rbf_ndo disturbed", "largest", 0.149, 0.151),
        ),
        others=frozenset(("smc", "smc disturbed")),
    ),
    Trial(
        "under (40) PID and SMC oscillate",
        swinging,
        {key: {"kmh": 0.0} for key in ("pid", "smc", "rbf_ndo")}
        | {"pid disturbed": {"kmh": 0.2}, "smc disturbed": {"kmh": 0.2}, "rbf_ndo disturbed": {"kmh": 0.05}},
        (
            edge("rbf_ndo disturbed", "kmh", 0.0999, 0.1001),
            edge("rbf_ndo disturbed", "largest", 0.149, 0.151),
        ),
        others=frozenset(("pid", "smc", "rbf_ndo", "pid disturbed", "smc disturbed")),
    ),
    Trial(
        "the network estimates delta",
        modelled,
        {},
        (edge("rbf", "error", 4.95e-5, 5.05e-5), edge("rbf_ks", "error", 4.95e-5, 5.05e-5, elsewhere=True)),
        elsewhere={"rbf": {"error": 1e-3}},
        others=frozenset(("rbf_ks",)),
    ),
    Trial(
        "the NDO observes",
        observed,
        {},
        (
            edge("rbf_ndo disturbed", "share", 0.099, 0.101),
            edge("rbf_ks_ndo disturbed", "share", 0.099, 0.101, elsewhere=True),
        ),
        elsewhere={"rbf_ndo disturbed": {"share": 0.3}},
        others=frozenset(("rbf_ks_ndo disturbed", "ndo 1000 noise", "ndo 20 noise")),
    ),
    Trial(
        "coupler forces stay",
        tracked,
        {},
        (
            edge("pid", "coupler_draft_max_kn", 746.0, 748.0),
            edge("rbf_ndo disturbed", "coupler_buff_max_kn", -746.0, -748.0),
        ),
    ),
    Trial(
        "the air brake keeps",
        tracked,
        {"rbf unbraked": {"largest": 50.0}},
        (edge("rbf", "largest", 0.149, 0.151), edge("rbf unbraked", "largest", 0.151, 0.149)),
        others=frozenset(("rbf unbraked",)),
    ),
    Trial(
        "the control force changes",
        swinging,
        {"pid": {"force": 1e5}, "smc": {"force": 5e4}, "rbf": {"force": 5e4}},
        (edge("smc", "force", 8.99e4, 9.01e4), edge("rbf", "force", 8.99e4, 9.01e4)),
        others=frozenset(("pid", "rbf_ndo")),
    ),
    Trial(
        "the network improves SMC",
        tracked,
        {
            **{"smc": {"rms": 1.0}, "rbf": {"rms": 0.5}, "smc exact": {"rms": 1.0}, "rbf exact": {"rms": 0.95}},
            **{"smc_ks": {"rms": 1.0}, "rbf_ks": {"rms": 0.5}},
        },
        (
            edge("rbf", "rms", 0.899, 0.901),
            edge("rbf exact", "rms", 0.501, 0.499),
            edge("rbf_ks", "rms", 0.899, 0.901, elsewhere=True),
        ),
        elsewhere={"rbf": {"rms": 2.0}},
        others=frozenset(("smc", "rbf exact", "smc_ks", "rbf_ks")),
    ),
)

LAGGED = (
    Trial(
        "the printed law is stable up to",
        swinging,
        {f"smc delay {delay}": {"kmh": 0.01 if delay < 0.17 else 0.5} for delay in (0.05, 0.1, 0.15, 0.2, 0.4)},
        (edge("smc delay 0.15", "kmh", 0.0999, 0.1001), edge("smc delay 0.2", "kmh", 0.1001, 0.0999)),
        others=frozenset(("smc delay 0.2", "smc delay 0.4")),
    ),
    Trial(
        "the method suits",
        tracked,
        {},
        (
            edge("rbf_ndo lagged", "largest", 0.149, 0.151),
            edge("rbf_ks_ndo lagged", "largest", 0.149, 0.151, elsewhere=True),
        ),
        elsewhere={"rbf_ndo lagged": {"largest": 5.0}},
        others=frozenset(("smc lagged", "rbf_ks_ndo lagged", "pid lagged", "pid lag")),
    ),
    Trial(
        "a twin of the whole train",
        tracked,
        {"preview_pid nominal": {"rms": 0.1}},
        (edge("twin_pid nominal", "rms", 0.0199, 0.0201), edge("preview_pid nominal", "rms", 0.0201, 0.0199)),
        others=frozenset(("preview_pid nominal",)),
    ),
    Trial(
        "a printed law works",
        tracked,
        {"predicted strong": {"rms": 5.0}},
        (edge("predicted nominal", "rms", 0.0199, 0.0201), edge("predicted strong", "rms", 1.01, 0.99)),
        others=frozenset(("predicted disturbed", "predicted mismatch", "predicted strong")),
    ),
    _goal("nominal", "nominal", 0.02, 0.30),
    _goal("disturbed", "disturbance (40)", 0.02, 0.30),
    _goal("mismatch", "+ mismatch", 0.06, 0.6),
    _goal("strong", "+ strong mismatch", 0.12, 0.8),
    Trial(
        "goal: coupler forces",
        tracked,
        {},
        (
            edge("twin_pid strong", "coupler_draft_max_kn", 599.0, 601.0),
            edge("twin_pid mismatch", "coupler_buff_max_kn", -599.0, -601.0),
        ),
    ),
    Trial(
        "goal: command variation",
        tracked,
        {},
        (
            edge(TWINS, "command_variation_kn_per_s", 14.9, 15.1),
            edge("twin_pid noise", "command_variation_kn_per_s", 99.0, 101.0),
        ),
        others=frozenset(("raw_pid noise",)),
    ),
    Trial(
        "with lag and delay the NDO",
        tracked,
        {f"twin_smc_ndo {train}": {"rms": 0.008} for train in TRAINS},
        (edge("twin_smc_ndo strong", "rms", 0.00899, 0.00901),),
        others=frozenset(f"twin_smc {train}" for train in TRAINS),
    ),
)

TRIALS = (*IDEAL, *LAGGED)
