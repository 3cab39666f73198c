"""A recorded run published again, and a law on recorded inputs."""

from __future__ import annotations

import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from train_ato.engine import run_engine
from train_ato.open_loop import replay_open_loop
from train_ato.record.reading import iter_raw, message_counts, stream
from train_ato.replay import ReplayOptions, chosen_topics, parse_remap, replay
from train_ato.run_folder import RunFolder
from train_ato.run_setup import prepare
from train_ato.scenario import load
from train_ato.wire import stamp_of

SECONDS = 15


@pytest.fixture(scope="module")
def setup():
    return prepare(*load("demo", (f"duration={SECONDS}",)))


@pytest.fixture(scope="module")
def run(setup, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = RunFolder.make(tmp_path_factory.mktemp("replay") / "run", "replay")
    with folder.sink(setup) as sink:
        assert run_engine(setup, sink=sink).failure is None
    return folder.path


@pytest.fixture
def domain():
    pytest.importorskip("rclpy")
    from train_ato.graph.environment import claim_domain

    with claim_domain() as held:
        yield held


class Listener:
    """A node on an executor of its own that keeps the bytes of some topics; it turns while the replay asks for it."""

    def __init__(self, context, executor, names):
        from rclpy.node import Node

        from train_ato.nodes.shell import message_class, quality_of_service
        from train_ato.topics import BY_NAME

        self.executor = executor
        self.node = Node("listener", context=context, enable_rosout=False)
        self.heard = {name: [] for name in names}
        self.subscriptions = []
        for name, source in names.items():
            topic = BY_NAME[source]
            self.subscriptions.append(
                self.node.create_subscription(
                    message_class(topic.type), name, self.heard[name].append, quality_of_service(topic), raw=True
                )
            )
        executor.add_node(self.node)

    def matched(self, node):
        """Tell whether both sides have met: a writer that does not know its reader yet sends into the void."""
        self.turn()
        names = {subscription.topic_name for subscription in self.subscriptions}
        writers = [publisher for publisher in node.publishers if publisher.topic_name in names]
        return all(subscription.get_publisher_count() == 1 for subscription in self.subscriptions) and all(
            publisher.get_subscription_count() == 1 for publisher in writers
        )

    def turn(self, turns=1):
        for _ in range(turns):
            self.executor.spin_once(timeout_sec=0.005)

    def drain(self, name, count):
        last = time.monotonic() + 5
        while len(self.heard[name]) < count and time.monotonic() < last:
            self.turn()


def recorded(run, name):
    return [data for topic, _, data in iter_raw(run, (name,))]


@pytest.fixture
def listen(domain):
    from train_ato.graph.assembly import executor_of

    with executor_of(domain) as (context, executor):
        yield lambda **names: Listener(context, executor, {k.replace("__", "/"): v for k, v in names.items()})


def test_every_message_is_sent_as_it_was_recorded(run, listen, domain):
    """Bytes, order and number of every topic; latched ones reach a reader as well."""
    names = {"train__cars": "train/cars", "ato__command": "ato/command", "ato__profile": "ato/profile"}
    listener = listen(**names)
    counts = replay(run, ReplayOptions(rate=100.0), domain=domain, ready=listener.matched)
    assert counts == message_counts(run)
    for name in ("train/cars", "ato/command", "ato/profile"):
        listener.drain(name, counts[f"/{name}"])
        assert listener.heard[name] == recorded(run, name)


def test_offset_choice_and_other_name(run, listen, domain):
    listener = listen(shadow__command="ato/command", ato__profile="ato/profile")
    options = ReplayOptions(
        rate=50.0, start_offset=10.0, topics=("ato/command", "/ato/profile"), remap={"ato/command": "shadow/command"}
    )
    counts = replay(run, options, domain=domain, ready=listener.matched)
    assert counts == {"/ato/profile": 1, "/ato/command": (SECONDS - 10) * 10}
    listener.drain("shadow/command", 50)
    assert listener.heard["shadow/command"] == recorded(run, "ato/command")[100:]
    listener.drain("ato/profile", 1)
    assert listener.heard["ato/profile"] == recorded(run, "ato/profile")


def test_the_rate_sets_the_pace(run, domain):
    """Told at the wall times it was sent: twice the rate, half the time; the bound allows for a busy machine."""
    told = []
    begin = time.monotonic()
    options = ReplayOptions(rate=20.0, topics=("train/cars",))
    replay(run, options, domain=domain, progress=lambda s: told.append((s, time.monotonic() - begin)))
    assert len(told) >= 4
    assert all(simulated <= 20.0 * wall for simulated, wall in told)


def test_a_clock_of_its_own_rate(run, listen, domain):
    listener = listen(clock="/clock")
    counts = replay(
        run, ReplayOptions(rate=15.0, clock_hz=50.0, topics=("ato/command",)), domain=domain, ready=listener.matched
    )
    assert counts == {"/ato/command": SECONDS * 10}
    listener.drain("clock", 20)
    stamps = [stamp_of(data) for data in listener.heard["clock"]]
    assert len(stamps) >= 20
    assert all(b > a for a, b in pairwise(stamps))


def test_start_paused_loop_and_stop(run, listen, domain):
    """Nothing moves before the service is called; the loop begins again."""
    from std_srvs.srv import Trigger

    listener = listen(ato__command="ato/command")
    client = listener.node.create_client(Trigger, "replay/start")
    state = {"called": False, "before": None}

    class Enough(Exception):
        pass

    def turned(simulated):
        if sum(len(heard) for heard in listener.heard.values()) > SECONDS * 10 + 20:
            raise Enough
        listener.turn(20)

    def matched(node):
        if listener.matched(node) and client.service_is_ready() and not state["called"]:
            state["before"] = len(listener.heard["ato/command"])
            client.call_async(Trigger.Request())
            state["called"] = True
        return state["called"]

    with pytest.raises(Enough):
        replay(
            run,
            ReplayOptions(rate=100.0, loop=True, start_paused=True, topics=("ato/command",)),
            domain=domain,
            ready=matched,
            progress=turned,
        )
    assert state["before"] == 0
    heard, once = listener.heard["ato/command"], recorded(run, "ato/command")
    assert heard[: len(once) + 5] == (once + once)[: len(once) + 5]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (ReplayOptions(rate=0.0), "--rate 0.0"),
        (ReplayOptions(rate=float("nan")), "--rate nan"),
        (ReplayOptions(start_offset=-1.0), "--start-offset -1.0"),
        (ReplayOptions(clock_hz=0.0), "--clock 0.0"),
        (ReplayOptions(topics=("ato/comand",)), "did you mean '/ato/command'"),
        (ReplayOptions(remap={"cars": "x"}), "--remap cars: not in the log"),
    ],
)
def test_bad_options_are_one_line(run, options, says):
    with pytest.raises(ValueError, match=says.replace("?", "\\?")):
        options.check()
        chosen_topics(run, options)


def test_remaps_are_read():
    assert parse_remap(("a:=b", "/c/d:=e")) == {"a": "b", "/c/d": "e"}
    for wrong in ("a=b", ":=b", "a:="):
        with pytest.raises(ValueError, match="from:=to"):
            parse_remap((wrong,))


def test_quality_of_service_is_that_of_the_log(run):
    topics = chosen_topics(run, ReplayOptions())
    assert {name for name, topic in topics.items() if topic.latched} == {"/ato/profile", "/ato/limits"}
    assert len(topics) == len({message.channel.topic for message in stream(run / "run.mcap")})


def test_the_recorded_law_gives_the_recorded_commands_bit_by_bit(setup, run):
    """Fails when the controller knows anything but its inputs: a clock, a global, the plant."""
    result = replay_open_loop(setup, run)
    assert result.stamp.tolist() == [k * setup.tick_ns for k in range(setup.ticks)]
    assert np.array_equal(result.recorded, result.replayed)
    assert result.summary()["equal_ticks"] == setup.ticks


def test_another_gain_is_seen(run):
    changed = prepare(*load("demo", (f"duration={SECONDS}", "controllers.pid={kp: 3.0e+5}")))
    summary = replay_open_loop(changed, run).summary()
    assert summary["difference_max_kn"] > 0.01
    assert 0 < summary["difference_rms_kn"] <= summary["difference_max_kn"]
    assert 0 <= summary["difference_max_at_s"] < SECONDS
