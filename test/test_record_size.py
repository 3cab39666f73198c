"""Size of a log on the disk with every compression."""

from __future__ import annotations

from pathlib import Path

import pytest

from train_ato.log.chunk_thread import CLOSE_AFTER_S
from train_ato.log.compression import COMPRESSIONS
from train_ato.log.reading import stream
from train_ato.log.run_folder import RunFolder
from train_ato.log.run_log import CHUNK, LogFile
from train_ato.loop.engine import run_engine
from train_ato.loop.setup import prepare
from train_ato.messages.topic import SUPERVISED
from train_ato.messages.topics import EPOCH_NS, TOPICS
from train_ato.scenario.scenario import load_scenario

BEGIN_S, END_S = 300, 400
# 340 MB with names car_i; vehicle_i adds 424 bytes to each message of three topics, 36 000 times an hour.
MEGABYTES_AN_HOUR = {"none": 340 + 3 * 424 * 36_000 / 1e6, "fast": 110, "small": 100}
"""Largest sizes without the topics of the supervision and the pressure at the tail."""
SUPERVISION = {f"/{topic.name}" for topic in TOPICS if topic.condition is SUPERVISED}
TAIL = "/train/brake_pipe_tail"
LARGEST_PRESSURE = 100
"""Largest message of the pressure at the tail with its record [bytes]: stamp, frame, two numbers."""
LARGEST_MESSAGE = 400
"""Largest message of the supervision with its record [bytes]: at most 10 names of 25 characters and 15 numbers."""


@pytest.fixture(scope="module")
def messages(tmp_path_factory: pytest.TempPathFactory):
    """Return the messages of 106 vehicles in motion, with the truth of the disturbances and the supervision."""
    setup = prepare(*load_scenario("daqin_heavy_haul:disturbed", (f"duration={END_S}",)))
    folder = RunFolder.make(tmp_path_factory.mktemp("size") / "run", "size")
    with folder.sink(setup) as sink:
        assert run_engine(setup, sink=sink).failure is None
    return [m for m in stream(folder.path / "run.mcap") if m.publish_ns - EPOCH_NS >= BEGIN_S * 10**9]


@pytest.mark.campaign
def test_the_supervision_has_five_small_messages_a_period(messages) -> None:
    """Breaks if a topic of the supervision grows, or is recorded at every tick."""
    found = [m for m in messages if m.channel.topic in SUPERVISION]
    assert {m.channel.topic for m in found} == SUPERVISION
    assert len(found) == pytest.approx(len(SUPERVISION) * (END_S - BEGIN_S) / 0.4, abs=len(SUPERVISION))
    assert max(len(m.data) + 31 for m in found) < LARGEST_MESSAGE


@pytest.mark.campaign
def test_the_pressure_at_the_tail_is_one_small_message_a_tick(messages) -> None:
    """Breaks if the message grows, or is recorded more often."""
    found = [m for m in messages if m.channel.topic == TAIL]
    assert len(found) == pytest.approx(10 * (END_S - BEGIN_S), abs=1)
    assert max(len(m.data) + 31 for m in found) < LARGEST_PRESSURE


@pytest.mark.campaign
@pytest.mark.parametrize("paced", [False, True])
def test_an_hour_of_the_long_train_keeps_its_size(paced: bool, messages, tmp_path: Path) -> None:
    """Breaks if a topic grows or the packing degrades; a paced run closes a chunk by its age, every eight ticks."""
    messages = [m for m in messages if m.channel.topic not in SUPERVISION | {TAIL}]
    assert "/train/disturbance" in {m.channel.topic for m in messages}
    a_tick = sum(len(m.data) + 31 for m in messages) / (10 * (END_S - BEGIN_S))
    sizes = {}
    for compression in COMPRESSIONS:
        (tmp_path / compression).mkdir()
        chunk_size = round(10 * CLOSE_AFTER_S * a_tick) if paced else CHUNK
        log = LogFile(tmp_path / compression, chunk_size=chunk_size, compression=compression)
        numbers: dict[str, int] = {}
        for m in messages:
            if m.channel.topic not in numbers:
                numbers[m.channel.topic] = log.copy(m.channel, m.schema)
            log.write(numbers[m.channel.topic], m.publish_ns, m.log_ns, m.data)
        log.close()
        sizes[compression] = log.path.stat().st_size / 1e6 * 3600 / (END_S - BEGIN_S)
    print({name: round(size) for name, size in sizes.items()})
    assert sizes["small"] < 0.95 * sizes["fast"] < 0.4 * sizes["none"]
    assert all(sizes[name] < MEGABYTES_AN_HOUR[name] for name in COMPRESSIONS), sizes
