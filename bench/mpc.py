"""Table of the law mpc beside pid and the law of the scenario, on the scenarios of its goals.

    python bench/mpc.py [--only TEXT] [--laws mpc,pid,pid_eso,paper] [--seeds N] [--json]

Every law runs with its default or the scenario's gains; pid under `preview` (under `twin` on daqin_heavy_haul:twin),
pid_eso is pid under `predictor` with the observer `eso`, mpc under `none`, the law of the scenario (paper) as shipped.
Rows with noise are over the seeds: the largest value of the columns `largest`, `draft` and `buff`, else the mean.
The table of the goals has 50 seeds: `python bench/mpc.py --seeds 50`.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from statistics import fmean
from typing import Any

import train_ato as ta

GPC, FUNNEL, METRO = "crh380a_gpc:short", "crh380a_funnel:short", "xuzhou_metro"
FREIGHT = "freight_consensus:realistic"
NOISE = {"plant.sensors.velocity_noise": 0.05}
LIGHT = {"plant.mismatch.mass_scale": 0.8}
ROWS: tuple[tuple[str, dict[str, Any], str], ...] = (
    (f"{GPC}+limited", {}, "9.2 m, .75 m/s"),
    (GPC, {}, ".045 m/s"),
    (f"{GPC}+delay_half_more", {}, ".20 m/s"),
    (f"{GPC}+delay_half_less", {}, ".14 m/s"),
    (f"{GPC}+heavy", {}, ".18 m/s"),
    (GPC, LIGHT, ".18 m/s"),
    (f"{GPC}+jump", {}, ".30 m/s"),
    (GPC, NOISE, ".045 m/s, 15 kN/s"),
    (f"{FUNNEL}+saturated", {}, "9.2 m"),
    (f"{FUNNEL}+noise", {}, ".08 m/s, 12 kN/s"),
    (METRO, {}, ".0003 m/s rms"),
    (f"{METRO}:disturbed", {}, ".0125 rms, .08 m/s"),
    (f"{METRO}:mismatch", {}, ".043 m/s rms"),
    (f"{METRO}:slower", {}, ".025 m/s rms"),
    (f"{FREIGHT}+delay_0_8", {}, ".105 m rms, 35 kN/s, 55 kN"),
    (f"{FREIGHT}+delay_1_0", {}, ".105 m rms, 35 kN/s, 55 kN"),
    ("demo", {}, "-"),
    ("daqin_heavy_haul", {}, "-"),
)
"""Scenario, changes and goal of every row; the goals are older than the law."""
NOISY = ("noise", "disturbed", "mismatch", "slower", "realistic", "demo")
"""Words of the scenarios with noise: only these are repeated with other seeds."""
COLUMNS = {
    "speed_error_max_kmh": ("largest m/s", 1 / 3.6, ".4f"),
    "speed_rmse_kmh": ("rms m/s", 1 / 3.6, ".4f"),
    "position_error_max_m": ("largest m", 1.0, ".2f"),
    "position_rmse_m": ("rms m", 1.0, ".3f"),
    "stop_error_m": ("stop m", 1.0, ".3f"),
    "command_variation_kn_per_s": ("kN/s", 1.0, ".1f"),
    "coupler_draft_max_kn": ("draft kN", 1.0, ".0f"),
    "coupler_buff_max_kn": ("buff kN", 1.0, ".0f"),
}
"""Metrics of the table: heading, factor and format."""


def chosen_for(scenario: str, law: str) -> dict[str, Any]:
    """Return law, compensation and observer of a column; those of the scenario for ``paper``."""
    if law == "paper":
        return {}
    if law == "pid_eso":
        return {"law": "pid", "compensation": "predictor", "observer": "eso"}
    if law == "mpc":
        return {"law": law, "compensation": "none"}
    return {"law": law, "compensation": "twin" if scenario.endswith("twin") else "preview"}


def row(scenario: str, changes: dict[str, Any], law: str, seeds: int) -> dict[str, Any]:
    """Return the metrics of a law on a scenario over the seeds; a refused or failed run has the key ``problem``."""
    noisy = bool(changes.keys() & NOISE.keys()) or any(word in scenario for word in NOISY)
    found: list[dict[str, Any]] = []
    for seed in range(1, 1 + (seeds if noisy else 1)):
        try:
            run = ta.run(scenario, set=changes, seed=seed, progress=False, **chosen_for(scenario, law))
        except ta.RunInterrupted:
            raise SystemExit(130) from None
        except (ValueError, ta.RunFailed) as error:
            return {"problem": str(error)}
        found.append(run.metrics)
    combined: dict[str, Any] = {"law": found[0]["controller"]}
    for name, (_, factor, _) in COLUMNS.items():
        values = [metrics[name] for metrics in found if metrics[name] is not None]
        combine = fmean if "_max_" not in name else min if "buff" in name else max
        combined[name] = factor * combine(values) if len(values) == len(found) else None
    return combined


def rows(only: str, laws: list[str], seeds: int) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table."""
    for scenario, changes, goal in ROWS:
        name = " ".join([scenario, *(f"{key}={value}" for key, value in changes.items())])
        if only in name:
            for law in laws:
                yield {"scenario": name, "goal": goal, "law": law, **row(scenario, changes, law, seeds)}


def main() -> None:
    """Print the table as Markdown, or one JSON value."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", metavar="TEXT")
    parser.add_argument("--laws", default="mpc,pid,pid_eso,paper", metavar="NAMES")
    parser.add_argument("--seeds", type=int, default=1, metavar="N")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    results = []
    if not options.json:
        print("| scenario | law | " + " | ".join(heading for heading, _, _ in COLUMNS.values()) + " | goal |")
        print("|---" * (len(COLUMNS) + 3) + "|")
    for result in rows(options.only, options.laws.split(","), max(1, options.seeds)):
        results.append(result)
        if options.json:
            print(result["scenario"], result["law"], file=sys.stderr)
        elif "problem" in result:
            print(f"| {result['scenario']} | {result['law']} | {result['problem']} |")
        else:
            cells = ["-" if result[n] is None else format(result[n], style) for n, (_, _, style) in COLUMNS.items()]
            print(f"| {result['scenario']} | {result['law']} | {' | '.join(cells)} | {result['goal']} |", flush=True)
    if options.json:
        print(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
