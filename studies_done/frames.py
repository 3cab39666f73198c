"""Time of opening the run of an hour as tables, compared with readers of single messages, and of export to files.

    python studies_done/frames.py [RUN]

Without RUN an hour of the heavy-haul train is simulated first (36 000 ticks, 106 vehicles, every topic).  Each run is
opened in a new process on one core, without the time of the imports; the best of several counts.  The other readers
make message objects, not tables, so their time is a lower bound.  Times are processor times of that core, independent
of other load; the wall time is given beside them.  The goal: below 3 s.  The exit status is 1 if it is missed widely
(see figures.py).
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
from figures import Figure, Goal, judge, publish

MOST_S = 3.0
REPEATS = 5
SCENARIO = "daqin_heavy_haul"
DURATION_S = 3600
PEER_SHARE = 10
"""The slower reader reads the first 1/``PEER_SHARE`` of the log; its time is scaled."""
OPEN = """
import json, os, sys, time
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
begin = time.process_time()
import pandas
from train_ato.log.table_loading import load
imported, clock = time.process_time(), time.perf_counter()
frames = load(sys.argv[1])
opened, wall = time.process_time(), time.perf_counter() - clock
import resource
cells = sum(frame.size for frame in frames.values())
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
result = {"import_s": imported - begin, "load_s": opened - imported, "wall_s": wall, "cells": cells, "peak_mb": peak}
print(json.dumps(result))
"""


def hour(folder: Path) -> Path:
    """Simulate and record an hour in the engine."""
    from train_ato.log.run_folder import RunFolder
    from train_ato.loop.engine import run_engine
    from train_ato.scenario.setup import prepare
    from train_ato.scenario.scenario import load_scenario

    setup = prepare(*load_scenario(SCENARIO, (), {"duration": DURATION_S}))
    run = RunFolder.make(folder / "hour", SCENARIO)
    run.begin(setup)
    with run.sink(setup) as sink:
        run_engine(setup, sink=sink)
    return run.path


def measured(script: str, *arguments: Path) -> dict[str, float]:
    """Run a script in a new process and return its figures."""
    command = [sys.executable, "-c", script, *map(str, arguments)]
    answer = subprocess.run(command, check=True, capture_output=True, text=True)
    result: dict[str, float] = json.loads(answer.stdout)
    return result


@contextmanager
def run_of_an_hour(description: str) -> Iterator[tuple[Path, Path]]:
    """Yield the run of the command line, or a new one of an hour, and a scratch folder; print the size of its log."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("run", type=Path, nargs="?", help="run folder (default: a new run of an hour)")
    chosen = parser.parse_args().run
    with tempfile.TemporaryDirectory(prefix="train_ato_bench_") as scratch:
        run = chosen or hour(Path(scratch))
        print(f"{run.name}: {(run / 'run.mcap').stat().st_size / 1e6:.0f} MB")
        yield run, Path(scratch)


def with_rosbags(run: Path) -> tuple[int, float]:
    """Decode every message with rosbags; return their number and the time [s]."""
    from rosbags.rosbag2 import Reader

    from train_ato.messages.cdr import typestore

    types, count, begin = typestore(), 0, time.process_time()
    with Reader(run) as bag:
        for connection, _, data in bag.messages():
            types.deserialize_cdr(data, connection.msgtype)
            count += 1
    return count, time.process_time() - begin


def with_mcap_ros2(run: Path) -> tuple[int, float]:
    """Decode the first part of the log with mcap-ros2-support; return the number of messages and the time [s]."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    count, begin = 0, time.process_time()
    with (run / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        part = summary.statistics.message_count // PEER_SHARE
        for _ in reader.iter_decoded_messages():
            count += 1
            if count == part:
                break
    return count, time.process_time() - begin


def export(run: Path, option: str) -> float:
    """Write every table as a file; return the time of the whole command [s]."""
    with tempfile.TemporaryDirectory(prefix="train_ato_bench_") as folder:
        command = [sys.executable, "-m", "train_ato", "export", str(run), option, "--out", f"{folder}/tables", "--json"]
        begin = time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return time.perf_counter() - begin


def _line(what: str, seconds: float, more: str = "") -> str:
    return f"{what:48s} {seconds:8.2f} s   {more}".rstrip()


def main() -> int:
    """Print the times and the goal; return the exit status."""
    with run_of_an_hour("Time of opening a run as tables.") as (run, _):
        runs = [measured(OPEN, run) for _ in range(REPEATS)]
        best = {key: min(r[key] for r in runs) for key in runs[0]}
        load_s = best["load_s"]
        print(f"{best['cells'] / 1e6:.1f} million numbers")
        print(_line("load, a new process, one core", load_s, f"imports {best['import_s']:.2f} s more"))
        print(_line("wall time", best["wall_s"], f"{best['peak_mb']:.0f} MB at most"))
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
        peers: list[tuple[str, Callable[[Path], tuple[int, float]]]] = [("rosbags", with_rosbags)]
        try:
            import mcap_ros2  # noqa: F401

            peers.append((f"mcap-ros2-support, a part of 1/{PEER_SHARE}, scaled", with_mcap_ros2))
        except ImportError:
            print("mcap-ros2-support: not installed; skipped")
        total = 0
        for name, decode in peers:
            count, taken = decode(run)
            total = total or count
            whole = taken * total / count
            publish(Figure(f"load of an hour beside {name}", load_s, "s", name, whole))
            text = f"{1e6 * taken / count:.1f} us a message, {whole / load_s:.1f} times load"
            print(_line(name, whole, text))
        for option in ("--parquet", "--csv"):
            seconds = min(export(run, option) for _ in range(2))
            publish(Figure(f"export {option} of an hour", seconds, "s", "load", load_s))
            print(_line(f"export {option}, wall time of the command", seconds))
    return judge((Goal("an hour's run as tables, without imports", load_s, MOST_S, "s"),))


if __name__ == "__main__":
    sys.exit(main())
