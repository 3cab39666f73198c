"""Time of recording: in a separate process, in one process with the graph, and compared with another writer.

    python studies_done/recorder.py [--seconds S] [--rate R] [--ticks N] [--rounds N] [--json]

*Own process*: a ring of empty nodes sends every recorded topic for the train of 106 vehicles at a fixed rate, as bytes
of a real run with new stamps; the recorder is the real node in a separate process.  Its log must contain all sent
messages.  Its processor time is compared with that of the sending process.

*One process*: the graph without the recorder and with it, once for every compression; all four run in turns of 500
ticks, so that other load on the machine affects all of them.  The difference is the time of recording: wall time,
processor time of the graph's thread, and processor time of the process with the packing thread.  With the default, the
share in the graph's thread must be below a fifth.

*Writers*: the log of the whole 45 km, written again with every compression and by the writer of the ``mcap`` package,
with the same checksums: time of a message and size of the log of a simulated hour.  ``with disturbances`` is the size
of the same run with the true disturbances, a topic of some runs only.

The exit status is 1 if a message is lost or a goal is missed widely (see figures.py).
"""

from __future__ import annotations

import argparse
import gc
import io
import json
import os
import struct
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
from figures import Figure, Goal, judge, publish
from mcap.writer import CompressionType, Writer

from train_ato.program.errors import FirstFailure
from train_ato.log.bag_layout import table_name
from train_ato.log.compression import COMPRESSIONS, DEFAULT
from train_ato.log.mcap_records import RawMessage, stream
from train_ato.log.run_folder import RunFolder
from train_ato.log.log_writer import LogFile
from train_ato.loop.engine import run_engine
from train_ato.scenario.setup import RunSetup, prepare
from train_ato.messages.codec import Wire
from train_ato.messages.topics import BY_NAME, EPOCH_NS, Rate, Role
from train_ato.ros.graph.environment import applied, claim_domain, variables
from train_ato.scenario.scenario import load_scenario

TURN = 500
"""Ticks of one graph before the next one: several chunks, so that the packing of its own chunks is included."""
PAUSE_S = 0.2
"""Wall time after a turn to finish the packing of chunks."""
UNRECORDED = "not recorded"
TIMES = ("wall", "thread", "process")
"""Clocks: wall time, processor time of the graph's thread, processor time of the process."""


class Graph:
    """Nodes of a run in this process, run for a number of ticks at a time.

    Parameters
    ----------
    compression
        Compression of the log; None: no recorder.
    """

    def __init__(self, setup: RunSetup, folder: Path, compression: str | None, stack: ExitStack) -> None:
        from train_ato.ros.graph.assembly import executor_of, make_node
        from train_ato.ros.graph.graph_result import GraphOptions
        from train_ato.ros.nodes.endpoints import ROLES, NodeEndpoints

        folder.mkdir(parents=True)
        recorded = compression is not None
        roles = ROLES if recorded else ROLES[:-1]
        self._watch = FirstFailure()
        domain = stack.enter_context(claim_domain())
        context, self._executor = stack.enter_context(executor_of(domain))
        wire = Wire(setup.layout)
        self._all_endpoints = {role: NodeEndpoints(role, wire, context, self._watch, roles) for role in roles}
        options = GraphOptions(timeout=60.0, compression=compression or DEFAULT)
        self._nodes = {
            role: make_node(role, setup, self._all_endpoints[role], folder, options, recorded=recorded)
            for role in roles
        }
        for role, endpoints in self._all_endpoints.items():
            if role is not Role.RECORDER:
                self._executor.add_node(endpoints.node)
        self._recorder = self._nodes.get(Role.RECORDER)
        self.spent: dict[str, list[float]] = {key: [] for key in TIMES}

    def begin(self) -> None:
        """Let the nodes find each other, and start."""
        while any(endpoints.missing() for endpoints in self._all_endpoints.values()):
            self._executor.spin_once(timeout_sec=0.01)
        self._nodes[Role.PROFILE].begin()
        self._nodes[Role.PLANT].begin()

    def drive(self, ticks: int) -> None:
        """Run and record a number of ticks; store the times of one tick [s]."""
        from train_ato.ros.graph.composed import RECORD_EVERY

        plant = self._nodes[Role.PLANT]
        last, turns = plant.stage.tick + ticks, 0
        begin = (time.perf_counter(), time.thread_time(), time.process_time())
        while plant.stage.tick < last and not plant.finished and self._watch.failure is None:
            self._executor.spin_once(timeout_sec=0.1)
            turns += 1
            if self._recorder is not None and turns % RECORD_EVERY == 0:
                self._recorder.poll()
        wall, thread = time.perf_counter(), time.thread_time()
        time.sleep(PAUSE_S)
        end = (wall, thread, time.process_time())
        if self._watch.failure is not None:
            raise RuntimeError(self._watch.failure)
        for key, first, second in zip(TIMES, begin, end, strict=True):
            self.spent[key].append((second - first) / ticks)

    def close(self) -> None:
        """Close the log."""
        if self._recorder is not None:
            self._recorder.close(None)
            self._all_endpoints[Role.RECORDER].destroy()


def one_process(setup: RunSetup, ticks: int, scratch: Path) -> dict[str, dict[str, float]]:
    """Run the graph without a recorder and with every compression, in turns.

    Returns
    -------
    dict
        By compression: median times of a tick [s], and share of the recording in each: the median over pairs of
        consecutive turns.
    """
    with ExitStack() as stack:
        graphs = {
            kind or UNRECORDED: Graph(setup, scratch / f"graph {kind}", kind, stack) for kind in (None, *COMPRESSIONS)
        }
        for graph in graphs.values():
            graph.begin()
        gc.collect()
        gc.freeze()
        for _ in range(ticks // TURN):
            for graph in graphs.values():
                graph.drive(TURN)
        gc.unfreeze()
        for graph in graphs.values():
            graph.close()
    found = {kind: {key: median(graph.spent[key]) for key in TIMES} for kind, graph in graphs.items()}
    for kind in COMPRESSIONS:
        for key in TIMES:
            pairs = zip(graphs[UNRECORDED].spent[key], graphs[kind].spent[key], strict=True)
            found[kind][f"{key}_share"] = 1 - median(without / recorded for without, recorded in pairs)
    return found


WRITERS = (*(f"train_ato {name}" for name in COMPRESSIONS), "mcap none", "mcap lz4", "mcap zstd")
HOUR = 3600.0
BATCH = 450
"""Number of messages per call: 50 ticks of nine, as for the recorder in one process."""


def write_ours(messages: list[RawMessage], folder: Path, compression: str) -> int:
    """Write with the project's writer; return the size of the file [bytes]."""
    folder.mkdir(parents=True)
    log, numbers = LogFile(folder, compression=compression), {}
    for message in messages:
        if message.channel.topic not in numbers:
            numbers[message.channel.topic] = log.copy(message.channel, message.schema)
    for begin in range(0, len(messages), BATCH):
        log.extend((numbers[m.channel.topic], m.publish_ns, m.log_ns, m.data) for m in messages[begin : begin + BATCH])
    log.close()
    return log.path.stat().st_size


def write_peer(messages: list[RawMessage], folder: Path, compression: str) -> int:
    """Write with the ``mcap`` package, with the same checksums; return the size of the file [bytes]."""
    folder.mkdir(parents=True)
    path = folder / "run.mcap"
    with path.open("wb") as file, io.BufferedWriter(file, 1 << 16) as stream:  # type: ignore[type-var]
        writer = Writer(stream, compression=CompressionType[compression.upper()], enable_data_crcs=True)
        writer.start("ros2", "mcap")
        numbers: dict[str, int] = {}
        for message in messages:
            channel, schema = message.channel, message.schema
            if channel.topic not in numbers:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                numbers[channel.topic] = writer.register_channel(channel.topic, "cdr", number, channel.metadata)
        for m in messages:
            writer.add_message(numbers[m.channel.topic], m.log_ns, m.data, m.publish_ns)
        writer.finish()
    return path.stat().st_size


def compared(messages: Iterable[RawMessage], seconds: float, rounds: int, scratch: Path) -> dict[str, Any]:
    """Write the messages with every writer in turn; the best round of each counts.

    Parameters
    ----------
    messages
        Messages of a run.
    seconds
        Simulated time of the run [s].

    Returns
    -------
    dict
        By writer: wall time and processor time of a message, with that of the packing thread [µs], and size of the log
        of a simulated hour [MB].
    """
    held = list(messages)
    found: dict[str, dict[str, float]] = {}
    for turn in range(rounds):
        for name in WRITERS:
            kind, _, compression = name.partition(" ")
            write: Callable[[list[RawMessage], Path, str], int] = write_ours if kind == "train_ato" else write_peer
            wall, processor = time.perf_counter(), time.process_time()
            size = write(held, scratch / f"{turn} {name}", compression)
            wall, processor = time.perf_counter() - wall, time.process_time() - processor
            entry = {
                "wall_us_per_message": wall / len(held) * 1e6,
                "processor_us_per_message": processor / len(held) * 1e6,
                "mb_per_hour": size / 1e6 * HOUR / seconds,
            }
            best = found.setdefault(name, entry)
            found[name] = {key: min(best[key], value) for key, value in entry.items()}
    return found


PLAIN, SCENARIO = "daqin_heavy_haul", "daqin_heavy_haul:disturbed"
RATE = 1500.0
SHARE = 0.2
SOURCE_TICKS = 2500
"""Of the run whose messages the ring sends again and again."""
KEYS = ("processor_us_per_message", "wall_us_per_message", "mb_per_hour")
PEER, PEER_RATIO = "mcap zstd", 1.0
SECOND = 1_000_000_000
_STAMP = struct.Struct("<iI")
_WAIT_S = 30.0


def recorded_ticks(setup: RunSetup, folder: Path) -> list[dict[str, list[bytearray]]]:
    """Return the messages of a short run of the engine, by topic."""
    with RunFolder.make(folder, "source").sink(setup) as sink:
        run_engine(setup, sink=sink)
    ticks: list[dict[str, list[bytearray]]] = [defaultdict(list) for _ in range(setup.ticks + 1)]
    for message in stream(folder / "run.mcap"):
        topic = str(table_name(message.channel.topic))
        ticks[(message.publish_ns - EPOCH_NS) // setup.tick_ns][topic].append(bytearray(message.data))
    return ticks[:-1]


@dataclass
class Ring:
    """Empty nodes of the graph; each sends its messages of a tick after its inputs have arrived."""

    setup: RunSetup
    all_endpoints: dict[Role, Any]
    ticks: list[dict[str, list[bytearray]]]
    tick: int = 0
    acknowledged: int = 0
    waiting: int = 2
    held_s: float = 0.0
    answered: bool = True
    sent: dict[str, int] = field(default_factory=lambda: defaultdict(int))

    def connect(self) -> None:
        """Subscribe as the nodes do."""
        all_endpoints = self.all_endpoints
        all_endpoints[Role.PROFILE].subscribe_raw("train/measurement", lambda _: self.send(Role.PROFILE))
        all_endpoints[Role.OBSERVER].subscribe_raw("train/measurement", lambda _: self.send(Role.OBSERVER))
        controller, plant = all_endpoints[Role.CONTROLLER], all_endpoints[Role.PLANT]
        for name in ("train/measurement", "ato/profile", "train/protection", "atp/speeds"):
            controller.subscribe_raw(name, lambda _: None)
        for name in ("ato/reference", "ato/estimate"):
            controller.subscribe_raw(name, self.joined)
        plant.subscribe_raw("ato/command", self.commanded)
        for name in ("ato/brake_pipe_command", "atp/brake_release"):
            plant.subscribe_raw(name, lambda _: None)
        plant.subscribe_raw("recorder/progress", self.written)
        all_endpoints[Role.PROFILE].subscribe_raw("ato/state", lambda _: None)
        all_endpoints[Role.SUPERVISOR].subscribe_raw("train/odometry", lambda _: self.send(Role.SUPERVISOR))

    def send(self, role: Role) -> None:
        """Send the messages of a node in the present tick with its stamp."""
        stamp = divmod(EPOCH_NS + self.tick * self.setup.tick_ns, SECOND)
        endpoints = self.all_endpoints[role]
        for topic, entries in self.ticks[self.tick % len(self.ticks)].items():
            publishers = BY_NAME[topic].publishers
            if role not in publishers or (self.tick and BY_NAME[topic].rate is Rate.ONCE):
                continue
            # A topic with several publishers has one message of each.
            chosen = entries if len(publishers) == 1 else entries[publishers.index(role) :][:1]
            for data in chosen:
                _STAMP.pack_into(data, 4, *stamp)
                endpoints._senders[topic](bytes(data))
                self.sent[topic] += 1

    def joined(self, _: bytes) -> None:
        """Send the command after reference and estimate have arrived."""
        self.waiting -= 1
        if self.waiting == 0:
            self.waiting = 2
            self.send(Role.CONTROLLER)

    def commanded(self, _: bytes) -> None:
        """End the tick."""
        self.tick += 1
        self.answered = True

    def written(self, data: bytes) -> None:
        """Store the progress of the recorder."""
        seconds, nanoseconds = _STAMP.unpack_from(data, 4)
        self.acknowledged = (seconds * SECOND + nanoseconds - EPOCH_NS) // self.setup.tick_ns

    def drive(self, executor: Any, ticks: int, rate: float) -> float:
        """Run the ring at a rate, with the lead over the recorder limited as in the plant; return the wall time [s]."""
        from train_ato.ros.nodes.plant import LEAD

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
    """Return the processor time of a process [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def own_process(setup: RunSetup, domain: int, ticks: int, rate: float, scratch: Path) -> dict[str, Any]:
    """Record a ring from another process and count the messages."""
    from train_ato.ros.graph.assembly import executor_of
    from train_ato.ros.graph.processes import NodeProcess
    from train_ato.ros.nodes.endpoints import NodeEndpoints, roles_of

    folder = scratch / "own"
    folder.mkdir()
    scenario = scratch / "scenario.yaml"
    scenario.write_text(setup.resolved_yaml(), encoding="utf-8")
    source = recorded_ticks(setup, scratch / "source")
    with ExitStack() as stack:
        arguments = ["--scenario", str(scenario), "--out", str(folder)]
        recorder = NodeProcess(Role.RECORDER, arguments, domain, scratch)
        stack.callback(recorder.end, 5.0)
        context, executor = stack.enter_context(executor_of(domain))
        roles = (role for role in roles_of(setup.layout) if role is not Role.RECORDER)
        all_endpoints = {role: NodeEndpoints(role, Wire(setup.layout), context, FirstFailure()) for role in roles}
        ring = Ring(setup, all_endpoints, source)
        ring.connect()
        for endpoints in all_endpoints.values():
            executor.add_node(endpoints.node)

        last = time.monotonic() + _WAIT_S
        while any(endpoints.missing() for endpoints in all_endpoints.values()):
            executor.spin_once(timeout_sec=0.01)
            if time.monotonic() > last:
                raise RuntimeError(f"the recorder was not ready within {_WAIT_S:g} s")
        before, mine = processor_s(recorder.process.pid), time.process_time()
        wall = ring.drive(executor, ticks, rate)
        took, mine = processor_s(recorder.process.pid) - before, time.process_time() - mine
        for endpoints in all_endpoints.values():
            endpoints.deliver(_WAIT_S)
        recorder.release()
        recorder.end(_WAIT_S)
        found = recorder.counts
        recorded = {
            name.removeprefix("recorded "): values[0] for name, values in found.items() if name.startswith("recorded ")
        }
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


def whole_run(setup: RunSetup, folder_path: Path) -> tuple[Path, float]:
    """Record the scenario in the engine; return the log and its size per simulated hour [MB]."""
    folder = RunFolder.make(folder_path, "disk")
    with folder.sink(setup) as sink:
        run_engine(setup, sink=sink)
    log = folder.path / "run.mcap"
    return log, log.stat().st_size / 1e6 * HOUR / (setup.ticks * setup.tick)


def main() -> int:
    """Measure and print; return the exit status, 0 if no message is lost and the goals are met."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=60.0, help="wall time of the ring [s]")
    parser.add_argument("--rate", type=float, default=RATE, help="ticks per second of the ring")
    parser.add_argument("--ticks", type=int, default=10_000, help="ticks of each graph in one process")
    parser.add_argument("--rounds", type=int, default=2, help="rounds of each writer")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    whole, plain = prepare(*load_scenario(SCENARIO)), prepare(*load_scenario(PLAIN))
    short = prepare(*load_scenario(SCENARIO, (f"duration={SOURCE_TICKS * whole.tick!r}",)))
    with tempfile.TemporaryDirectory() as name, claim_domain() as domain:
        scratch = Path(name)
        with applied(variables(domain, scratch)):
            own = own_process(short, domain, round(options.seconds * options.rate), options.rate, scratch)
            one = one_process(prepare(*load_scenario(PLAIN)), options.ticks, scratch)
        log, _ = whole_run(plain, scratch / "plain")
        writers = compared(stream(log), plain.ticks * plain.tick, options.rounds, scratch)
        _, disturbed = whole_run(whole, scratch / "disturbed")
    result = {
        "scenario": SCENARIO,
        "vehicles": whole.layout.n_vehicles,
        "own_process": own,
        "one_process": one,
        "writers": writers,
        "mb_per_hour_disturbed": disturbed,
    }
    ratio = writers[f"train_ato {DEFAULT}"]["processor_us_per_message"] / writers[PEER]["processor_us_per_message"]
    goals = [
        Goal("rate beside which nothing is lost", own["ticks_per_s"], 0.99 * options.rate, "ticks/s", at_least=True),
        Goal(f"share of a tick that recording takes in one process, {DEFAULT}", one[DEFAULT]["thread_share"], SHARE),
        Goal(f"processor time of {DEFAULT} over that of the mcap package's writer", ratio, PEER_RATIO),
    ]
    publish(
        Figure("messages lost in another process", own["lost"], bound=0.0),
        Figure("recorder, a message", own["recorder_us_per_message"], "us", "sender", own["sender_us_per_message"]),
        *(
            Figure(f"writer, {kind}, a message", found[KEYS[0]], "us", PEER, writers[PEER][KEYS[0]])
            for kind, found in writers.items()
            if kind.startswith("train_ato")
        ),
    )
    if options.json:
        print(json.dumps({**result, "goals": [goal.as_data() for goal in goals]}, indent=2))
    else:
        show(result)
    status = judge(goals, quiet=options.json)
    return 1 if own["lost"] else status


def share_text(found: dict[str, float], key: str) -> str:
    """Return the time of recording as text."""
    share = found.get(f"{key}_share")
    return "      " if share is None else f" {share:4.0%} "


def show(result: dict[str, Any]) -> None:
    """Print the result as text."""
    own, one, writers = result["own_process"], result["one_process"], result["writers"]
    print(f"{result['scenario']}, {result['vehicles']} vehicles, {own['topics']} topics")
    print(
        f"  own process   {own['ticks_per_s']:.0f} ticks/s for {own['wall_s']:.0f} s: {own['sent']} messages sent, "
        f"{own['recorded']} recorded, {own['lost']} lost; held back {own['held_back_s']:.2f} s"
    )
    print(
        f"                recorder {own['recorder_us_per_message']:.1f} us of processor a message "
        f"({own['recorder_share_of_a_core']:.0%} of a core), sender {own['sender_us_per_message']:.1f} us"
    )
    print("  one process   wall time of a tick; processor time of the graph's thread, of the whole process")
    for name, found in one.items():
        times = "  ".join(f"{found[key] * 1e6:6.0f} us" + share_text(found, key) for key in TIMES)
        print(f"    {name:<16} {times}")
    peer = writers[PEER]
    print(f"  writers       processor and wall time of a message, a simulated hour; beside {PEER}")
    for name, found in writers.items():
        processor, wall, size = (found[key] for key in KEYS)
        ratios = ", ".join(f"{found[key] / peer[key]:.2f}" for key in KEYS)
        print(f"    {name:<16} {processor:6.1f} us  {wall:6.1f} us  {size:6.1f} MB   {ratios} times")
    print(f"    with disturbances, {DEFAULT}: {result['mb_per_hour_disturbed']:.1f} MB a simulated hour")


if __name__ == "__main__":
    sys.exit(main())
