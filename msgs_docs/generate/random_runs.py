"""Seeded random runs with supervision, laws x faults x spread of mass, brake, adhesion and delay; their page.

    python -m msgs_docs.generate.random_runs [--count N] [--seed S] [--workers W] [--law NAME] [--scenario NAME]

Prints the summary of the runs; without options these are the runs of ``msgs_docs/random_runs.md``. ``--law`` replaces
the law of every run, ``--scenario`` leaves out the others of the N runs.
"""

import argparse
import hashlib
import json
import os
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from msgs_docs.generate.fault_page import BASES, BEGIN, ROWS, STANDSTILL, FaultRow, FaultRun
from msgs_docs.generate.rows import page_text, read_rows, write_rows
from train_ato.api.progress import share_bar
from train_ato.control.registry import LAWS
from train_ato.loop.engine import run_engine
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import prepare

COUNT, SEED = 1000, 1
"""Number and seed of the runs of the page."""
MEASURED = Path("msgs_docs", "random_runs_measured.json")
SCENARIOS: dict[str, tuple[float, str, tuple[str, ...], float]] = {
    "metro": (0.75, BASES["metro"][0], BASES["metro"][1:], 60.0),
    "metro, 460 s": (0.11, "xuzhou_metro", ("supervision.enabled=true",), 450.0),
    "10 684 t": (0.11, "demo", (), 700.0),
    "10 684 t, long descent": (0.03, BASES["daqin"][0], BASES["daqin"][1:], 1900.0),
}
"""Scenarios of the runs: share, name, assignments, last time of a fault [s]."""
SPREAD: dict[str, tuple[float, float]] = {
    "plant.mismatch.mass_scale": (0.9, 1.05),
    "plant.mismatch.brake_scale": (0.85, 1.05),
    "plant.mismatch.resistance_scale": (0.7, 1.3),
    "plant.mismatch.actuator_gain": (0.9, 1.05),
}
"""Uniform spread of the train about its nominal model.

The smallest brake force per mass is 0.81 of the nominal one, inside the ``kdry`` of 0.8 of the braking curves.
"""
ADHESION = (0.16, 0.3)
"""Uniform spread of the adhesion of the metro train; its guaranteed deceleration needs 0.14."""
DELAY = (0.5, 2.0)
"""Uniform spread of the factor on the delay of the command."""
LONGER = (1.0, 2.0, 4.0)
"""Factors on the duration, until the train is at standstill."""
NO_FAULT = 0.1
"""Part of the runs without a fault."""


@dataclass(frozen=True)
class Draw:
    """One random run.

    Attributes
    ----------
    number
        Index from 0; it is also the seed of the run.
    base
        Key of :data:`SCENARIOS`.
    law, fault
        Name of the law; name of the row of the fault table, empty without a fault.
    scenario, sets
        Scenario and assignments.
    """

    number: int
    base: str
    law: str
    fault: str
    scenario: str
    sets: tuple[str, ...]

    @property
    def command(self) -> str:
        """Command of the same run."""
        options = " ".join(f"--set '{text}'" for text in self.sets)
        return f"train-ato run {self.scenario} --engine --law {self.law} {options}"


@dataclass(frozen=True)
class Figures:
    """Figures of a random run.

    Attributes
    ----------
    margin, short
        Distance from the foremost place of the front to the supervised location, and to the planned stop [m].
    excess
        Largest speed less its bound [m/s].
    moving
        True if the train moves at the end of the run.
    interventions
        Number of interventions of the supervisor.
    failure
        Failed node and reason, or empty.
    """

    margin: float
    short: float
    excess: float
    moving: bool
    interventions: int
    failure: str


def draws(count: int, seed: int) -> Iterator[Draw]:
    """Yield ``count`` random runs; equal arguments give equal runs."""
    bases = list(SCENARIOS)
    shares = [SCENARIOS[base][0] for base in bases]
    for number in range(count):
        random = np.random.default_rng([seed, number])
        base = bases[random.choice(len(bases), p=shares)]
        _, scenario, sets, last = SCENARIOS[base]
        law = _chosen(seed, number, LAWS.names())
        rows = {row.name: row for row in ROWS if _fits(row, base)}
        row = None if random.random() < NO_FAULT else rows[_chosen(seed, number, rows)]
        spread = [f"{key}={random.uniform(*bounds):.4f}" for key, bounds in SPREAD.items()]
        if base.startswith("metro"):
            spread.append(f"plant.adhesion={{kind: constant, coefficient: {random.uniform(*ADHESION):.4f}}}")
        spread.append(f"links.command.delay={_delay(scenario) * random.uniform(*DELAY):.3f}")
        spread.append(f"seed={number}")
        at = f"{random.uniform(5.0, last):.1f}"
        more = () if row is None else tuple(_moved(text, at) for text in row.sets)
        chosen = (*sets, f"law={law}", *spread, *more)
        yield Draw(number, base, law, "" if row is None else row.name, scenario, chosen)


def _chosen(seed: int, number: int, names: Iterable[str]) -> str:
    """Return a random name: the one with the largest hash of seed, number and name.

    One more name takes its share of the runs and leaves the others as they are.
    """
    return max(names, key=lambda name: hashlib.sha256(f"{seed} {number} {name}".encode()).digest())


def _fits(row: FaultRow, base: str) -> bool:
    """Return True for a fault that can be drawn: none of the spread, on heavy trains also of messages and nodes."""
    if any(text.startswith((*SPREAD, "plant.adhesion")) for text in row.sets):
        return False
    same = (row.base == "metro") == base.startswith("metro")
    return same or (row.base == "metro" and row.kind not in ("train", "sensor", "link"))


@cache
def _delay(scenario: str) -> float:
    """Return the largest delay of the command of a scenario [s]."""
    return float(np.max(load_scenario(scenario, ())[0].links.command.delay))


def _moved(text: str, at: str) -> str:
    """Return an assignment with its fault at another time."""
    for key in ("begin", "at"):
        text = text.replace(f"{key}: {BEGIN}", f"{key}: {at}")
    return text


def drive_draw(draw: Draw) -> Figures:
    """Drive a random run in the engine and return its figures.

    A run with a train that moves at its end is driven again for a longer time: the place of its end is not yet the
    foremost one.
    """
    duration = load_scenario(draw.scenario, draw.sets)[0].duration
    for factor in LONGER:
        setup = prepare(*load_scenario(draw.scenario, (*draw.sets, f"duration={factor * duration!r}")))
        result = run_engine(setup)
        run = FaultRun(setup, result)
        if run.end_speed <= STANDSTILL:
            break
    return Figures(
        margin=run.supervised_location - run.front,
        short=run.stop - run.front,
        excess=run.top_speed - run.largest_speed,
        moving=run.end_speed > STANDSTILL,
        interventions=int(result.summary.get("brake_interventions", 0)),
        failure=result.failure or "",
    )


def with_law(draw: Draw, law: str) -> Draw:
    """Return the random run with another law."""
    return replace(draw, law=law, sets=tuple(f"law={law}" if text == f"law={draw.law}" else text for text in draw.sets))


def measure_draws(count: int, seed: int, workers: int, law: str = "", scenario: str = "") -> dict[str, Any]:
    """Drive random runs in ``workers`` processes and return their summary; all with one law or of one scenario."""
    chosen = [draw for draw in draws(count, seed) if scenario in ("", draw.base)]
    chosen = [with_law(draw, law) for draw in chosen] if law else chosen
    found = []
    with share_bar("random runs") as report, ProcessPoolExecutor(workers) as pool:
        for figures in pool.map(drive_draw, chosen, chunksize=4):
            found.append(figures)
            report(len(found) / len(chosen), "")
    return {"runs": digest(chosen), "count": len(chosen), "seed": seed, **summary(chosen, found)}


def digest(chosen: Iterable[Draw]) -> str:
    """Return a hash of the scenarios and assignments of runs."""
    text = json.dumps([(draw.scenario, draw.sets) for draw in chosen])
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def summary(chosen: list[Draw], found: list[Figures]) -> dict[str, Any]:
    """Return the figures of runs by scenario, and the runs beyond the supervised location or the speed bound."""
    bad = [
        {"number": draw.number, "margin_m": round(run.margin, 1), "excess_kmh": round(3.6 * run.excess, 1),
         "fault": draw.fault, "command": draw.command}
        for draw, run in zip(chosen, found, strict=True)
        if run.margin < 0.0 or run.excess > 0.0
    ]  # fmt: skip
    groups = {}
    for base in SCENARIOS:
        pairs = [(draw, run) for draw, run in zip(chosen, found, strict=True) if draw.base == base]
        if pairs:
            groups[base] = _group(pairs)
    return {"beyond": sum(run.margin < 0.0 for run in found), "bad": bad, "scenarios": groups}


def _group(pairs: list[tuple[Draw, Figures]]) -> dict[str, Any]:
    """Return numbers of runs, and median, 95 % and 100 % of the distances [m] of the trains at standstill."""
    still = [run for _, run in pairs if not run.moving]
    margins = np.array([run.margin for run in still])
    faultless = [run for draw, run in pairs if not draw.fault]
    return {
        "runs": len(pairs),
        "beyond": sum(run.margin < 0.0 for _, run in pairs),
        "too_fast": sum(run.excess > 0.0 for _, run in pairs),
        "moving_at_end": len(pairs) - len(still),
        "interventions": sum(run.interventions > 0 for _, run in pairs),
        "failed": sum(bool(run.failure) for _, run in pairs),
        "without_fault": len(faultless),
        "interventions_without_fault": sum(run.interventions > 0 for run in faultless),
        "margin_m": _quantiles(margins),
        "short_m": _quantiles(np.array([run.short for run in still])),
    }


def _quantiles(values: np.ndarray[Any, Any]) -> dict[str, float]:
    """Return smallest value, median and 95 % quantile."""
    if not values.size:
        return {}
    found = np.quantile(values, (0.0, 0.5, 0.95)).tolist()
    return {name: round(value, 1) for name, value in zip(("smallest", "median", "p95"), found, strict=True)}


def main(arguments: list[str] | None = None) -> int:
    """Print the summary of random runs; exit status 1 if a train was beyond the supervised location."""
    parser = argparse.ArgumentParser(prog="python -m msgs_docs.generate.random_runs", description=__doc__)
    parser.add_argument("--count", type=int, default=COUNT, help="number of runs")
    parser.add_argument("--seed", type=int, default=SEED, help="seed of the draws")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--law", default="", choices=LAWS.names(), help="law of all runs; default: random")
    parser.add_argument("--scenario", default="", choices=list(SCENARIOS), help="only these runs; default: all")
    options = parser.parse_args(arguments)
    found = measure_draws(options.count, options.seed, options.workers, options.law, options.scenario)
    sys.stdout.write(json.dumps(found, indent=1, ensure_ascii=False) + "\n")
    return 1 if found["bad"] else 0


PAGE = Path("msgs_docs", "random_runs.md")
NAME = "random_runs"


def measure(root: Path) -> None:
    """Make the runs of the page and write their summary."""
    write_rows(root / MEASURED, measure_draws(COUNT, SEED, os.cpu_count() or 1), 2)


def unmeasured(root: Path) -> list[str]:
    """Return one line if the summary is not that of the present runs."""
    if read_rows(root / MEASURED).get("runs") == digest(draws(COUNT, SEED)):
        return []
    return [f"{MEASURED}: other runs or none; run python -m msgs_docs.generate --measure {NAME}"]


def page(root: Path) -> str:
    """Return the text of the page."""
    found = read_rows(root / MEASURED)
    scenarios: dict[str, Any] = found.get("scenarios", {})
    totals = Counter[str]()
    for group in scenarios.values():
        totals.update({key: value for key, value in group.items() if isinstance(value, int)})
    return page_text(
        NAME,
        count=COUNT,
        seed=SEED,
        share=f"{100.0 * NO_FAULT:g}",
        spread={**SPREAD, "plant.adhesion (metro)": ADHESION, "links.command.delay, factor": DELAY},
        groups={f"{base} (`{SCENARIOS[base][1]}`)": group for base, group in scenarios.items()},
        totals=totals,
        bad=found.get("bad", []),
    )


if __name__ == "__main__":
    sys.exit(main())
