"""Log read from any time on by its index, and a law replayed against a recording."""

import json
import math
import shutil
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from commands import answer
from engine_runs import record_run, setup_of
from matplotlib.image import imread
from mcap.records import Channel
from mcap.writer import CompressionType, Writer
from refusals import one_line
from report_runs import without
from test_wire import LONG, message

from train_ato.cli import main
from train_ato.log.log_writer import RunLog
from train_ato.log.mcap_records import stream
from train_ato.messages.codec import Wire
from train_ato.messages.topics import EPOCH_NS, Rate, topics_of
from train_ato.playback.log import ReplayLog, ReplayOptions, _described, chosen_topics, parse_remap
from train_ato.playback.open_loop import replay_open_loop
from train_ato.playback.playback import Playback, ReplayClock
from train_ato.playback.publishing import note_far_stamp
from train_ato.playback.replaying import output_names

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


@pytest.mark.parametrize(("depth", "kept"), [(0, 10), (7, 7), (2**64 - 1, 2**31 - 1)])
def test_the_depth_of_a_topic_is_one_that_a_publisher_can_have(depth: int, kept: int) -> None:
    """Breaks if a replay of a log with an unlimited depth ends with a traceback."""
    channel = Channel(1, "/a", "cdr", {"offered_qos_profiles": f"[{{depth: {depth}}}]"}, 1)
    assert _described(channel, "std_msgs/msg/String", 1).depth == kept


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
        ("begun.mcap", b"\x89MCAP0\r\n", "damaged or no log: "),
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


@pytest.mark.parametrize(("options", "says"), [
    ({"rate": 0.0}, "--rate 0: give a number above 0"), ({"rate": float("nan")}, "--rate nan"),
    ({"start_offset": -1.0}, "--start-offset -1"), ({"duration": 0.0}, "--playback-duration 0"),
    ({"delay": -1.0}, "--delay -1"), ({"clock_hz": 0.0}, "--clock 0"),
    ({"acknowledged_s": -0.001}, "--wait-for-all-acked -1"),
    ({"topics": ("ato/comand",)}, "did you mean '/ato/command'"),
    ({"exclude": ("cars",)}, "--exclude-topics cars: not in the log"),
    ({"remap": {"cars": "x"}}, "--remap cars: not in the log"),
    ({"topics": ("ato/command",), "exclude": ("/ato/command",)}, "leave no topic to publish"),
    ({"remap": {"ato/command": "/clock"}}, "would both be published as /clock"),
])  # fmt: skip
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


SECONDS = 40


@pytest.fixture(scope="module")
def setup():
    return setup_of("demo", f"duration={SECONDS}")


@pytest.fixture(scope="module")
def replayed(demo_run) -> Path:
    return demo_run(f"duration={SECONDS}")


def test_the_recorded_law_gives_the_recorded_outputs_bit_by_bit(setup, replayed):
    """Fails if the controller depends on more than its inputs: a clock, a global, the plant."""
    result = replay_open_loop(setup, replayed)
    assert result.stamp.tolist() == [k * setup.tick_ns for k in range(setup.ticks)]
    assert np.array_equal(result.recorded, result.replayed)
    assert np.array_equal(result.recorded_pipe, result.replayed_pipe)
    assert result.recorded_pipe.size == setup.ticks
    assert result.summary()["equal_ticks"] == setup.ticks


def test_the_outputs_of_a_disengaged_ato_are_equal_too(tmp_path):
    """Breaks if the states of the ATO, a takeover or a request are not repeated on the recorded inputs."""
    disengage, brake = "ato_requests=[{at: 20, do: disengage}]", "interventions=[{at: 32, do: emergency_brake}]"
    setup = setup_of("demo", "duration=40", disengage, brake)
    result = replay_open_loop(setup, record_run(setup, tmp_path / "run"))
    assert result.summary()["equal_ticks"] == setup.ticks
    assert (result.recorded[220:240] == 0.0).all()


def test_a_log_without_the_supervisor_is_replayed_as_driven(setup, replayed, tmp_path):
    """Breaks if the replay waits for messages that the log does not have, as that of a measured run."""
    cut = without(replayed, tmp_path / "cut", {"train/protection", "atp/speeds"})
    assert replay_open_loop(setup, cut).summary()["equal_ticks"] == setup.ticks


def test_another_gain_is_seen(replayed):
    changed = setup_of("demo", f"duration={SECONDS}", "laws.pid={kp: 3.0e+5}")
    result = replay_open_loop(changed, replayed)
    summary = result.summary()
    assert summary["difference_max_kn"] > 0.01
    assert 0 < summary["difference_rms_kn"] <= summary["difference_max_kn"]
    worst = int(np.abs(result.difference).max(axis=1).argmax())
    assert summary["difference_max_at_s"] == pytest.approx(result.stamp[worst] * 1e-9)
    assert summary["replayed"]["force_max_kn"] == pytest.approx(result.replayed.sum(axis=1).max() / 1e3)


def test_the_command_shows_both_outputs_and_draws_them(replayed, capsys):
    """The figure is written beside the log; with another law its content differs."""
    assert main(["replay", str(replayed), "--law", "smc"]) == 0
    shown = capsys.readouterr().out
    for text in ("pid, recorded", "smc, replayed", "difference, rms in kN", "replay-smc.png", "Open loop"):
        assert text in shown
    summary = answer(capsys, "replay", str(replayed), "--law", "pid")
    assert (summary["difference_max_kn"], summary["equal_ticks"]) == (0, SECONDS * 10)
    assert summary["figure"] == str(replayed / "replay-pid.png")
    setup = setup_of("demo", f"duration={SECONDS}")
    swap = {"controller": "pid", "changes": [{"at_s": 614.0, "name": "controller", "value": "smc"}]}
    assert output_names(setup, swap, "mpc") == ("pid → smc at 614 s, recorded", "mpc, replayed")
    assert output_names(setup, swap, "pid")[1] == "pid → smc at 614 s, replayed"
    assert output_names(setup, {"restarts": {"controller": 1}}, "pid")[0] == "pid, recorded with a restart"
    assert output_names(setup, {"restarts": {"plant": 1}}, "pid")[0] == "pid, recorded"
    assert output_names(setup, {"controller": "external: mine"}, "pid") == ("external: mine, recorded", "pid, replayed")
    figures = [imread(replayed / f"replay-{name}.png") for name in ("smc", "pid")]
    assert all(figure.shape[0] > 500 and figure.std() > 0.05 for figure in figures)
    assert not np.array_equal(*figures)


def test_a_log_alone_is_enough(replayed, tmp_path, capsys):
    """The scenario is an attachment of the log."""
    shutil.copy(replayed / "run.mcap", tmp_path / "alone.mcap")
    figure = tmp_path / "both.svg"
    arguments = ["replay", str(tmp_path / "alone.mcap"), "--law", "smc", "--out", str(figure), "--json"]
    assert main(arguments) == 0
    alone = json.loads(capsys.readouterr().out)
    assert figure.read_text().startswith("<?xml")
    beside = answer(capsys, "replay", str(replayed), "--law", "smc")
    for key in ("run", "figure"):
        assert alone.pop(key) != beside.pop(key)
    assert alone == beside


def test_a_log_without_a_scenario_is_refused(tmp_path, capsys):
    assert main(["replay", str(other(tmp_path / "other.mcap")), "--law", "smc"]) == 2
    assert "no scenario.yaml is attached" in capsys.readouterr().err


@pytest.fixture
def wall() -> SimpleNamespace:
    """Give a wall clock that the test sets."""
    return SimpleNamespace(now=1000.0)


def test_time_flows_by_the_rate_and_a_change_of_it_does_not_jump(wall):
    clock = ReplayClock(2.0, paused=False, steady=lambda: wall.now)
    wall.now += 3
    assert clock.now == 6
    assert clock.until(10) == 2
    clock.set_rate(0.5)
    assert clock.now == 6
    assert clock.until(10) == 8
    wall.now += 8
    assert (clock.now, clock.until(10), clock.until(9)) == (10, 0, 0)


def test_time_stands_in_a_pause_and_goes_on_from_there(wall):
    clock = ReplayClock(1.0, paused=False, steady=lambda: wall.now)
    wall.now += 5
    clock.set_paused(True)
    wall.now += 100
    assert (clock.now, clock.until(5)) == (5, math.inf)
    clock.reached(7)
    assert clock.now == 7
    clock.set_rate(10)
    clock.set_paused(False)
    assert clock.until(8) == pytest.approx(0.1)


def test_a_jump_with_a_delay(wall):
    """The delay is in wall time, at any rate; a pause does not change it."""
    for rate in (4.0, math.inf):
        clock = ReplayClock(rate, paused=False, steady=lambda: wall.now)
        clock.jump(20, delay=3)
        wall.now += 1
        assert (clock.now, clock.until(20)) == (20, 2)
        clock.set_paused(True)
        clock.set_paused(False)
        wall.now += 2
        assert clock.until(20) == 0


def test_as_fast_as_possible_time_follows_the_messages(wall):
    clock = ReplayClock(math.inf, paused=False, steady=lambda: wall.now)
    wall.now += 50
    assert (clock.now, clock.until(1e9)) == (0, 0)
    clock.reached(12)
    assert clock.now == 12
    clock.set_rate(1.0)
    wall.now += 1
    assert clock.now == 13


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan])
def test_a_rate_that_is_none_is_refused(wall, rate):
    clock = ReplayClock(1.0, paused=False, steady=lambda: wall.now)
    with pytest.raises(ValueError, match="above 0"):
        clock.set_rate(rate)
    assert clock.rate == 1.0
