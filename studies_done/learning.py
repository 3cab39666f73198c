"""Table of the errors before and after learning from run to run, on the disturbed metro line.

    python studies_done/learning.py [--runs N] [--seeds N] [--page] [--json]

Every stack of law, observer and compensation learns from ``--runs`` runs, and then drives ``--seeds`` others: without
the learned resistance, with it, and with the line of the plant in the nominal model. Gusts ``repeated``: they act at
the same times in every run, as in the scenario. Gusts ``moved``: by up to 50 s, another time in every run; they cannot
be learned. ``--page`` writes the table into ``msgs_docs/learning.md``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Any

import train_ato as ta
from train_ato.studies.learn import repeated
from train_ato.api.scenario_choice import put_components
from train_ato.api.drive import RunMode, drive
from train_ato.scenario.scenario_data import PartCache
from train_ato.scenario.setup import prepare
from train_ato.judge.verdict import outcomes_text

SCENARIO, LINE = "xuzhou_metro:disturbed", "xuzhou_metro_test"
STACKS: dict[str, dict[str, str]] = {
    "mpc": {"law": "mpc", "observer": "none", "compensation": "none"},
    "pid, preview": {"law": "pid", "observer": "none", "compensation": "preview"},
    "pid, predictor, eso": {"law": "pid", "observer": "eso", "compensation": "predictor"},
    "rbf_switching_smc, preview": {"law": "rbf_switching_smc", "observer": "none", "compensation": "preview"},
}
"""Stacks of the table; the last one is the law of paper 001."""
GUSTS = {"repeated": 0.0, "moved": 50.0}
"""Largest shift of the gusts from run to run [s]."""
FIRST_SEED = 1001
"""First seed of the runs of the table; the runs that are learned have the seeds from 1 on."""
PAGE = Path(__file__).resolve().parents[1] / "msgs_docs" / "learning.md"
BEGIN, END = "<!-- table of studies_done/learning.py -->\n", "<!-- end of the table -->\n"
HEAD = (
    "| gusts | law | knowledge | outcome | rms, median | rms, largest | error, largest | stop, largest |\n"
    f"{'|---' * 8}|\n"
)


def rows(runs: int, seeds: int) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table, in m/s and m."""
    for gusts, shift in GUSTS.items():
        for stack, names in STACKS.items():
            found = ta.learn(SCENARIO, runs=runs, gust_shift=shift, progress=False, **names)
            for knowledge in ("none", f"{runs} runs", "line"):
                changes = {"model.line": LINE} if knowledge == "line" else {}
                choice = ta.scenario(SCENARIO).with_(changes, seed=FIRST_SEED)
                scenario = put_components(choice.checked, importable=False, **names)
                learned = found.learned if knowledge.endswith("runs") else None
                parts, metrics = PartCache(), []
                for number in range(seeds):
                    setup = prepare(repeated(scenario, number, learned, shift), choice.path, parts)
                    metrics.append(drive(setup, RunMode(), shown=False).metrics)
                rms = [one["speed_rmse_kmh"] / 3.6 for one in metrics]
                yield {
                    "gusts": gusts, "law": stack, "knowledge": knowledge, "outcome": outcomes_text(metrics),
                    "rms_median": median(rms), "rms_max": max(rms),
                    "error_max": max(one["speed_error_max_kmh"] for one in metrics) / 3.6,
                    "stop_max": max((one["stop_error_m"] for one in metrics), key=abs),
                }  # fmt: skip


def line_of(row: dict[str, Any]) -> str:
    """Return a row as Markdown."""
    numbers = f"{row['rms_median']:.4f} | {row['rms_max']:.4f} | {row['error_max']:.3f} | {row['stop_max']:.3f}"
    return f"| {row['gusts']} | {row['law']} | {row['knowledge']} | {row['outcome']} | {numbers} |\n"


def write_table(text: str, runs: int, seeds: int) -> None:
    """Replace the table of the page."""
    page = PAGE.read_text(encoding="utf-8")
    before, _, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not end:
        raise SystemExit(f"{PAGE}: no lines '{BEGIN.strip()}' and '{END.strip()}'; add them")
    command = f"The table has m/s and m. Its command is `python studies_done/learning.py --runs {runs} --seeds {seeds} --page`:\n\n"
    PAGE.write_text(f"{before}{BEGIN}{command}{text}{END}{after}", encoding="utf-8")


def main() -> None:
    """Print the table as Markdown, or one JSON value."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=5, metavar="N")
    parser.add_argument("--seeds", type=int, default=50, metavar="N")
    parser.add_argument("--page", action="store_true")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    results, text = [], HEAD
    if not options.json:
        print(HEAD, end="")
    for row in rows(max(1, options.runs), max(1, options.seeds)):
        results.append(row)
        text += line_of(row)
        if not options.json:
            print(line_of(row), end="", flush=True)
    if options.json:
        print(json.dumps(results, indent=1))
    if options.page:
        write_table(text, max(1, options.runs), max(1, options.seeds))


if __name__ == "__main__":
    main()
