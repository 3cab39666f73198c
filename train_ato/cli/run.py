"""``train-ato run``: drive a scenario, record it, score it, draw it."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from train_ato.cli.main import RunFailed
from train_ato.cli.scenario_options import add_scenario_options, prepare_from
from train_ato.cli.screen import COMPILE_NOTE, noted_when_slow, print_json, progress_bar, table
from train_ato.graph.environment import check_domain
from train_ato.interrupt import interruptible
from train_ato.outcome import Outcome
from train_ato.run_folder import RunFolder
from train_ato.run_setup import RunSetup

RESULT_ROWS: tuple[tuple[str, str], ...] = (
    ("speed_rmse_kmh", "speed error, rms in km/h"),
    ("speed_error_max_kmh", "speed error, largest in km/h"),
    ("position_error_max_m", "position error, largest in m"),
    ("stop_error_m", "stop error in m"),
    ("overspeed_max_kmh", "overspeed, largest in km/h"),
    ("coupler_draft_max_kn", "coupler draft, largest in kN"),
    ("coupler_buff_max_kn", "coupler buff, largest in kN"),
    ("command_variation_kn_per_s", "command variation in kN/s"),
    ("energy_traction_kwh", "traction energy in kWh"),
    ("energy_regenerated_kwh", "regenerated energy in kWh"),
    ("saturated_s", "time at a force limit in s"),
    ("real_time_factor", "simulated over wall time"),
    ("step_time_us_median", "controller step, median in µs"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``run``."""
    add_scenario_options(parser)
    parser.add_argument("--controller", metavar="NAME", help="control law")
    way = parser.add_mutually_exclusive_group()
    way.add_argument("--engine", action="store_true", help="plain Python loop without ROS, same log")
    way.add_argument("--processes", action="store_true", help="one process for each node (default: all nodes in one)")
    clock = parser.add_mutually_exclusive_group()
    clock.add_argument(
        "--realtime", type=float, metavar="F", help="pace on the wall clock, F simulated seconds a second"
    )
    clock.add_argument(
        "--pace", type=float, default=0.0, metavar="F", help="lockstep, held back to F simulated seconds a second"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="run folder to make (default: runs/NAME-N)")
    parser.add_argument("--domain", type=int, metavar="N", help="ROS domain, 1 to 101 (default: a free one)")


def way_of(options: argparse.Namespace) -> str:
    """Return which of the three ways of running the options choose."""
    return "engine" if options.engine else "processes" if options.processes else "composed"


def execute(options: argparse.Namespace) -> int:
    """Drive one scenario."""
    if options.realtime is not None and not 0 < options.realtime < float("inf"):
        raise ValueError(f"--realtime {options.realtime}: give a positive number, 1 for real time")
    if not 0 <= options.pace < float("inf"):
        raise ValueError(f"--pace {options.pace}: give a positive number, 1 for real time; 0 is as fast as it goes")
    if options.pace and options.engine:
        raise ValueError("--pace: the engine cannot be held back while it runs; use --realtime, or leave --engine out")
    if options.domain is not None and options.engine:
        raise ValueError(f"--domain {options.domain}: the engine uses no ROS; leave it or --engine out")
    check_domain(options.domain)
    setup = prepare_from(options, controller=options.controller)
    folder = RunFolder.make(options.out, setup.scenario.name)
    try:
        folder.begin(setup)
        note_compilation()
        outcome = drive(
            setup, folder, way_of(options), options.realtime, options.domain, setup.scenario.name, options.pace
        )
        outcome = replace(outcome, summary={**outcome.summary, "way": way_of(options)})
        finish(setup, folder, outcome)
    except ValueError:
        folder.discard()
        raise
    except OSError as error:
        if folder.recorded:
            raise
        folder.discard()
        raise ValueError(
            f"--out {folder.path}: cannot be written ({error.strerror or error}); name a place with room"
        ) from None
    except KeyboardInterrupt:
        if not folder.recorded:
            folder.discard()
            raise
        raise RunFailed(f"interrupted; what was recorded is in {folder.path}") from None
    report(outcome, folder, options.json)
    if outcome.failure:
        raise RunFailed(outcome.failure)
    if outcome.interrupted:
        raise RunFailed(f"interrupted; what was recorded is in {folder.path}")
    return 0


def finish(setup: RunSetup, folder: RunFolder, outcome: Outcome) -> None:
    """Write summary and figure; where a failed run left no room for them, what it failed of is told, not that."""
    try:
        folder.finish(setup, outcome)
    except OSError:
        if not outcome.failure:
            raise
        raise RunFailed(outcome.failure) from None


def note_compilation() -> None:
    """Load the train's kernel; where that takes long it is being compiled, once on this machine, and a line says so."""
    from plant_sim.train import compile_kernel

    with noted_when_slow(COMPILE_NOTE):
        compile_kernel()


def drive(
    setup: RunSetup,
    folder: RunFolder,
    way: str,
    realtime: float | None,
    domain: int | None,
    title: str,
    pace: float = 0.0,
) -> Outcome:
    """Run a prepared scenario in one of the three ways, recorded into ``folder``."""
    with progress_bar(title) as progress:
        if way == "engine":
            from train_ato.engine import run_engine

            with interruptible() as interrupt, folder.sink(setup) as sink:
                outcome = run_engine(
                    setup,
                    sink=sink,
                    progress=progress,
                    realtime=realtime,
                    log_folder=folder.path / "log",
                    interrupt=interrupt,
                )
            return outcome.checked_against(sink.counts)
        from train_ato.graph.runner import run_graph

        return run_graph(setup, folder.path, way=way, progress=progress, realtime=realtime, pace=pace, domain=domain)


def report(outcome: Outcome, folder: RunFolder, as_json: bool) -> None:
    """Print the result."""
    summary: dict[str, Any] = {**outcome.summary, "run": str(folder.path)}
    if as_json:
        print_json(summary)
        return
    rows = [(text, summary[key]) for key, text in RESULT_ROWS if key in summary]
    head = f"{summary['scenario']}  {summary['controller']} / {summary['observer']} / {summary['compensation']}"
    table(("figure", "value"), rows, head)
    if held := summary.get("held_steps"):
        sys.stdout.write(
            f"in {held} steps the last command was repeated: the law or a measurement gave nothing usable\n"
        )
    sys.stdout.write(f"{summary['ticks']} ticks in {summary['wall_s']:.1f} s; recorded in {folder.path}\n")
