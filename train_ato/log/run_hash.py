"""SHA-256 of all messages of a run, without the wall-clock values of its diagnostics."""

from __future__ import annotations

import hashlib
import json
import struct
from pathlib import Path

from train_ato.log.difference import WALL
from train_ato.log.reading import iter_raw
from train_ato.messages.codec.codec import Wire
from train_ato.messages.topics import TOPICS

DIAGNOSTICS = "/diagnostics"
_HEAD = struct.Struct("<qI")


def run_hash(run: Path, wire: Wire) -> str:
    """Return the SHA-256 of the messages of a log: topic, stamp and content, by topic and in the order of the stamps.

    The order of the nodes in one stamp of the diagnostics, and keys of wall-clock values, have no effect, as in
    :func:`train_ato.log.difference.compare_logs`.

    Parameters
    ----------
    run
        Run folder or MCAP file.
    wire
        Decoder for its train.

    Raises
    ------
    ValueError
        If it is not a log, or damaged.
    """
    messages: dict[str, list[tuple[int, bytes]]] = {topic.name: [] for topic in TOPICS}
    for topic, stamp, data in iter_raw(run):
        content = _without_wall_clock(wire, data) if topic == DIAGNOSTICS else data
        messages.setdefault(topic, []).append((stamp, content))
    digest = hashlib.sha256()
    for topic, entries in messages.items():
        digest.update(f"{topic} {len(entries)}\n".encode())
        entries.sort(key=lambda entry: entry if topic == DIAGNOSTICS else entry[:1])
        for stamp, content in entries:
            digest.update(_HEAD.pack(stamp, len(content)))
            digest.update(content)
    return digest.hexdigest()


def _without_wall_clock(wire: Wire, data: bytes) -> bytes:
    """Return a diagnostic message as text without the values of the wall clock."""
    message = wire.decode(DIAGNOSTICS, data)
    values = {key: value for key, value in message.values.items() if not key.startswith(WALL)}
    return json.dumps([message.node, message.level, message.message, values], sort_keys=True).encode()
