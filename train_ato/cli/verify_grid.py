"""``train-ato verify --grid``: one hash of runs over CPU targets, threads, modes and Python versions."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from typing import TYPE_CHECKING, Any

from train_ato.apps.grid.cell import GRAPH_MODES
from train_ato.cli.screen import print_json, print_table
from train_ato.errors import RunFailed

if TYPE_CHECKING:
    from train_ato.apps.grid.cell import Axes
    from train_ato.apps.grid.grid import CellResult, Grid
    from train_ato.apps.grid.interpreters import Skipped

MODES = ("engine", *GRAPH_MODES)
SHORT = 12
"""Number of digits of a hash in the table."""


def add_grid_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``verify --grid``."""
    from train_ato.apps.grid.cell import TARGETS, THREADS

    group = parser.add_argument_group("grid")
    group.add_argument(
        "--grid",
        nargs="*",
        metavar="SCENARIO",
        help="run scenarios on a grid of CPU targets, threads, modes and Python versions and print one hash, or the "
        "first difference (default: three short scenarios)",
    )
    _add_axis(group, "--target", TARGETS, "CPU target of the kernels")
    _add_axis(group, "--threads", THREADS, "number of threads", kind=int)
    _add_axis(group, "--mode", MODES, "mode of the runs")
    group.add_argument(
        "--python",
        action="append",
        metavar="PATH",
        help="interpreter with the packages of train_ato beside this one; may be repeated (default: those of PATH and "
        "pyenv)",
    )
    group.add_argument(
        "--libraries",
        action="store_true",
        help="also cells with the code of numpy, libm and OpenBLAS for other processors",
    )


def _add_axis(group: Any, option: str, values: tuple[Any, ...], text: str, kind: type = str) -> None:
    listed = ", ".join(map(str, values))
    group.add_argument(option, action="append", choices=values, type=kind, help=f"{text}: {listed} (default: all)")


def verify_grid(options: argparse.Namespace) -> int:
    """Run the grid and print the table and the verdict."""
    from train_ato.apps.grid.grid import DEFAULT, Grid, GridScenario, scratch_folder
    from train_ato.apps.grid.interpreters import find_interpreters
    from train_ato.apps.runs.progress import activity, share_bar

    if options.run is not None:
        raise ValueError(f"RUN {options.run}: not used with --grid; name scenarios after --grid, or remove one")
    if options.relative:
        raise ValueError("--relative: not used with --grid, which compares bits; remove it")
    grid = Grid([GridScenario(name) for name in options.grid] or DEFAULT)
    with scratch_folder() as scratch:
        with activity("looking for Python interpreters"):
            interpreters, skipped = find_interpreters(options.python, scratch)
        for entry in skipped:
            sys.stderr.write(f"train-ato: skipped: {entry.path}: {entry.reason}\n")
        axes = _axes(options, interpreters)
        complete = False
        try:
            with share_bar("grid") as report:
                grid.run(axes, scratch, report)
            complete = True
        finally:
            if not complete and grid.results:
                _print(grid, axes, skipped, options.json)
    _print(grid, axes, skipped, options.json)
    if grid.one_hash is None:
        raise RunFailed(_reason(grid))
    return 0


def _axes(options: argparse.Namespace, interpreters: tuple[Any, ...]) -> Axes:
    """Return the axes of the options; the values of the reference cell first."""
    from train_ato.apps.grid.cell import HOST, LIBRARIES, TARGETS, THREADS, Axes

    targets = options.target or TARGETS
    return Axes(
        interpreters,
        tuple(sorted(dict.fromkeys(targets), key=lambda target: target != HOST)),
        tuple(sorted(set(options.threads or THREADS))),
        tuple(mode for mode in MODES if mode in (options.mode or MODES)),
        tuple(LIBRARIES) if options.libraries else (),
    )


def _reason(grid: Grid) -> str:
    """Return the first failure or difference as text."""
    reference = grid.results[0]
    for entry in grid.results:
        if entry.failure:
            return f"{entry.cell}: {entry.failure}"
        if entry.first is not None:
            scenario, difference = entry.first
            return f"{entry.cell}: differs from {reference.cell}: {scenario}: {difference}"
    return "the grid has no result"


def _row(entry: CellResult, reference: CellResult) -> list[str]:
    cell = entry.cell
    axes = [cell.python, cell.target, str(cell.threads), cell.mode, cell.library or "-"]
    if entry.failure:
        return [*axes, "failed", entry.failure]
    if entry.first is None:
        return [*axes, entry.hash[:SHORT], "reference" if entry is reference else "equal"]
    scenario, difference = entry.first
    return [*axes, entry.hash[:SHORT], f"{scenario}: {difference}"]


def _print(grid: Grid, axes: Axes, skipped: tuple[Skipped, ...], as_json: bool) -> None:
    """Print the table and the one hash, or JSON."""
    reference = grid.results[0]
    if as_json:
        print_json(as_data(grid, axes, skipped))
        return
    for scenario, text in zip(grid.scenarios, reference.hashes, strict=False):
        sys.stdout.write(f"{scenario}: {text}\n")
    columns = ("python", "target", "threads", "mode", "library", "hash", "result")
    print_table(columns, (_row(entry, reference) for entry in grid.results))
    if grid.one_hash is not None:
        sys.stdout.write(f"one hash: {grid.one_hash}\n")


def as_data(grid: Grid, axes: Axes, skipped: tuple[Skipped, ...]) -> dict[str, Any]:
    """Return the result of the grid for ``--json``."""
    cells = []
    for entry in grid.results:
        row = {**dataclasses.asdict(entry.cell), "hash": entry.hash, "hashes": entry.hashes, "failure": entry.failure}
        if entry.first is not None:
            row |= {"scenario": entry.first[0], "first": dataclasses.asdict(entry.first[1])}
        cells.append(row)
    return {
        "one_hash": grid.one_hash,
        "scenarios": [str(scenario) for scenario in grid.scenarios],
        "interpreters": [dataclasses.asdict(entry) for entry in axes.interpreters],
        "skipped": [dataclasses.asdict(entry) for entry in skipped],
        "cells": cells,
    }
