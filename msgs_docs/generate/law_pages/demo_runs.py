"""Demonstration runs of every component: the two runs of its figure and the rows of its table.

A component without an entry in ``DEMO_RUNS`` gets the runs of :func:`default_demo`, so that a new law needs no entry.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from train_ato.papers.claims import Case


@dataclass(frozen=True)
class DemoRun:
    """Runs of one page; the first two are drawn.

    Attributes
    ----------
    runs : dict
        Label and case of every run.
    draw : str
        Upper panel: ``speed`` or ``position`` error.
    lower : str
        Lower panel: ``force`` of all units, or ``estimate`` against the truth.
    span : tuple of float
        Drawn part of the run [s]; None draws all of it.
    """

    runs: Mapping[str, Case]
    draw: str = "speed"
    lower: str = "force"
    span: tuple[float, float] | None = None


def _run(
    scenario: str,
    law: str | None = None,
    observer: str | None = None,
    compensation: str | None = None,
    values: Mapping[str, Any] | None = None,
    **components: Any,
) -> Case:
    """Return the case of a scenario with other components; ``values`` are parameters of the law."""
    chosen = {"law": law, "observer": observer, "compensation": compensation}
    changes: dict[str, Any] = {key: name for key, name in chosen.items() if name is not None}
    if values:
        changes["laws"] = {law or "pid": dict(values)}
    return Case(scenario, changes | components)


DAQIN, METRO, FREIGHT = "daqin_heavy_haul", "xuzhou_metro", "freight_consensus"
FUNNEL, GPC = "crh380a_funnel:short", "crh380a_gpc:short"
SCORED = (0.0, 2618.0)
"""Evaluated part of the heavy-haul run [s]; the stop follows after it."""
FITTED = {"gains": "fitted"}
"""A case has the printed gains unless it names others."""

DEMO_RUNS: dict[str, DemoRun] = {
    "law/pid": DemoRun(
        {
            "pid": _run("demo"),
            "pid without feed-forward": _run("demo", values={"feedforward": False, "kp": 0.1}),
            "45 km heavy haul": _run(DAQIN),
            "45 km heavy haul under twin": _run(f"{DAQIN}:twin"),
            "metro": _run(METRO),
        }
    ),
    "law/smc": DemoRun(
        {
            "smc": _run(f"{DAQIN}:ideal", "smc"),
            "pid": _run(f"{DAQIN}:ideal"),
            "smc as printed, ks = 0": _run(f"{DAQIN}:ideal", "smc", values={"ks": 0.0}),
            "smc, disturbance (40)": _run(f"{DAQIN}:ideal+disturbed", "smc"),
            "45 km heavy haul, lag and delay, published gains": _run(DAQIN, "smc"),
            "the same, fitted gains": _run(DAQIN, "smc", values=FITTED),
            "the same, fitted gains, under twin": _run(f"{DAQIN}:twin", "smc", values=FITTED),
        },
        span=SCORED,
    ),
    "law/rbf_smc": DemoRun(
        {
            "rbf_smc": _run(f"{DAQIN}:ideal", "rbf_smc"),
            "pid": _run(f"{DAQIN}:ideal"),
            "rbf_smc as printed, ks = 0, no clip": _run(
                f"{DAQIN}:ideal", "rbf_smc", values={"ks": 0.0, "clip": False}
            ),
            "rbf_smc, disturbance (40), ndo": _run(f"{DAQIN}:ideal+disturbed", "rbf_smc", "ndo"),
            "45 km heavy haul, lag and delay, published gains": _run(DAQIN, "rbf_smc"),
            "the same, fitted gains": _run(DAQIN, "rbf_smc", values=FITTED),
            "the same, fitted gains, under twin": _run(f"{DAQIN}:twin", "rbf_smc", values=FITTED),
        },
        span=SCORED,
    ),
    "law/rbf_switching_smc": DemoRun(
        {
            "rbf_switching_smc": _run(f"{METRO}:disturbed", "rbf_switching_smc", "eso", "predictor"),
            "pid": _run(f"{METRO}:disturbed", "pid", "eso", "predictor"),
            "rbf_switching_smc, ideal actuator": _run(f"{METRO}:ideal", "rbf_switching_smc"),
            "the bare relay, ideal actuator": _run(
                f"{METRO}:ideal", "rbf_switching_smc", values={"switching": "sign"}
            ),
            "45 km heavy haul, lag and delay, published gains": _run(DAQIN, "rbf_switching_smc"),
            "the same, fitted gains": _run(DAQIN, "rbf_switching_smc", values=FITTED),
            "the same, fitted gains, under twin": _run(f"{DAQIN}:twin", "rbf_switching_smc", values=FITTED),
        }
    ),
    "law/fixed_time_smc": DemoRun(
        {
            "fixed_time_smc": _run(f"{FREIGHT}:aligned"),
            "pid": _run(f"{FREIGHT}:aligned", "pid", values={"kp": 2.0, "ki": 1.0}),
            "fixed_time_smc from 108 m out of place": _run(FREIGHT),
            "a real train, delay 0.3 s, gains 0.3, eso": _run(
                f"{FREIGHT}:realistic+delay_0_3", "fixed_time_smc", "eso", "predictor",
                {"surface": 0.3, "reaching": 0.3, "unmatched": False},
            ),
        },
        draw="position",
    ),
    "law/lag_smc": DemoRun(
        {
            "lag_smc": _run(f"{FREIGHT}:realistic+delay_1_0"),
            "pid": _run(f"{FREIGHT}:realistic+delay_1_0", "pid", values={"kp": 0.5, "ki": 0.05}),
            "lag_smc, common command": _run(f"{FREIGHT}:realistic+delay_1_0", "lag_smc", values={"command": "common"}),
            "lag_smc, delay 0.6 s": _run(f"{FREIGHT}:realistic"),
            "pid, delay 0.6 s": _run(f"{FREIGHT}:realistic", "pid", values={"kp": 0.5, "ki": 0.05}),
            "45 km heavy haul, lag and delay, gains of the freight train": _run(DAQIN, "lag_smc"),
            "the same, fitted gains": _run(DAQIN, "lag_smc", values=FITTED),
        },
        draw="position",
    ),
    "law/funnel": DemoRun(
        {
            "funnel": _run(FUNNEL, "funnel", compensation="none"),
            "pid": _run(FUNNEL, compensation="none"),
            "funnel as printed, f known": _run(
                FUNNEL, "funnel", compensation="none", values={"variant": "printed", "resistance": "model"}
            ),
            "funnel, 200 kN": _run(f"{FUNNEL}+saturated", "funnel", compensation="none"),
            "45 km heavy haul, lag and delay, published gains": _run(DAQIN, "funnel"),
            "the same, fitted gains": _run(DAQIN, "funnel", values=FITTED),
        }
    ),
    "law/mpc": DemoRun(
        {
            "mpc": _run(f"{GPC}+limited", "mpc", compensation="none"),
            "pid, preview": _run(f"{GPC}+limited", "pid", compensation="preview"),
            "mpc, limits that suffice": _run(GPC, "mpc", compensation="none"),
            "mpc, delays 1.5 times those of the model": _run(f"{GPC}+delay_half_more", "mpc", compensation="none"),
            "mpc, gain, delay and lag jump": _run(f"{GPC}+jump", "mpc", compensation="none"),
            "mpc, metro, disturbed": _run(f"{METRO}:disturbed", "mpc", compensation="none"),
            "mpc, freight, delay 1 s": _run(f"{FREIGHT}:realistic+delay_1_0", "mpc", compensation="none"),
            "mpc, long train": _run("demo", "mpc"),
        },
        draw="position",
    ),
    "law/gpc": DemoRun(
        {
            "gpc": _run(GPC, "gpc", compensation="none"),
            "pid": _run(GPC, "pid", compensation="preview"),
            "gpc, gain, delay and lag jump": _run(f"{GPC}+jump", "gpc", compensation="none"),
            "gpc, a loop for each coupled unit": _run(GPC, "gpc", compensation="none", values={"structure": "unit"}),
            "45 km heavy haul, lag and delay, published gains": _run(DAQIN, "gpc"),
            "the same, fitted gains": _run(DAQIN, "gpc", values=FITTED),
        }
    ),
    "observer/none": DemoRun(
        {
            "none": _run(f"{METRO}:disturbed"),
            "eso": _run(f"{METRO}:disturbed", observer="eso"),
        },
        lower="estimate",
    ),
    "observer/ndo": DemoRun(
        {
            "ndo": _run(f"{DAQIN}:ideal+disturbed", "smc", "ndo"),
            "none": _run(f"{DAQIN}:ideal+disturbed", "smc"),
            "ndo, metro with grades unknown to it": _run(f"{METRO}:disturbed", observer="ndo"),
        },
        lower="estimate",
        span=(600.0, 900.0),
    ),
    "observer/cascaded": DemoRun(
        {
            "cascaded": _run(f"{FREIGHT}:aligned"),
            "none": _run(f"{FREIGHT}:aligned", observer="none"),
            "cascaded, metro with grades unknown to it": _run(f"{METRO}:disturbed", observer="cascaded"),
        },
        draw="position",
        lower="estimate",
    ),
    "observer/eso": DemoRun(
        {
            "eso": _run(f"{METRO}:disturbed", observer="eso"),
            "none": _run(f"{METRO}:disturbed"),
            "eso, real freight train": _run(f"{FREIGHT}:realistic"),
            "none, real freight train": _run(f"{FREIGHT}:realistic", observer="none"),
        },
        lower="estimate",
    ),
    "compensation/none": DemoRun(
        {
            "none": _run(METRO, compensation="none"),
            "preview": _run(METRO),
        }
    ),
    "compensation/pade": DemoRun(
        {
            "pade": _run(METRO, compensation="pade"),
            "none": _run(METRO, compensation="none"),
            "preview": _run(METRO),
        }
    ),
    "compensation/preview": DemoRun(
        {
            "preview": _run(METRO),
            "none": _run(METRO, compensation="none"),
            "preview, 45 km heavy haul": _run(DAQIN),
            "none, 45 km heavy haul": _run(DAQIN, compensation="none"),
        }
    ),
    "compensation/predictor": DemoRun(
        {
            "predictor": _run(f"{METRO}:long_delay", observer="eso", compensation="predictor"),
            "preview": _run(f"{METRO}:long_delay", observer="eso"),
            "predictor, gains for 0.3 s": _run(f"{METRO}:disturbed", observer="eso", compensation="predictor"),
            "predictor, delay estimated": _run(
                f"{METRO}:slower", observer="eso", compensation="predictor",
                compensations={"predictor": {"delay": "estimated"}},
            ),
        }
    ),
    "compensation/train_predictor": DemoRun(
        {
            "train_predictor": _run(DAQIN, "smc", compensation="train_predictor"),
            "none": _run(DAQIN, "smc", compensation="none"),
            "train_predictor, moderate mismatch": _run(
                f"{DAQIN}:mismatch", "smc", compensation="train_predictor"
            ),
        },
        span=SCORED,
    ),
    "compensation/twin": DemoRun(
        {
            "twin": _run(f"{DAQIN}:twin"),
            "preview": _run(DAQIN),
            "twin, moderate mismatch": _run(f"{DAQIN}:twin+mismatch"),
            "twin, strong mismatch": _run(f"{DAQIN}:twin+strong_mismatch"),
        },
        span=SCORED,
    ),
}  # fmt: skip
"""Runs by kind and name of the component."""


def default_demo(kind: str, name: str) -> DemoRun:
    """Return the runs of a component without an entry: on the metro train, beside the baseline of its kind."""
    scenario = f"{METRO}:disturbed"
    if kind == "law":
        return DemoRun({name: _run(scenario, name), "pid": _run(scenario, "pid")})
    if kind == "observer":
        runs = {name: _run(scenario, observer=name), "none": _run(scenario, observer="none")}
        return DemoRun(runs, lower="estimate")
    return DemoRun({name: _run(METRO, compensation=name), "preview": _run(METRO, compensation="preview")})


def demo_of(kind: str, name: str) -> DemoRun:
    """Return the demonstration runs of a component."""
    return DEMO_RUNS.get(f"{kind}/{name}") or default_demo(kind, name)
