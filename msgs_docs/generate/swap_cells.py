"""Changes of the law on ``msgs_docs/any_law.md``: every pair of laws at five places of five scenarios."""

import multiprocessing
from itertools import permutations
from pathlib import Path

import numpy as np

from msgs_docs.generate.rows import read_rows, row_line, table_lines, texts, write_rows
from plant_sim.units import number_text
from train_ato.control.registry import LAWS
from train_ato.judge.recording import Recording
from train_ato.loop.engine import TickLoop
from train_ato.messages.types import Array
from train_ato.scenario.scenario import LawChange, load_scenario
from train_ato.scenario.setup import RunSetup, prepare

NAME = "swaps"
MEASURED = Path("msgs_docs", "swaps_measured.json")
HELD_S, AFTER_S = 3.0, 20.0
"""Time for which a change keeps the bound of the command, and for which its errors count [s]."""
LAST = "last 200 m"
"""Place from which on a run goes to its end, and the place of its stop counts."""
PLACES = {
    "xuzhou_metro": {"standstill": 1, "acceleration": 19, "cruising": 224, "braking": 405, LAST: 416},
    "demo": {"standstill": 20, "acceleration": 133, "cruising": 350, "braking": 534, LAST: 603},
    "daqin_heavy_haul": {"standstill": 20, "acceleration": 250, "cruising": 800, "braking": 1400, LAST: 3046},
    "crh380a_gpc:short": {"standstill": 2, "acceleration": 60, "cruising": 320, "braking": 500, LAST: 611},
    "crh380a_funnel:short": {"standstill": 6, "acceleration": 60, "cruising": 320, "braking": 500, LAST: 609},
}
"""Places of a change of the law by scenario: its time [s]; on daqin_heavy_haul the air brake acts in braking. The
commands of the departure begin at 1.7 s on xuzhou_metro, and at 3.8 s on crh380a_gpc:short."""
JERK = {
    "xuzhou_metro": 0.6, "demo": 0.002, "daqin_heavy_haul": 0.002, "crh380a_gpc": 0.25, "crh380a_funnel": 0.25,
    "freight_consensus": 0.1,
}  # fmt: skip
"""Jerk of the profile [m/s³]; that of the recorded one of daqin_heavy_haul jumps, its limit is in the scenario."""
REASONS = {tuple(cell): row["reason"] for row in texts("reasons")["swaps"] for cell in row["cells"]}
"""Measured reason of the changes beyond twice the error, by scenario, place, old and new law."""
_at_place: tuple[TickLoop, RunSetup, LawChange, str] | None = None
"""Run at a place with its change, for the processes that drive on from there."""


def swap_errors(setup: RunSetup, recording: Recording, begin: float) -> tuple[float, float]:
    """Return the largest speed error from a time on [m/s], and the position error at the end of the run [m]."""
    share = setup.model.share
    speeds = recording.velocity @ share - recording.reference_velocity
    end = (recording.position[-1] + setup.model.offsets) @ share - recording.reference_position[-1]
    return float(np.abs(speeds[recording.time >= begin]).max()), abs(float(end))


def swap_bound(setup: RunSetup) -> Array:
    """Return jerk x inertia x share x tick of every unit [N]."""
    jerk = JERK[setup.scenario.name.partition(":")[0]]
    return np.asarray(jerk * setup.model.inertia * setup.model.share * setup.tick * (1 + 1e-6))


def change(recording: Recording, begin: float, tick: float, lasting: float = HELD_S) -> Array:
    """Return the largest change of the command of every unit in one tick from a time on [N]."""
    held = (recording.time >= begin - 1.5 * tick) & (recording.time < begin + lasting - 0.5 * tick)
    return np.asarray(np.abs(np.diff(recording.command[held], axis=0)).max(axis=0))


def measure(root: Path) -> None:
    """Drive all cells, and write a row for every place of a scenario."""
    rows = []
    for scenario, places in PLACES.items():
        found: dict[tuple[str, str, str], tuple[float, float, bool]] = {}
        for old in LAWS.names():
            found |= _driven_from(scenario, old)
        for place in places:
            beyond, kept = [], 0
            for old, new in permutations(LAWS.names(), 2):
                swap, alone = found[place, old, new], (found[place, old, old], found[place, new, new])
                kept += swap[2]
                for number, unit in enumerate(("m/s", "m") if place == LAST else ("m/s",)):
                    worse = max(law[number] for law in alone)
                    if swap[number] > 2.0 * worse:
                        beyond.append([old, new, swap[number], worse, unit])
            cells = len(LAWS.names()) * (len(LAWS.names()) - 1)
            rows.append({"scenario": scenario, "place": place, "cells": cells, "kept": kept, "beyond": beyond})
        write_rows(root / MEASURED, rows)


def _driven_from(scenario: str, old: str) -> dict[tuple[str, str, str], tuple[float, float, bool]]:
    """Return both errors, and True if the bound is kept, by place, old and new law for one old law.

    One run drives to every place; processes that have its state drive on from there, with every law.
    """
    global _at_place
    found, (other, *_) = {}, (law for law in LAWS.names() if law != old)
    marks = [{"at": float(at), "law": other} for at in PLACES[scenario].values()]
    setup = prepare(*load_scenario(scenario, changes={"law": old, "law_changes": marks}))
    loop = TickLoop(setup, None, compiled=True)
    loop.start()
    for place in PLACES[scenario]:
        mark = loop.controller.planned[0]
        while loop.ticks < round(mark.at / setup.tick):
            loop.advance()
        loop.controller.planned.pop(0)
        _at_place = loop, setup, mark, place
        with multiprocessing.get_context("fork").Pool(2, maxtasksperchild=1) as pool:
            for new, figures in zip(LAWS.names(), pool.map(_driven_on, LAWS.names(), 1), strict=True):
                found[place, old, new] = figures
    return found


def _driven_on(new: str) -> tuple[float, float, bool]:
    """Return both errors, and True if the bound is kept, after a change to a law; none for the old law."""
    assert _at_place is not None
    loop, setup, mark, place = _at_place
    loop.controller.planned = [] if new == setup.scenario.law else [mark.model_copy(update={"law": new})]
    last = setup.ticks
    if place != LAST:
        last = round((mark.at + AFTER_S) / setup.tick)
        loop.controller.planned.append(mark.model_copy(update={"at": mark.at + AFTER_S}))
    while loop.ticks < last and not loop.plant.finished:
        loop.advance()
    if place == LAST:
        loop.conclude()
    recording = loop.recording.finish()
    kept = bool((change(recording, mark.at, setup.tick) <= swap_bound(setup)).all())
    return *swap_errors(setup, recording, mark.at), kept


def table(root: Path) -> list[str]:
    """Return the lines of the page: cells within twice the error by scenario and place, and the others."""
    rows = read_rows(root / MEASURED)
    places = list(dict.fromkeys(row["place"] for row in rows))
    lines = table_lines(("scenario", *places), ())
    for scenario in dict.fromkeys(row["scenario"] for row in rows):
        counts = [row["cells"] - len(row["beyond"]) for row in rows if row["scenario"] == scenario]
        lines.append(row_line(f"`{scenario}`", *counts))
    kept, cells = (sum(row[key] for row in rows) for key in ("kept", "cells"))
    lines += ["", f"{kept} of {cells} changes keep the bound of the command.", ""]
    for row in rows:
        for old, new, value, worse, unit in row["beyond"]:
            found = f"{number_text(value, 3)} {unit}, the worse law alone {number_text(worse, 3)} {unit}"
            reason = REASONS.get((row["scenario"], row["place"], old, new), "")
            lines.append(f"* `{row['scenario']}`, {row['place']}, `{old}` to `{new}`: {found}. {reason}".rstrip())
    return lines
