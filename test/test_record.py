"""Log of a run: readable by three independent readers and complete as far as the disk permits."""

import dataclasses
import errno
import re
import threading
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from engine_runs import setup_of
from mcap.reader import make_reader
from mcap.records import Chunk, DataEnd, Footer
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from recordings import message_counts
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from test_wire import LONG, message, same
from waiting import pause, wait_for

from train_ato.log import chunk_thread, reading
from train_ato.log.bag_layout import log_name, table_name
from train_ato.log.chunk_thread import CLOSE_AFTER_S
from train_ato.log.definitions import definition, from_typestore, installed
from train_ato.log.log_writer import RunLog
from train_ato.log.mcap_records import stream
from train_ato.log.reading import iter_raw, read_log
from train_ato.log.recover import recover
from train_ato.log.run_folder import RunFolder
from train_ato.loop.engine import run_engine
from train_ato.messages.codec import Wire
from train_ato.messages.topics import EPOCH_NS, TOPICS, Rate, topics_of

TICK = 100_000_000
WIRE = Wire(LONG)


def write(folder, ticks, close=True):
    """Write a run of a number of ticks; return the log and the sent messages."""
    log, sent = RunLog(folder, topics_of(LONG)), []
    for tick in range(ticks):
        for topic in topics_of(LONG):
            if topic.recorded and (topic.rate is Rate.TICK or tick == 0):
                content = message(topic.name, LONG, tick * TICK, seed=tick)
                moment = EPOCH_NS + tick * TICK
                log.add(topic.name, moment, moment + 500, WIRE.encode(topic.name, content))
                sent.append((topic.name, tick * TICK, content))
    if close:
        log.close()
    return log, sent


def test_everything_comes_back_in_order(tmp_path):
    """Fails if a message is lost, repeated, reordered or decoded to other bits."""
    log, sent = write(tmp_path, 300)
    back = list(read_log(tmp_path, WIRE.decode))
    assert [entry[:2] for entry in back] == [entry[:2] for entry in sent]
    assert all(same(a[2], b[2]) for a, b in zip(back, sent, strict=True))
    assert sum(log.counts.values()) == len(sent)
    assert not (tmp_path / "run.mcap.partial").exists()
    chosen = [entry for entry in sent if entry[0] in ("ato/command", "/clock")]
    assert [e[:2] for e in iter_raw(tmp_path, ("ato/command", "/clock"))] == [e[:2] for e in chosen]


def test_every_checksum_of_a_log_is_there_and_right(tmp_path):
    """Breaks if a checksum is 0: then a reader checks nothing."""
    write(tmp_path, 120)
    with (tmp_path / "run.mcap").open("rb") as file:
        records = list(StreamReader(file, emit_chunks=True).records)
    chunks = [record for record in records if isinstance(record, Chunk)]
    assert chunks
    for chunk in chunks:
        content, size = get_chunk_data_stream(chunk)
        assert chunk.uncompressed_crc == zlib.crc32(content.read(size)) != 0
    data = (tmp_path / "run.mcap").read_bytes()
    (footer,) = [record for record in records if isinstance(record, Footer)]
    assert footer.summary_crc == zlib.crc32(data[footer.summary_start : -12]) != 0
    (end,) = [record for record in records if isinstance(record, DataEnd)]
    assert end.data_section_crc == zlib.crc32(data[: footer.summary_start - 13]) != 0


def test_other_tools_read_the_log(tmp_path):
    """Read with rosbags, which returns no message with other QoS texts, and with mcap, which checks all checksums."""
    _, sent = write(tmp_path, 120)
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
        assert summary.statistics.message_count == len(sent)
        assert sum(1 for _ in reader.iter_messages()) == len(sent)
        names = [entry.name for entry in reader.iter_metadata()]
        assert names == ["rosbag2", "wall_time", "wall_time", "rosbag2"]
        for channel in summary.channels.values():
            assert channel.message_encoding == "cdr"
            assert summary.schemas[channel.schema_id].encoding == "ros2msg"
            assert channel.metadata["topic_type_hash"].startswith("RIHS01_")
            (qos,) = yaml.safe_load(channel.metadata["offered_qos_profiles"])
            latched = channel.topic in ("/ato/profile", "/ato/limits")
            assert qos["durability"] == ("transient_local" if latched else "volatile")
    with Reader(tmp_path) as bag:
        assert bag.message_count == len(sent)
        read = [(connection.topic, time) for connection, time, _ in bag.messages()]
        assert read == [(f"/{name.lstrip('/')}", EPOCH_NS + stamp + 500) for name, stamp, _ in sent]


def test_metadata_says_what_the_log_holds(tmp_path):
    log, sent = write(tmp_path, 30)
    (information,) = yaml.safe_load((tmp_path / "metadata.yaml").read_text()).values()
    assert information["version"] == 9
    assert information["message_count"] == len(sent)
    assert information["duration"]["nanoseconds"] == 29 * TICK
    assert information["relative_file_paths"] == ["run.mcap"]
    counts = {e["topic_metadata"]["name"]: e["message_count"] for e in information["topics_with_message_count"]}
    assert counts == message_counts(tmp_path)
    plain, own = ({name.lstrip("/"): count for name, count in each.items()} for each in (counts, log.counts))
    assert plain == own


def _sections(text):
    """Return the definitions in a schema text without comments, spacing, order and package prefixes of fields."""
    sections = re.split(r"={80}\n", text)
    plain = []
    for section in sections:
        lines = [re.sub(r"\s+", " ", line.split("#")[0]).strip() for line in section.splitlines()]
        plain.append(
            tuple(re.sub(r"^(?:\w+/)?(\w+)", r"\1", line) if "MSG" not in line else line for line in lines if line)
        )
    return plain[0], frozenset(plain[1:])


@pytest.mark.parametrize("kind", sorted({topic.type for topic in TOPICS}))
def test_definitions_are_the_installed_ones(kind):
    """The engine's log, without ROS, equals that of the recorder."""
    there, shipped = installed(kind), from_typestore(kind)
    assert there is not None, "the message packages are installed with the tests"
    assert there.hash == shipped.hash
    assert _sections(there.text) == _sections(shipped.text)
    assert definition(kind) == there


@pytest.mark.parametrize(("resolved", "name", "expected"), [
    ("", "ato/command", "/ato/command"), ("/two/ato/command", "ato/command", "/two/ato/command"),
    ("/clock", "/clock", "/clock"), ("/a/clock", "/clock", "/a/clock"), ("/mine", "ato/command", "/ato/command"),
])  # fmt: skip
def test_names_in_the_log(resolved, name, expected):
    """Breaks if a namespace or a remap is lost, or a log has a name that no reader finds in the table."""
    topic = next(topic for topic in TOPICS if topic.name == name)
    assert log_name(topic, resolved) == expected
    assert table_name(expected) == name
    assert table_name("/somewhere/else") is None


def test_recover_refuses_what_it_cannot_help(tmp_path):
    for name, content, text in (
        ("", b"", "no such file"), ("run.mcap.partial", b"rubbish", "nothing can be recovered"),
        ("run.mcap", b"", "exists already"),
    ):  # fmt: skip
        if name:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(ValueError, match=text):
            recover(tmp_path)


class FullDisk:
    """Raw file on a disk that is full after a number of bytes."""

    def __init__(self, raw, room):
        self._raw, self._room = raw, room
        self.refused = 0

    def write(self, data):
        if len(data) > self._room:
            self.refused += 1
            raise OSError(errno.ENOSPC, "No space left on device")
        self._room -= len(data)
        return self._raw.write(data)

    def __getattr__(self, name):
        return getattr(self._raw, name)


def test_after_a_failed_write_nothing_more_is_written(tmp_path):
    """Breaks if a second attempt on a full disk leaves an incomplete file that looks complete."""
    log = RunLog(tmp_path, topics_of(LONG))
    log._writer._stream = disk = FullDisk(log._raw, 40_000)
    with pytest.raises(OSError, match=r"writing failed .No space left"):
        for tick in range(5000):
            data = WIRE.encode("train/vehicles", message("train/vehicles", LONG, tick, seed=tick))
            log.add("train/vehicles", tick, tick, data)
    for _ in range(3):
        with pytest.raises(OSError, match="writing failed"):
            log.add("train/vehicles", 0, 0, data)
    log.close()
    assert disk.refused == 1
    assert not (tmp_path / "run.mcap").exists()
    assert "train-ato recover" in log.failure


def test_an_existing_log_is_never_overwritten_and_a_folder_that_cannot_be_written_is_named(tmp_path):
    write(tmp_path, 2)
    before = (tmp_path / "run.mcap").read_bytes()
    for folder, text in ((tmp_path, "exists already"), (tmp_path / "absent", "cannot be written")):
        with pytest.raises(ValueError, match=text):
            RunLog(folder, topics_of(LONG))
    assert (tmp_path / "run.mcap").read_bytes() == before


def whole_messages(path):
    """Return the number of messages in the closed chunks of the file."""
    return sum(1 for _ in stream(path, broken=True))


def test_the_last_messages_of_a_stalled_run_reach_the_file(tmp_path):
    """Breaks if a chunk closes only with the next message: a stalled run sends none."""
    log, sent = write(tmp_path, 3, close=False)
    partial = tmp_path / "run.mcap.partial"
    assert whole_messages(partial) == 0
    wait_for(lambda: whole_messages(partial) == len(sent))
    before = partial.stat().st_size
    pause(2.5 * CLOSE_AFTER_S)
    assert partial.stat().st_size == before, "an empty chunk is written again and again"
    log.close()
    assert message_counts(tmp_path)["/train/vehicles"] == 3


def test_slow_messages_are_never_older_than_a_second(tmp_path):
    """Breaks if the age of a chunk is counted from its last message: a slow run would never close one."""
    log = RunLog(tmp_path, topics_of(LONG))
    data = WIRE.encode("ato/command", message("ato/command", LONG, 0))
    partial = tmp_path / "run.mcap.partial"

    def add():
        log.add("ato/command", EPOCH_NS, EPOCH_NS, data)
        pause(0.05)

    wait_for(lambda: whole_messages(partial) > 0, turn=add)
    log.close()


def test_a_full_disk_is_told_even_if_no_message_comes_any_more(tmp_path):
    """Breaks if the failure of a write in the background is lost, and the run counts as recorded."""
    log, _ = write(tmp_path, 3, close=False)
    log._writer._stream = FullDisk(log._raw, 0)
    wait_for(lambda: log.failure is not None)
    with pytest.raises(OSError, match="writing failed"):
        log.close()
    log.close()
    assert not (tmp_path / "run.mcap").exists()


def test_no_thread_is_left(tmp_path):
    before = threading.enumerate()  # a log in a cycle of another case has its thread up to the next search for garbage
    for number in range(5):
        folder = tmp_path / str(number)
        folder.mkdir()
        log, _ = write(folder, 2, close=number % 2 == 0)
        del log
    wait_for(
        lambda: not [entry for entry in threading.enumerate() if entry.name == "chunk clock" and entry not in before]
    )


GOLDEN = Path(__file__).resolve().parent / "golden" / "short_train"
Read = tuple[str, int, Any]
"""Topic, log time, message."""


def plain(message: Any) -> Any:
    """Return a message of any of the three as nested dictionaries, lists and plain values."""
    if hasattr(message, "get_fields_and_field_types"):
        return {name: plain(getattr(message, name)) for name in message.get_fields_and_field_types()}
    if dataclasses.is_dataclass(message):
        # rosbags includes the constants of a definition, in capitals, in the fields.
        names = [part.name for part in dataclasses.fields(message) if part.name.islower() and part.name[:2] != "__"]
        return {name: plain(getattr(message, name)) for name in names}
    if hasattr(message, "__slots__") and not isinstance(message, (list, tuple)):
        return {name.lstrip("_"): plain(getattr(message, name)) for name in message.__slots__ if name[:1] != "_"}
    if isinstance(message, (list, tuple, np.ndarray)) or type(message).__module__ == "array":
        return [plain(entry) for entry in message]
    if isinstance(message, bytes):
        return message[0] if len(message) == 1 else list(message)
    return message.item() if isinstance(message, np.generic) else message


def by_mcap_ros2() -> Iterator[Read]:
    """Read with mcap-ros2-support: the types come from the schemas of the file."""
    from mcap_ros2.decoder import DecoderFactory

    with (GOLDEN / "run.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            yield channel.topic, message.log_time, decoded


def by_rosbags() -> Iterator[Read]:
    """Read with rosbags: its own Jazzy types, and metadata.yaml."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(GOLDEN) as bag:
        for connection, time, data in bag.messages():
            yield connection.topic, time, store.deserialize_cdr(data, connection.msgtype)


def by_rclpy() -> Iterator[Read]:
    """Read with the classes and the deserialiser of the installed ROS packages."""
    from rclpy.serialization import deserialize_message

    from train_ato.ros.nodes.endpoints import message_class

    with (GOLDEN / "run.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(log_time_order=False):
            yield channel.topic, message.log_time, deserialize_message(message.data, message_class(schema.name))


def test_three_readers_read_equal_values() -> None:
    """Breaks if only our own reader can read a schema, an alignment or a padding."""
    pytest.importorskip("rclpy")
    reads = [
        # The order of messages with equal log times is not defined, so messages of a topic are sorted by content.
        sorted(((topic, time, plain(message)) for topic, time, message in reader()), key=repr)
        for reader in (by_mcap_ros2, by_rosbags, by_rclpy)
    ]
    assert len(reads[0]) > 4000
    for one, other, third in zip(*reads, strict=True):
        assert one == other == third
    layout = setup_of(str(GOLDEN.parent / "short_train.yaml")).layout
    assert {table_name(topic) for topic, _, _ in reads[0]} == {t.name for t in topics_of(layout) if t.recorded}


def test_the_file_is_laid_out_as_ros2_bag_does() -> None:
    """Breaks if a player uses default QoS, or a tool finds no definition, hash or metadata."""
    (information,) = yaml.safe_load((GOLDEN / "metadata.yaml").read_text()).values()
    listed = {entry["topic_metadata"]["name"]: entry for entry in information["topics_with_message_count"]}
    with (GOLDEN / "run.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
        records = list(reader.iter_metadata())
        kept = [record.metadata["serialized_metadata"] for record in records if record.name == "rosbag2"]
        assert {record.name for record in records} == {"rosbag2", "wall_time"}
        attached = {entry.name: (entry.media_type, entry.data) for entry in reader.iter_attachments()}
    assert [yaml.safe_load(text)["message_count"] for text in kept] == [0, information["message_count"]]
    assert yaml.safe_load(kept[-1]) == information
    assert set(attached) == {"scenario.yaml", "versions.yaml"}
    assert {"train_ato", "python", "numpy", "numba", "rclpy"} <= set(yaml.safe_load(attached["versions.yaml"][1]))
    assert yaml.safe_load(attached["scenario.yaml"][1])["name"] == "golden_short_train"
    assert all(index.compression == "zstd" and index.message_index_length > 0 for index in summary.chunk_indexes)
    assert summary.statistics.attachment_count == 2
    for channel in summary.channels.values():
        schema, entry = summary.schemas[channel.schema_id], listed[channel.topic]
        assert schema.data.decode().count("=" * 80 + "\nMSG: ") == definition(schema.name).text.count("MSG: ")
        assert channel.metadata["topic_type_hash"] == entry["topic_metadata"]["type_description_hash"]
        assert channel.metadata["topic_type_hash"].startswith("RIHS01_")
        profiles = yaml.safe_load(channel.metadata["offered_qos_profiles"])
        assert profiles == entry["topic_metadata"]["offered_qos_profiles"]
        assert entry["message_count"] == summary.statistics.channel_message_counts[channel.id]


def test_equal_runs_of_the_engine_give_equal_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if anything of the wall clock, of memory or of the order of a dictionary gets into the file."""
    # Only the record of the wall time and the age at which a chunk is closed depend on the wall clock; the first is
    # fixed and the limit of the second is not reached here.
    monkeypatch.setattr(chunk_thread, "CLOSE_AFTER_S", 60.0)
    monkeypatch.setattr(reading, "clock_ns", lambda: 10**18)
    monkeypatch.setattr(reading, "steady_ns", lambda: 0)
    setup = setup_of("demo", "duration=60", "observer=ndo", "law_changes=[{at: 30, law: smc}]")
    for name in ("one", "other"):
        with RunFolder.make(tmp_path / name, "demo").sink(setup) as sink:
            run_engine(setup, sink=sink)
    for file in ("run.mcap", "metadata.yaml"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "other" / file).read_bytes()
