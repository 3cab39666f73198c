"""Time of the log writer of the project compared with the ``mcap`` package, for ``recorder.py``."""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from train_ato.log.compression import COMPRESSIONS
from train_ato.log.mcap_records import RawMessage
from train_ato.log.run_log import LogFile

WRITERS = (*(f"train_ato {name}" for name in COMPRESSIONS), "mcap none", "mcap lz4", "mcap zstd")
HOUR = 3600.0
BATCH = 450
"""Number of messages per call: 50 ticks of nine, as for the recorder in one process."""


def write_ours(messages: list[RawMessage], folder: Path, compression: str) -> int:
    """Write with the project's writer; return the size of the file [bytes]."""
    folder.mkdir(parents=True)
    log, numbers = LogFile(folder, compression=compression), {}
    for message in messages:
        if message.channel.topic not in numbers:
            numbers[message.channel.topic] = log.copy(message.channel, message.schema)
    for begin in range(0, len(messages), BATCH):
        log.extend((numbers[m.channel.topic], m.publish_ns, m.log_ns, m.data) for m in messages[begin : begin + BATCH])
    log.close()
    return log.path.stat().st_size


def write_peer(messages: list[RawMessage], folder: Path, compression: str) -> int:
    """Write with the ``mcap`` package, with the same checksums; return the size of the file [bytes]."""
    folder.mkdir(parents=True)
    path = folder / "run.mcap"
    with path.open("wb") as file, io.BufferedWriter(file, 1 << 16) as stream:  # type: ignore[type-var]
        writer = Writer(stream, compression=CompressionType[compression.upper()], enable_data_crcs=True)
        writer.start("ros2", "mcap")
        numbers: dict[str, int] = {}
        for message in messages:
            channel, schema = message.channel, message.schema
            if channel.topic not in numbers:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                numbers[channel.topic] = writer.register_channel(channel.topic, "cdr", number, channel.metadata)
        for m in messages:
            writer.add_message(numbers[m.channel.topic], m.log_ns, m.data, m.publish_ns)
        writer.finish()
    return path.stat().st_size


def compared(messages: Iterable[RawMessage], seconds: float, rounds: int, scratch: Path) -> dict[str, Any]:
    """Write the messages with every writer in turn; the best round of each counts.

    Parameters
    ----------
    messages
        Messages of a run.
    seconds
        Simulated time of the run [s].

    Returns
    -------
    dict
        By writer: wall time and processor time of a message, with that of the packing thread [µs], and size of the log
        of a simulated hour [MB].
    """
    held = list(messages)
    found: dict[str, dict[str, float]] = {}
    for turn in range(rounds):
        for name in WRITERS:
            kind, _, compression = name.partition(" ")
            write: Callable[[list[RawMessage], Path, str], int] = write_ours if kind == "train_ato" else write_peer
            wall, processor = time.perf_counter(), time.process_time()
            size = write(held, scratch / f"{turn} {name}", compression)
            wall, processor = time.perf_counter() - wall, time.process_time() - processor
            entry = {
                "wall_us_per_message": wall / len(held) * 1e6,
                "processor_us_per_message": processor / len(held) * 1e6,
                "mb_per_hour": size / 1e6 * HOUR / seconds,
            }
            best = found.setdefault(name, entry)
            found[name] = {key: min(best[key], value) for key, value in entry.items()}
    return found
