"""Three independent readers read the same values from a log in the layout of ``ros2 bag``."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from engine_runs import setup_of
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from train_ato.log import chunk_thread, reading
from train_ato.log.bag_layout import table_name
from train_ato.log.definitions import definition
from train_ato.log.run_folder import RunFolder
from train_ato.loop.engine import run_engine
from train_ato.messages.topics import topics_of

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
    setup = setup_of("demo", "duration=60", "observer=ndo", "law_changes=[{at: 30, law: smc}]")
    for name in ("one", "other"):
        with RunFolder.make(tmp_path / name, "demo").sink(setup) as sink:
            run_engine(setup, sink=sink)
    for file in ("run.mcap", "metadata.yaml"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "other" / file).read_bytes()
