"""Frames a second of the live page, and what it costs: this process's share of a core, and the browser's.

    python bench/view.py [--scenario NAME] [--pace F] [--seconds S] [--pages N] [--rounds R] [--json]

A run is started in a process of its own, paced; the page is served here as ``train-ato view`` serves it and looked at
in a headless Chromium.  Frames are counted where they are drawn.  The share of a core is this process's CPU time over
the wall time, reading the graph and serving the page together; the best round counts, since others on the machine
only ever add.  Without Chromium the page has no reader, and only the reading of the graph is measured.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from goals import Goal, judge

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))

FRAMES, SHARE = 20.0, 0.25
"""What is to be reached: frames a second (a hundredth is left to the beat of the two clocks), part of a core."""


def browser_seconds(root: int) -> float:
    """Return the CPU time of a process and all that it started [s]."""
    ticks = os.sysconf("SC_CLK_TCK")
    parents: dict[int, int] = {}
    used: dict[int, float] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            parents[int(entry.name)] = int(fields[1])
            used[int(entry.name)] = (int(fields[11]) + int(fields[12])) / ticks
    total, wave = 0.0, {root}
    while wave:
        total += sum(used.get(pid, 0.0) for pid in wave)
        wave = {pid for pid, parent in parents.items() if parent in wave}
    return total


def children() -> set[int]:
    """Return the processes that this one started."""
    found = set()
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                if int((entry / "stat").read_text().rpartition(")")[2].split()[1]) == os.getpid():
                    found.add(int(entry.name))
            except OSError:
                continue
    return found


def looked_at(url: str, options: argparse.Namespace, feed: Any) -> list[dict[str, float]]:
    """Measure rounds with pages open in Chromium, or with none where there is no Chromium."""
    if shutil.which("chromium") is None and shutil.which("chromium-browser") is None:
        return [measured(options.seconds, lambda: feed.frame.number, lambda: 0.0) for _ in range(options.rounds)]
    from contextlib import ExitStack

    from chromium import browser

    before = children()
    with ExitStack() as stack:
        pages = [stack.enter_context(browser()) for _ in range(options.pages)]
        chromiums = children() - before
        for page in pages:
            page.open(url, 1720, 1000)
            page.wait_for("window.trainAto && window.trainAto.frames > 10")

        def frames() -> float:
            return sum(float(page.evaluate("window.trainAto.frames")) for page in pages) / len(pages)

        def browsers() -> float:
            return sum(browser_seconds(pid) for pid in chromiums)

        return [measured(options.seconds, frames, browsers) for _ in range(options.rounds)]


def measured(seconds: float, frames: Any, browsers: Any) -> dict[str, float]:
    """Return frames a second and shares of a core over some wall time."""
    begin, first, own, others = time.monotonic(), frames(), time.process_time(), browsers()
    time.sleep(seconds)
    own, others = time.process_time() - own, browsers() - others
    count, wall = frames() - first, time.monotonic() - begin
    return {"frames_per_s": count / wall, "share": own / wall, "browser_share": others / wall}


def served(domain: int, options: argparse.Namespace) -> list[dict[str, float]]:
    """Attach to the run, serve its page from a thread, measure."""
    from train_ato.view.live import LiveFeed
    from train_ato.view.server import PageServer

    feed = LiveFeed(domain)
    over = threading.Event()
    ready: list[str] = []

    def serve() -> None:
        server = PageServer(feed)
        ready.append(server.url)
        server.run(over.is_set)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        while not ready or feed.frame is None:
            time.sleep(0.05)
        return looked_at(ready[0], options, feed)
    finally:
        over.set()
        thread.join()
        feed.close()


def main() -> int:
    """Measure and print; the exit status tells whether the limits are kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--scenario", default="demo")
    parser.add_argument("--pace", type=float, default=10.0)
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--pages", type=int, default=1)
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    from train_ato.graph.environment import applied, claim_domain, held_domains, variables

    with claim_domain() as domain:
        pass
    with tempfile.TemporaryDirectory() as scratch:
        command = [sys.executable, "-m", "train_ato", "run", options.scenario, "--pace", repr(options.pace)]
        command += ["--domain", str(domain), "--out", f"{scratch}/run"]
        run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            while domain not in held_domains():
                time.sleep(0.1)
            with applied(variables(domain, Path(scratch))):
                rounds = served(domain, options)
        finally:
            run.send_signal(signal.SIGINT)
            run.wait()
    best = max(rounds, key=lambda entry: (round(entry["frames_per_s"]), -entry["share"]))
    result = {"scenario": options.scenario, "pace": options.pace, "pages": options.pages, **best, "rounds": rounds}
    if options.json:
        print(json.dumps(result, indent=2))
    else:
        print(f"{options.scenario} at {options.pace:g} times real time, {options.pages} page(s)")
        for entry in rounds:
            print(
                f"  {entry['frames_per_s']:5.1f} frames/s, {100 * entry['share']:5.1f} % of a core here, "
                f"{100 * entry['browser_share']:6.1f} % in the browser"
            )
    goals = (
        Goal("frames a second", round(best["frames_per_s"], 1), 0.99 * FRAMES, at_least=True),
        Goal("share of a core of the server", best["share"], SHARE),
    )
    return judge(goals, quiet=options.json)


if __name__ == "__main__":
    sys.exit(main())
