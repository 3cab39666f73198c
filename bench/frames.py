"""Opening an hour's run as tables, beside readers that decode message by message; writing the tables as files.

    python bench/frames.py [RUN]

Without RUN an hour of the heavy-haul train is driven first (36 000 ticks, 106 vehicles, every topic).  Each opening is
that of a new process on one core, imports counted apart; the best of several.  The peers make message objects, no
tables: what they take is what one pays before a table can be made.  Times are processor time of that core, which is
what a core of one's own takes; the wall time beside them is that of this machine with whatever else runs on it.  The
goal: under 3 s.  The exit status is 1 when it is missed widely (see goals.py).
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from goals import Goal, judge

MOST_S = 3.0
REPEATS = 5
SCENARIO = "daqin_heavy_haul"
DURATION_S = 3600
PEER_SHARE = 10
"""The slower peer reads one message in so many ticks' time: the first part of the log, scaled."""
OPEN = """
import json, os, sys, time
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
begin = time.process_time()
import pandas
from train_ato.frames.loading import load
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
    """Drive and record an hour, in the engine."""
    from train_ato.engine import run_engine
    from train_ato.run_folder import RunFolder
    from train_ato.run_setup import prepare
    from train_ato.scenario import load

    setup = prepare(*load(SCENARIO, (), {"duration": DURATION_S}))
    run = RunFolder.make(folder / "hour", SCENARIO)
    run.begin(setup)
    with run.sink(setup) as sink:
        run_engine(setup, sink=sink)
    return run.path


def opened(run: Path) -> dict[str, float]:
    """Open the run as tables in a new process."""
    answer = subprocess.run([sys.executable, "-c", OPEN, str(run)], check=True, capture_output=True, text=True)
    result: dict[str, float] = json.loads(answer.stdout)
    return result


def with_rosbags(run: Path) -> tuple[int, float]:
    """Decode every message with rosbags; return how many there were and the time."""
    from rosbags.rosbag2 import Reader

    from train_ato.cdr import typestore

    types, count, begin = typestore(), 0, time.process_time()
    with Reader(run) as bag:
        for connection, _, data in bag.messages():
            types.deserialize_cdr(data, connection.msgtype)
            count += 1
    return count, time.process_time() - begin


def with_mcap_ros2(run: Path) -> tuple[int, float]:
    """Decode the first part of the log with mcap-ros2-support; return how many messages there were and the time."""
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
    """Write every table as files; return the time of the whole command."""
    with tempfile.TemporaryDirectory(prefix="train_ato_bench_") as folder:
        command = [sys.executable, "-m", "train_ato", "export", str(run), option, "--out", f"{folder}/tables", "--json"]
        begin = time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return time.perf_counter() - begin


def _line(what: str, seconds: float, more: str = "") -> str:
    return f"{what:48s} {seconds:8.2f} s   {more}".rstrip()


def main() -> int:
    """Print the times and the goal; return the exit status."""
    parser = argparse.ArgumentParser(description="Time of opening a run as tables.")
    parser.add_argument("run", type=Path, nargs="?", help="run folder (default: an hour is driven)")
    chosen = parser.parse_args().run
    with tempfile.TemporaryDirectory(prefix="train_ato_bench_") as scratch:
        run = chosen or hour(Path(scratch))
        size = (run / "run.mcap").stat().st_size
        runs = [opened(run) for _ in range(REPEATS)]
        best = {key: min(r[key] for r in runs) for key in runs[0]}
        load_s = best["load_s"]
        print(f"{run.name}: {size / 1e6:.0f} MB, {best['cells'] / 1e6:.1f} million numbers")
        print(_line("load, a new process, one core", load_s, f"imports {best['import_s']:.2f} s more"))
        print(_line("its wall time here", best["wall_s"], f"{best['peak_mb']:.0f} MB at its peak"))
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
        peers: list[tuple[str, Callable[[Path], tuple[int, float]]]] = [("rosbags", with_rosbags)]
        try:
            import mcap_ros2  # noqa: F401

            peers.append((f"mcap-ros2-support, a part of 1/{PEER_SHARE}, scaled", with_mcap_ros2))
        except ImportError:
            print("mcap-ros2-support is not installed: left out")
        total = 0
        for name, decode in peers:
            count, taken = decode(run)
            total = total or count
            whole = taken * total / count
            text = f"{1e6 * taken / count:.1f} us a message, {whole / load_s:.1f} times load"
            print(_line(name, whole, text))
        for option in ("--parquet", "--csv"):
            print(_line(f"export {option}, wall time of the command", min(export(run, option) for _ in range(2))))
    return judge((Goal("an hour's run as tables, without imports", load_s, MOST_S, "s"),))


if __name__ == "__main__":
    sys.exit(main())
