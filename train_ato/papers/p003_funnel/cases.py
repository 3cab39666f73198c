"""Runs of the CRH380A as one mass for paper 003: some on 286 km, the others shorter with the same phases.

The largest errors of both occur in the same phases. The errors of the printed law also depend on the length of the run,
because its funnel narrows over hours.
"""

from collections.abc import Mapping
from typing import Any

from train_ato.papers.checks import PrintedForm
from train_ato.papers.claims import Case


def _funnel(**parameters: Any) -> dict[str, Any]:
    return {"law": "funnel", "compensation": "none", "laws": {"funnel": parameters}}


PRINTED = {"variant": "printed", "resistance": "model", "outside_funnel": "printed"}
"""Printed law with known f; its network is a separate row."""
CLIPPED = {**PRINTED, "outside_funnel": "clip"}
PRINTED_RATES = {"gamma_w": 1.0, "bias_rate": 15.0, "weight_limit": 100.0}
"""Learning rates of the paper; the limit of the weights is the largest one possible."""
UNAWARE = {"model": {"consist": "crh380a_one_mass"}}
"""Model of the law: 240 kN; plant: 200 kN."""
UNHANDLED = {**PRINTED, "resistance": "network", "funnel": "prescribed", **PRINTED_RATES}
"""Comparison of the paper: a funnel that always narrows, gains that are negative outside of it."""

LAWS: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "printed": ("printed, f known", _funnel(**PRINTED)),
    "corrected": ("corrected", _funnel()),
    "corrected slow": ("corrected, lam_h 1.2", _funnel(lam_h=1.2)),
    "pid": ("PID + preview", {}),
    "predictor": ("PID + predictor + eso", {"compensation": "predictor", "observer": "eso"}),
    "quiet": (
        "the same, kp 0.4, ki 0.05, eso 0.5, 0.2 s",
        {
            "compensation": "predictor",
            "observer": "eso",
            "observers": {"eso": {"omega": 0.5}},
            "laws": {"pid": {"kp": 0.4, "ki": 0.05}},
            "control_period": 0.2,
        },
    ),
}
"""Label and changes by key, in the order of the table."""

TRAINS: Mapping[str, tuple[str, str]] = {
    "nominal": ("no saturation", ""),
    "saturated": ("200 kN", "+saturated"),
    "planned": ("200 kN, planned for", "+planned_ahead"),
    "replanned": ("200 kN, found and re-planned", "+replanned"),
    "half_more": ("delay x1.5", "+delay_half_more"),
    "later": ("delay +0.6 s", "+delay_plus_0_6"),
    "lagging": ("lag 0.4 s", "+lagging"),
    "light": ("mass -20 %", "+light"),
    "noise": ("noise 0.05 m/s", "+noise"),
    "grade": ("12 per mille unknown", "+grade"),
}
"""Label and variants of the short run by key."""


def _unhandled(variants: str, tick: float, *, full_only: bool = False, **parameters: Any) -> Case:
    grid = {"tick": tick, "step": min(tick, 0.01)}
    return Case(f"crh380a_funnel:{variants}", _funnel(**UNHANDLED | parameters) | UNAWARE | grid, full_only)


def _cases() -> dict[str, Case]:
    cases: dict[str, Case] = {}
    for key in ("printed", "corrected", "pid", "predictor"):
        cases[f"{key} long"] = Case("crh380a_funnel", LAWS[key][1])
    cases["printed long saturated"] = Case("crh380a_funnel:saturated", LAWS["printed"][1])
    cases["corrected long saturated"] = Case("crh380a_funnel:saturated", LAWS["corrected"][1])
    cases["unhandled 1 ms"] = _unhandled("short+saturated", 0.001, full_only=True)
    cases["unhandled long 10 ms"] = _unhandled("saturated", 0.01, full_only=True)
    cases["unhandled long"] = _unhandled("saturated", 0.05)
    cases["unhandled 10 ms"] = _unhandled("short+saturated", 0.01)
    for key, (_, changes) in LAWS.items():
        for train, (_, variants) in TRAINS.items():
            if key != "quiet" or "planned" not in train:
                cases[f"{key} {train}"] = Case(f"crh380a_funnel:short{variants}", changes)
    saturated = "crh380a_funnel:short+saturated"
    wide = {"funnel": "fixed", "phi1": 1e4, "phi2": 1e4}
    cases["unhandled"] = _unhandled("short+saturated", 0.05)
    cases["unhandled clipped"] = _unhandled("short+saturated", 0.05, outside_funnel="clip")
    cases["unhandled aware"] = Case(saturated, _funnel(**UNHANDLED))
    cases["fixed gains"] = Case(saturated, _funnel(**PRINTED, **wide))
    network = {**PRINTED, "resistance": "network"}
    cases["printed network"] = Case("crh380a_funnel:short", _funnel(**network, **PRINTED_RATES))
    cases["printed network slow"] = Case("crh380a_funnel:short", _funnel(**network))
    cases["printed light long"] = Case("crh380a_funnel:light", _funnel(**PRINTED))
    cases["printed clipped light long"] = Case("crh380a_funnel:light", _funnel(**CLIPPED))
    cases["printed excess"] = Case("crh380a_funnel:short", _funnel(**PRINTED, kappa="printed"))
    cases["printed excess saturated"] = Case(saturated, _funnel(**PRINTED, kappa="printed"))
    cases["unhandled slow"] = _unhandled("saturated", 0.05, gamma_w=0.05, bias_rate=0.3, weight_limit=2.0)
    cases["corrected no delay state"] = Case("crh380a_funnel:short", _funnel(delay_state=False))
    cases["printed no delay state"] = Case("crh380a_funnel:short", _funnel(**PRINTED, delay_state=False))
    cases["corrected, f known"] = Case("crh380a_funnel:short", _funnel(resistance="model"))
    cases["printed position noise"] = Case(
        "crh380a_funnel:short", _funnel(**PRINTED) | {"plant": {"sensors": {"position_noise": 0.1}}}
    )
    cases["corrected position noise"] = Case(
        "crh380a_funnel:short", _funnel() | {"plant": {"sensors": {"position_noise": 0.1}}}
    )
    cases["pid alone"] = Case("crh380a_funnel:short", {"compensation": "none", "laws": {"pid": {"feedforward": False}}})
    cases["lag modelled"] = Case("crh380a_funnel:short+lagging", {**LAWS["predictor"][1], "model": {"lag": 0.4}})
    return cases


CASES = _cases()
PRINTED_FORMS = (
    PrintedForm(
        "k_i of (12), (23) outside the funnel; mass -20 %, 286 km",
        "printed light long",
        "clipped",
        "printed clipped light long",
    ),
    PrintedForm("learning rates 1 and 15 of (27), (28)", "printed network", "0.05 and 0.3", "printed network slow"),
    PrintedForm(
        "the same in a funnel that always narrows; 200 kN, 286 km", "unhandled long", "0.05 and 0.3", "unhandled slow"
    ),
    PrintedForm("kappa(u(t - tau)) of (9)", "printed excess", "kappa(u(t))", "printed nominal"),
    PrintedForm("kappa(u(t - tau)) of (9); 200 kN", "printed excess saturated", "kappa(u(t))", "printed saturated"),
)
