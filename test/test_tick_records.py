"""The log of compiled ticks, encoded at once, has the records of single messages."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.records import Chunk, MessageIndex
from mcap.stream_reader import StreamReader
from span_runs import setup_of

from train_ato.log.log_writer import RunLog
from train_ato.log.mcap_writer import MESSAGE, MESSAGE_TYPE
from train_ato.log.run_folder import Encoder
from train_ato.loop.engine import run_engine
from train_ato.messages.codec import Wire
from train_ato.messages.topics import topics_of

pytestmark = pytest.mark.usefixtures("without_figure")

HEAVY: tuple[str, dict[str, Any]] = ("daqin_heavy_haul", {"duration": 90})
GUST = [{"kind": "gust", "begin": 10.0, "end": 30.0, "acceleration": 0.05}]


def records_of(folder: Path, name: str, changes: dict[str, Any], *, compiled: bool) -> list[tuple[Any, ...]]:
    """Return topic, times and bytes of all messages in the log of a run in their order in the file."""
    folder.mkdir()
    setup = setup_of(name, changes)
    with RunLog(folder, topics_of(setup.layout)) as log:
        result = run_engine(setup, sink=Encoder(log, Wire(setup.layout)), compiled=compiled)
        assert result.failure is None
        assert log.counts == {topic: result.published.get(topic, 0) for topic in log.numbers}
    with (folder / "run.mcap").open("rb") as stream:
        found = make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False)
        return [
            (channel.topic, message.log_time, message.publish_time, message.sequence, message.data)
            for _, channel, message in found
        ]


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        HEAVY, ("xuzhou_metro", {"duration": 60, "law": "pid"}),
        ("crh380a_gpc", {"law": "pid", "compensation": "preview", "duration": 90, "plant.disturbances": GUST}),
    ],
    ids=["supervisor, air brake, couplers", "without supervisor and brake", "disturbances, several units"],
)  # fmt: skip
def test_the_log_of_compiled_ticks_is_that_of_single_messages(name, changes, tmp_path: Path) -> None:
    """Breaks if a block has a message at another place, with another time or other bytes, or loses one."""
    logs = [records_of(tmp_path / str(compiled), name, changes, compiled=compiled) for compiled in (False, True)]
    assert next((pair for pair in zip(*logs, strict=False) if pair[0] != pair[1]), None) is None
    assert len(logs[0]) == len(logs[1])


def test_the_index_finds_every_message_of_a_block(tmp_path: Path) -> None:
    """Breaks if the index of a chunk has a wrong place or time, or lacks a message."""
    records = records_of(tmp_path / "run", *HEAVY, compiled=True)
    data, found = b"", 0
    with (tmp_path / "run" / "run.mcap").open("rb") as stream:
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, Chunk):
                data = zstandard.ZstdDecompressor().decompress(record.data, record.uncompressed_size)
            elif isinstance(record, MessageIndex):
                for time, place in record.records:
                    kind, _, channel, _, log_time, _ = MESSAGE.unpack_from(data, place)
                    assert (kind, channel, log_time) == (MESSAGE_TYPE, record.channel_id, time)
                    found += 1
    assert found == len(records)


def test_a_block_with_an_impossible_value_is_refused() -> None:
    """Breaks if a value that is not finite, or a wrong number of values, reaches the log in a block."""
    record = Wire(setup_of("xuzhou_metro", {}).layout).records["ato/command"]
    rows, stamps = np.zeros(3, record.dtype), np.arange(3) * 50_000_000
    force = np.array([[1.0], [np.inf], [2.0]])
    with pytest.raises(ValueError, match="ato/command: effort is not finite: inf"):
        record.fill(rows, stamps, {"force": force})
    with pytest.raises(ValueError, match="ato/command: effort has 2 values"):
        record.fill(rows, stamps, {"force": np.zeros((3, 2))})
