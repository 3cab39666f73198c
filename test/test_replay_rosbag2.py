"""Service calls with the types of rosbag2, as from its scripts; requires rosbag2_interfaces."""

from __future__ import annotations

import pytest
from replay_listener import Replaying
from test_replay import COMMAND, SECONDS, TICKS, domain, listen, paused, recorded, run  # noqa: F401

from train_ato.apps.replay.player import NODE
from train_ato.messages.codec.codec import stamp_of
from train_ato.messages.topics import EPOCH_NS

types = pytest.importorskip("rosbag2_interfaces.srv", reason="rosbag2_interfaces is not installed")


def test_every_order_of_rosbag2(run, listen, domain):  # noqa: F811
    """Same names, types and answers; times are absolute times of the log, durations are relative."""
    listener = listen({COMMAND: COMMAND})
    expected = recorded(run, COMMAND)

    def ask(kind, service, **fields):
        return listener.answer(kind, f"/{NODE}/{service}", kind.Request(**fields))

    def moment(seconds):
        from builtin_interfaces.msg import Time

        whole, rest = divmod(EPOCH_NS + round(seconds * 1e9), 10**9)
        return Time(sec=whole, nanosec=rest)

    with Replaying(run, paused(topics=(COMMAND,)), domain, listener) as replaying:
        assert ask(types.IsPaused, "is_paused").paused
        assert ask(types.GetRate, "get_rate").rate == 1.0
        assert not ask(types.SetRate, "set_rate", rate=0.0).success
        assert ask(types.SetRate, "set_rate", rate=50.0).success
        assert ask(types.GetRate, "get_rate").rate == 50.0
        assert ask(types.PlayNext, "play_next").success
        assert ask(types.Burst, "burst", num_messages=3).actually_burst == 3
        assert listener.hear(COMMAND, 4) == expected[:4]
        assert not ask(types.Seek, "seek", time=moment(SECONDS + 1)).success
        assert ask(types.Seek, "seek", time=moment(10.0)).success
        assert ask(types.PlayNext, "play_next").success
        assert stamp_of(listener.hear(COMMAND, 5)[-1]) == 10 * 10**9
        assert not ask(types.Play, "play").success, "messages are left"
        assert ask(types.Burst, "burst", num_messages=0).actually_burst == TICKS - 101
        ask(types.TogglePaused, "toggle_paused")
        replaying.wait()
        assert replaying.outcome.end == "end"


def test_pause_resume_play_and_stop(run, listen, domain):  # noqa: F811
    from builtin_interfaces.msg import Duration, Time

    listener = listen({COMMAND: COMMAND})
    expected = recorded(run, COMMAND)
    with Replaying(run, paused(topics=(COMMAND,)), domain, listener) as replaying:

        def ask(kind, service, **fields):
            return listener.answer(kind, f"/{NODE}/{service}", kind.Request(**fields))

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
