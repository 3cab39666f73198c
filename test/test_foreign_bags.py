"""Bags of other recorders: `info`, `export`, `replay`, `view` and `recover` read them, or name a remedy that works."""

import shlex
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pandas as pd
import pytest
import yaml
import zstandard
from commands import answer, complaint
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.typesys import Stores, get_typestore

import train_ato as ta
from train_ato.cli import main
from train_ato.log import table_columns
from train_ato.log.mcap_records import RawMessage, stream
from train_ato.playback.log import ReplayLog
from train_ato.view.recorded import RecordedFeed

TYPES = get_typestore(Stores.ROS2_JAZZY)
SQL, MCAP = StoragePlugin.SQLITE3, StoragePlugin.MCAP
CHUNK = 1 << 16
BY_FILE, BY_MESSAGE = CompressionMode.FILE, CompressionMode.MESSAGE


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run of 3 s with the supervisor, recorded by this project."""
    return ta.run("demo", set={"duration": 3}).save(tmp_path_factory.mktemp("foreign") / "run")


@pytest.fixture(scope="module")
def messages(run: Path) -> list[RawMessage]:
    return list(stream(run / "run.mcap"))


def rosbag(
    messages: list[RawMessage], folder: Path, storage: StoragePlugin, mode: CompressionMode | None = None
) -> Path:
    """Write a bag with the package ``rosbags``, which has the layout of `ros2 bag record`."""
    writer = Writer(folder, version=9, storage_plugin=storage)
    if mode is not None:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        known = {}
        for message in messages:
            name = message.channel.topic
            if name not in known:
                known[name] = writer.add_connection(name, message.schema.name, typestore=TYPES)
            writer.write(known[name], message.publish_ns, message.data)
    return folder


def mcap(
    messages: list[RawMessage],
    path: Path,
    idl: bool = False,
    publish: bool = True,
    part: str = "/msg/",
    attached: tuple[bytes, ...] = (),
    **options: object,
) -> Path:
    """Write a file with the package ``mcap``; ``part`` is that between package and type in the names of types."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        writer = McapWriter(file, **options)  # type: ignore[arg-type]
        writer.start(profile="ros2")
        known: dict[str, int] = {}
        for message in messages:
            name, kind = message.channel.topic, message.schema
            if name not in known:
                text = TYPES.generate_msgdef(kind.name)[0].encode() if not idl else idl_text(kind.name)
                kind_name = kind.name.replace("/msg/", part)
                schema = writer.register_schema(kind_name, "ros2idl" if idl else "ros2msg", text)
                known[name] = writer.register_channel(name, "cdr", schema, dict(message.channel.metadata))
            writer.add_message(known[name], message.log_ns, message.data, message.publish_ns if publish else 0)
        for scenario in attached:
            writer.add_attachment(0, 0, "scenario.yaml", "text/yaml", scenario)
        writer.finish()
    return path


def idl_text(name: str) -> bytes:
    """Return a definition in IDL; the reader has the types of the topic table."""
    if not name.endswith("/Float64"):
        return b"module builtin_interfaces { module msg { struct Time { int32 sec; uint32 nanosec; }; }; };"
    return b"module std_msgs { module msg { struct Float64 { double data; }; }; };"


def split(messages: list[RawMessage], folder: Path, *, metadata: bool) -> Path:
    """Write a bag of eleven files, as `ros2 bag record --max-bag-size`."""
    size = -(-len(messages) // 11)
    files = [
        mcap(messages[begin : begin + size], folder / f"long_{number}.mcap", chunk_size=CHUNK // 8)
        for number, begin in enumerate(range(0, len(messages), size))
    ]
    if metadata:
        information = {"version": 9, "storage_identifier": "mcap", "compression_mode": "NONE"}
        information["relative_file_paths"] = [file.name for file in files]
        (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": information}))
    assert len(files) == 11
    return folder


def packed(file: Path, frames: int = 1) -> Path:
    """Compress a file as `ros2 bag record --compression-mode file`, in several frames as `pzstd`."""
    out, data = file.with_name(f"{file.name}.zstd"), file.read_bytes()
    size = -(-len(data) // frames)
    pieces = (data[begin : begin + size] for begin in range(0, len(data), size))
    out.write_bytes(b"".join(map(zstandard.ZstdCompressor().compress, pieces)))
    file.unlink()
    return out


def only(folder: Path) -> Path:
    """Return the storage file of a bag without its metadata."""
    (folder / "metadata.yaml").unlink()
    (file,) = folder.iterdir()
    return file


def renamed(file: Path, name: str) -> Path:
    """Rename a file."""
    return file.rename(file.with_name(name))


def lone_folder(folder: Path) -> Path:
    only(folder)
    return folder


def with_empty(folder: Path) -> Path:
    """Add the file that a recorder had only opened."""
    (folder / "long_9.mcap").touch()
    return folder


def in_journal(file: Path) -> Path:
    """Return a folder whose messages are in the write-ahead log beside the file, as a killed recorder leaves them."""
    with closing(sqlite3.connect(file)) as database:
        rows = database.execute("SELECT topic_id, timestamp, data FROM messages").fetchall()
        database.execute("DELETE FROM messages")
        database.commit()
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA wal_autocheckpoint = 0")
        database.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
        database.commit()
        return Path(shutil.copytree(file.parent, file.parent.with_name("killed")))


Make = Callable[[list[RawMessage], Path], Path]
READ: dict[str, Make] = {
    "folder": lambda m, at: rosbag(m, at / "ride of monday", MCAP),
    "folder without metadata": lambda m, at: lone_folder(rosbag(m, at / "ride", MCAP)),
    "split": lambda m, at: split(m, at / "long", metadata=True),
    "split without metadata": lambda m, at: split(m, at / "long", metadata=False),
    "split, one file empty": lambda m, at: with_empty(split(m, at / "long", metadata=False)),
    "compressed by file": lambda m, at: rosbag(m, at / "ride", MCAP, BY_FILE),
    "compressed by message": lambda m, at: rosbag(m, at / "ride", MCAP, BY_MESSAGE),
    "one file compressed by message": lambda m, at: next(rosbag(m, at / "ride", MCAP, BY_MESSAGE).glob("*.mcap")),
    "SQLite": lambda m, at: rosbag(m, at / "ride", SQL),
    "SQLite file": lambda m, at: renamed(only(rosbag(m, at / "ride", SQL)), "100% new? #1.db3"),
    "SQLite with a journal": lambda m, at: in_journal(only(rosbag(m, at / "ride", SQL))),
    "SQLite compressed by file": lambda m, at: rosbag(m, at / "ride", SQL, BY_FILE),
    "SQLite compressed by message": lambda m, at: rosbag(m, at / "ride", SQL, BY_MESSAGE),
    "file compressed as a whole": lambda m, at: packed(mcap(m, at / "ride_0.mcap")),
    "file compressed in frames": lambda m, at: packed(mcap(m, at / "ride_0.mcap"), 3),
    "types without msg": lambda m, at: mcap(m, at / "a.mcap", part="/"),
    "no summary": lambda m, at: mcap(m, at / "a.mcap", **NO_SUMMARY),
    "unchunked": lambda m, at: mcap(m, at / "a.mcap", use_chunking=False),
    "lz4": lambda m, at: mcap(m, at / "a.mcap", compression=CompressionType.LZ4),
    "no checksums": lambda m, at: mcap(m, at / "a.mcap", enable_crcs=False, enable_data_crcs=False),
    "publish time 0": lambda m, at: mcap(m, at / "a.mcap", publish=False),
    "ros2idl": lambda m, at: mcap(m, at / "a.mcap", idl=True),
}  # fmt: skip


SOME = ("--topics", "/diagnostics", "ato/command", "atp/speeds", "train/measurement")
"""Topics of the compared tables; a table of 106 vehicles takes most of the time, and all messages are compared too."""
NO_SUMMARY = {"use_statistics": False, "repeat_channels": False, "repeat_schemas": False, "index_types": IndexType.NONE}


def assert_equal_tables(one: Path, other: Path) -> None:
    """Fail unless both exports have the same files, columns and bits; the schema has no other attributes."""
    assert {file.name for file in one.iterdir()} == {file.name for file in other.iterdir()}
    for file in one.iterdir():
        pd.testing.assert_frame_equal(pd.read_parquet(file), pd.read_parquet(other / file.name), check_exact=True)


@pytest.mark.parametrize("kind", READ)
def test_a_bag_of_another_recorder_is_read(kind, run, messages, tmp_path, capsys):
    """Breaks if a kind is refused, loses a message or a row, or its times are those of another clock."""
    bag = READ[kind](messages, tmp_path)
    before = sorted((path, path.stat().st_size) for path in tmp_path.rglob("*"))
    found, ours = answer(capsys, "info", str(bag)), answer(capsys, "info", str(run))
    assert (found["messages"], found["duration_s"]) == (ours["messages"], ours["duration_s"])
    assert found["topics"] == ours["topics"]
    assert str(found["log"]).startswith(str(tmp_path)) and found["log_bytes"]
    assert main(["export", str(bag), *SOME, f"--out={tmp_path / 'tables'}"]) == 0
    if not (run.parent / "tables").exists():
        assert main(["export", str(run), *SOME, f"--out={run.parent / 'tables'}"]) == 0
    assert_equal_tables(tmp_path / "tables", run.parent / "tables")
    with ReplayLog(bag) as log:  # of the command replay
        sent = [(m.channel.topic, m.publish_ns, bytes(m.data)) for m in log.messages(set(log.topics), 0)]
    assert sorted(sent) == sorted((m.channel.topic, m.publish_ns, m.data) for m in messages)
    feed = RecordedFeed(bag)  # of the command view
    assert feed.span == pytest.approx((0.0, 3.0))
    assert "undamaged; there is nothing to recover" in complaint(capsys, "recover", str(bag))
    after = sorted((path, path.stat().st_size) for path in tmp_path.rglob("*") if "tables" not in path.parts)
    assert after == before


def cut(file: Path, share: float = 0.7) -> Path:
    """Cut the end of a file off."""
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    return file


def torn(file: Path) -> Path:
    """Clear a page in the middle of an SQLite file that holds rows."""
    data = bytearray(file.read_bytes())
    size = int.from_bytes(data[16:18], "big")
    page = next(place for place in range(len(data) // size // 2 * size, len(data), size) if data[place] == 13)
    data[page : page + size] = bytes(size)
    file.write_bytes(data)
    return file


def with_large_pages(file: Path) -> Path:
    """Write an SQLite file again with the largest pages, whose size its head writes as 1."""
    with closing(sqlite3.connect(file, isolation_level=None)) as database:
        database.execute("PRAGMA page_size = 65536")
        database.execute("VACUUM")
    return file


def cut_last(folder: Path, share: float = 0.7) -> Path:
    """Cut the end of the last file of a bag off."""
    cut(sorted(folder.glob("*.mcap"))[-1], share)
    return folder


def killed(messages: list[RawMessage], file: Path) -> Path:
    """Write what `ros2 bag record --storage-preset-profile fastwrite` leaves: no end, the last message incomplete."""
    data = mcap(messages, file, use_chunking=False, use_statistics=False, use_summary_offsets=False).read_bytes()
    file.write_bytes(data[: data.rindex(messages[-1].data) + 4])
    return file


REFUSED: dict[str, Make] = {
    "cut": lambda m, at: cut(mcap(m, at / "a.mcap", chunk_size=CHUNK)),
    "cut, unchunked": lambda m, at: killed(m, at / "a.mcap"),
    "one of a split bag cut": lambda m, at: cut_last(split(m, at / "long", metadata=True), 0.6),
    "cut in its folder": lambda m, at: cut_last(rosbag(m, at / "ride", MCAP)),
    "compressed and cut": lambda m, at: cut(packed(mcap(m, at / "ride.mcap", chunk_size=CHUNK))),
    "SQLite, cut": lambda m, at: cut(only(rosbag(m, at / "ride", SQL))),
    "SQLite, large pages, cut": lambda m, at: cut(with_large_pages(only(rosbag(m, at / "ride", SQL)))),
    "SQLite, a page lost": lambda m, at: torn(only(rosbag(m, at / "ride", SQL))),
}  # fmt: skip


@pytest.fixture(scope="module")
def many(messages: list[RawMessage]) -> list[RawMessage]:
    """Messages of several chunks of 1 MiB."""
    shifts = [shift * 4_000_000_000 for shift in range(12)]
    return [m._replace(publish_ns=m.publish_ns + by, log_ns=m.log_ns + by) for by in shifts for m in messages]


@pytest.mark.parametrize("kind", REFUSED)
def test_the_remedy_for_a_damaged_bag_works(kind, many, tmp_path, capsys):
    """Breaks if a damaged bag is read as whole, or the command of the message does not make it readable."""
    bag = REFUSED[kind](many, tmp_path)
    lines = set()
    for command in (["info"], ["export", f"--out={tmp_path / 'tables'}"], ["replay"], ["view", "--no-browser"]):
        assert main([command[0], str(bag), *command[1:]]) == 2, command
        lines.add(capsys.readouterr().err)
    (line,) = lines
    assert line.count("\n") == 1 and str(bag) in line
    made = Path(answer(capsys, *shlex.split(line.split("`train-ato ")[1].split("`")[0]))["log"])
    with ReplayLog(bag if bag.is_dir() else made) as log:
        found = [(m.channel.topic, m.publish_ns, bytes(m.data)) for m in log.messages(set(log.topics), 0)]
    recorded = iter([(m.channel.topic, m.publish_ns, m.data) for m in many])
    assert all(message in recorded for message in found)  # in this order
    assert len(many) // 8 < len(found) < len(many)
    assert kind not in {"cut, unchunked", "SQLite, a page lost"} or len(found) > 0.9 * len(many)
    assert kind != "cut, unchunked" or len(found) == len(many) - 1


@pytest.mark.parametrize(
    "make", [lambda m, at: only(rosbag(m, at / "ride", SQL)), lambda m, at: mcap(m, at / "a.mcap")], ids=["db3", "mcap"]
)
def test_recover_is_not_named_for_a_bag_without_a_readable_message(make, messages, tmp_path, capsys):
    """Breaks if a user is sent to a command that saves nothing."""
    bag = cut(make(messages[:20], tmp_path), 0.3)
    assert complaint(capsys, "info", str(bag)).endswith("; no message in it is readable\n")
    assert "nothing can be recovered" in complaint(capsys, "recover", str(bag))


@pytest.mark.parametrize("checked", [True, False])
def test_a_bag_cut_after_its_messages_is_recovered_whole(checked, messages, tmp_path, capsys):
    """Breaks if the messages of an unchunked bag without the end of its summary are lost, or a wrong one is saved."""
    bag = mcap(messages, tmp_path / "a.mcap", use_chunking=False, enable_data_crcs=checked)
    cut(bag, 0.999)
    wrong = bytearray(bag.read_bytes())
    wrong[wrong.index(messages[-1].data) + 8] ^= 1
    (tmp_path / "b.mcap").write_bytes(wrong)
    assert main(["recover", str(bag)]) == 0
    assert [m.data for m in stream(bag)] == [m.data for m in messages]
    assert main(["recover", str(tmp_path / "b.mcap")]) == (2 if checked else 0)


def test_times_of_a_bag_with_wall_times_begin_at_its_first_message(run, messages, tmp_path, capsys):
    """Breaks if the times of a bag of `ros2 bag record` are seconds since the start of the simulation, years ago."""
    by = 400 * 86_400 * 10**9
    late = [m._replace(publish_ns=m.publish_ns + by, log_ns=m.log_ns + by) for m in messages]
    one, other = (answer(capsys, "info", str(bag))["topics"] for bag in (mcap(late, tmp_path / "a.mcap"), run))
    assert one == other


def test_a_log_of_merged_runs_is_refused_and_not_mixed(run, messages, tmp_path, capsys):
    """Breaks if `report` ends with a traceback, or a law is replayed on inputs of two runs in turn."""
    twice, scenario = sorted([*messages, *messages], key=lambda m: m.log_ns), (run / "scenario.yaml").read_bytes()
    merged = str(mcap(twice, tmp_path / "merged.mcap", attached=(scenario, scenario)))
    assert "train/measurement: two messages of one time: several runs" in complaint(capsys, "report", merged)
    assert "two attachments scenario.yaml: several runs" in complaint(capsys, "replay", merged, "--law", "pid")
    export = complaint(capsys, "export", merged, "--out", str(tmp_path / "tables"))
    assert "train/measurement: two messages of one time: several runs" in export
    assert "two messages of one time: several runs" in answer(capsys, "info", merged)["note"]
    assert not table_columns.merged([*range(20), 19]), "a node may publish one message twice"


def test_an_error_names_the_bag_and_not_its_copy(messages, tmp_path, capsys):
    """Breaks if a user reads the name of a temporary file."""
    bag = rosbag(messages[:20], tmp_path / "ride", SQL)
    for command, change in (
        ("export", ""),
        ("info", "UPDATE messages SET data = x'00'"),
        ("replay", "DELETE FROM messages"),
    ):
        with closing(sqlite3.connect(next(bag.glob("*.db3")))) as database:
            database.execute(change)
            database.commit()
        options = ["--topics", "no/such", f"--out={tmp_path / 'tables'}"] if command == "export" else []
        assert complaint(capsys, command, str(bag), *options).startswith(f"train-ato: {bag}: ")


def test_files_that_are_no_whole_bag_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str], messages) -> None:
    """Breaks if a bag of ROS 1 or an empty one is called damaged, or a missing file of a split bag has no name."""
    bag = tmp_path / "old.bag"
    bag.write_bytes(b"#ROSBAG V2.0\n" + bytes(5000))
    for command in ("info", "export", "recover"):
        assert "ROS 1; convert it: `rosbags-convert --src" in complaint(capsys, command, str(bag))
    (bag := tmp_path / "a.mcap").touch()
    assert complaint(capsys, "info", str(bag)) == f"train-ato: {bag}: is empty; nothing was recorded in it\n"
    bag = split(messages, tmp_path / "long", metadata=True)
    (bag / "long_4.mcap").unlink()
    assert "metadata.yaml: relative_file_paths: long_4.mcap is missing" in complaint(capsys, "info", str(bag))
