"""Log read from any time on by its index, compared with reading from its beginning."""

import math
from collections.abc import Iterator
from pathlib import Path

import pytest
from mcap.writer import CompressionType, Writer
from refusals import one_line
from test_wire import LONG, message

from train_ato.log.log_writer import RunLog
from train_ato.log.mcap_records import stream
from train_ato.messages.codec import Wire
from train_ato.messages.topics import EPOCH_NS, Rate, topics_of
from train_ato.playback.log import ReplayLog, ReplayOptions, chosen_topics, parse_remap
from train_ato.playback.playback import Playback
from train_ato.playback.publishing import note_far_stamp

TICK, TICKS = 100_000_000, 3000
REPLANNED = 1700


def test_a_replay_that_waits_for_a_far_stamp_is_noted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if one foreign message makes a replay wait for weeks without a word, or every replay is noted."""
    for options in (ReplayOptions(rate=20.0), ReplayOptions(rate=math.inf), ReplayOptions(duration=60.0)):
        note_far_stamp(tmp_path, 1.3e8, options)
        note_far_stamp(tmp_path, 86_400.0, options)
    told = capsys.readouterr().err
    assert told.count("note: ") == 1 and "130000000 s from the first message to the last" in told


def write(folder: Path, ticks: int = TICKS, *, tiny: bool = False, only: str | None = None) -> Path:
    """Write a run of a slow wall clock, a late estimate and a second plan; one topic ``only``, or chunks ``tiny``."""
    wire = Wire(LONG)
    with RunLog(folder, topics_of(LONG)) as log:
        for tick in range(ticks):
            received = EPOCH_NS + 10**18 + round(tick * TICK / 200.0)
            for topic in topics_of(LONG):
                late = tick - 1 if topic.name == "ato/estimate" else tick
                once = tick == 0 or (topic.name == "ato/profile" and tick == REPLANNED)
                if only not in (None, topic.name) or not topic.recorded or late < 0:
                    continue
                if once if topic.rate is Rate.ONCE else topic.rate is Rate.TICK:
                    data = wire.encode(topic.name, message(topic.name, LONG, late * TICK, seed=tick))
                    log.add(topic.name, EPOCH_NS + late * TICK, received, data)
                    if tiny:
                        log.flush()
    return folder


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("log"))


@pytest.fixture
def log(run: Path) -> Iterator[ReplayLog]:
    with ReplayLog(run) as log:
        yield log


def test_length_and_topics_are_told_without_reading_the_file(run, log):
    found = list(stream(run / "run.mcap"))
    assert log.length == pytest.approx((TICKS - 1) * 0.1, abs=1e-9)
    assert {name: topic.count for name, topic in log.topics.items()} == {
        name: sum(message.channel.topic == name for message in found) for name in {m.channel.topic for m in found}
    }
    assert {name for name, topic in log.topics.items() if topic.latched} == {"/ato/profile", "/ato/limits"}
    assert len(log._spans) <= 3, "only the chunks at both ends are looked at"


@pytest.mark.parametrize("place", [0.0, 0.05, 0.1, 123.4, 123.45, 169.9, 170.0, 299.9])
def test_entering_at_a_moment_leaves_nothing_out_and_adds_nothing(run, log, place):
    """Fails if a message late in the log is lost because its chunk was skipped."""
    moment = EPOCH_NS + round(place * 1e9)
    wanted = {"/ato/command", "/ato/estimate", "/train/vehicles"}
    expected = [m for m in stream(run / "run.mcap") if m.channel.topic in wanted and m.publish_ns >= moment]
    assert [(m.channel.topic, m.publish_ns, m.data) for m in log.messages(wanted, moment)] == [
        (m.channel.topic, m.publish_ns, m.data) for m in expected
    ]


def test_tiny_chunks_out_of_order_lose_nothing(tmp_path):
    """The last times of the chunks are not increasing: bisection alone would skip messages."""
    write(tmp_path, 40, tiny=True)
    everything = list(stream(tmp_path / "run.mcap"))
    with ReplayLog(tmp_path) as log:
        assert len(log._chunks) == len(everything)
        for tick in range(40):
            moment = EPOCH_NS + tick * TICK
            expected = [(m.channel.topic, m.publish_ns) for m in everything if m.publish_ns >= moment]
            assert [(m.channel.topic, m.publish_ns) for m in log.messages(set(log.topics), moment)] == expected


def test_a_moment_is_found_in_a_few_chunks(log):
    """Fails if the file is read from its beginning, which would read every chunk."""
    assert len(log._chunks) > 20
    next(log.messages({"/train/vehicles"}, EPOCH_NS + 250 * 10**9))
    assert len(log._spans) <= 3 + 8


def test_an_absolute_time_is_a_place_of_the_log(log: ReplayLog) -> None:
    """Breaks if a service of rosbag2, whose times are absolute, enters a log at another moment."""
    playback = Playback(log, log.topics, ReplayOptions(), None, interrupted=lambda: False)
    assert [playback.place_of(EPOCH_NS + round(place * 1e9)) for place in (0.0, 0.1, 123.4)] == [0.0, 0.1, 123.4]


@pytest.mark.parametrize(("tick", "profiles"), [(0, [0]), (REPLANNED - 1, [0]), (REPLANNED, [0, REPLANNED])])
def test_what_stands_at_a_moment_is_what_a_late_joiner_would_get(log, tick, profiles):
    depths = {name: topic.depth for name, topic in log.topics.items() if topic.latched}
    found = log.standing(depths, EPOCH_NS + tick * TICK)
    stamps = [message.publish_ns - EPOCH_NS for message in found if message.channel.topic == "/ato/profile"]
    assert stamps == [profile * TICK for profile in profiles]
    assert sum(message.channel.topic == "/ato/limits" for message in found) == 1
    kept = log.standing({**depths, "/ato/profile": 1}, EPOCH_NS + tick * TICK)
    assert [m.publish_ns - EPOCH_NS for m in kept if m.channel.topic == "/ato/profile"] == [profiles[-1] * TICK]


def other(path: Path, **options) -> Path:
    """Write a log of another recorder: no publish times, no quality of service, another epoch."""
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/Empty", "ros2msg", b"")
        channel = writer.register_channel("/beat", "cdr", schema)
        for beat in range(50):
            writer.add_message(channel, 10**18 + beat * 10**9, b"\0\1\0\0", 0)
        writer.finish()
    return path


@pytest.mark.parametrize(
    "options",
    [
        {"use_chunking": False},
        {"compression": CompressionType.NONE, "chunk_size": 100},
        {"compression": CompressionType.ZSTD, "use_statistics": False},
        {"use_summary_offsets": False, "enable_crcs": False},
    ],
)
def test_logs_of_others_are_entered_too(tmp_path, options):
    """Logs with and without index, chunks, statistics, checksums; times are from the first message."""
    with ReplayLog(other(tmp_path / "other.mcap", **options)) as log:
        assert log.length == 49.0
        assert log.topics["/beat"].count == 50 and not log.topics["/beat"].latched
        moments = [m.publish_ns - log.begin_ns for m in log.messages({"/beat"}, log.begin_ns + 30 * 10**9)]
        assert moments == [beat * 10**9 for beat in range(30, 50)]


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("absent.mcap", None, "no such log"),
        ("empty.mcap", b"", "is empty; nothing was recorded in it"),
        ("text.mcap", b"not a log at all, but a text that is longer than a footer is", "no log: a text; name the log"),
    ],
)
def test_what_is_no_log_is_refused_in_one_line(tmp_path, name, content, says):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with one_line(says):
        ReplayLog(tmp_path / name)


def test_a_log_without_messages_is_refused(tmp_path):
    RunLog(tmp_path, topics_of(LONG)).close()
    with pytest.raises(ValueError, match="contains no message"):
        ReplayLog(tmp_path)


def test_a_cut_or_changed_file_is_refused_and_never_read_wrongly(run, tmp_path):
    """Ten damaged places of each kind: one line, or the same messages (a bit of an unused index)."""
    whole = (run / "run.mcap").read_bytes()
    truth = [(m.channel.topic, m.publish_ns, m.data) for m in stream(run / "run.mcap")]
    file = tmp_path / "run.mcap"
    for number in range(10):
        place = (number * 2 + 1) * len(whole) // 20
        flipped = bytearray(whole)
        flipped[place] ^= 1 << (number % 8)
        for data in (whole[:place], bytes(flipped)):
            file.write_bytes(data)
            try:
                with ReplayLog(file) as log:
                    read = [(m.channel.topic, m.publish_ns, m.data) for m in log.messages(set(log.topics), 0)]
            except ValueError as error:
                assert "damaged or no log" in str(error)
                assert "\n" not in str(error)
            else:
                assert read == truth


@pytest.mark.parametrize("place", [1, 60, 400, 2000])
def test_a_changed_index_is_noticed(run, tmp_path, place):
    """The mcap reader does not check its index: without the checksum a topic could lose a chunk unnoticed."""
    flipped = bytearray((run / "run.mcap").read_bytes())
    flipped[-8 - 29 - place] ^= 4
    (tmp_path / "run.mcap").write_bytes(flipped)
    with pytest.raises(ValueError, match="checksum of the summary"):
        ReplayLog(tmp_path)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"rate": 0.0}, "--rate 0: give a number above 0"), ({"rate": float("nan")}, "--rate nan"),
        ({"start_offset": -1.0}, "--start-offset -1"), ({"duration": 0.0}, "--playback-duration 0"),
        ({"delay": -1.0}, "--delay -1"), ({"clock_hz": 0.0}, "--clock 0"),
        ({"acknowledged_s": -0.001}, "--wait-for-all-acked -1"),
        ({"topics": ("ato/comand",)}, "did you mean '/ato/command'"),
        ({"exclude": ("cars",)}, "--exclude-topics cars: not in the log"),
        ({"remap": {"cars": "x"}}, "--remap cars: not in the log"),
        ({"topics": ("ato/command",), "exclude": ("/ato/command",)}, "leave no topic to publish"),
        ({"remap": {"ato/command": "/clock"}}, "would both be published as /clock"),
    ],
)  # fmt: skip
def test_bad_options_are_one_line(log, options, says):
    with one_line("", says):
        ReplayOptions(**options).check()
        chosen_topics(log.topics, ReplayOptions(**options))


def test_remaps_are_read():
    assert parse_remap(("a:=b", "/c/d:=e")) == {"a": "b", "/c/d": "e"}
    for wrong in ("a=b", ":=b", "a:="):
        with pytest.raises(ValueError, match="from:=to"):
            parse_remap((wrong,))
    with pytest.raises(ValueError, match="already has another new name"):
        parse_remap(("a:=b", "/a:=c"))
