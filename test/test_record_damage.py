"""Cut and damaged logs: recovered or rejected in one line, without messages that were not recorded.

Recovery of other logs: metadata for a complete log, bags in several files, other encodings.
"""

import io
import random
import re
import shutil
import tempfile
import tracemalloc
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
import yaml
import zstandard
from case_costs import sampled
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from report_runs import copy_messages
from rosbags.rosbag2 import Reader

from train_ato.cli import main
from train_ato.log.definitions import definition
from train_ato.log.log_writer import LogFile
from train_ato.log.mcap_records import Damage, chunk_content, stream
from train_ato.log.reading import attachments, log_file
from train_ato.log.recover import recover
from train_ato.log.table_loading import load

pytestmark = pytest.mark.usefixtures("without_figure")

GOLDEN = Path(__file__).resolve().parent / "golden" / "short_train" / "run.mcap"


def in_chunks() -> bytes:
    """Return the golden run as a log of several chunks."""
    with tempfile.TemporaryDirectory() as folder:
        log = LogFile(Path(folder), attachments(GOLDEN), chunk_size=150_000)
        copy_messages(GOLDEN, log)
        return log.path.read_bytes()


WHOLE = in_chunks()
ORIGINAL = [(m.channel.topic, m.publish_ns, m.log_ns, m.data) for m in stream(GOLDEN)]
"""Every message of the golden run, in its order."""


def cut(chance: random.Random) -> bytes:
    return WHOLE[: chance.randrange(len(WHOLE))]


def flipped(chance: random.Random) -> bytes:
    data = bytearray(WHOLE)
    for _ in range(chance.choice((1, 1, 1, 2, 5))):
        data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    return bytes(data)


def overwritten(chance: random.Random) -> bytes:
    begin, size = chance.randrange(len(WHOLE)), chance.randrange(1, 5000)
    return WHOLE[:begin] + chance.randbytes(size) + WHOLE[begin + size :]


def taken_out(chance: random.Random) -> bytes:
    begin = chance.randrange(len(WHOLE))
    return WHOLE[:begin] + WHOLE[begin + chance.randrange(1, 5000) :]


def flipped_in_structure(chance: random.Random) -> bytes:
    """Damage the structure of the file: heads of records, its smallest part."""
    data = bytearray(WHOLE)
    data[chance.choice(HEADS) + chance.randrange(60)] ^= 1 << chance.randrange(8)
    return bytes(data)


def heads() -> list[int]:
    """Return where the records of the file begin."""
    places, place = [], 8
    while place < len(WHOLE) - 100:
        places.append(place)
        place += 9 + int.from_bytes(WHOLE[place + 1 : place + 9], "little")
    return places


HEADS = heads()
KINDS: tuple[Callable[[random.Random], bytes], ...] = (cut, flipped, flipped_in_structure, overwritten, taken_out)
CASES = [(kind, seed) for kind in KINDS for seed in range(25 if kind in KINDS[:2] else 10)]


def one_line(capsys: pytest.CaptureFixture[str], *arguments: str) -> int:
    """Run a command; its standard error has at most one line."""
    try:
        status = main(list(arguments))
    except SystemExit as end:
        status = int(end.code or 0)
    said = capsys.readouterr().err
    lines = said.strip().splitlines()
    assert len(lines) == (status != 0), said
    assert "Traceback" not in said
    assert len(said) < 400
    return status


@pytest.mark.parametrize(
    ("kind", "seed"), sampled(CASES, every=6), ids=lambda case: getattr(case, "__name__", str(case))
)
def test_whatever_is_recovered_was_recorded(
    kind: Callable[[random.Random], bytes], seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks on a traceback, a message not in the original, or an incomplete new file."""
    damaged = kind(random.Random(f"{kind.__name__} {seed}"))
    (tmp_path / "run.mcap").write_bytes(damaged)
    if one_line(capsys, "recover", str(tmp_path)) == 2:
        assert (tmp_path / "run.mcap").read_bytes() == damaged
        assert sorted(path.name for path in tmp_path.iterdir()) == ["run.mcap"]
        return
    assert (tmp_path / "run.mcap.broken").read_bytes() == damaged
    left = iter(ORIGINAL)
    count = 0
    for m in stream(tmp_path / "run.mcap"):
        assert any(entry == (m.channel.topic, m.publish_ns, m.log_ns, m.data) for entry in left)
        count += 1
    with Reader(tmp_path) as bag:
        assert bag.message_count == count > 0
    with (tmp_path / "run.mcap").open("rb") as file:
        assert sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages()) == count


@pytest.mark.parametrize(
    ("kind", "seed"), sampled(CASES, every=4), ids=lambda case: getattr(case, "__name__", str(case))
)
def test_reading_commands_refuse_a_damaged_log_in_one_line(
    kind: Callable[[random.Random], bytes], seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if a wrong bit is not detected: figures, tables and a replay would use an incomplete log."""
    log = tmp_path / "run.mcap"
    log.write_bytes(kind(random.Random(f"{kind.__name__} {seed}")))
    for command, *more in (["info"], ["verify"], ["replay"], ["export", f"--out={tmp_path / 'tables'}", "--csv"]):
        assert one_line(capsys, command, str(log), *more) == 2, command
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]


def chunks() -> dict[int, list[tuple[str, int, int, bytes]]]:
    """Return where every chunk begins, and its messages."""
    found: dict[int, list[tuple[str, int, int, bytes]]] = {}
    left = iter(ORIGINAL)
    for place in HEADS:
        if WHOLE[place] == Opcode.CHUNK:
            length = int.from_bytes(WHOLE[place + 1 : place + 9], "little")
            data = chunk_content(WHOLE[place + 9 : place + 9 + length])
            found[place] = []
            at = 0
            while at < len(data):
                found[place] += [next(left)] if data[at] == Opcode.MESSAGE else []
                at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    return found


GROUPS = chunks()


def read_back(folder: Path) -> list[tuple[str, int, int, bytes]]:
    return [(m.channel.topic, m.publish_ns, m.log_ns, m.data) for m in stream(folder / "run.mcap")]


def test_one_wrong_bit_costs_one_chunk(tmp_path: Path) -> None:
    """Breaks if another chunk is lost too: the first one contains the definitions of all messages."""
    assert len(GROUPS) >= 3
    for place in GROUPS:
        folder = tmp_path / str(place)
        folder.mkdir()
        data = bytearray(WHOLE)
        data[place + 200] ^= 1
        (folder / "run.mcap").write_bytes(data)
        found = recover(folder)
        assert found.lost_chunks == 1
        assert read_back(folder) == [entry for at, group in GROUPS.items() if at != place for entry in group]
        assert attachments(found.path) == attachments(GOLDEN)


def test_a_chunk_that_lost_its_checksum_is_damaged(tmp_path: Path) -> None:
    """Breaks if a checksum of 0 is taken for none where the other chunks have one: nothing checks its messages."""
    place = list(GROUPS)[1]
    data = bytearray(WHOLE)
    data[place + 33 : place + 37] = bytes(4)
    (tmp_path / "run.mcap").write_bytes(data)
    assert recover(tmp_path).lost_chunks == 1
    assert read_back(tmp_path) == [entry for at, group in GROUPS.items() if at != place for entry in group]


def test_every_closed_chunk_of_a_killed_run_comes_back(tmp_path: Path) -> None:
    """Breaks if a log without summary is lost, or an intact chunk is omitted."""
    places = list(GROUPS)
    for number in range(1, len(places) + 1):
        folder = tmp_path / str(number)
        folder.mkdir()
        end = places[number] if number < len(places) else len(WHOLE) - 3
        (folder / "run.mcap.partial").write_bytes(WHOLE[: end + 30])
        recover(folder)
        assert read_back(folder) == [entry for at in places[:number] for entry in GROUPS[at]]


def test_a_whole_log_is_left_alone(tmp_path: Path) -> None:
    for name in ("run.mcap", "alone.mcap"):
        (tmp_path / name).write_bytes(WHOLE)
    recover(tmp_path)  # metadata.yaml
    for path in (tmp_path, tmp_path / "alone.mcap"):
        with pytest.raises(ValueError, match="is undamaged; there is nothing to recover"):
            recover(path)
    assert (tmp_path / "run.mcap").read_bytes() == WHOLE


def test_the_log_of_a_run_that_goes_on_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if ``recover`` moves the file of a running recorder, or a reader reports a running run as killed."""
    log = LogFile(tmp_path)
    with pytest.raises(ValueError, match="being written by a run that goes on"):
        recover(tmp_path)
    with pytest.raises(ValueError, match="still goes on"):
        log_file(tmp_path)
    assert one_line(capsys, "replay", str(tmp_path)) == 2
    log.close()
    assert log_file(tmp_path) == tmp_path / "run.mcap"


def test_a_recovered_run_differs_by_what_is_left_out(
    demo_run: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if a recovered log differs without a stated reason."""
    run = Path(shutil.copytree(demo_run("duration=20"), tmp_path / "run"))
    whole = (run / "run.mcap").read_bytes()
    (run / "run.mcap").write_bytes(whole[: 2 * len(whole) // 3])
    recover(run)
    assert main(["verify", str(run)]) == 1
    assert capsys.readouterr().err.endswith("; `train-ato recover` may have left out damaged messages of this log\n")


def test_recover_overwrites_nothing(tmp_path: Path) -> None:
    """Breaks if a second ``recover`` overwrites the file kept by the first."""
    (tmp_path / "run.mcap.partial").write_bytes(WHOLE[:200_000])
    (tmp_path / "run.mcap.broken").write_bytes(b"earlier")
    with pytest.raises(ValueError, match=r"run\.mcap\.broken: exists already"):
        recover(tmp_path)
    assert (tmp_path / "run.mcap.broken").read_bytes() == b"earlier"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.mcap.broken", "run.mcap.partial"]


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_logs_of_another_writer_are_recovered_too(compression: str, tmp_path: Path) -> None:
    """Breaks if the search for chunks depends on properties of our writer."""
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2000, compression=CompressionType[compression.upper()])
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/Byte", "ros2msg", b"byte data")
        channel = writer.register_channel("/byte", "cdr", schema)
        for number in range(1000):
            writer.add_message(channel, number, number.to_bytes(8, "little") * 4, number)
        writer.finish()
    data = bytearray(path.read_bytes())
    place = 8
    for _ in range(12):  # the header, and some chunks with the indexes of their messages
        place += 9 + int.from_bytes(data[place + 1 : place + 9], "little")
    place += 0 if data[place] == Opcode.CHUNK else 9 + int.from_bytes(data[place + 1 : place + 9], "little")
    assert data[place] == Opcode.CHUNK
    data[place + 90] ^= 0x10
    path.write_bytes(data)
    with pytest.raises(ValueError, match="damaged"):
        list(stream(path))
    found = recover(path)
    assert found.path == path
    assert 800 < found.messages < 1000
    assert all(m.data == m.publish_ns.to_bytes(8, "little") * 4 for m in stream(path))
    assert not (tmp_path / "metadata.yaml").exists()


def test_our_checksums_are_those_of_the_format() -> None:
    """Breaks if the MCAP library calculates another checksum of the data section."""
    kinds = {type(record).__name__ for record in StreamReader(io.BytesIO(WHOLE), validate_crcs=True).records}
    assert {"Attachment", "AttachmentIndex", "Statistics", "DataEnd", "Message"} <= kinds


def log_of(path: Path, topic: str, messages: list[tuple[int, bytes]]) -> None:
    """Write a log of JointState messages (publish time [ns], CDR bytes) on one topic."""
    known = definition("sensor_msgs/msg/JointState")
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2**20)
        writer.start("ros2")
        schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", known.text.encode())
        channel = writer.register_channel(topic, "cdr", schema)
        for time, data in messages:
            writer.add_message(channel, 0, data, time)
        writer.finish()


@pytest.mark.parametrize("command", ["info", "export", "recover"])
def test_a_time_beyond_that_of_ros_is_refused(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a publish time of 2^63 ns overflows the arrays of times."""
    log_of(tmp_path / "run.mcap", "/ato/command", [(2**63, bytes(64))])
    assert one_line(capsys, command, str(tmp_path / "run.mcap")) == 2


@pytest.mark.parametrize("topic", ["/train/vehicles", "/foreign"])
def test_long_arrays_are_refused_at_the_first_message(topic: str, tmp_path: Path) -> None:
    """Breaks if a small log of compressed zeros is unpacked as a whole before its arrays are refused."""
    size = 250_000  # numbers in one message, 2 MB
    data = bytes((0, 1, 0, 0)) + bytes(16) + size.to_bytes(4, "little") + bytes(4) + bytes(8 * size) + bytes(8)
    log_of(tmp_path / "run.mcap", topic, [(time, data) for time in range(100)])
    assert (tmp_path / "run.mcap").stat().st_size < 100_000
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=r"position .* 250000 "):
            load(tmp_path / "run.mcap", [topic])
        assert tracemalloc.get_traced_memory()[1] < 60e6  # all messages have 200 MB
    finally:
        tracemalloc.stop()


def test_a_chunk_without_checksum_has_the_length_of_its_head() -> None:
    """Breaks if a chunk of 9 bytes with a head of 10 is read, where no checksum shows it."""
    head = bytes(16) + (10).to_bytes(8, "little") + bytes(8) + (9).to_bytes(8, "little")
    with pytest.raises(Damage, match="the length of a chunk differs"):
        chunk_content(head + bytes(9))


@pytest.mark.parametrize("name", ["zstd", "lz4"])
def test_a_chunk_unpacks_no_more_than_its_head_says(name: str) -> None:
    """Breaks if a chunk that says 10 bytes and has 300 MB is unpacked before its length is compared."""
    if name == "lz4":
        packed = pytest.importorskip("lz4.frame").compress(bytes(300_000_000), store_size=False)
    else:
        packed = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(300_000_000))
    letters = len(name).to_bytes(4, "little") + name.encode()
    head = bytes(16) + (10).to_bytes(8, "little") + bytes(4) + letters + len(packed).to_bytes(8, "little")
    tracemalloc.start()
    try:
        with suppress(Damage):
            assert len(chunk_content(head + packed)) == 10
        assert tracemalloc.get_traced_memory()[1] < 60e6
    finally:
        tracemalloc.stop()


def test_verify_refuses_a_message_too_long_for_the_train(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the messages of a log are kept whole before one of them is decoded."""
    run = tmp_path / "run"
    assert main(["run", "demo", "--engine", "--json", "--set", "duration=1", "--out", str(run)]) == 0
    log_of(run / "run.mcap", "/ato/command", [(0, bytes((0, 1, 0, 0)) + bytes(2_000_000))])
    assert main(["verify", str(run)]) == 2
    assert re.search(r"ato/command: a message of 2000004 bytes, at most \d+ for this train", capsys.readouterr().err)


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
