"""Runs of the metro train for paper 001: its own setting, and one with lag 0.4 s and delay 0.3 s.

The gains of the laws of this project were chosen on two runs: `disturbed`, and the same with a true lag of 0.45 s and a
delay of 0.4 s. The mismatch, the slower actuator and the delay of 1 s are held out. The PID gains are from an
independent optimisation.
"""

from collections.abc import Mapping
from typing import Any

from train_ato.papers.checks import PrintedForm
from train_ato.papers.claims import Case

INERTIA = 192_170.0
"""Mass including rotating masses [kg]."""
SWEEP = (0.2, 0.5, 0.75)
"""Delays between those of the table [s]."""

Choice = dict[str, Any]


def _law(name: str, compensation: str, parameters: Mapping[str, Any], **more: Any) -> Choice:
    return {"law": name, "laws": {name: dict(parameters)}, "compensation": compensation, **more}


PID = {"kp": 1.66, "ki": 0.61, "kd": 0.017, "integral": "speed", "integral_limit": 20.0, "feedforward": False}
PID_PREVIEW = {"kp": 1.16, "ki": 0.43, "integral": "speed", "integral_limit": 20.0}
RBF = {"phi": 3.0, "eta": 0.03}
FAST_PHI = 1.0
RATE = 0.6
"""Surface [m/s] and learning rate of the paper, per sample, of the corrected network with an ideal actuator."""
NO_NOISE: Choice = {"plant": {"sensors": {"velocity_noise": 0.0}}}
TANH = {"switching": "tanh", "phi": 1.2}
LITERAL = {"objective": "printed_acceleration", "eta": RATE / 0.05, "weight_limit": 1000.0}
"""The learning rate of the paper at 0.05 s, weights without bound."""
UNCLIPPED = {"clip": False, "sensitivity": "value", "rbfi_input": "command", "anti_windup": False, "eta_v": 0.6}
"""The rest of (11)-(14) as printed."""
ESO: Choice = {"observer": "eso", "observers": {"eso": {"omega": 3.0}}}
SWITCHING = "rbf_switching_smc"

LAWS: dict[str, tuple[str, Choice]] = {
    "pid": ("PID, no preview", _law("pid", "none", PID)),
    "pid_preview": ("PID + preview", _law("pid", "preview", PID_PREVIEW)),
    "rbf": ("RBF corrected + preview", _law(SWITCHING, "preview", RBF)),
    "tanh": ("tanh + preview", _law(SWITCHING, "preview", TANH | {"phi": 2.0})),
    "rbf_predictor": ("RBF + preview + predictor (+ ESO)", _law(SWITCHING, "predictor", RBF)),
    "tanh_predictor": ("tanh + preview + predictor (+ ESO)", _law(SWITCHING, "predictor", TANH)),
}
"""Label and choice by key, in the order of the table."""
TRAINS: dict[str, tuple[str, str]] = {
    "nominal": ("nominal, no disturbance", ""),
    "disturbed": ("disturbed, noise", ":disturbed"),
    "mismatch": ("gain 0.9, resistance x10", ":mismatch"),
    "slower": ("true lag 0.5, delay 0.45", ":slower"),
    "long_delay": ("delay 1.0, gains of 0.3", ":long_delay"),
}
"""Label and variant by key, the rows of the table."""


def _run(choice: Choice, variant: str, **more: Any) -> Case:
    return Case(f"xuzhou_metro{variant}", {**choice, **more})


def _cases() -> dict[str, Case]:
    cases: dict[str, Case] = {}
    for key, (_, choice) in LAWS.items():
        for train, (_, variant) in TRAINS.items():
            observed = train != "nominal" and choice["compensation"] == "predictor"
            cases[f"{key} {train}"] = _run({**choice, **(ESO if observed else {})}, variant)
    ideal = {
        "pid": _law("pid", "none", PID),
        "pid_known": _law("pid", "none", PID_PREVIEW),
        "rbf": _law(SWITCHING, "none", RBF),
        "tanh": _law(SWITCHING, "none", TANH),
        "sign": _law(SWITCHING, "none", {"switching": "sign"}),
        "literal": _law(SWITCHING, "none", LITERAL),
    }
    for key, choice in ideal.items():
        cases[f"ideal {key}"] = _run(choice, ":ideal")
        cases[f"ideal {key} disturbed"] = _run(choice, ":ideal+disturbed")
    for key in ("rbf", "sign"):
        cases[f"ideal {key} 10 ms"] = _run(ideal[key], ":ideal", tick=0.01)
    for tick, suffix in ((0.05, ""), (0.01, " 10 ms")):
        fast = _law(SWITCHING, "none", {"phi": FAST_PHI, "eta": RATE / tick})
        for key, choice in (("rbf", ideal["rbf"]), ("rbf fast", fast)):
            cases[f"ideal {key} no noise{suffix}"] = _run(choice, ":ideal+disturbed", tick=tick, **NO_NOISE)
    cases["sign nominal"] = _run(_law(SWITCHING, "preview", {"switching": "sign"}), "")
    cases["literal nominal"] = _run(_law(SWITCHING, "preview", LITERAL), "")
    cases["rbf unidentified disturbed"] = _run(_law(SWITCHING, "preview", RBF | {"identify": False}), ":disturbed")
    cases["ideal literal unclipped"] = _run(_law(SWITCHING, "none", LITERAL | UNCLIPPED), ":ideal")
    cases["measured nominal"] = _run(_law(SWITCHING, "none", {"derivatives": "measured", "switching": "tanh"}), "")
    cases["rbf command disturbed"] = _run(_law(SWITCHING, "preview", RBF | {"rbfi_input": "command"}), ":disturbed")
    for compensation in ("none", "pade"):
        cases[f"rbf {compensation}"] = _run(_law(SWITCHING, compensation, RBF), "")
    for delay in SWEEP:
        choice = {**LAWS["tanh_predictor"][1], **ESO}
        cases[f"sweep {delay}"] = _run(choice, ":disturbed", links={"command": {"delay": delay}})
    return cases


CASES = _cases()
PRINTED_FORMS = (
    PrintedForm("objective (13), e''²/2; lag and delay", "literal nominal", "s²/2", "rbf nominal"),
    PrintedForm(
        "clips, slope and holding of (11)-(14); printed objective, ideal",
        "ideal literal unclipped",
        "clipped, sign, held",
        "ideal literal",
    ),
    PrintedForm(
        "measured derivatives and a_s' in u_eq (9); lag and delay, tanh",
        "measured nominal",
        "those of the profile",
        "tanh nominal",
    ),
    PrintedForm("relay (9); lag and delay", "sign nominal", "tanh", "tanh nominal"),
    PrintedForm("first input of (14): u(l-1); disturbed", "rbf command disturbed", "u_n", "rbf disturbed"),
)
