"""Gains of the laws for the shipped trains, found by `train_ato.tune`.

    python studies_done/tuned_gains.py [SCENARIO ...] [--runs 18]     # search of every law without a result in the file
    python studies_done/tuned_gains.py --table                        # scores and metrics before and after
    python studies_done/tuned_gains.py --laws                         # YAML for train_ato/control/fitted_gains.yaml

Searches are in studies_done/tuned_gains.yaml, their results in studies_done/tuned_gains.json, written after every law; an entry that
is removed is searched again. The table has the tuned gains if they are better in the search and on the held-out
scenarios, otherwise the gains of the scenario.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

import train_ato as ta
from msgs_docs.generate.rows import read_rows, write_rows
from plant_sim.units import number_text

HERE = Path(__file__).parent
SEARCHES, RESULTS = HERE / "tuned_gains.yaml", HERE / "tuned_gains.json"
SPAN = 10.0
"""Factor between the start value of a gain and the ends of its range."""


def choice(entry: Mapping[str, Any]) -> Any:
    """Return a scenario with the changes of an entry."""
    found = ta.scenario(entry["scenario"])
    return found.with_(entry["set"]) if "set" in entry else found


def spec_of(law: str, entry: Mapping[str, Any]) -> dict[str, Any]:
    """Return ranges, fixed values and start values of a law for `over`."""
    from train_ato.control.registry import LAWS

    declared = {parameter.name: parameter for parameter in LAWS.parameters(law)}
    over: dict[str, Any] = {name: [value] for name, value in entry.get("fixed", {}).items()}
    for name, value in entry["start"].items():
        low, high = max(value / SPAN, declared[name].low), min(value * SPAN, declared[name].high)
        over[name] = {"from": float(f"{low:.3g}"), "to": float(f"{high:.3g}"), "scale": "log"}
    return {"over": over, "start": entry["start"]}


def find(scenario: str, searches: Mapping[str, Any], runs: int) -> None:
    """Search the gains of every law of a scenario without a result, and store them."""
    entry = searches[scenario]
    for law, given in entry["laws"].items():
        results = read_rows(RESULTS)
        if law in results.get(scenario, {}):
            continue
        searched = {**entry["search"], "set": {**entry["search"]["set"], **given.get("set", {})}}
        begin = time.process_time()
        try:
            found = ta.tune(
                choice(searched),
                law,
                over=spec_of(law, given),
                held_out=[choice(other) for other in entry["held_out"]],
                runs=runs,
                progress=False,
            )
        except ValueError as error:
            result: dict[str, Any] = {"refused": str(error)}
            print(f"{scenario} {law}: refused: {error}", flush=True)
        else:
            if found.interrupted:
                raise KeyboardInterrupt
            seconds = time.process_time() - begin
            result = {**found.data, "cpu_s": round(seconds, 1)}
            print(f"{scenario} {law}: {score_texts(result)}, {seconds:.0f} s of CPU time", flush=True)
        results = read_rows(RESULTS)
        results.setdefault(scenario, {})[law] = result
        write_rows(RESULTS, results, 2)


def objective(result: Mapping[str, Any], gains: str, part: str) -> float:
    """Return the objective over the runs of a part."""
    scores = [row["score"] for row in result["runs"] if row["gains"] == gains and row["part"] == part]
    return (sum(scores) / len(scores) + max(scores)) / 2


def score_texts(result: Mapping[str, Any]) -> str:
    """Return objectives before and after, of the search and held out, as text."""
    parts = []
    for part in ("searched", "held out"):
        before, after = (objective(result, gains, part) for gains in ("initial", "tuned"))
        parts.append(f"{part} {number_text(before, 3)} -> {number_text(after, 3)}")
    return ", ".join(parts)


def shipped_gains(result: Mapping[str, Any]) -> tuple[dict[str, Any], bool]:
    """Return the gains for the table, and True if they are the tuned ones."""
    better = bool(result["improved"] and result["improved_held_out"])
    return result["gains" if better else "initial"], better


def pairs() -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield scenario, law and result of every search that ran."""
    for scenario, laws in read_rows(RESULTS).items():
        for law, result in sorted(laws.items()):
            if "refused" not in result:
                yield scenario, law, result


def print_table() -> None:
    """Print the objectives, and the metrics of the last held-out run, as Markdown."""
    print("| scenario | law | runs | score | held out: score | rms km/h | stop m | kN/s | tracking | shipped |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for scenario, law, result in pairs():
        outside = {row["gains"]: row for row in result["runs"] if row["part"] == "held out"}
        cells = [
            " → ".join(number_text(objective(result, gains, part), 3) for gains in ("initial", "tuned"))
            for part in ("searched", "held out")
        ]
        cells += [
            " → ".join(dict.fromkeys(_text(outside[gains][key]) for gains in ("initial", "tuned")))
            for key in ("speed_rmse_kmh", "stop_error_max_m", "command_variation_kn_per_s", "tracking")
        ]
        shipped = "tuned" if shipped_gains(result)[1] else "initial"
        print(f"| `{scenario}` | {law} | {result['settings']['runs']} | {' | '.join(cells)} | {shipped} |")


def _text(value: Any) -> str:
    return "-" if value is None else number_text(value, 3) if isinstance(value, float) else str(value)


def print_laws() -> None:
    """Print the block `laws` of the table for the train of every scenario."""
    found: dict[str, dict[str, Any]] = {}
    for scenario, law, result in pairs():
        found.setdefault(scenario, {})[law] = shipped_gains(result)[0]
    for scenario, laws in found.items():
        print(f"# {scenario}\n  laws:")
        for law, gains in laws.items():
            text = yaml.safe_dump(gains, default_flow_style=True, sort_keys=False, width=1000).strip()
            print(f"    {law}: {text}")


def main() -> int:
    """Search, or print the table or the gains."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="*")
    parser.add_argument("--runs", type=int, default=18)
    parser.add_argument("--table", action="store_true")
    parser.add_argument("--laws", action="store_true")
    options = parser.parse_args()
    if options.table:
        print_table()
    elif options.laws:
        print_laws()
    else:
        searches = yaml.safe_load(SEARCHES.read_text(encoding="utf-8"))
        for scenario in options.scenario or [name for name, entry in searches.items() if "laws" in entry]:
            find(scenario, searches, options.runs)
    return 0


if __name__ == "__main__":
    sys.exit(main())
