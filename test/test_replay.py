"""Replay of a recorded run: messages received by a real node, and service calls."""

import math
import socket
import sys
import time
from pathlib import Path

import pytest
from recordings import message_counts
from replay_listener import Listener, Replaying
from waiting import LIMIT_S

from train_ato.cli.main import main
from train_ato.log.reading import iter_raw
from train_ato.messages.codec import stamp_of
from train_ato.playback.log import ReplayOptions
from train_ato.playback.publishing import REPLAY_PROFILE, refuse_topics_of_runs

SECONDS = 15
TICKS = SECONDS * 10
COMMAND, PROFILE, CARS = "ato/command", "ato/profile", "train/vehicles"


@pytest.fixture(scope="module")
def run(demo_run) -> Path:
    return demo_run(f"duration={SECONDS}")


@pytest.fixture
def domain(tmp_path):
    pytest.importorskip("rclpy")
    from train_ato.ros.graph.domain_lock import TRAINS
    from train_ato.ros.graph.environment import applied, claim_domain, middleware, variables

    with claim_domain(namespace=TRAINS) as held:  # no run, whose topics are refused
        names = {**variables(held, tmp_path), **middleware(REPLAY_PROFILE)}
        with applied(names):
            yield held


@pytest.fixture
def listen(domain):
    from train_ato.ros.graph.assembly import executor_of

    with executor_of(domain, []) as (context, executor):
        yield lambda topics: Listener(context, executor, topics)


@pytest.fixture(autouse=True)
def without_rosbag2(monkeypatch):
    """With rosbag2_interfaces the services have its types; see test_replay_command.py."""
    monkeypatch.setitem(sys.modules, "rosbag2_interfaces.srv", None)


def recorded(run, name):
    return [data for _, _, data in iter_raw(run, (name,))]


def paused(**more):
    return ReplayOptions(start_paused=True, **more)


def test_a_listener_that_waits_already_hears_every_message_as_it_was_recorded(run, listen, domain):
    """Bytes, order and number of every topic at full speed; fails if sending starts before the reader is matched."""
    listener = listen({name: name for name in (CARS, COMMAND, PROFILE, "ato/limits", "/clock", "/diagnostics")})
    with Replaying(run, ReplayOptions(rate=math.inf), domain, listener) as replaying:
        replaying.wait()
        assert replaying.outcome.counts == message_counts(run)
        assert (replaying.outcome.end, replaying.outcome.acknowledged) == ("end", True)
        for name, heard in listener.heard.items():
            expected = recorded(run, name)
            listener.hear(name, len(expected))
            assert heard == expected


def test_a_participant_that_is_not_discovered_yet_is_awaited(run, listen, domain):
    """Fails if a reader that a loaded machine discovers late loses the first messages: its socket is there before."""
    from train_ato.playback.log import ReplayLog, chosen_topics
    from train_ato.playback.publishing import Player
    from train_ato.ros.graph.assembly import executor_of

    listen({COMMAND: COMMAND})
    with (
        ReplayLog(run) as log,
        executor_of(domain, []) as (context, executor),
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as late,
    ):
        player = Player(executor, context, chosen_topics(log.topics, ReplayOptions(topics=(COMMAND,))), None)
        assert player.wait_for_readers(LIMIT_S, lambda: False)
        late.bind(("127.0.0.1", 7400 + 250 * domain + 10 + 2 * 60))
        assert not player.wait_for_readers(0.1, lambda: False)
        late.close()
        assert player.wait_for_readers(LIMIT_S, lambda: False)


def test_latched_topics_come_to_a_late_joiner(run, listen, domain):
    listener = listen({COMMAND: COMMAND})
    with Replaying(run, paused(), domain, listener):
        listener.set("burst", 500)
        listener.call("burst")
        listener.listen(PROFILE, PROFILE)
        assert listener.hear(PROFILE, 1) == recorded(run, PROFILE)
        listener.call("stop")


def test_offset_duration_choice_and_other_name(run, listen, domain):
    """Latched topics from before the offset are sent, other topics only for the selected time."""
    listener = listen({"shadow/command": COMMAND, PROFILE: PROFILE})
    options = ReplayOptions(
        rate=math.inf,
        start_offset=10.0,
        duration=2.0,
        topics=(COMMAND, "/ato/profile", CARS),
        exclude=(CARS,),
        remap={COMMAND: "shadow/command"},
    )
    with Replaying(run, options, domain, listener) as replaying:
        replaying.wait()
        assert replaying.outcome.counts == {"/ato/profile": 1, "/ato/command": 21}
        assert listener.hear("shadow/command", 21) == recorded(run, COMMAND)[100:121]
        assert listener.hear(PROFILE, 1) == recorded(run, PROFILE)


def test_no_message_comes_before_its_time(run, listen, domain):
    """At a rate of 20, 15 s take at least 0.75 s; other load only adds time."""
    listener = listen({COMMAND: COMMAND})
    with Replaying(run, paused(rate=20.0, topics=(COMMAND,)), domain, listener):
        listener.call("is_paused")
        assert listener.heard[COMMAND] == []
        begin = time.monotonic()
        listener.call("resume")
        stamps = [stamp_of(data) * 1e-9 for data in listener.hear(COMMAND, TICKS)]
    assert all(at - begin >= stamp / 20.0 for at, stamp in zip(listener.came_at[COMMAND], stamps, strict=True))


def test_start_paused_play_next_and_burst(run, listen, domain):
    """In a pause only the requested messages are sent, one by one; the rest follows after ``resume``."""
    listener = listen({COMMAND: COMMAND, PROFILE: PROFILE})
    expected = recorded(run, COMMAND)
    options = paused(rate=math.inf, topics=(COMMAND, PROFILE))
    with Replaying(run, options, domain, listener):
        assert listener.call("is_paused").success
        assert listener.hear(PROFILE, 1) == recorded(run, PROFILE)
        assert listener.heard[COMMAND] == []
        for count in (1, 2):
            assert listener.call("play_next").success
            listener.hear(COMMAND, count)
            listener.stay()
            assert listener.heard[COMMAND] == expected[:count]
        assert listener.set("burst", 40) is None
        assert listener.call("burst").message.startswith("40 messages sent; paused at 4.1")
        listener.hear(COMMAND, 42)
        listener.stay()
        assert listener.heard[COMMAND] == expected[:42]
        assert listener.set("burst", -1) == "burst -1: give 0 or more"
        assert listener.call("resume").success
        assert listener.hear(COMMAND, TICKS) == expected


def test_the_whole_run_in_one_burst_then_again(run, listen, domain):
    """A paused replay stays at its end; seek and play start it again."""
    listener = listen({COMMAND: COMMAND})
    expected = recorded(run, COMMAND)
    with Replaying(run, paused(topics=(COMMAND,)), domain, listener):
        assert not listener.call("play").success, "messages are left"
        listener.set("burst", 0)
        assert listener.call("burst").message.startswith(f"{TICKS} messages sent")
        answer = listener.call("play_next")
        assert not answer.success and "end of the run" in answer.message
        listener.set("seek", 14.8)
        assert listener.call("seek").success
        listener.call("burst")
        assert listener.hear(COMMAND, TICKS + 2) == expected + expected[148:]
        assert listener.set("start_offset", 14) is None, "an integer for a double"
        assert listener.set("playback_duration", 0.5) is None
        assert listener.call("play").success
        assert listener.hear(COMMAND, TICKS + 2 + 6) == expected + expected[148:] + expected[140:146]


def test_pause_holds_at_once_and_resume_goes_on_where_it_was(run, listen, domain):
    """No message beyond the time in the answer is sent; none is lost or repeated."""
    listener = listen({COMMAND: COMMAND})
    expected = recorded(run, COMMAND)
    with Replaying(run, ReplayOptions(rate=0.5, topics=(COMMAND,)), domain, listener):
        listener.hear(COMMAND, 5)
        answer = listener.call("pause")
        assert listener.call("is_paused").success
        moment = float(answer.message.split()[2])
        listener.stay(0.5)
        heard = len(listener.heard[COMMAND])
        assert stamp_of(listener.heard[COMMAND][-1]) * 1e-9 <= moment + 1e-3
        assert heard < TICKS, "the run was over before the pause"
        assert listener.call("play_next").success
        assert listener.hear(COMMAND, heard + 1) == expected[: heard + 1]
        assert listener.set("rate", math.inf) is None
        assert listener.call("toggle_paused").message.startswith("plays")
        assert listener.hear(COMMAND, TICKS) == expected


def test_orders_are_heard_at_full_speed(run, listen, domain):
    """Fails if a replay at full speed ignores service calls, or sends single messages without a pause."""
    listener = listen({COMMAND: COMMAND})
    options = ReplayOptions(rate=math.inf, loop=True, topics=(COMMAND,))
    expected = recorded(run, COMMAND)
    with Replaying(run, options, domain, listener) as replaying:
        listener.hear(COMMAND, 3 * TICKS)
        assert listener.call("get_rate").message == "inf"
        refused = listener.call("play_next")
        assert (refused.success, refused.message) == (False, "play_next and burst work in a pause; call pause first")
        assert listener.call("pause").success
        listener.stay(0.5)
        heard = list(listener.heard[COMMAND])
        assert heard[: 3 * TICKS] == 3 * expected, "the loop begins again at the beginning"
        listener.stay(0.5)
        assert listener.heard[COMMAND] == heard
        listener.call("stop")
        replaying.wait()
        assert replaying.outcome.end == "stopped"


def test_the_rate_is_a_parameter(run, listen, domain):
    """At a rate of 1e-6 a tick would take years: all further messages are due to the new rate."""
    listener = listen({COMMAND: COMMAND})
    with Replaying(run, ReplayOptions(rate=1e-6, topics=(COMMAND,)), domain, listener):
        listener.hear(COMMAND, 1)
        listener.stay()
        assert len(listener.heard[COMMAND]) == 1
        for wrong in (0.0, -1.0, float("nan")):
            assert "give a number above 0" in listener.set("rate", wrong)
        assert listener.call("get_rate").message == "1e-06"
        assert listener.set("rate", 200.0) is None
        assert listener.call("set_rate").message.startswith("rate 200")
        assert listener.call("get_rate").message == "200"
        assert listener.hear(COMMAND, TICKS) == recorded(run, COMMAND)


def test_seek_forth_and_back_sends_what_is_latched_again(run, listen, domain):
    listener = listen({COMMAND: COMMAND, PROFILE: PROFILE})
    commands, profiles = recorded(run, COMMAND), recorded(run, PROFILE)
    with Replaying(run, paused(topics=(COMMAND, PROFILE)), domain, listener):
        for number, place in enumerate((12.0, 3.05, 0.0), start=2):
            assert listener.set("seek", place) is None
            assert listener.call("seek").message == f"paused at {place:.3f} of 15.000 s"
            assert listener.hear(PROFILE, number) == number * profiles
            assert listener.call("play_next").success
        assert listener.hear(COMMAND, 3) == [commands[120], commands[31], commands[0]]
        listener.set("seek", 99.0)
        refused = listener.call("seek")
        assert (refused.success, refused.message) == (False, "seek 99: the run has 15 s; give 0 to 15")
        listener.call("play_next")
        assert listener.hear(COMMAND, 4)[-1] == commands[1], "a refused order changes nothing"
        listener.call("stop")


def test_a_clock_of_its_own_rate(run, listen, domain):
    """The generated clock follows the replay, its pauses and seeks; the recorded clock is not sent."""
    listener = listen({"/clock": "/clock"})
    with Replaying(run, paused(rate=10.0, clock_hz=50.0, topics=(COMMAND, "/clock")), domain, listener) as replaying:
        stamps = lambda: [stamp_of(data) for data in listener.heard["/clock"]]  # noqa: E731
        listener.hear("/clock", 5)
        assert set(stamps()) == {0}
        listener.set("seek", 7.5)
        listener.call("seek")
        listener.until(lambda: stamps()[-1] == 7_500_000_000, "the clock at 7.5 s")
        listener.call("resume")
        replaying.wait()
    after = [stamp for stamp in stamps() if stamp >= 7_500_000_000]
    assert after == sorted(after)
    assert after[-1] <= 15_000_000_000
    assert replaying.outcome.counts == {"/ato/command": 75}


def test_the_domain_without_an_option_is_named_so(monkeypatch):
    """Breaks if the remedy is a variable that is not set."""
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    monkeypatch.setattr("train_ato.ros.graph.domain_lock.locked_runs", lambda: [(0, "")])
    with pytest.raises(ValueError, match=r"^ROS domain 0: a run in progress publishes /clock there"):
        refuse_topics_of_runs(None, ["/clock"])


@pytest.mark.parametrize("space", ["", "/t1"])
def test_no_topic_of_a_run_in_progress_is_published(space, run, capfd, monkeypatch):
    """Breaks if a replay into the domain of a run ends it by a second publisher."""
    pytest.importorskip("rclpy")
    from train_ato.ros.graph.environment import claim_domain

    with claim_domain(namespace=space) as held:
        words = ["replay", str(run), "--rate", "max", "--topics", COMMAND, "--remap"]
        assert main([*words, f"{COMMAND}:={space}/ato/command", "--domain", str(held)]) == 2
        monkeypatch.setenv("ROS_DOMAIN_ID", str(held))
        assert main([*words, f"{COMMAND}:={space}/clock"]) == 2
        refused = capfd.readouterr().err.splitlines()
        assert [line.split("; give")[0] for line in refused] == [
            f"train-ato: --domain {held}: a run in progress publishes {space}/ato/command there, and would end",
            f"train-ato: ROS_DOMAIN_ID {held}: a run in progress publishes {space}/clock there, and would end",
        ]
        assert main([*words, f"{COMMAND}:=elsewhere", "--clock"]) == (0 if space else 2)  # the clock of no namespace
        assert main([*words, f"{COMMAND}:=elsewhere"]) == 0
        diagnostics = ["/diagnostics" if word == COMMAND else word for word in words]  # of several nodes
        assert main([*diagnostics, "/diagnostics:=/diagnostics"]) == 0
