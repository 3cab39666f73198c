"""Runs of the CRH380A as three power units for paper 004: 286 km for the figures of the paper, else short."""

from collections.abc import Mapping
from typing import Any

from train_ato.papers.checks import PrintedForm
from train_ato.papers.claims import Case

SAMPLINGS = (0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.6)
"""Sampling periods of the law [s]."""
WEIGHTS = (0.001, 0.01, 1.0, 10.0)
"""Values of lambda at 0.4 s, beside 0.1 [s²]."""
JUMP = 100.0
"""Time of the jump of the variant `jump` [s]."""
UNCLAMPED = 1e6
"""Limit of the PID's integral [m]: none, the default of 20 m binds in some of the runs."""


def _gpc(**parameters: Any) -> dict[str, Any]:
    return {"law": "gpc", "compensation": "none", "laws": {"gpc": parameters}}


def _pid(compensation: str, **parameters: Any) -> dict[str, Any]:
    laws = {"pid": {"integral_limit": UNCLAMPED, **parameters}}
    return {"law": "pid", "compensation": compensation, "laws": laws}


LAWS: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "gpc": ("gpc, Ts 1.2, on the mean speed", _gpc()),
    "gpc fixed": ("the same without identification", _gpc(identify="none")),
    "gpc absolute": ("the same, identified on the speed as printed", _gpc(identify="absolute")),
    "pid": ("PID", _pid("none", feedforward=False)),
    "pid preview": ("PID + preview", _pid("preview")),
    "predictor": (
        "PID + predictor + eso",
        {**_pid("predictor"), "observer": "eso", "observers": {"eso": {"omega": 0.5}}},
    ),
}
"""Label and changes by key, in the order of the table."""

TRAINS: Mapping[str, tuple[str, str]] = {
    "normal": ("normal", ""),
    "jump": ("jump: gain 0.8, T x1.3, tau 0.6", "+jump"),
    "half_more": ("delay x1.5", "+delay_half_more"),
    "half_less": ("delay x0.5", "+delay_half_less"),
    "noise": ("noise 0.05 m/s", "+noise"),
    "heavy": ("mass +20 %", "+heavy"),
    "light": ("mass -20 %", "+light"),
    "limited": ("200 kN", "+limited"),
}
"""Label and variants of the short run by key."""


def _cases() -> dict[str, Case]:
    short = "crh380a_gpc:short"
    cases = {f"{key} long": Case("crh380a_gpc", LAWS[key][1]) for key in ("gpc", "pid", "pid preview")}
    for key, (_, changes) in LAWS.items():
        for train, (_, variants) in TRAINS.items():
            cases[f"{key} {train}"] = Case(f"{short}{variants}", changes)
    for sampling in SAMPLINGS:
        cases[f"Ts {sampling}"] = Case(short, _gpc(sampling=sampling))
        cases[f"Ts {sampling} held"] = Case(short, _gpc(sampling=sampling, beyond_horizon="hold"))
    for weight in WEIGHTS:
        cases[f"Ts 0.4 lambda {weight}"] = Case(short, _gpc(sampling=0.4, command_weight=weight))
    cases["Ts 0.1 long horizon"] = Case(short, _gpc(sampling=0.1, n=30, nu=10, beyond_horizon="hold"))
    cases["no network"] = Case(short, _gpc(use_network=False))
    cases["raw residual"] = Case(short, _gpc(learning_rate=1.0))
    cases["stationary"] = Case(short, _gpc(residual_gain="stationary"))
    cases["unbounded jump"] = Case(f"{short}+jump", _gpc(identify="absolute", deviation_limit=1e9))
    cases["per unit"] = Case(short, _gpc(structure="unit"))
    cases["per unit, free"] = Case(f"{short}+free", _gpc(structure="unit"))
    cases["gpc held"] = Case(short, _gpc(beyond_horizon="hold"))
    cases["gpc on position"] = Case(short, _gpc(position_gain=0.02))
    cases["gpc planned"] = Case("crh380a_gpc:short+planned_ahead", _gpc())
    clamped = _pid("none", feedforward=False, integral_limit=20.0)
    cases["pid clamped long"] = Case("crh380a_gpc", clamped)
    cases["pid preview planned"] = Case("crh380a_gpc:short+planned_ahead", _pid("preview"))
    return cases


CASES = _cases()
PRINTED_FORMS = (
    PrintedForm("Hc(1) = B(1) Lc(1) of (21)", "stationary", "Lc of the cost", "gpc normal"),
    PrintedForm(
        "identification (10) on v, without a bound; parameter jump",
        "unbounded jump",
        "within half the norm of B",
        "gpc absolute jump",
    ),
    PrintedForm("one law per unit (18); coupled units", "per unit", "one law on the mean speed", "gpc normal"),
)
