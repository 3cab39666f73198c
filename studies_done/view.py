"""Frame rate of the live page and its share of a core in the server and the browser.

    python studies_done/view.py [--scenario NAME] [--rate F] [--seconds S] [--pages N] [--rounds R] [--json]

A run starts in a separate process; this process serves the page as ``train-ato view`` does, and a headless
Chromium shows it.  Frames are counted after they are drawn.  The share of a core is the CPU time of this process over
the wall time, for reading the graph and serving the page; the best round counts, because other load on the machine only
adds time.  Without Chromium only the reading of the graph is measured.
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

sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
from figures import Goal, judge

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))

FRAMES, SHARE = 20.0, 0.25
"""Goals: frames a second (one per cent below 20 for the beat of the two clocks) and share of a core."""


def processes() -> dict[int, tuple[int, float]]:
    """Return parent and CPU time [s] of every process."""
    ticks = os.sysconf("SC_CLK_TCK")
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            found[int(entry.name)] = int(fields[1]), (int(fields[11]) + int(fields[12])) / ticks
    return found


def browser_seconds(root: int) -> float:
    """Return the CPU time of a process and its children [s]."""
    known = processes()
    total, wave = 0.0, {root}
    while wave:
        total += sum(known[pid][1] for pid in wave if pid in known)
        wave = {pid for pid, (parent, _) in known.items() if parent in wave}
    return total


def children() -> set[int]:
    """Return the child processes."""
    return {pid for pid, (parent, _) in processes().items() if parent == os.getpid()}


def looked_at(url: str, options: argparse.Namespace, feed: Any) -> list[dict[str, float]]:
    """Measure rounds with pages open in Chromium, or without pages if it is not installed."""
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
    """Return the frames a second and the shares of a core over a wall time [s]."""
    begin, first, own, others = time.monotonic(), frames(), time.process_time(), browsers()
    time.sleep(seconds)
    own, others = time.process_time() - own, browsers() - others
    count, wall = frames() - first, time.monotonic() - begin
    return {"frames_per_s": count / wall, "share": own / wall, "browser_share": others / wall}


def served(domain: int, options: argparse.Namespace) -> list[dict[str, float]]:
    """Attach to the run, serve its page from a thread, measure."""
    from train_ato.view.live import LiveFeed
    from train_ato.view.server import PageServer

    feed = LiveFeed(domain, lambda _: None)
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
    """Measure and print; return the exit status, 0 if the goals are met."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--scenario", default="demo")
    parser.add_argument("--rate", type=float, default=10.0)
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--pages", type=int, default=1)
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    from train_ato.ros.graph.environment import applied, claim_domain, held_domains, variables

    with claim_domain() as domain:
        pass
    with tempfile.TemporaryDirectory() as scratch:
        command = [sys.executable, "-m", "train_ato", "run", options.scenario, "--rate", repr(options.rate)]
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
    result = {"scenario": options.scenario, "rate": options.rate, "pages": options.pages, **best, "rounds": rounds}
    if options.json:
        print(json.dumps(result, indent=2))
    else:
        print(f"{options.scenario} at {options.rate:g} times real time, {options.pages} page(s)")
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
