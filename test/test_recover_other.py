"""Recovery of other logs: metadata for a complete log, bags in several files, other encodings."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.rosbag2 import Reader

from train_ato.cli import main
from train_ato.log.mcap_records import stream
from train_ato.log.recover import recover

GOLDEN = Path(__file__).resolve().parent / "golden" / "short_train" / "run.mcap"
COUNT = sum(1 for _ in stream(GOLDEN))


@pytest.mark.parametrize("wrong", ["missing", "no yaml", "another's", "empty"])
def test_metadata_beside_a_whole_log_is_written_again(wrong: str, tmp_path: Path) -> None:
    """Breaks if ``ros2 bag`` cannot open a bag although its log is complete."""
    shutil.copytree(GOLDEN.parent, tmp_path / "run")
    file, log = tmp_path / "run" / "metadata.yaml", tmp_path / "run" / "run.mcap"
    good, bytes_before = file.read_text(), log.read_bytes()
    texts = {"no yaml": "{{{", "another's": good.replace("message_count: 441", "message_count: 7"), "empty": ""}
    if wrong == "missing":
        file.unlink()
    else:
        file.write_text(texts[wrong])
    assert main(["recover", str(tmp_path / "run")]) == 0
    assert file.read_text() == good
    assert log.read_bytes() == bytes_before
    with Reader(tmp_path / "run") as bag:
        assert bag.message_count == COUNT
    if wrong != "missing":
        assert file.with_name("metadata.yaml.broken").read_text() == texts[wrong]


def test_metadata_beside_a_log_with_unreadable_quality_of_service(tmp_path: Path) -> None:
    """Breaks if the quality of service of a channel is parsed without a check."""
    with (tmp_path / "run.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/text", "cdr", schema, {"offered_qos_profiles": "["})
        writer.add_message(channel, 1, bytes(8), 1)
        writer.finish()
    assert main(["recover", str(tmp_path)]) == 0
    text = yaml.safe_load((tmp_path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert text["topics_with_message_count"][0]["topic_metadata"]["offered_qos_profiles"] == []


def test_metadata_of_a_bag_in_several_files_is_left_alone(tmp_path: Path) -> None:
    """Breaks if the recovery of one file of a bag removes the others from it."""
    (tmp_path / "bag_0.mcap").write_bytes(GOLDEN.read_bytes()[:-30])
    text = yaml.safe_dump(
        {"rosbag2_bagfile_information": {"relative_file_paths": ["bag_0.mcap", "bag_1.mcap"],
                                         "topics_with_message_count": []}}
    )  # fmt: skip
    (tmp_path / "metadata.yaml").write_text(text)
    assert recover(tmp_path / "bag_0.mcap").messages == COUNT
    assert (tmp_path / "metadata.yaml").read_text() == text


def test_what_is_not_ros_2_is_recovered_as_what_it_is(tmp_path: Path) -> None:
    """Breaks if messages without a schema count as damage, or get another encoding or topic."""
    path = tmp_path / "other.mcap"
    binary = bytes(range(256))
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2000)
        writer.start("x")
        plain = writer.register_channel("/plain", "json", 0, {"offered_qos_profiles": "{{{"})
        schema = writer.register_schema("Some", "protobuf", binary)
        coded = writer.register_channel("/coded", "protobuf", schema, {"more": "told"})
        again = writer.register_channel("/plain", "protobuf", schema)
        for number in range(500):
            writer.add_message((plain, coded, again)[number % 3], number, b"%d" % number, number)
        writer.finish()
    assert main(["info", str(path)]) == 0
    path.write_bytes(path.read_bytes()[:-200])
    recover(path)
    with path.open("rb") as file:
        found = [(s and (s.name, s.encoding, s.data), c, m.data) for s, c, m in make_reader(file).iter_messages()]
    assert len(found) == 500
    for number, (schema, channel, data) in enumerate(found):
        assert data == b"%d" % number
        assert channel.topic == ("/plain", "/coded", "/plain")[number % 3]
        assert channel.message_encoding == ("json", "protobuf", "protobuf")[number % 3]
        assert schema == (None, *2 * (("Some", "protobuf", binary),))[number % 3]
    assert found[1][1].metadata["more"] == "told"
