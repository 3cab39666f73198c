"""Runs of the heavy-haul train for paper 000: its own setting, and one with lag 0.4 s and delay 0.8 s.

Every case has the 2674 s of the driver's run and a tick of 0.05 s (printed PID: 0.01 s), unless a shorter run suffices.
"""

from collections.abc import Mapping
from typing import Any

from train_ato.papers.checks import PrintedForm
from train_ato.papers.claims import Case

DURATION = 2674
"""Length of the driver's run [s]."""
PERIOD = 0.05
"""Tick of the tables [s]."""
SHORT = 600
"""Start from rest to 70 km/h, sufficient for the detection of an unstable loop [s]."""

Choice = dict[str, Any]


def _law(name: str, parameters: Mapping[str, Any], omega: float | None = None, scope: str = "vehicle") -> Choice:
    choice: Choice = {"law": name, "laws": {name: dict(parameters)}, "observer": "none"}
    if omega is not None:
        choice |= {"observer": "ndo", "observers": {"ndo": {"omega": omega, "scope": scope}}}
    return choice


PRINTED_PID = {
    "per_mass": False, "kp": 1e7, "ki": 1.0, "kd": 1.0, "integral": "speed", "feedforward": False,
    "filter_time": 0.0,
}  # fmt: skip
PRINTED = {"ks": 0.0, "anti_windup": False, "integral_limit": 1e12}
"""The printed reaching law has no linear term; its integral has no anti-windup and no limit."""
PRINTED_NETWORK = {**PRINTED, "clip": False, "weight_limit": 1e3}
"""The printed network has no output outside its basis functions, and no limit of its weights."""


def _printed_observer(omega: float) -> Choice:
    """Return the printed law with its observer, whose known part has the output of the network."""
    return _law("rbf_smc", PRINTED_NETWORK | {"ndo_omega": omega}, omega)


IDEAL_LAWS: dict[str, tuple[str, Choice]] = {
    "pid": ("PID (Tc 0.01)", _law("pid", PRINTED_PID) | {"tick": 0.01}),
    "smc": ("SMC", _law("smc", PRINTED)),
    "smc_ndo": ("SMC + NDO 1000", _law("smc", PRINTED, 1000.0)),
    "rbf": ("RBFNN-SMC", _law("rbf_smc", PRINTED_NETWORK)),
    "rbf_ndo": ("RBFNN-SMC + NDO 1000", _printed_observer(1000.0)),
    "smc_ks": ("SMC + ks", _law("smc", {})),
    "rbf_ks": ("RBFNN + ks", _law("rbf_smc", {})),
    "rbf_ks_ndo": ("RBFNN + ks + NDO 20", _law("rbf_smc", {}, 20.0)),
}
"""Label and choice by key, in the order of the table; run undisturbed and with (40)."""

LAGGED_SMC = {"equivalent": "feedforward", "l1": 0.07, "l2": 0.002, "ks": 0.02, "kappa": 0.01, "phi": 1.0}
"""Gains for lag and delay, chosen with the nominal train and the strong mismatch."""
PREDICTED = {"compensation": "train_predictor"}

LAGGED_LAWS: dict[str, tuple[str, Choice]] = {
    "twin_pid": ("twin + PID", {}),
    "twin_smc": ("twin + SMC", _law("smc", LAGGED_SMC)),
    "twin_smc_ndo": ("twin + SMC + NDO 0.01", _law("smc", LAGGED_SMC, 0.01, "train")),
    "predicted": ("printed SMC on a full-train prediction", _law("smc", PRINTED) | PREDICTED),
}
LAGGED_TRAINS: dict[str, tuple[str, str]] = {
    "nominal": ("nominal", ""),
    "disturbed": ("disturbance (40)", "+disturbed"),
    "mismatch": ("+ mismatch", "+disturbed+mismatch"),
    "strong": ("+ strong mismatch", "+disturbed+strong_mismatch"),
}
"""Label and variants by key; the mismatches are in addition to the disturbance."""

LIMIT_DELAYS = (0.05, 0.1, 0.15, 0.2, 0.4)
"""Pure delays below and above the limit of the printed law, 0.17 s [s]."""


def _ideal(choice: Choice, variants: str = "", **more: Any) -> Case:
    return Case(f"daqin_heavy_haul:ideal+paper_rate{variants}", {"duration": DURATION, **choice, **more})


def _lagged(choice: Choice, variants: str = "", **more: Any) -> Case:
    return Case(f"daqin_heavy_haul:twin+paper_rate{variants}", {"duration": DURATION, **choice, **more})


def _cases() -> dict[str, Case]:
    cases: dict[str, Case] = {}
    for key, (_, choice) in IDEAL_LAWS.items():
        cases[key] = _ideal(choice)
        cases[f"{key} disturbed"] = _ideal(choice, "+disturbed")
    exact = {"model_error": 0.0}
    cases["smc exact"] = _ideal(_law("smc", PRINTED | exact))
    cases["rbf exact"] = _ideal(_law("rbf_smc", PRINTED_NETWORK | exact))
    for key, (_, choice) in LAGGED_LAWS.items():
        for train, (_, variants) in LAGGED_TRAINS.items():
            cases[f"{key} {train}"] = _lagged(choice, variants)
    cases["twin_pid noise"] = _lagged(LAGGED_LAWS["twin_pid"][1], "+noise")
    cases["preview_pid nominal"] = _lagged({"compensation": "preview"})
    cases["raw_pid noise"] = _lagged({"laws": {"pid": {"kp": 0.09, "filter_time": 0.0}}}, "+noise")
    for delay in LIMIT_DELAYS:
        cases[f"smc delay {delay}"] = _ideal(_law("smc", PRINTED), duration=SHORT, links={"command": {"delay": delay}})
    bare: dict[str, Any] = {"compensation": "none", "duration": SHORT}
    cases["pid lag"] = _lagged(IDEAL_LAWS["pid"][1], **bare, links={"command": {"delay": 0.0}})
    for key in ("pid", "rbf_ndo", "rbf_ks_ndo"):
        cases[f"{key} lagged"] = _lagged(IDEAL_LAWS[key][1], **bare)
    cases["smc lagged"] = _lagged(IDEAL_LAWS["smc"][1], compensation="none")
    for omega in (1000.0, 20.0):
        noise = {"sensors": {"velocity_noise": 0.01}}
        cases[f"ndo {omega:g} noise"] = _ideal(_printed_observer(omega), duration=SHORT, plant=noise)
    cases["rbf_ndo apart disturbed"] = _ideal(_law("rbf_smc", PRINTED_NETWORK, 1000.0), "+disturbed")
    cases["rbf unbraked"] = _ideal(IDEAL_LAWS["rbf"][1], brake={"policy": "none", "events": []})
    cubic = {"disturbances": [{"kind": "eq40", "speed_power": 3}]}
    cases["rbf_ndo cubic"] = _ideal(_printed_observer(1000.0), plant=cubic)
    clamped = _law("smc", PRINTED | {"integral_limit": 100.0})
    cases["smc lagged clamped"] = _lagged(clamped, compensation="none")
    longest = sorted(cases, key=lambda key: -cases[key].changes["duration"] / cases[key].changes.get("tick", PERIOD))
    return {key: cases[key] for key in longest}


CASES = _cases()
PRINTED_FORMS = (
    PrintedForm(
        "integral of (19) without a limit; lag 0.4 s, delay 0.8 s", "smc lagged", "limit 100 m s", "smc lagged clamped"
    ),
    PrintedForm(
        "delta_hat in the known part of the observer, (30)-(34); with (40)",
        "rbf_ndo disturbed",
        "delta_hat also in d_hat",
        "rbf_ndo apart disturbed",
    ),
    PrintedForm(
        "third power of the speed in (40); RBFNN-SMC + NDO", "rbf_ndo cubic", "first power", "rbf_ndo disturbed"
    ),
    PrintedForm(
        "network without a linear reaching term and without clipped inputs, (21), (25)", "rbf", "both", "rbf_ks"
    ),
)
