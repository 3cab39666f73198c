"""``train-ato replay`` as a process: another process as listener, keys, Ctrl-C, and the services of rosbag2."""

import fcntl
import json
import os
import pty
import select
import signal
import subprocess
import time
from pathlib import Path

import pytest
from programs import begun
from recordings import message_counts
from replay_listener import Replaying
from test_replay import COMMAND, PROFILE, SECONDS, TICKS, domain, listen, paused, recorded, run  # noqa: F401
from waiting import LIMIT_S

from train_ato.cli.main import main
from train_ato.cli.replay import KEYS, pressed
from train_ato.messages.codec import stamp_of
from train_ato.messages.topics import EPOCH_NS
from train_ato.playback.publishing import NODE
from train_ato.playback.replaying import replay


def started(log: Path, *arguments: str, **more) -> subprocess.Popen:
    """Start the command; it selects its own middleware profile."""
    environment = {key: value for key, value in os.environ.items() if key != "FASTRTPS_DEFAULT_PROFILES_FILE"}
    return begun("replay", str(log), *arguments, env=environment, **{"stdin": subprocess.DEVNULL, **more})


@pytest.fixture
def long_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record a run with more messages than the queues hold: 1000 at the sender, 5000 at the reader."""
    from test_replay_log import write

    return write(tmp_path_factory.mktemp("long"), 12_000, only=COMMAND)


@pytest.mark.graph
def test_nothing_is_lost_at_full_speed_to_a_slow_reader_that_keeps_all(long_run, listen, domain):  # noqa: F811
    """Without waiting for the reader the queues would overflow and lose messages."""
    listener = listen({COMMAND: COMMAND})
    expected = recorded(long_run, COMMAND)
    heard = listener.heard[COMMAND]

    class Slow(list):
        def append(self, data):
            time.sleep(0.0003)
            heard.append(data)

    listener.heard[COMMAND] = Slow()
    process = started(long_run, "--domain", str(domain), "--rate", "max", "--topics", COMMAND, "--json")
    try:
        listener.until(lambda: len(heard) >= len(expected), "the last message")
        listener.until(lambda: process.poll() is not None, "the end of the process")
    finally:
        process.kill()
        out, errors = process.communicate()
    assert heard == expected
    assert (process.returncode, errors) == (0, "")
    result = json.loads(out)
    assert result["published"] == {"/ato/command": len(expected)}
    assert (result["end"], result["acknowledged"], result["moment_s"]) == ("end", True, 1199.9)


def test_two_topics_change_names(run, listen, domain):  # noqa: F811
    """Fails if the middleware applies the remappings of the command line too: it would exchange the names again."""
    listener = listen({COMMAND: COMMAND})
    remap = ("--remap", "ato/command:=ato/estimate", "/ato/estimate:=/ato/command")
    process = started(run, "--domain", str(domain), "--rate", "max", *remap)
    try:
        listener.until(lambda: process.poll() is not None, "the end of the process")
    finally:
        process.kill()
        _, errors = process.communicate()
    assert (process.returncode, errors) == (0, "")
    expected = recorded(run, "ato/estimate")
    assert listener.hear(COMMAND, len(expected)) == expected


@pytest.mark.parametrize(("arguments", "status"), [((), 1), (("--loop", "--rate", "max"), 0), (("--start-paused",), 1)])
def test_ctrl_c_ends_it_cleanly(run, listen, domain, arguments, status):  # noqa: F811
    """The sent messages are reported in one JSON value; Ctrl-C is the normal end of a loop."""
    listener = listen({PROFILE: PROFILE})
    process = started(run, "--domain", str(domain), "--json", *arguments)
    try:
        listener.hear(PROFILE, 1)
        process.send_signal(signal.SIGINT)
        out, errors = process.communicate(timeout=LIMIT_S)
    finally:
        process.kill()
    assert process.returncode == status
    result = json.loads(out)
    assert result["end"] == "interrupted"
    assert result["published"]["/ato/profile"] >= 1
    assert errors.count("\n") <= 1
    assert "Traceback" not in errors


def test_keys_of_a_terminal(run, listen, domain):  # noqa: F811
    """Space resumes, the up arrow increases the rate, and the terminal is restored."""
    import termios

    listener = listen({COMMAND: COMMAND})
    ours, theirs = pty.openpty()
    before = termios.tcgetattr(theirs)
    process = started(
        run, "--domain", str(domain), "--start-paused", stdin=theirs, stderr=theirs, start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(theirs, termios.TIOCSCTTY, 0),
    )  # fmt: skip
    drawn = bytearray()

    def seen(condition):
        while select.select([ours], [], [], 0)[0]:
            drawn.extend(os.read(ours, 65536))
        return condition()

    def press(key, condition, what):
        os.write(ours, key)
        listener.until(lambda: seen(condition), what)

    try:
        assert listener.call("is_paused").success
        press(b"", lambda: b"0.0 of 15.0 s, paused" in drawn, "the progress bar")
        press(b"\x1b[A", lambda: listener.call("get_rate").message == "1.1", "a faster rate")
        press(b"\x1b[B", lambda: listener.call("get_rate").message == "1", "a slower rate")
        press(b" ", lambda: len(listener.heard[COMMAND]) > 2, "messages after space")
        press(b"\x03", lambda: process.poll() is not None, "the end of the process by Ctrl-C")
        assert process.returncode == 1
        assert termios.tcgetattr(theirs) == before
    finally:
        process.kill()
        process.communicate()
        os.close(ours)
        os.close(theirs)


def test_keys_are_taken_apart():
    orders = list(pressed(b"x \x1b[A\x1b[Cq\x1b[D "))
    assert orders == [KEYS[b" "], KEYS[b"\x1b[A"], KEYS[b"\x1b[C"], KEYS[b" "]]


def test_somebody_else_on_the_topic_is_told_of(run, listen, domain):  # noqa: F811
    """Readers would receive both a running train and its recording."""
    from train_ato.messages.topics import BY_NAME
    from train_ato.ros.nodes.endpoints import message_class, quality_of_service

    listener = listen({})
    topic = BY_NAME[COMMAND]
    listener.node.create_publisher(message_class(topic.type), COMMAND, quality_of_service(topic))
    process = started(run, "--domain", str(domain), "--rate", "10", "--topics", COMMAND)
    try:
        _, errors = process.communicate(timeout=LIMIT_S)
    finally:
        process.kill()
    assert process.returncode == 0
    assert errors == (
        "train-ato: /ato/command: also published on this domain by listener, readers receive both; give --domain, "
        "--remap or --exclude-topics\n"
    )


def test_a_domain_of_the_environment_that_is_none(run, capfd, monkeypatch):  # noqa: F811
    monkeypatch.setenv("ROS_DOMAIN_ID", "abc")
    assert main(["replay", str(run)]) == 2
    assert "ROS_DOMAIN_ID abc" in capfd.readouterr().err


def test_messages_that_are_not_installed_or_not_of_ros(tmp_path, capfd):
    from mcap.writer import Writer

    for kind, encoding, says in (
        ("no_such_msgs/msg/Thing", "cdr", "are not installed"),
        ("Thing", "json", "are not ROS 2 messages"),
    ):
        path = tmp_path / f"{encoding}.mcap"
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start()
            channel = writer.register_channel("/thing", encoding, writer.register_schema(kind, "ros2msg", b""))
            writer.add_message(channel, 1, b"{}", 1)
            writer.finish()
        assert main(["replay", str(path), "--domain", "99"]) == 2
        captured = capfd.readouterr()
        assert says in captured.err
        assert captured.err.count("\n") == 1


def test_the_counts_are_those_of_the_log(run, domain, capfd):  # noqa: F811
    assert main(["replay", str(run), "--domain", str(domain), "--rate", "max"]) == 0
    rows = [line.split() for line in capfd.readouterr().out.splitlines()]
    assert {row[0]: int(row[1]) for row in rows if row[-1].isdigit()} == message_counts(run)


def test_the_name_of_one_topic_is_no_list_of_characters(run):  # noqa: F811
    with pytest.raises(ValueError, match=r"--topics ato/comand: not in the log; did you mean '/ato/command'"):
        replay(run, topics="ato/comand")


types = pytest.importorskip("rosbag2_interfaces.srv", reason="rosbag2_interfaces is not installed")


@pytest.fixture
def listener(listen):  # noqa: F811
    """Give a listener to the commands that uses the services of rosbag2."""
    found = listen({COMMAND: COMMAND})
    found.ask = lambda kind, service, **fields: found.answer(kind, f"/{NODE}/{service}", kind.Request(**fields))
    return found


def test_every_order_of_rosbag2(run, listener, domain):  # noqa: F811
    """Same names, types and answers; times are absolute times of the log, durations are relative."""
    from builtin_interfaces.msg import Time

    ask, expected = listener.ask, recorded(run, COMMAND)
    epoch = EPOCH_NS // 10**9
    with Replaying(run, paused(topics=(COMMAND,)), domain, listener) as replaying:
        assert ask(types.IsPaused, "is_paused").paused
        assert ask(types.GetRate, "get_rate").rate == 1.0
        assert not ask(types.SetRate, "set_rate", rate=0.0).success
        assert ask(types.SetRate, "set_rate", rate=50.0).success
        assert ask(types.GetRate, "get_rate").rate == 50.0
        assert ask(types.PlayNext, "play_next").success
        assert ask(types.Burst, "burst", num_messages=3).actually_burst == 3
        assert listener.hear(COMMAND, 4) == expected[:4]
        assert not ask(types.Seek, "seek", time=Time(sec=epoch + SECONDS + 1)).success
        assert ask(types.Seek, "seek", time=Time(sec=epoch + 10)).success
        assert ask(types.PlayNext, "play_next").success
        assert stamp_of(listener.hear(COMMAND, 5)[-1]) == 10 * 10**9
        assert not ask(types.Play, "play").success, "messages are left"
        assert ask(types.Burst, "burst", num_messages=0).actually_burst == TICKS - 101
        ask(types.TogglePaused, "toggle_paused")
        replaying.wait()
        assert replaying.outcome.end == "end"


def test_pause_resume_play_and_stop(run, listener, domain):  # noqa: F811
    from builtin_interfaces.msg import Duration, Time

    ask, expected = listener.ask, recorded(run, COMMAND)
    with Replaying(run, paused(topics=(COMMAND,)), domain, listener) as replaying:
        ask(types.Resume, "resume")
        assert not ask(types.IsPaused, "is_paused").paused
        assert ask(types.Burst, "burst", num_messages=5).actually_burst == 0, "no burst without a pause"
        ask(types.Pause, "pause")
        assert ask(types.IsPaused, "is_paused").paused
        ask(types.Burst, "burst", num_messages=0)
        assert listener.hear(COMMAND, TICKS) == expected
        play = {"start_offset": Time(sec=14), "playback_duration": Duration(nanosec=300_000_000)}
        assert ask(types.Play, "play", **play).success
        assert listener.hear(COMMAND, TICKS + 4) == expected + expected[140:144]
        replaying.wait()
    with Replaying(run, paused(topics=(COMMAND,)), domain, listener) as replaying:
        ask(types.Stop, "stop")
        replaying.wait()
        assert replaying.outcome.end == "stopped"
