"""How much of the disk a log takes."""

from __future__ import annotations

from pathlib import Path

import pytest

from train_ato.engine import run_engine
from train_ato.record.reading import stream
from train_ato.record.run_log import CHUNK, CLOSE_AFTER_S, LogFile
from train_ato.run_folder import RunFolder
from train_ato.run_setup import prepare
from train_ato.scenario import load
from train_ato.topics import EPOCH_NS

BEGIN_S, END_S = 300, 400
MEGABYTES_AN_HOUR = 100


@pytest.fixture(scope="module")
def messages(tmp_path_factory: pytest.TempPathFactory):
    """Return the messages of 106 vehicles in motion, with the truth of the disturbances."""
    setup = prepare(*load("daqin_heavy_haul:disturbed", (f"duration={END_S}",)))
    folder = RunFolder.make(tmp_path_factory.mktemp("size") / "run", "size")
    with folder.sink(setup) as sink:
        assert run_engine(setup, sink=sink).failure is None
    return [m for m in stream(folder.path / "run.mcap") if m.publish_ns - EPOCH_NS >= BEGIN_S * 10**9]


@pytest.mark.slow
@pytest.mark.parametrize("paced", [False, True])
def test_an_hour_of_the_long_train_stays_under_100_mb(paced: bool, messages, tmp_path: Path) -> None:
    """Breaks if a topic grows, or packing gets worse; a paced run closes a chunk for its age, every eight ticks."""
    assert "/train/disturbance" in {m.channel.topic for m in messages}
    a_tick = sum(len(m.data) + 31 for m in messages) / (10 * (END_S - BEGIN_S))
    log = LogFile(tmp_path, chunk_size=round(10 * CLOSE_AFTER_S * a_tick) if paced else CHUNK)
    numbers: dict[str, int] = {}
    for m in messages:
        if m.channel.topic not in numbers:
            numbers[m.channel.topic] = log.copy(m.channel, m.schema)
        log.write(numbers[m.channel.topic], m.publish_ns, m.log_ns, m.data)
    log.close()
    assert log.path.stat().st_size * 3600 / (END_S - BEGIN_S) < MEGABYTES_AN_HOUR * 1e6
