"""Runs of the freight train for paper 002: the printed setting at 1 ms, and a realistic setting over the delay."""

from collections.abc import Mapping
from typing import Any

from train_ato.papers.checks import PrintedForm
from train_ato.papers.claims import Calculation, Case
from train_ato.papers.p002_freight.observer_trials import nominal_settling, observer_accuracy

DELAYS: Mapping[float, str] = {0.3: "+delay_0_3", 0.6: "", 0.8: "+delay_0_8", 1.0: "+delay_1_0"}
"""Variant of the scenario by command delay [s]."""

RATIOS = (0.75, 0.9, 1.1, 1.25)
"""Ratio of true to modelled delay, for a modelled delay of 0.8 s."""


def _fixed_time(gain: float, **more: Any) -> dict[str, Any]:
    return {"fixed_time_smc": {"surface": gain, "reaching": gain, **more}}


LAWS: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "print": (
        "paper's law, gain 2, cascaded observer",
        {
            "law": "fixed_time_smc",
            "compensation": "none",
            "observer": "cascaded",
            "observers": {"cascaded": {"method": "implicit"}},
            "laws": _fixed_time(2, unmatched=True, offset_bandwidth=5),
        },
    ),
    "scaled": (
        "paper's law, gain 0.3, eso",
        {"law": "fixed_time_smc", "compensation": "none", "laws": _fixed_time(0.3, unmatched=False)},
    ),
    "scaled predicted": (
        "paper's law, gain 0.3, eso, predictor",
        {"law": "fixed_time_smc", "laws": _fixed_time(0.3, unmatched=False)},
    ),
    "pd": (
        "PD per car, ndo",
        {
            "law": "pid",
            "compensation": "none",
            "observer": "ndo",
            "observers": {"ndo": {"omega": 0.7}},
            "laws": {"pid": {"kp": 0.5, "ki": 0.06}},
        },
    ),
    "unit": ("lag_smc per car (1, 0.25), eso, predictor", {}),
    "unit slow": ("lag_smc per car (0.6, 0.09), eso, predictor", {"laws": {"lag_smc": {"c1": 0.6, "c0": 0.09}}}),
    "common": (
        "lag_smc common, damping 0.2, eso, predictor",
        {"laws": {"lag_smc": {"command": "common", "damping": 0.2}}},
    ),
    "common damped": (
        "lag_smc common, damping 0.5, eso, predictor",
        {"laws": {"lag_smc": {"command": "common", "damping": 0.5}}},
    ),
}
"""Label and changes by key, in the order of the table."""

OBSERVER_TICKS: Mapping[str, tuple[float, float, float]] = {
    "0.01 ms": (1e-5, 0.1, 0.06), "0.1 ms": (1e-4, 0.5, 0.3), "1 ms": (1e-3, 30.0, 0.5), "10 ms": (1e-2, 30.0, 0.5),
    "50 ms": (5e-2, 30.0, 0.5),
}  # fmt: skip
"""Tick, duration and begin of the evaluation [s] by sampling time."""

PD = {"law": "pid", "observer": "none", "plant": {"disturbances": []}, "duration": 10.0}
"""PD law, undisturbed: the rate of convergence depends on its gains only."""


def _pd(kp: float, ki: float) -> Case:
    gains = {"pid": {"kp": kp, "ki": ki, "integral_limit": 1000}}
    return Case("freight_consensus", {**PD, "laws": gains})


def _cases() -> dict[str, Case | Calculation]:
    cases: dict[str, Case | Calculation] = {
        f"observers {key}": Calculation(observer_accuracy, {"tick": tick, "duration": duration, "settle": settle})
        for key, (tick, duration, settle) in OBSERVER_TICKS.items()
    }
    cases["ideal"] = Case("freight_consensus", {})
    implicit = {"observers": {"cascaded": {"method": "implicit"}}}
    cases["ideal implicit"] = Case("freight_consensus", implicit)
    cases["ideal explicit"] = Case("freight_consensus", {"observers": {"cascaded": {"method": "explicit"}}})
    literal = {"fixed_time_smc": {"states": "estimated", "unmatched": True}}
    cases["ideal estimated"] = Case("freight_consensus", {"observer": "none", "laws": literal})
    cases["printed order"] = Case("freight_consensus:printed_order", {"duration": 10})
    cases["pd fast"] = _pd(9.0, 20.0)
    for key, (_, changes) in LAWS.items():
        for delay, variant in DELAYS.items():
            cases[f"{key} {delay}"] = Case(f"freight_consensus:realistic{variant}", changes)
    for key in ("unit", "common", "common damped"):
        for ratio in RATIOS:
            cases[f"{key} x{ratio}"] = Case(
                "freight_consensus:realistic+delay_0_8",
                {**LAWS[key][1], "links": {"command": {"delay": 0.8 * ratio}}, "model": {"delay": 0.8, "lag": 0.4}},
            )
    quiet: dict[str, Any] = {"plant": {"disturbances": [], "sensors": None}}
    cases["unit undisturbed"] = Case("freight_consensus:realistic+delay_1_0", quiet)
    for gain in (1.9, 50.0):
        for error in (108.0, 748.0):
            cases[f"gain {gain:g} from {error:g} m"] = Calculation(
                nominal_settling, {"gain": gain, "error": error, "rate": -12.0}
            )
    return cases


CASES = _cases()
SETTLED = 3.0
"""Time after which the initial error of 108 m is removed [s]; 1.7 s in the paper."""
PRINTED_FORMS = (
    PrintedForm("explicit signs of (7), (11); after 3 s", "ideal explicit", "implicit", "ideal implicit", SETTLED),
    PrintedForm(
        "cascade (7), (11), implicit; after 3 s", "ideal implicit", "Levant's differentiators", "ideal", SETTLED
    ),
    PrintedForm(
        "x, v, d1, d1', d2 of (36) from the cascade; after 3 s",
        "ideal estimated",
        "measured x and v, implicit",
        "ideal implicit",
        SETTLED,
    ),
)
"""The cascade of the law alone has no node, so no command contains d_hat twice."""
