"""Size, compression, times and memory of a record and of its readers, and what info says of it."""

import functools
import itertools
import json
import shutil
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from commands import answer
from engine_runs import no_figure, record_run, setup_of
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from test_record import wait_for

import train_ato
from train_ato.cli.main import main
from train_ato.judge.run_end import RunEnd
from train_ato.log import reading
from train_ato.log.chunk_thread import CLOSE_AFTER_S
from train_ato.log.compression import COMPRESSIONS
from train_ato.log.difference import compare_logs
from train_ato.log.log_writer import CHUNK, LogFile, RunLog
from train_ato.log.mcap_records import stream
from train_ato.log.mcap_writer import McapWriter
from train_ato.log.overview import log_overview
from train_ato.log.reading import WallTime, read_wall_time
from train_ato.log.recorded import open_recording, read_changes
from train_ato.log.recover import recover
from train_ato.log.run_folder import read_run_folder
from train_ato.loop.engine import run_engine
from train_ato.messages.codec import Wire
from train_ato.messages.topics import EPOCH_NS, topics_of
from train_ato.report.page_data import page_data
from train_ato.ros.nodes import recorder
from train_ato.scenario.setup import RunSetup
from train_ato.view.recorded import RecordedFeed

GOLDEN = Path(__file__).resolve().parent / "golden" / "short_train" / "run.mcap"


def test_a_log_alone_tells_all_but_the_summary(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the laws and their times are missing for a log without its folder."""
    found = answer(capsys, "info", str(GOLDEN))
    assert found["duration_s"] == pytest.approx(44.0)
    assert found["messages"]["/train/vehicles"] == 441
    by_name = {topic["name"]: topic for topic in found["topics"]}
    assert by_name["/train/vehicles"]["rate_hz"] == pytest.approx(10.0)
    assert by_name["/diagnostics"]["rate_hz"] == pytest.approx(4.0, abs=0.1)
    assert by_name["/ato/profile"]["rate_hz"] is None
    assert all(topic["gaps"] == 0 for topic in found["topics"])
    assert [(row["at_s"], row["name"]) for row in found["changes"]] == [
        (12.0, "pid.kp"), (20.0, "controller"), (24.0, "gust"), (26.0, "delay_jump"),
    ]  # fmt: skip
    assert found["versions"]["train_ato"]
    assert found["note"] == ""


def test_a_run_folder_tells_its_summary_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "run"
    swaps = "--set=law_changes=[{at: 3, law: smc}]"
    assert main(["run", "demo", "--engine", "--set=duration=5", swaps, f"--out={run}", "--json"]) == 0
    capsys.readouterr()
    found = answer(capsys, "info", str(run))
    assert found["ticks"] == 50
    assert found["status"] == "done"
    assert found["changes"] == [{"at_s": 3.0, "name": "controller", "value": "smc", "planned": True}]
    assert main(["info", str(run)]) == 0
    shown = capsys.readouterr().out
    for part in ("controller = smc", "planned", "/ato/command", "recorded with train_ato"):
        assert part in shown


def test_gaps_are_found_where_they_are(tmp_path: Path) -> None:
    """Breaks if lost messages in the middle of a run are not shown."""
    log, numbers = LogFile(tmp_path), {}
    for m in stream(GOLDEN):
        name, stamp = m.channel.topic, m.publish_ns - EPOCH_NS
        if name not in numbers:
            numbers[name] = log.channel(name, m.schema.name, m.schema.data.decode(), "", "[]")
        lost = name == "/ato/command" and (10e9 < stamp < 12e9 or stamp == 30e9)
        if not lost:
            log.write(numbers[name], m.publish_ns, m.log_ns, m.data)
    log.close()
    topics = {topic.name: topic for topic in log_overview(log.path).topics}
    command = topics.pop("/ato/command")
    assert (command.gaps, command.longest_gap_s, command.longest_gap_at_s) == (2, 2.0, 10.0)
    assert all(topic.gaps == 0 for topic in topics.values())


def test_a_log_that_was_never_closed_names_recover(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a killed run shows nothing, or the remedy for its log is missing."""
    partial = tmp_path / "my runs" / "run.mcap.partial"
    partial.parent.mkdir()
    partial.write_bytes(GOLDEN.read_bytes()[:200_000])
    for path in (partial, partial.parent):
        found = answer(capsys, "info", str(path))
        assert f"train-ato recover '{partial}'" in found["note"]  # to be copied
        assert 100 < found["messages"]["/train/vehicles"] <= 441
        assert found["versions"]
    assert main(["info", str(partial)]) == 0
    assert "train-ato recover" in capsys.readouterr().out


def test_a_log_that_is_being_written_is_not_called_killed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = LogFile(tmp_path)
    number = log.channel("/ato/command", "sensor_msgs/msg/JointState", "", "", "[]")
    log.write(number, EPOCH_NS, EPOCH_NS, bytes(12))
    log.flush()
    found = answer(capsys, "info", str(tmp_path))
    assert "still goes on" in found["note"]
    assert found["messages"] == {"/ato/command": 1}
    log.close()


def test_a_foreign_log_counts_from_its_first_message(tmp_path: Path) -> None:
    log = LogFile(tmp_path)
    number = log.channel("/chatter", "std_msgs/msg/Byte", "byte data\n", "", "[]")
    for k in range(5):
        log.write(number, 10**18 + k * 10**9, 0, bytes(8))
    log.close()
    (topic,) = log_overview(log.path).topics
    assert (topic.first_s, topic.last_s, topic.rate_hz, topic.gaps) == (0.0, 4.0, 1.0, 0)


NAMES = {"none": "", "fast": "zstd", "small": "zstd"}
"""Name of each compression in the file."""
SIZE = 1000
"""Size of a message of the killed process [bytes]."""
WRITER = f"""
import sys
from pathlib import Path
from train_ato.log.log_writer import LogFile
log = LogFile(Path(sys.argv[1]), compression=sys.argv[2])
number = log.channel("/bytes", "std_msgs/msg/Byte", "byte data", "", "[]")
count = 0
while True:
    for _ in range(100):
        log.write(number, count, count, count.to_bytes(8, "little") * {SIZE // 8})
        count += 1
    print(count, flush=True)
"""

pytestmark = pytest.mark.usefixtures("without_figure")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return the folder of the same run with every compression."""
    folder = tmp_path_factory.mktemp("runs")
    for name in COMPRESSIONS:
        options = ("--set", "duration=30", "--compression", name, "--out", str(folder / name))
        with no_figure():
            assert main(["run", "demo", "--engine", *options]) == 0
    return {name: folder / name for name in COMPRESSIONS}


def raw(path: Path) -> list[tuple[str, int, int, bytes]]:
    return [(m.channel.topic, m.publish_ns, m.log_ns, m.data) for m in stream(path)]


def chunk_names(path: Path) -> set[str]:
    """Return the compressions of the chunks of a log, as its index names them."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return {index.compression for index in summary.chunk_indexes}


@pytest.mark.parametrize("name", COMPRESSIONS)
def test_every_reader_gets_the_same_messages(name: str, runs: dict[str, Path]) -> None:
    """Breaks if a reader does not support the compression of a chunk or its name."""
    log, expected = runs[name] / "run.mcap", raw(runs["fast"] / "run.mcap")
    assert chunk_names(log) == {NAMES[name]}
    assert raw(log) == expected
    with log.open("rb") as file:
        read = make_reader(file, validate_crcs=True).iter_messages(log_time_order=False)
        assert [(c.topic, m.publish_time, m.log_time, m.data) for _, c, m in read] == expected
    with Reader(runs[name]) as bag:
        messages = sorted((connection.topic, time, bytes(data)) for connection, time, data in bag.messages())
    assert messages == sorted((topic, log_ns, data) for topic, _, log_ns, data in expected)
    tables: list[Any] = [train_ato.load(runs[entry]) for entry in (name, "fast")]
    assert tables[0] and all(table.equals(tables[1][topic]) for topic, table in tables[0].items())
    assert main(["verify", str(runs[name])]) == 0


def test_the_sizes_are_those_of_the_choices(runs: dict[str, Path], tmp_path: Path) -> None:
    """Breaks if a packing degrades, a topic grows or is recorded more often, or a paced run closes a chunk early."""
    none, fast, small = ((runs[name] / "run.mcap").stat().st_size for name in COMPRESSIONS)
    assert none < 3.02e6 and fast < 0.235 * none and small < 0.95 * fast
    messages = list(stream(runs["none"] / "run.mcap"))
    a_second = sum(len(m.data) + 31 for m in messages) / 30
    log, numbers = LogFile(tmp_path, chunk_size=round(CLOSE_AFTER_S * a_second), compression="fast"), {}
    for m in messages:
        if m.channel.topic not in numbers:
            numbers[m.channel.topic] = log.copy(m.channel, m.schema)
        log.write(numbers[m.channel.topic], m.publish_ns, m.log_ns, m.data)
    log.close()
    assert log.path.stat().st_size < 0.245 * none


@pytest.mark.parametrize(
    ("way", "name"), [((), "none"), pytest.param(("--processes",), "none", marks=pytest.mark.campaign)]
)
def test_the_recorder_node_packs_as_chosen(way: tuple[str, ...], name: str, tmp_path: Path) -> None:
    """Breaks if the option does not reach the node."""
    options = ("--set", "duration=5", "--compression", name, "--out", str(tmp_path / "run"))
    assert main(["run", "demo", *way, *options]) == 0
    assert chunk_names(tmp_path / "run" / "run.mcap") == {NAMES[name]}


def test_an_unknown_compression_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="'zip' does not exist; choose none, fast, small"):
        LogFile(tmp_path, compression="zip")


@pytest.mark.parametrize("name", COMPRESSIONS)
def test_a_killed_process_loses_two_chunks_at_most(name: str, tmp_path: Path) -> None:
    """Breaks if chunks accumulate before the packing thread: a kill would lose all of them."""
    command, written = [sys.executable, "-c", WRITER, str(tmp_path), name], 0
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        while written < 20 * CHUNK // SIZE:
            written = int(process.stdout.readline())
        process.kill()
        written = max([written, *map(int, process.stdout.read().split("\n")[:-1])])
    found = recover(tmp_path)
    assert found.messages >= written - 2 * CHUNK / SIZE
    recovered = [message.data for message in stream(found.path)]
    assert recovered == [count.to_bytes(8, "little") * (SIZE // 8) for count in range(found.messages)]


def test_a_failure_of_the_packing_thread_ends_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the thread ends without a report: the next full chunk would wait for ever."""

    def fails(self: McapWriter, chunk: object) -> None:
        raise MemoryError("no room to pack")

    monkeypatch.setattr(McapWriter, "write_chunk", fails)
    log = LogFile(tmp_path)
    number = log.channel("/bytes", "std_msgs/msg/Byte", "byte data", "", "[]")
    with pytest.raises(OSError, match=r"writing failed \(no room to pack\)"):
        for _ in range(4 * CHUNK // SIZE):
            log.write(number, 0, 0, bytes(SIZE))
    wait_for(lambda: log.failure is not None)
    log.close()
    assert not (tmp_path / "run.mcap").exists()


SECONDS = 20
"""Simulated duration of the runs [s]: many times their wall time, so that the two cannot be mistaken."""
TICK_TOPICS = ("/clock", "/train/vehicles", "/train/measurement", "/ato/reference", "/ato/estimate", "/ato/command")
MODES = {"engine": ["--engine"], "composed": [], "processes": ["--processes"]}
EVERY_MODE = pytest.mark.parametrize("mode", ["engine", "composed", pytest.param("processes", marks=pytest.mark.graph)])


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Return the function that runs the scenario in a mode, once per mode."""
    made: dict[str, Path] = {}

    def folder(mode: str) -> Path:
        if mode not in made:
            if mode != "engine":
                pytest.importorskip("rclpy")
            out = tmp_path_factory.mktemp(mode) / "run"
            assert main(["run", "demo", "--json", f"--set=duration={SECONDS}", f"--out={out}", *MODES[mode]]) == 0
            made[mode] = out
        return made[mode]

    return folder


@EVERY_MODE
def test_duration_and_rates_are_those_of_the_simulation(mode: str, run: Callable[[str], Path]) -> None:
    """Breaks if log times are the wall times of receipt: a player then shows 10 Hz topics at hundreds of hertz."""
    with Reader(run(mode)) as bag:
        times: dict[str, list[int]] = {}
        for connection, moment, _ in bag.messages():
            times.setdefault(connection.topic, []).append(moment)
        assert bag.start_time == EPOCH_NS
        # rosbags counts to the nanosecond after the last message
        assert bag.duration - 1 == pytest.approx(SECONDS * 10**9)
    for topic in TICK_TOPICS:
        found = times[topic]
        assert (len(found) - 1) / (found[-1] - found[0]) * 1e9 == pytest.approx(10.0)
        assert {late - early for early, late in itertools.pairwise(found)} == {10**8}, topic


@EVERY_MODE
def test_log_time_is_the_stamp_of_every_message(mode: str, run: Callable[[str], Path]) -> None:
    """Breaks if one topic keeps a time of its own, or the order in the file differs from that of the times."""
    last = 0
    for message in stream(run(mode) / "run.mcap"):
        assert message.log_ns == message.publish_ns
        assert message.log_ns >= last - 10**8, "more than a tick out of order"
        last = max(last, message.log_ns)


OWN = SimpleNamespace(begun=True, lost=0, fault=None, check=list, newcomers=list, take=lambda *_, lossy=False: True)
"""Publisher of every message; also those of a topic of several nodes."""


class LateQueues:
    """Queues of the recorder's topics with recorded bytes; those of one topic arrive later than the others."""

    is_repeated = sent_outside = staticmethod(lambda *_: False)
    answer_requests = publish = staticmethod(lambda *_: None)
    end = None

    def __init__(self, folder: Path, late: str) -> None:
        setup, _ = read_run_folder(folder)
        self.wire = Wire(setup.layout)
        self._late, self._queues = late, {}
        for message in stream(folder / "run.mcap"):
            self._queues.setdefault(message.channel.topic.removeprefix("/"), []).append(message.data)
        self.arrived = False

    def taker(self, name: str) -> tuple[Callable[[], Any], Any]:
        queue = iter(self._queues.get(name.removeprefix("/"), []))

        def take() -> tuple[bytes, dict[str, int]] | None:
            data = next(queue, None) if name != self._late or self.arrived else None
            return None if data is None else (data, {"received_timestamp": 0, "publication_sequence_number": 0})

        return take, OWN

    shared_taker = taker


@pytest.mark.parametrize("hold", [60.0, 0.0], ids=["waits", "longest wait"])
def test_messages_wait_for_the_last_topic_of_their_tick(hold, run, tmp_path, monkeypatch):
    """Breaks if a tick is before the late command of an earlier one, or if a silent topic stops the recording."""
    monkeypatch.setattr(recorder, "HOLD_S", hold)
    queues = LateQueues(run("engine"), "ato/command")
    node = recorder.RecorderNode(RunLog(tmp_path, topics_of(queues.wire.layout)), queues, 10**8)
    node.poll()
    assert node.log.counts["train/measurement"] == 0
    node.poll()
    assert (node.log.counts["train/measurement"] == 0) == (hold > 0.0)
    queues.arrived = True
    node.poll()
    node.close(None)
    times = [message.log_ns for message in stream(tmp_path / "run.mcap")]
    assert len(times) > 1000
    assert (times == sorted(times)) == (hold > 0.0)


@pytest.mark.parametrize(("topic", "stamp"), [("ato/profile", "0.000"), ("ato/command", "19.900")])
def test_a_complete_run_without_the_last_message_of_a_topic_fails(topic, stamp, run, tmp_path):
    """Breaks if a message that a bad network has never brought is missing in the log of a run with status done."""
    queues = LateQueues(run("engine"), topic)
    queues.end = RunEnd("done", "", 10 * SECONDS).notice(0)
    node = recorder.RecorderNode(RunLog(tmp_path, topics_of(queues.wire.layout)), queues, 10**8)
    with pytest.raises(ValueError, match=f"{topic} of node \\w+ for {stamp} s did not arrive; check the network"):
        node.close(None)


@EVERY_MODE
def test_wall_time_is_a_metadata_record(mode: str, run: Callable[[str], Path], capsys) -> None:
    """Breaks if the wall time of a run is lost, or is not that of the run."""
    found = read_wall_time(run(mode) / "run.mcap")
    summary = json.loads((run(mode) / "summary.json").read_text())
    assert found is not None and found.duration_s is not None
    # the log is opened before the first tick and closed after the last one; the clocks differ by rounding
    assert found.duration_s >= summary["wall_s"] - 0.01
    assert found.begin_ns * 1e-9 <= (run(mode) / "summary.json").stat().st_mtime
    assert answer(capsys, "info", str(run(mode)))["wall_time"] == found.listed()
    assert main(["info", str(run(mode))]) == 0
    assert f"recorded from {found.begin}" in capsys.readouterr().out


def test_the_duration_of_a_recording_is_its_wall_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the time between both clock readings is not the duration, or a wall clock that is set back counts."""
    assert time.monotonic_ns() <= reading.steady_ns() <= time.monotonic_ns()
    monkeypatch.setattr(reading, "steady_ns", lambda: 7)
    begun = WallTime.now()
    monkeypatch.setattr(reading, "steady_ns", lambda: 3_500_000_007)
    monkeypatch.setattr(reading, "clock_ns", lambda: EPOCH_NS)
    assert begun.ended().duration_s == pytest.approx(3.5, rel=1e-12)


def test_recovery_keeps_the_begin_of_a_killed_run(tmp_path: Path) -> None:
    """Breaks if the begin is written only at the end of a run, or is not copied."""
    killed = f"""
import os, pathlib
from train_ato.log.log_writer import RunLog
log = RunLog(pathlib.Path({str(tmp_path)!r}))
log.add("/clock", 1, 1, bytes(12))
log.flush()
os._exit(9)"""
    subprocess.run([sys.executable, "-c", killed], check=False)
    began = read_wall_time(tmp_path / "run.mcap.partial", broken=True)
    assert began is not None and began.duration_s is None
    assert recover(tmp_path).messages == 1
    assert read_wall_time(tmp_path / "run.mcap") == began


def test_a_log_without_wall_time_is_read(tmp_path: Path) -> None:
    """Breaks if logs of other recorders or of measured runs are refused."""
    LogFile(tmp_path).close()
    assert read_wall_time(tmp_path / "run.mcap") is None
    for record in ({"begin": "yesterday", "begin_ns": "1"}, {"begin_ns": "x"}, {"begin": "", "begin_ns": "9" * 40}):
        assert WallTime.of(record) is None


TICK_OF_TRIPS, TRIP = 0.1, 60
"""Tick and duration of a trip from stop to stop [s]."""
WINDOWS = {
    "log.difference.PORTION": 64, "log.difference.WINDOW_NS": 10**10, "log.table_loading.PART": 2**14,
    "log.table_loading.REPORTS_OF_PART": 64, "log.tables.PORTION": 2**14, "judge.kept_samples.CACHED": 2**14,
    "judge.kept_samples.IN_MEMORY": 2**14, "loop.forecast.WINDOW": 2**10,
}  # fmt: skip
"""Windows in memory: messages, bytes, ticks."""
TRIPS = """
schema: train_ato/scenario/1
name: shuttle
duration: {seconds}
tick: {tick}
step: 0.05
plant: {{consist: xuzhou_metro_3, line: line.yaml, lag: 0.4}}
profile: {{limits: {{jerk: 0.6, acceleration: 0.8, deceleration: 0.8}}, phases: [{phases}]}}
law: pid
compensation: preview
"""


def shuttle(folder: Path, seconds: int) -> RunSetup:
    """Return a run of trips from its begin to its end: its profile grows with its duration."""
    trip = "{{accelerate_to_kmh: 36}}, {{cruise_for: 10}}, {{brake_to: 0}}, {{cruise_until: {end}}}"
    phases = ", ".join(trip.format(end=end) for end in range(TRIP, seconds + 1, TRIP))
    path = folder / f"{seconds}.yaml"
    (folder / "line.yaml").write_text("{schema: train_ato/line/1, name: level, end_km: 6, source: chosen}")
    path.write_text(TRIPS.format(seconds=seconds, tick=TICK_OF_TRIPS, phases=phases))
    return setup_of(str(path))


def info_of(run: Path, out: Path) -> None:
    log_overview(run / "run.mcap")


def compared(run: Path, out: Path) -> None:
    setup, _ = read_run_folder(run)
    assert compare_logs(run, run, Wire(setup.layout)).equal


def repeated(run: Path, out: Path) -> None:
    """Run it again, as the command ``verify`` does before it compares; its log needs a few chunks."""
    setup, _ = read_run_folder(run)
    assert not read_changes(run).rows(setup.scenario)
    assert run_engine(setup, messages_only=True).failure is None


def exported(run: Path, out: Path) -> None:
    assert main(["export", str(run), "--out", str(out / "tables")]) == 0


def reported(run: Path, out: Path) -> None:
    page_data(open_recording(run), share=0.01)  # the short run fills its curves, too


def viewed(run: Path, out: Path) -> None:
    RecordedFeed(run)


def recovered(run: Path, out: Path) -> None:
    log = out / "run.mcap.partial"
    shutil.copyfile(run / "run.mcap", log)
    recover(log)


@pytest.fixture(scope="module")
def memory_runs(tmp_path_factory: pytest.TempPathFactory) -> Callable[[int], Path]:
    """Return a function that records a run of a duration, once."""
    folder = tmp_path_factory.mktemp("runs")
    return functools.cache(lambda seconds: record_run(shuttle(folder, seconds), folder / str(seconds)))


@pytest.mark.parametrize(  # durations of two runs [s] that fill some chunks of the log; a comparison is slow
    ("read", "lengths"),
    [
        (compared, (120, 240)),
        *((read, (480, 960)) for read in (info_of, recovered, repeated, exported, reported, viewed)),
    ],
)
def test_a_day_needs_less_than_a_gigabyte(read, lengths, memory_runs, tmp_path, monkeypatch):
    """Fails if a run or a reader keeps all messages or samples, or several copies of the profile."""
    # The windows in memory are so small that the short run fills them, too.
    for place, size in WINDOWS.items():
        monkeypatch.setattr(f"train_ato.{place}", size)
    short, long = lengths
    peaks = {}
    for number, seconds in enumerate((short, short, long)):  # the first reading imports modules and fills caches
        out = tmp_path / str(number)
        out.mkdir()
        run = memory_runs(seconds)
        if number > 0:
            tracemalloc.start()
        try:
            read(run, out)
            peaks[seconds] = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
    grown = (peaks[long] - peaks[short]) / ((long - short) / TICK_OF_TRIPS)
    assert grown < (1e9 - 2e8) / (24 * 3600 * 20), peaks  # 200 MB without a log; a day of ticks of 0.05 s
