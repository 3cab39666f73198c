"""Table of the law mpc beside the other laws, on the scenarios of its goals.

    python studies_done/mpc.py [--only TEXT] [--laws mpc,pid,pid_eso,paper] [--seeds N] [--json]
    python studies_done/mpc.py --seeds 50 --json > mpc.json      # in several parts, for example one for every law
    python studies_done/mpc.py --page mpc.json [MORE.json ...]   # writes msgs_docs/mpc_table.md

Every law runs with its default or the scenario's gains; pid under `preview` (under `twin` on daqin_heavy_haul:twin),
pid_eso is pid under `predictor` with the observer `eso`, mpc under `none` (`twin` there), and paper is the law of the
paper of the scenario under the compensation of the scenario, on the metro line under `preview`, under `twin` with the
fitted gains.
Rows with noise are over the seeds, with the median and the largest of every figure.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Any

import train_ato as ta
from train_ato.judge.verdict import outcomes_text

GPC, FUNNEL, METRO = "crh380a_gpc:short", "crh380a_funnel:short", "xuzhou_metro"
FREIGHT, TWIN = "freight_consensus:realistic", "daqin_heavy_haul:twin"
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
    (TWIN, {}, ".0016 m/s rms, 12 kN/s"),
    (f"{TWIN}+disturbed+noise", {}, ".004 m/s rms, 12 kN/s"),
    (f"{TWIN}+mismatch", {}, ".007 m/s rms, 12 kN/s"),
    (f"{TWIN}+strong_mismatch", {}, ".010 m/s rms, 12 kN/s"),
)
"""Scenario, changes and goal of every row; the goals are older than the law."""
PAPER_LAWS: dict[str, dict[str, Any]] = {
    "xuzhou_metro": {"law": "rbf_switching_smc", "compensation": "preview"},
    "crh380a_funnel": {"law": "funnel"},
    "daqin_heavy_haul": {"law": "rbf_smc"},
    "demo": {"law": "rbf_smc"},
}
"""Laws of the papers in scenarios with another law."""
BEST: dict[str, str] = {
    f"{GPC}+limited": "44 m, 1.58 m/s", GPC: ".049 m/s", f"{GPC}+delay_half_more": ".295 m/s",
    f"{GPC}+delay_half_less": ".186 m/s", f"{GPC}+heavy": ".315 m/s", f"{GPC}+jump": ".455 m/s",
    f"{GPC} plant.mismatch.mass_scale=0.8": ".349 m/s",
    f"{GPC} plant.sensors.velocity_noise=0.05": ".047 m/s, 64 kN/s",
    f"{FUNNEL}+saturated": "44 m", f"{FUNNEL}+noise": ".172 m/s, 55 kN/s", METRO: ".0014 rms",
    f"{METRO}:disturbed": ".0201 rms, .100 m/s", f"{METRO}:mismatch": ".0509 rms", f"{METRO}:slower": ".0306 rms",
    TWIN: ".0016 rms", f"{TWIN}+disturbed+noise": ".0054 rms", f"{TWIN}+mismatch": ".0128 rms",
    f"{TWIN}+strong_mismatch": ".0245 rms",
    f"{FREIGHT}+delay_0_8": ".106 m rms, 81 kN/s, 59 kN", f"{FREIGHT}+delay_1_0": ".12 m rms, 81 kN/s, 59 kN",
}  # fmt: skip
"""Best other law of this package when the goals were written, before `mpc`."""
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
        return PAPER_LAWS.get(scenario.partition(":")[0], {})
    if law == "pid_eso":
        return {"law": "pid", "compensation": "predictor", "observer": "eso"}
    if law == "mpc":
        return {"law": law, "compensation": "twin" if TWIN in scenario else "none"}
    return {"law": law, "compensation": "twin" if TWIN in scenario else "preview"}


def row(scenario: str, changes: dict[str, Any], law: str, seeds: int) -> dict[str, Any]:
    """Return the metrics of a law on a scenario over the seeds; a refused or failed run has the key ``problem``.

    A scenario whose second seed gives the figures of the first has no noise: further seeds are left out.
    """
    if TWIN in scenario:
        scenario += "+identified" if law == "mpc" else ""
    found: list[dict[str, Any]] = []
    for seed in range(1, 1 + seeds):
        try:
            run = ta.run(scenario, set=changes, seed=seed, progress=False, **chosen_for(scenario, law))
        except ta.RunInterrupted:
            raise SystemExit(130) from None
        except (ValueError, ta.RunFailed) as error:
            return {"problem": str(error)}
        found.append({name: run.metrics[name] for name in ("controller", "tracking", "tracking_findings", *COLUMNS)})
        if seed == 2 and found[0] == found[1]:
            del found[1]
            break
    combined: dict[str, Any] = {"stack": found[0]["controller"], "seeds": len(found), "outcome": outcomes_text(found)}
    for name, (_, factor, _) in COLUMNS.items():
        values = [factor * metrics[name] for metrics in found if metrics[name] is not None]
        complete = len(values) == len(found)
        combined[name] = [median(values), max(values, key=abs)] if complete else None
    return combined


def rows(only: str, laws: list[str], seeds: int) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table."""
    for scenario, changes, goal in ROWS:
        name = " ".join([scenario, *(f"{key}={value}" for key, value in changes.items())])
        if only in name:
            for law in laws:
                yield {"scenario": name, "goal": goal, "law": law, **row(scenario, changes, law, seeds)}


def line_of(result: dict[str, Any]) -> str:
    """Return a row as Markdown: median, and after a slash the largest of several seeds."""
    begin = f"| {result['scenario']} | {result['law']} |"
    if "problem" in result:
        return f"{begin} {result['problem']} |"
    cells = []
    for name, (_, _, style) in COLUMNS.items():
        figures = (result[name] or [])[: 1 if result["seeds"] == 1 else 2]
        cells.append(" / ".join(format(figure, style) for figure in figures) or "-")
    best = BEST.get(result["scenario"], "-")
    return f"{begin} {result['seeds']} | {result['outcome']} | {' | '.join(cells)} | {best} | {result['goal']} |"


def page_of(results: list[dict[str, Any]]) -> str:
    """Return the page with the rows of several measurements, by scenario and law."""
    places = {name: place for place, (name, _, _) in enumerate(ROWS)}
    order = [place.partition(" ")[0] for place in (result["scenario"] for result in results)]
    rows = sorted(zip(order, results, strict=True), key=lambda pair: (places[pair[0]], pair[1]["scenario"]))
    return PAGE_HEAD + HEAD + "".join(f"{line_of(result)}\n" for _, result in rows)


HEAD = (
    f"| scenario | law | seeds | outcome | {' | '.join(heading for heading, _, _ in COLUMNS.values())} "
    f"| best so far | goal |\n{'|---' * (len(COLUMNS) + 6)}|\n"
)
PAGE = Path(__file__).resolve().parents[1] / "msgs_docs" / "mpc_table.md"
PAGE_HEAD = """# Law mpc beside the other laws

Written by `python studies_done/mpc.py --page`, from `python studies_done/mpc.py --json`; goals and reasons for misses:
[mpc_goals.md](mpc_goals.md). Rows with noise: median / largest over the seeds of the column `seeds`, from seed 1 on.
`outcome`: that of [tracking.md](tracking.md), of different ones the number of runs with each.
`pid`: under `preview`; `mpc`: under `none`; both under `twin` on `daqin_heavy_haul:twin`, `mpc` there with the variant
`identified`; `pid_eso`: `pid` under `predictor` with the observer `eso`; `paper`: law of the paper of the scenario,
under `twin` with fitted gains. A dash: the scenario does not have the figure.
"Best so far": the best other law of this package before `mpc`.

"""


def main() -> None:
    """Print the table as Markdown, or one JSON value, or write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", metavar="TEXT")
    parser.add_argument("--laws", default="mpc,pid,pid_eso,paper", metavar="NAMES")
    parser.add_argument("--seeds", type=int, default=1, metavar="N")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--page", nargs="+", type=Path, metavar="FILE", help="results of --json for the page")
    options = parser.parse_args()
    if options.page:
        PAGE.write_text(page_of([row for file in options.page for row in json.loads(file.read_text())]), "utf-8")
        return
    results = []
    if not options.json:
        print(HEAD, end="")
    for result in rows(options.only, options.laws.split(","), max(1, options.seeds)):
        results.append(result)
        if options.json:
            print(result["scenario"], result["law"], file=sys.stderr)
        else:
            print(line_of(result), flush=True)
    if options.json:
        print(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
