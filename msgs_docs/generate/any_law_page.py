"""Generate ``msgs_docs/any_law.md``: every law on every nominal shipped scenario, with fitted and printed gains."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from plant_sim.number_text import number_text
from train_ato.control.gains import FITTED, PRINTED, has_gains
from train_ato.control.registry import LAWS
from train_ato.errors import RunFailed
from train_ato.loop.engine import run_engine
from train_ato.loop.setup import prepare
from train_ato.scenario.scenario import load_scenario

PAGE = Path("msgs_docs", "any_law.md")
"""Path of the page in the repository."""
MEASURED = Path("msgs_docs", "any_law_measured.json")
"""Path of the measured figures in the repository."""
NAME = "any_law"
"""Name of the page for ``--measure``."""
SCENARIOS = (
    "demo",
    "daqin_heavy_haul",
    "daqin_heavy_haul:twin",
    "daqin_heavy_haul:ideal",
    "daqin_heavy_haul:paper_rate",
    "daqin_heavy_haul:triggered",
    "daqin_heavy_haul:predictive",
    "daqin_heavy_haul:trip",
    "daqin_two_locomotives",
    "xuzhou_metro",
    "xuzhou_metro:ideal",
    "freight_consensus:realistic",
    "crh380a_funnel",
    "crh380a_funnel:short",
    "crh380a_funnel:planned_ahead",
    "crh380a_gpc",
    "crh380a_gpc:short",
    "crh380a_gpc:planned_ahead",
)
"""Nominal scenarios: the model of the law is that of the plant, no fault, and a profile within the limits."""
KEPT = (
    "speed_rmse_kmh",
    "stop_error_max_m",
    "coupler_buff_max_kn",
    "coupler_draft_max_kn",
    "command_variation_kn_per_s",
)

INTRODUCTION = """# Any law on any train

Made by `python -m msgs_docs.generate`; do not edit by hand. Measured by
`python -m msgs_docs.generate --measure any_law`; `train-ato compare SCENARIO` makes the rows of one scenario with the
default gains.

Every law runs on every shipped scenario that is nominal: its model is that of the plant, it has no fault, no added
noise and no force shortage. The default gains of a law are those fitted to the train, in
`train_ato/control/fitted_gains.yaml` ([tuning.md](tuning.md)); the gains that a scenario gives remain, such as those of
`pid`. `mpc` computes its own gains. The outcome is that of [tracking.md](tracking.md), with the criteria of the
scenario that are not met. *refused*: before the run, with a reason.
"""


REASONS = """
`funnel` follows the reference at the time of the measurement, not at the time of effect of its command: it lags by the
delay times the acceleration. Under `predictor` with the observer `eso` it has 0.056 instead of 0.271 km/h rms on
`crh380a_gpc:short` and meets all criteria, and a jerk of 0.755 instead of 0.79 m/s³ on `xuzhou_metro`. `gpc` and `mpc`
predict over the delay by themselves, so the scenario with `predictor` refuses them; `--compensation none` is accepted.
"""
"""Measured reasons of the cells that are not met, `train-ato run SCENARIO --law funnel --compensation predictor
--observer eso`."""


def measure_any_law(root: Path) -> None:
    """Run every law on every scenario with both gains, and write the rows after every run."""
    path = root / MEASURED
    rows: list[dict[str, Any]] = []
    for name in SCENARIOS:
        for law in LAWS.names():
            for gains in (FITTED, PRINTED) if has_gains(LAWS.get(law)) else ("",):
                rows.append({"scenario": name, "law": law, "gains": gains, **outcome(name, law, gains)})
                path.write_text(json.dumps(rows, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def outcome(name: str, law: str, gains: str) -> dict[str, Any]:
    """Return outcome and figures of a run to four digits; for a refused or failed run its reason."""
    changes: dict[str, Any] = {"law": law}
    if gains == PRINTED:
        changes["laws"] = {law: {"gains": PRINTED}}
    try:
        summary = run_engine(prepare(*load_scenario(name, changes=changes)), summary_only=True).summary
    except ValueError as error:
        return {"outcome": "refused", "reason": str(error).partition(f"law '{law}'")[2].lstrip(":, ") or str(error)}
    except RunFailed as error:
        return {"outcome": "failed", "reason": str(error)}
    return summary_figures(summary)


def summary_figures(summary: dict[str, Any]) -> dict[str, Any]:
    """Return outcome, criteria that are not met, takeovers and figures of a summary."""
    missed = {entry["criterion"]: _short(entry["value"]) for entry in summary["criteria"] if not entry["passed"]}
    found: dict[str, Any] = {"outcome": summary["tracking"]}
    if missed:
        found["missed"] = missed
    if summary["tracking_findings"]:
        found["finding"] = summary["tracking_findings"][0]["text"]
    if summary.get("takeovers"):
        found["takeovers"] = summary["takeovers"]
    return found | {key: _short(summary.get(key)) for key in KEPT}


def _short(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.4g}")


def holds(found: dict[str, Any]) -> bool:
    """Return True for a tracked run without takeover that meets all criteria."""
    return found["outcome"] == "tracked" and not found.get("missed") and not found.get("takeovers")


def page(root: Path) -> str:
    """Return the text of the page."""
    path = root / MEASURED
    rows = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else []
    default = [found for found in rows if found["gains"] != PRINTED]
    printed = [found for found in rows if found["gains"] == PRINTED]
    lines = [INTRODUCTION, "| gains | runs | tracked, no takeover, all criteria |", "|---|---|---|"]
    for title, part in (("default", default), ("printed", printed)):
        lines.append(f"| {title} | {len(part)} | {sum(map(holds, part))} |")
    lines += ["", "Default gains, not met:", ""]
    lines += [f"* `{found['scenario']}`, `{found['law']}`: {_verdict(found)}" for found in default if not holds(found)]
    lines.append(REASONS.rstrip())
    for name in SCENARIOS:
        part = [found for found in rows if found["scenario"] == name]
        if part:
            lines += ["", f"## `{name}`", "", *_table(part)]
    return "\n".join(lines) + "\n"


def _table(rows: list[dict[str, Any]]) -> list[str]:
    lines = ["| law | gains | outcome | rms km/h | stop m | couplers kN | command variation kN/s |"]
    lines.append("|---|---|---|---|---|---|---|")
    for found in rows:
        figures = [found.get(key) for key in KEPT]
        cells = ["-" if value is None else number_text(value, 3) for value in figures]
        couplers = f"{cells[2]} ... {cells[3]}" if figures[2] or figures[3] else "-"
        shown = [found["law"], found["gains"] or "own", _verdict(found), cells[0], cells[1], couplers, cells[4]]
        lines.append(f"| {' | '.join(shown)} |")
    return lines


def _verdict(found: dict[str, Any]) -> str:
    """Return outcome, finding, criteria that are not met with their values, takeovers, or the reason of a refusal."""
    text = [found["outcome"], *(found[key] for key in ("reason", "finding") if key in found)]
    text += [
        f"{name} {'-' if value is None else number_text(value, 3)}" for name, value in found.get("missed", {}).items()
    ]
    if found.get("takeovers"):
        text.append(f"{found['takeovers']} takeovers")
    return "; ".join(text)
