"""Table of the law mpc beside pid and the law of the scenario, on the scenarios of its goals.

    python bench/mpc.py [--only TEXT] [--laws mpc,pid] [--seeds N] [--json]

Every law runs with its default or the scenario's gains; pid under `preview` (under `twin` on daqin_heavy_haul:twin),
pid_eso is pid under `predictor` with the observer `eso`, mpc under `none`, the law of the scenario (paper) as shipped.
Rows with noise are the means over the seeds, and the line after each of them has the largest values of all seeds.
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


def compensation_of(scenario: str, law: str) -> str | None:
    """Return the compensation of a law; None is that of the scenario."""
    if law == "mpc":
        return "none"
    return ("twin" if scenario.endswith("twin") else "preview") if law == "pid" else None


def row(scenario: str, changes: dict[str, Any], law: str, seeds: int) -> dict[str, Any]:
    """Return the mean metrics of a law on a scenario; a refused or failed run has the key ``problem``."""
    noisy = bool(changes.keys() & NOISE.keys()) or any(word in scenario for word in NOISY)
    found: list[dict[str, Any]] = []
    for seed in range(1, 1 + (seeds if noisy else 1)):
        compensation = compensation_of(scenario, law)
        chosen: dict[str, Any] = {} if compensation is None else {"compensation": compensation}
        try:
            run = ta.run(
                scenario, law=None if law == "paper" else law, set=changes, seed=seed, progress=False, **chosen
            )
        except ta.RunInterrupted:
            raise SystemExit(130) from None
        except (ValueError, ta.RunFailed) as error:
            return {"problem": str(error)}
        found.append(run.metrics)
    means: dict[str, Any] = {"law": found[0]["controller"]}
    for name, (_, factor, _) in COLUMNS.items():
        values = [metrics[name] for metrics in found if metrics[name] is not None]
        means[name] = factor * fmean(values) if len(values) == len(found) else None
    return means


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
    parser.add_argument("--laws", default="mpc,pid,paper", metavar="NAMES")
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
