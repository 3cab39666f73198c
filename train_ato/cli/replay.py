"""``train-ato replay``: publish a recorded run again, or try a law on its recorded inputs."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import Any

from train_ato.cli.screen import print_json, table
from train_ato.record.reading import log_file
from train_ato.replay import ReplayOptions, parse_remap, replay
from train_ato.run_folder import open_run
from train_ato.run_setup import prepare
from train_ato.scenario import load

ROWS: tuple[tuple[str, str], ...] = (
    ("ticks", "ticks compared"),
    ("equal_ticks", "ticks with the same command"),
    ("difference_rms_kn", "difference, rms in kN"),
    ("difference_max_kn", "difference, largest in kN"),
    ("difference_max_at_s", "largest at s"),
    ("difference_mean_kn", "difference, mean in kN"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``replay``."""
    parser.add_argument("run", type=Path, metavar="RUN", help="run folder or MCAP file")
    parser.add_argument(
        "--rate", type=float, default=1.0, metavar="R", help="simulated seconds per second (default: 1)"
    )
    parser.add_argument("--start-offset", type=float, default=0.0, metavar="S", help="begin so many seconds later")
    parser.add_argument("--loop", action="store_true", help="begin again at the end, until Ctrl-C")
    parser.add_argument("--start-paused", action="store_true", help="wait for the service /replay/start")
    parser.add_argument("--clock", type=float, metavar="HZ", help="publish /clock so often instead of the recorded one")
    parser.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="only these topics")
    parser.add_argument("--remap", nargs="+", default=[], metavar="A:=B", help="publish a topic under another name")
    parser.add_argument("--domain", type=int, metavar="N", help="ROS domain (default: ROS_DOMAIN_ID or 0)")
    parser.add_argument("--controller", metavar="NAME", help="publish nothing: drive this law with the recorded inputs")
    parser.add_argument("--set", action="append", default=[], metavar="A.B=V", help="with --controller: change a key")
    parser.add_argument("--json", action="store_true", help="print one JSON value and nothing else")


def execute(options: argparse.Namespace) -> int:
    """Publish a run, or compare a law's commands with the recorded ones."""
    if options.controller is not None:
        return _compare(options)
    if options.set:
        raise ValueError("--set: changes a law, so it needs --controller NAME")
    log_file(options.run)
    if options.domain is not None and not 0 <= options.domain <= 101:
        raise ValueError(f"--domain {options.domain}: give a domain from 0 to 101")
    chosen = ReplayOptions(
        rate=options.rate,
        start_offset=options.start_offset,
        loop=options.loop,
        start_paused=options.start_paused,
        clock_hz=options.clock,
        topics=tuple(options.topics),
        remap=parse_remap(tuple(options.remap)),
    )
    from train_ato.graph.environment import discovery_profile

    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(discovery_profile()))
    counts = replay(options.run, chosen, domain=options.domain)
    if options.json:
        print_json({"run": str(options.run), "published": counts})
    else:
        table(("topic", "messages"), sorted(counts.items()), f"published again from {options.run}")
    return 0


def _compare(options: argparse.Namespace) -> int:
    """Drive a law with the recorded inputs; the law of the run itself keeps the swaps that were planned in it."""
    from train_ato.open_loop import replay_open_loop

    setup, _ = open_run(options.run)
    changes: dict[str, Any] = {}
    if options.controller != setup.controller:
        changes = {"controller": options.controller, "swaps": []}
    changed = prepare(*load(str(options.run / "scenario.yaml"), tuple(options.set), changes))
    summary = {
        "run": str(options.run),
        "controller": options.controller,
        **replay_open_loop(changed, options.run).summary(),
    }
    if options.json:
        print_json(summary)
    else:
        rows = [(text, summary[key]) for key, text in ROWS]
        table(("figure", "value"), rows, f"{options.controller} on the recorded inputs of {options.run}")
        sys.stdout.write("The loop is open: the train in the log did not feel these commands.\n")
    return 0
