"""Every compression gives the same messages in every reader, and the same loss after a kill."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from test_record import wait_for

import train_ato
from train_ato.cli import main
from train_ato.log.compression import COMPRESSIONS
from train_ato.log.log_writer import CHUNK, LogFile
from train_ato.log.mcap_records import stream
from train_ato.log.mcap_writer import McapWriter
from train_ato.log.recover import recover

pytestmark = pytest.mark.usefixtures("without_figure")

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


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return the folder of the same run with every compression."""
    folder = tmp_path_factory.mktemp("runs")
    for name in COMPRESSIONS:
        options = ("--set", "duration=30", "--compression", name, "--out", str(folder / name))
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
    assert all(table.equals(tables[1][topic]) for topic, table in tables[0].items())
    assert tables[0]


@pytest.mark.parametrize("name", COMPRESSIONS)
def test_a_run_is_verified_with_every_compression(name: str, runs: dict[str, Path]) -> None:
    assert main(["verify", str(runs[name])]) == 0


def test_the_sizes_are_in_the_order_of_the_choices(runs: dict[str, Path]) -> None:
    """Breaks if a compression has no effect."""
    sizes = [(runs[name] / "run.mcap").stat().st_size for name in COMPRESSIONS]
    assert sizes == sorted(sizes, reverse=True)
    assert len(set(sizes)) == 3


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
    environment = {**os.environ, "PYTHONPATH": str(Path(train_ato.__file__).parents[1])}
    command, written = [sys.executable, "-c", WRITER, str(tmp_path), name], 0
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment, text=True) as process:
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
