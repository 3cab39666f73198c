"""Generate ``msgs_docs/any_law.md``: every law on every nominal shipped scenario, with fitted and printed gains."""

import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from msgs_docs.generate.rows import page_text, read_rows, table_lines, texts, write_rows
from msgs_docs.generate.swap_cells import table as swap_table
from msgs_docs.generate.tutorials import page_blocks, run_block
from plant_sim.plant_setup import Mismatch
from plant_sim.units import number_text
from train_ato.control.gains import FITTED, PRINTED, has_gains
from train_ato.control.registry import LAWS
from train_ato.judge.ranking import standings
from train_ato.loop.engine import run_engine
from train_ato.program.errors import RunFailed
from train_ato.scenario.scenario import load_scenario, raw_scenario
from train_ato.scenario.scenario_files import shipped_scenarios, variants_of
from train_ato.scenario.setup import RunSetup, prepare

PAGE = Path("msgs_docs", "any_law.md")
MEASURED = Path("msgs_docs", "any_law_measured.json")
NAME = "any_law"
LEADERBOARD_NAME = "leaderboard"
LEADERBOARD_ROWS = Path("msgs_docs", "leaderboard_measured.json")
TUTORIAL = Path("msgs_docs", "tutorials", "learn_a_law.md")
"""Page with the files of the law that learns."""
LEARNED = "learned:Learned"
DISTURBED = (
    "xuzhou_metro:disturbed", "crh380a_funnel:grade", "freight_consensus:realistic", "daqin_heavy_haul:disturbed",
)  # fmt: skip
"""Scenarios of the leaderboard, one for every train with disturbances."""
SEEDS = 3
"""Number of seeds of each."""
STANDINGS = {
    "passed": "passed", "tracked": "tracked", "runs": "runs", "refused": "refused", "first": "first",
    "rank": "mean rank", "speed_rmse_kmh": "median rms km/h", "stop_error_m": "stop m",
}  # fmt: skip
"""Keys of a row of the leaderboard with their headings."""
FREIGHT = "freight_consensus:realistic"
"""Scenario of the freight train of paper 002, which has no nominal one."""
MAX_NOISE = 0.01
"""Largest noise of the speed measurement of a nominal scenario [m/s]."""
DELAY_TOLERANCE = 0.01
"""Largest relative difference of the delay of the model from the mean delay of the commands."""
AT_LIMIT = 1.001
"""Force of a profile over that of the train up to which the profile is within it: a planned one is at the limit."""
KEPT = (
    "speed_rmse_kmh", "stop_error_max_m", "coupler_buff_max_kn", "coupler_draft_max_kn",
    "command_variation_kn_per_s",
)  # fmt: skip

REASONS = {tuple(row["cell"]): row["reason"] for row in texts("reasons")["any_law"]}
"""Measured reason of every cell with default gains that is not met, by scenario and law."""


def shipped_names() -> list[str]:
    """Return the names of the shipped scenarios and of their variants that change more than gains."""
    found = []
    for name, path in shipped_scenarios().items():
        variants, own = [f"{name}:{variant}" for variant in variants_of(path)], _without_gains(name)
        found += [name, *(variant for variant in variants if _without_gains(variant) != own)]
    return found


def nominal_names() -> list[str]:
    """Return the names of the shipped scenarios that have rows."""
    return [name for name in shipped_names() if name == FREIGHT or is_nominal(name)]


def _without_gains(name: str) -> dict[str, Any]:
    """Return the keys of a scenario without its name and the parameters of its laws."""
    return {key: value for key, value in raw_scenario(name)[1].items() if key not in ("name", "laws")}


def is_nominal(name: str) -> bool:
    """Return True for a scenario without a difference between model and plant; the page has the definition."""
    setup = prepare(*load_scenario(name))
    scenario, model = setup.scenario, setup.model
    plant = scenario.plant
    undisturbed = not (plant.disturbances or plant.jumps or scenario.faults or scenario.interventions)
    usual = plant.force_limit is None and plant.adhesion is None and plant.mismatch == Mismatch()
    quiet = max(plant.sensors.velocity_noise, plant.sensors.position_noise) <= MAX_NOISE
    known = (setup.consist, setup.line, np.max(plant.lag)) == (model.consist, model.line, model.lag)
    return undisturbed and usual and quiet and known and _delay_is_known(setup) and _force_suffices(setup)


def _delay_is_known(setup: RunSetup) -> bool:
    """Return True if the delay of the model is the mean delay of the commands."""
    link, model = setup.scenario.links.command, setup.model
    if link.jump is not None or link.jitter or link.loss:
        return False
    varying = 0.0 if link.varying is None else link.varying.amplitude * 2.0 / math.pi  # mean of a rectified sine
    pairs = zip(link.per_unit(model.n_units, "links.command"), (model.delay, model.delay_brake), strict=True)
    return all(np.allclose(delay + varying, modelled, rtol=DELAY_TOLERANCE) for delay, modelled in pairs)


def _force_suffices(setup: RunSetup) -> bool:
    """Return True if the units have the force of the profile at every second, or the train has an air brake."""
    model, profile = setup.model, setup.profile
    if model.consist.air_brake is not None:
        return True
    for t in np.arange(0.0, float(profile.time[-1]), 1.0):
        place, speed, pull, _ = profile.at(t)
        low, high = model.limits_of_units([speed] * model.n_units)
        if not sum(low) <= model.rigid_force(place, speed, pull) / AT_LIMIT <= sum(high):
            return False
    return True


def measure(root: Path, scenarios: Sequence[str] = ()) -> None:
    """Run every law on every scenario with both gains, and write the rows after every scenario.

    Parameters
    ----------
    root
        Top folder of the repository.
    scenarios
        Scenarios to run, the rows of the others remain; default: every nominal one, and that of the freight train.
    """
    path, names = root / MEASURED, shipped_names()
    for name in scenarios:
        if name not in names or not (name == FREIGHT or is_nominal(name)):
            raise ValueError(f"--measure {NAME}:{name}: not a nominal scenario that is shipped; see {PAGE}")
    for name in scenarios or nominal_names():
        rows = [found for found in read_rows(path) if found["scenario"] in names and found["scenario"] != name]
        for law in LAWS.names():
            wanted = (FITTED, PRINTED) if has_gains(LAWS.get(law)) else ("",)
            rows += [{"scenario": name, "law": law, "gains": gains, **outcome(name, law, gains)} for gains in wanted]
        rows.sort(key=lambda found: names.index(found["scenario"]))
        write_rows(path, rows)


def outcome(name: str, law: str, gains: str) -> dict[str, Any]:
    """Return outcome and figures of a run to four digits; for a refused or failed run its reason."""
    changes: dict[str, Any] = {"law": law}
    if gains == PRINTED:
        changes["laws"] = {law: {"gains": PRINTED}}
    try:
        setup = prepare(*load_scenario(name, changes=changes))
        summary = run_engine(setup, summary_only=True).summary
    except ValueError as error:
        text = str(error).partition(f"law '{law}'")[2].lstrip(":, ") or str(error)
        reason, _, choice = text.rpartition("; ")
        return {"outcome": "refused", "reason": reason, "choice": f"nearest choice: {choice}"}
    except RunFailed as error:
        return {"outcome": "failed", "reason": str(error)}
    return {"source": setup.gains(law).source} | summary_figures(summary)


def summary_figures(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return outcome, criteria that are not met, takeovers and figures of a summary."""
    missed = {
        entry["criterion"]: _short(entry["value"]) for entry in summary.get("criteria") or [] if not entry["passed"]
    }
    found: dict[str, Any] = {"outcome": summary["tracking"]}
    if missed:
        found["missed"] = missed
    if summary["tracking_findings"]:
        found["finding"] = summary["tracking_findings"][0]["text"]
    if summary.get("takeovers"):
        found["takeovers"] = summary["takeovers"]
    return found | {key: _short(summary.get(key)) for key in KEPT}


def _short(value: float | None) -> float | None:
    """Return a figure as it is kept: counts whole, others to four digits."""
    return value if value is None or isinstance(value, int) else float(f"{value:.4g}")


def holds(found: dict[str, Any]) -> bool:
    """Return True for a tracked run without takeover that meets all criteria."""
    return found["outcome"] == "tracked" and not found.get("missed") and not found.get("takeovers")


def not_met(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the runs with default gains that do not hold and are not refused."""
    return [row for row in rows if row["gains"] != PRINTED and row["outcome"] != "refused" and not holds(row)]


def page(root: Path) -> str:
    """Return the text of the page."""
    rows = read_rows(root / MEASURED)
    default = [found for found in rows if found["gains"] != PRINTED]
    printed = [found for found in rows if found["gains"] == PRINTED]
    counts = []
    for title, part in (("default", default), ("printed", printed)):
        refused = [found["outcome"] for found in part].count("refused")
        counts.append(f"| {title} | {len(part)} | {sum(map(holds, part))} | {refused} |")
    missed = []
    for found in not_met(rows):
        cell = found["scenario"], found["law"]
        missed.append(f"* `{cell[0]}`, `{cell[1]}`: {verdict(found)}. {REASONS.get(cell, '')}".rstrip())
    lines = []
    for name in dict.fromkeys(found["scenario"] for found in rows):
        lines += ["", f"## `{name}`", "", *_table([found for found in rows if found["scenario"] == name])]
    found = read_rows(root / LEADERBOARD_ROWS)
    ranks = {"scenarios": len(DISTURBED), "seeds": SEEDS, "command": found["command"], "standings": _leaderboard(found)}
    return page_text(NAME, counts=counts, not_met=missed, swaps=swap_table(root), tables=lines, **ranks)


def measure_leaderboard(root: Path) -> None:
    """Let the law of the tutorial learn, compare it and all laws in the scenarios with disturbances, and write rows."""
    with tempfile.TemporaryDirectory(prefix="train_ato_leaderboard_") as scratch:
        folder = Path(scratch)
        for block in page_blocks((root / TUTORIAL).read_text(encoding="utf-8")):
            if block.file:
                run_block(block, folder, 0)
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (str(root), os.getenv("PYTHONPATH"))))}
        subprocess.run([sys.executable, "train.py", "xuzhou_metro"], cwd=folder, env=environment, check=True)
        weights = yaml.safe_load((folder / "learned.yaml").read_text(encoding="utf-8"))["laws"]
        names = [f"{name.replace(':', '_')}.yaml" for name in DISTURBED]
        for name, file in zip(DISTURBED, names, strict=True):
            content = {"schema": "train_ato/scenario/1", "name": name.replace(":", "_"), "base": name, "laws": weights}
            (folder / file).write_text(yaml.safe_dump(content), encoding="utf-8")
        laws = ",".join([*LAWS.names(), LEARNED])
        command = ["compare", *names, "--seeds", str(SEEDS), "--laws", laws, "--out", "leaderboard"]
        subprocess.run([sys.executable, "-m", "train_ato", *command], cwd=folder, env=environment, check=False)
        found = json.loads((folder / "leaderboard" / "summary.json").read_text(encoding="utf-8"))
    rows = [{"law": row["law"], **{key: _short(row[key]) for key in STANDINGS}} for row in found["laws"]]
    for row in rows:
        for name, file in zip(DISTURBED, names, strict=True):
            own = [[run for run in runs if run["scenario"] == Path(file).stem] for runs in found["runs"]]
            (of_law,) = (other for other in standings(own) if other["law"] == row["law"])
            row[name] = [of_law["passed"], of_law["runs"], _short(of_law["speed_rmse_kmh"])]
    write_rows(root / LEADERBOARD_ROWS, {"command": f"train-ato {' '.join(command)}", "rows": rows}, 2)


def _leaderboard(found: Mapping[str, Any]) -> list[str]:
    """Return the standings of all laws and the learned one in the scenarios with disturbances."""
    rows = []
    for row in found["rows"]:
        cells = [f"{passed} of {runs}; {_cell(error)}" for passed, runs, error in (row[name] for name in DISTURBED)]
        rows.append((row["law"], *(_cell(row[key]) for key in STANDINGS), *cells))
    return table_lines(("law", *STANDINGS.values(), *(f"`{name}`" for name in DISTURBED)), rows)


def _cell(value: float | None) -> str:
    return "-" if value is None else number_text(value, 3)


def _table(rows: list[dict[str, Any]]) -> list[str]:
    lines = []
    for found in rows:
        figures = [found.get(key) for key in KEPT]
        cells = [_cell(value) for value in figures]
        couplers = f"{cells[2]} ... {cells[3]}" if figures[2] or figures[3] else "-"
        outcome = verdict(found).replace("; ", "<br>")
        lines.append((found["law"], gains_text(found), outcome, *cells[:2], couplers, cells[4]))
    heads = ("law", "gains", "outcome", "rms km/h", "stop m", "couplers kN", "command variation kN/s")
    return table_lines(heads, lines)


def gains_text(found: Mapping[str, Any]) -> str:
    """Return the gains of a row: those that its run took, or for a law without printed ones `own`."""
    text: str = found["gains"] and found.get("source", found["gains"])
    return text or "own"


def verdict(found: dict[str, Any]) -> str:
    """Return outcome, finding, criteria that are not met with their values, takeovers, or the reason of a refusal."""
    text = [found["outcome"], *(found[key] for key in ("reason", "choice", "finding") if key in found)]
    text += [f"{name} {_cell(value)}" for name, value in found.get("missed", {}).items()]
    if found.get("takeovers"):
        text.append(f"{found['takeovers']} takeovers")
    return "; ".join(text)
