"""Times of a log are simulated times in every mode of a run; the wall time is a metadata record."""

import itertools
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rosbags.rosbag2 import Reader

from train_ato.cli import main
from train_ato.log import reading
from train_ato.log.log_writer import LogFile, RunLog
from train_ato.log.mcap_records import stream
from train_ato.log.reading import WallTime, read_wall_time
from train_ato.log.recover import recover
from train_ato.log.run_folder import read_run_folder
from train_ato.messages.codec import Wire
from train_ato.messages.topics import EPOCH_NS, topics_of
from train_ato.ros.nodes import recorder

pytestmark = pytest.mark.usefixtures("without_figure")

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


@EVERY_MODE
def test_wall_time_is_a_metadata_record(mode: str, run: Callable[[str], Path], capsys) -> None:
    """Breaks if the wall time of a run is lost, or is not that of the run."""
    found = read_wall_time(run(mode) / "run.mcap")
    summary = json.loads((run(mode) / "summary.json").read_text())
    assert found is not None and found.duration_s is not None
    # the log is opened before the first tick and closed after the last one; the clocks differ by rounding
    assert found.duration_s >= summary["wall_s"] - 0.01
    assert found.begin_ns * 1e-9 <= (run(mode) / "summary.json").stat().st_mtime
    capsys.readouterr()  # the run is executed here if no other test has done it
    assert main(["info", str(run(mode)), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["wall_time"] == found.listed()
    assert main(["info", str(run(mode))]) == 0
    assert f"recorded from {found.begin}" in capsys.readouterr().out


def test_the_duration_of_a_recording_is_its_wall_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the time between both clock readings is not the duration."""
    monkeypatch.setattr(reading, "clock_ns", lambda: EPOCH_NS + 3_500_000_000)
    assert WallTime(EPOCH_NS).ended().duration_s == pytest.approx(3.5, rel=1e-12)


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
