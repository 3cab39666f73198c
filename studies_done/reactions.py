"""Reaction times: from the end of a node's process, and from a lost message, to the demand to brake.

    python studies_done/reactions.py [--rounds R] [--json]

A graph with one process per node runs at the rate 1, so that simulated time is wall time.  A node is killed; the time
to the first brake of the train counts from the stamp of its first missing message.  The goal is 0.6 s at 10 and 50 Hz;
the exit status is 1 if it is missed widely (see figures.py).  ``test/test_reaction_times.py`` has the reactions to lost
messages in simulated time.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
from figures import Goal, judge

from msgs_docs.generate.fault_page import BASES
from plant_sim.train import compile_kernel
from train_ato.judge.protection_record import state_spans
from train_ato.scenario.setup import prepare
from train_ato.ros.graph.runner import run_graph
from train_ato.scenario.scenario import load_scenario

KILLED_S = 8.0
"""Time of the first missing message [s]; the train accelerates."""
BRAKES = ("service brake", "emergency brake")
LARGEST_S = 0.6
NODES = ("controller", "profile", "observer", "supervisor")


def reaction(node: str, tick: float) -> float:
    """Return the time from the first missing message of a killed node to the first brake of the train [s]."""
    name, *sets = BASES["metro"]
    fault = f"faults=[{{at: {KILLED_S}, do: kill, node: {node}}}]"
    setup = prepare(*load_scenario(name, (*sets, "duration=30", f"tick={tick}", fault)))
    with tempfile.TemporaryDirectory() as folder:
        result = run_graph(setup, Path(folder), mode="processes", lockstep=False, rate=1.0)
    if result.recording is None:
        raise RuntimeError(result.failure)
    spans = state_spans(result.recording.reports, "plant")
    return min(span.begin for span in spans if span.state in BRAKES) - KILLED_S


def main() -> int:
    """Measure and print; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    compile_kernel()
    found = {
        f"{node} at {1 / tick:g} Hz": [reaction(node, tick) for _ in range(options.rounds)]
        for tick in (0.1, 0.02)
        for node in NODES
    }
    goals = [Goal(f"end of {name} to brake", max(times), LARGEST_S, "s") for name, times in found.items()]
    if options.json:
        print(json.dumps({"reactions_s": found, "goals": [goal.as_data() for goal in goals]}, indent=2))
    return judge(goals, quiet=options.json)


if __name__ == "__main__":
    sys.exit(main())
