"""What recording takes: beside the ring in a process of its own, in one process with it, and on the disk.

    python bench/recorder.py [--seconds S] [--rate R] [--ticks N] [--rounds N] [--json]

*Own process*: a bare ring of the graph's nodes sends every recorded topic of the catalogue for the train of 106
vehicles at a fixed rate, as bytes of a real run under new stamps; the recorder is the real node in its own process.
As many messages have to be in its log as were sent.  Its processor time stands beside that of the process that sends.

*One process*: ticks of the whole graph with and without the recorder, in turn, the best round of each; the
difference is what recording takes, its share of a tick has to stay under a half.

*On the disk*: size of the log of the 106-vehicle train over its whole 45 km, laid on a simulated hour; beside it that
of the same run with the truth of the disturbances, the one topic that only some runs have.

The exit status is 1 when a message is lost or a goal is missed widely (see goals.py).
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import struct
import sys
import tempfile
import time
from collections import defaultdict
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from goals import Goal, judge

from train_ato.engine import run_engine
from train_ato.graph.environment import applied, claim_domain, variables
from train_ato.record.layout import table_name
from train_ato.record.reading import stream
from train_ato.run_folder import RunFolder
from train_ato.run_setup import RunSetup, prepare
from train_ato.scenario import load
from train_ato.topics import BY_NAME, EPOCH_NS, Rate, Role

PLAIN, SCENARIO = "daqin_heavy_haul", "daqin_heavy_haul:disturbed"
RATE = 1500.0
SHARE = 0.5
MEGABYTES = 100.0
SECOND = 1_000_000_000
HOUR = 3600.0
_STAMP = struct.Struct("<iI")
_WAIT_S = 30.0


def recorded_ticks(setup: RunSetup, folder: Path) -> list[dict[str, list[bytearray]]]:
    """Return the messages of every tick of a short run of the engine, by topic."""
    with RunFolder.make(folder, "source").sink(setup) as sink:
        run_engine(setup, sink=sink)
    ticks: list[dict[str, list[bytearray]]] = [defaultdict(list) for _ in range(setup.ticks + 1)]
    for message in stream(folder / "run.mcap"):
        topic = str(table_name(message.channel.topic))
        ticks[(message.publish_ns - EPOCH_NS) // setup.tick_ns][topic].append(bytearray(message.data))
    return ticks[:-1]


@dataclass
class Ring:
    """The nodes of the graph with nothing in them: each sends its messages of a tick when those it needs have come."""

    setup: RunSetup
    shells: dict[Role, Any]
    ticks: list[dict[str, list[bytearray]]]
    tick: int = 0
    acknowledged: int = 0
    waiting: int = 2
    held_s: float = 0.0
    answered: bool = True
    sent: dict[str, int] = field(default_factory=lambda: defaultdict(int))

    def connect(self) -> None:
        """Subscribe as the nodes do."""
        shells = self.shells
        shells[Role.PROFILE].subscribe_raw("train/measurement", lambda _: self.send(Role.PROFILE))
        shells[Role.OBSERVER].subscribe_raw("train/measurement", lambda _: self.send(Role.OBSERVER))
        controller, plant = shells[Role.CONTROLLER], shells[Role.PLANT]
        for name in ("train/measurement", "ato/profile"):
            controller.subscribe_raw(name, lambda _: None)
        for name in ("ato/reference", "ato/estimate"):
            controller.subscribe_raw(name, self.joined)
        plant.subscribe_raw("ato/command", self.commanded)
        plant.subscribe_raw("ato/brake_pipe", lambda _: None)
        plant.subscribe_raw("record/acknowledged", self.written)

    def send(self, role: Role) -> None:
        """Send what a node sends in the tick under way, under its stamp."""
        stamp = divmod(EPOCH_NS + self.tick * self.setup.tick_ns, SECOND)
        shell = self.shells[role]
        for topic, entries in self.ticks[self.tick % len(self.ticks)].items():
            publishers = BY_NAME[topic].publishers
            if role not in publishers or (self.tick and BY_NAME[topic].rate is Rate.ONCE):
                continue
            # Of a topic with several publishers each sends one.
            chosen = entries if len(publishers) == 1 else entries[publishers.index(role) :][:1]
            for data in chosen:
                _STAMP.pack_into(data, 4, *stamp)
                shell._senders[topic](bytes(data))
                self.sent[topic] += 1

    def joined(self, _: bytes) -> None:
        """Answer once reference and estimate are there."""
        self.waiting -= 1
        if self.waiting == 0:
            self.waiting = 2
            self.send(Role.CONTROLLER)

    def commanded(self, _: bytes) -> None:
        """End the tick."""
        self.tick += 1
        self.answered = True

    def written(self, data: bytes) -> None:
        """Take how far the recorder is."""
        seconds, nanoseconds = _STAMP.unpack_from(data, 4)
        self.acknowledged = (seconds * SECOND + nanoseconds - EPOCH_NS) // self.setup.tick_ns

    def drive(self, executor: Any, ticks: int, rate: float) -> float:
        """Go round at a rate, as the plant does not more than its lead before the recorder; return the wall time."""
        from plant_sim.node import LEAD

        begin = time.perf_counter()
        while self.tick < ticks:
            now = time.perf_counter()
            due = begin + self.tick / rate
            ahead = self.tick - self.acknowledged > LEAD
            if self.answered and now >= due and not ahead:
                self.answered = False
                self.send(Role.PLANT)
            elif self.answered and now >= due:
                executor.spin_once(timeout_sec=0.001)
                self.held_s += time.perf_counter() - now
            else:
                executor.spin_once(timeout_sec=max(0.0, due - now) if self.answered else 0.1)
        return time.perf_counter() - begin


def processor_s(pid: int) -> float:
    """Return the processor time that a process has taken [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def own_process(setup: RunSetup, domain: int, ticks: int, rate: float, scratch: Path) -> dict[str, Any]:
    """Record a ring from another process and count."""
    from train_ato.failure import Watch
    from train_ato.graph.assembly import executor_of
    from train_ato.graph.child import Child
    from train_ato.nodes.shell import Shell
    from train_ato.wire import Wire

    folder = scratch / "own"
    folder.mkdir()
    scenario = scratch / "scenario.yaml"
    scenario.write_text(setup.resolved_yaml(), encoding="utf-8")
    source = recorded_ticks(setup, scratch / "source")
    events: queue.Queue[Any] = queue.Queue()
    with ExitStack() as stack:
        arguments = ["--scenario", str(scenario), "--out", str(folder)]
        child = Child(Role.RECORDER, arguments, variables(domain, scratch), scratch, events)
        stack.callback(child.end, 5.0)
        context, executor = stack.enter_context(executor_of(domain))
        roles = (Role.PLANT, Role.PROFILE, Role.OBSERVER, Role.CONTROLLER)
        shells = {role: Shell(role, Wire(setup.shape), context, Watch()) for role in roles}
        ring = Ring(setup, shells, source)
        ring.connect()
        for shell in shells.values():
            executor.add_node(shell.node)

        def until(kind: str) -> dict[str, Any]:
            last = time.monotonic() + _WAIT_S
            while time.monotonic() < last:
                executor.spin_once(timeout_sec=0.01)
                while not events.empty():
                    event: dict[str, Any] = events.get()[1]
                    if event["event"] in (kind, "failed", "ended"):
                        return event
            raise RuntimeError(f"the recorder was not {kind} within {_WAIT_S:g} s")

        until("ready")
        before, mine = processor_s(child.process.pid), time.process_time()
        wall = ring.drive(executor, ticks, rate)
        took, mine = processor_s(child.process.pid) - before, time.process_time() - mine
        child.tell("drain", published=dict(ring.sent), limit=_WAIT_S)
        recorded = until("closed")["recorded"]
    sent = sum(ring.sent.values())
    return {
        "ticks_per_s": ticks / wall,
        "wall_s": wall,
        "held_back_s": ring.held_s,
        "topics": len(ring.sent),
        "sent": sent,
        "recorded": sum(recorded.values()),
        "lost": sum(abs(ring.sent[name] - recorded.get(name, 0)) for name in ring.sent),
        "recorder_us_per_message": took / sent * 1e6,
        "recorder_share_of_a_core": took / wall,
        "sender_us_per_message": mine / sent * 1e6,
        "log_mb": (folder / "run.mcap").stat().st_size / 1e6,
    }


def graph_tick(setup: RunSetup, domain: int, folder: Path, recorded: bool) -> float:
    """Return the wall time of one tick of the graph in one process [s]."""
    from train_ato.failure import Watch
    from train_ato.graph.assembly import executor_of, make_node
    from train_ato.graph.composed import RECORD_EVERY
    from train_ato.nodes.shell import ROLES, Shell
    from train_ato.wire import Wire

    folder.mkdir()
    roles = ROLES if recorded else ROLES[:-1]
    watch = Watch()
    with executor_of(domain) as (context, executor):
        shells = {role: Shell(role, Wire(setup.shape), context, watch, roles) for role in roles}
        nodes = {role: make_node(role, setup, shells[role], folder, None, 60.0, recorded) for role in roles}
        for role, shell in shells.items():
            if role is not Role.RECORDER:
                executor.add_node(shell.node)
        while any(shell.missing() for shell in shells.values()):
            executor.spin_once(timeout_sec=0.01)
        recorder = nodes.get(Role.RECORDER)
        begin = time.perf_counter()
        nodes[Role.PROFILE].begin()
        plant = nodes[Role.PLANT]
        plant.begin()
        record = 0
        while not plant.finished and watch.failure is None:
            executor.spin_once(timeout_sec=0.1)
            if recorder is not None and plant.role.tick >= record:
                record = plant.role.tick + RECORD_EVERY
                recorder.poll()
        if recorder is not None:
            recorder.close(None)
            shells[Role.RECORDER].destroy()
        wall = time.perf_counter() - begin
    if watch.failure is not None:
        raise RuntimeError(watch.failure)
    return wall / setup.ticks


def one_process(setup: RunSetup, domain: int, rounds: int, scratch: Path) -> dict[str, Any]:
    """Drive the graph with and without recording, in turn."""
    pairs = [
        [graph_tick(setup, domain, scratch / f"{number}{name}", name == "with") for name in ("with", "without")]
        for number in range(rounds)
    ]
    with_s, without_s = (min(column) for column in zip(*pairs, strict=True))
    return {
        "tick_recorded_us": with_s * 1e6,
        "tick_unrecorded_us": without_s * 1e6,
        "recording_us": (with_s - without_s) * 1e6,
        "share": (with_s - without_s) / with_s,
    }


def on_disk(setup: RunSetup, folder_path: Path) -> dict[str, Any]:
    """Record the whole scenario and lay its size on an hour."""
    folder = RunFolder.make(folder_path, "disk")
    with folder.sink(setup) as sink:
        outcome = run_engine(setup, sink=sink)
    size = (folder.path / "run.mcap").stat().st_size
    seconds = setup.ticks * setup.tick
    messages = sum(outcome.published.values())
    return {
        "simulated_s": seconds,
        "messages": messages,
        "bytes_per_message": size / messages,
        "mb_per_hour": size / 1e6 * HOUR / seconds,
    }


def main() -> int:
    """Measure and print; the exit status tells whether everything was recorded and the goals are kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=60.0, help="wall time beside the ring")
    parser.add_argument("--rate", type=float, default=RATE, help="ticks per second of the ring")
    parser.add_argument("--ticks", type=int, default=2500, help="of a round in one process")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    whole, plain = prepare(*load(SCENARIO)), prepare(*load(PLAIN))
    short = prepare(*load(SCENARIO, (f"duration={options.ticks * whole.tick!r}",)))
    with tempfile.TemporaryDirectory() as name, claim_domain() as domain:
        scratch = Path(name)
        with applied(variables(domain, scratch)):
            own = own_process(short, domain, round(options.seconds * options.rate), options.rate, scratch)
            one = one_process(short, domain, options.rounds, scratch)
        disk = {name: on_disk(setup, scratch / name) for name, setup in (("plain", plain), ("disturbed", whole))}
    result = {
        "scenario": SCENARIO,
        "vehicles": whole.shape.n_vehicles,
        "own_process": own,
        "one_process": one,
        "on_disk": disk,
    }
    goals = [
        Goal("rate beside which nothing is lost", own["ticks_per_s"], 0.99 * options.rate, "ticks/s", at_least=True),
        Goal("share of a tick that recording takes in one process", one["share"], SHARE),
        Goal("log of a simulated hour", disk["plain"]["mb_per_hour"], MEGABYTES, "MB"),
        Goal("the same with disturbances", disk["disturbed"]["mb_per_hour"], MEGABYTES, "MB"),
    ]
    if options.json:
        print(json.dumps({**result, "goals": [goal.as_data() for goal in goals]}, indent=2))
    else:
        show(result)
    status = judge(goals, quiet=options.json)
    return 1 if own["lost"] else status


def show(result: dict[str, Any]) -> None:
    """Print the result for people."""
    own, one, disk = result["own_process"], result["one_process"], result["on_disk"]
    print(f"{result['scenario']}, {result['vehicles']} vehicles, {own['topics']} topics")
    print(
        f"  own process   {own['ticks_per_s']:.0f} ticks/s for {own['wall_s']:.0f} s: {own['sent']} messages sent, "
        f"{own['recorded']} recorded, {own['lost']} lost; held back {own['held_back_s']:.2f} s"
    )
    print(
        f"                recorder {own['recorder_us_per_message']:.1f} us of processor a message "
        f"({own['recorder_share_of_a_core']:.0%} of a core), sender {own['sender_us_per_message']:.1f} us"
    )
    print(
        f"  one process   {one['tick_recorded_us']:.0f} us a tick recorded, {one['tick_unrecorded_us']:.0f} us not: "
        f"recording takes {one['recording_us']:.0f} us, {one['share']:.0%} of a tick"
    )
    for name, found in disk.items():
        print(
            f"  on the disk   {found['mb_per_hour']:.1f} MB a simulated hour, {found['bytes_per_message']:.0f} bytes a "
            f"message ({name}, {found['messages']} messages over {found['simulated_s']:.0f} s)"
        )


if __name__ == "__main__":
    sys.exit(main())
