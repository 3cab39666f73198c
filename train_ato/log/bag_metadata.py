"""``metadata.yaml`` beside a log that is whole: whether it is that of the log, and the same written again.

``ros2 bag`` and ``rosbags`` open a bag by that file; without it, or with another log's, they refuse a log in which
nothing is missing.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from mcap.reader import SeekingReader
from mcap.records import Schema, Statistics

from train_ato.record.layout import LOG, METADATA, NEVER, ChannelCount, bag_information, metadata_yaml
from train_ato.record.reading import NO_SCHEMA

BAG = "rosbag2_bagfile_information"


def rewritten(log: Path) -> Path | None:
    """Write ``metadata.yaml`` of a whole log again where it is missing or not that of the log.

    Parameters
    ----------
    log
        A whole MCAP file.

    Returns
    -------
    Path or None
        Where the file is kept that stood there; the new one itself where there was none; None where nothing was to do.
    """
    information = _information(log)
    file = log.parent / METADATA
    if information is None or _read(file) == ([log.name], _counts(information)):
        return None
    kept = file
    if file.exists():
        kept = file.with_name(f"{METADATA}.broken")
        if kept.exists():
            raise ValueError(f"{kept}: exists already; move it away first")
        file.rename(kept)
    file.write_text(metadata_yaml(information), encoding="utf-8")
    return kept


def _information(log: Path) -> dict[str, Any] | None:
    """Return what ``ros2 bag`` says of a log, from its summary; None of one without."""
    with log.open("rb") as file:
        summary = SeekingReader(file).get_summary()
    if summary is None or summary.statistics is None:
        return None
    statistics: Statistics = summary.statistics
    channels = []
    for number, channel in sorted(summary.channels.items()):
        schema: Schema = summary.schemas.get(channel.schema_id, NO_SCHEMA)
        found, count = channel.metadata, statistics.channel_message_counts.get(number, 0)
        told = (found.get("topic_type_hash", ""), found.get("offered_qos_profiles", "[]"))
        channels.append(ChannelCount(channel.topic, schema.name, channel.message_encoding, *told, count))
    some = statistics.message_count > 0
    span = (statistics.message_start_time, statistics.message_end_time) if some else (NEVER, NEVER)
    return bag_information(log.name, channels, *span)


def belongs(file: Path, log: str) -> bool:
    """Tell whether a ``metadata.yaml`` is, or would be, that of one log alone; a bag in several files keeps its own.

    Parameters
    ----------
    file
        ``metadata.yaml``; it may be missing, or not readable.
    log
        Name of the log beside it.
    """
    if not file.exists():
        return log == LOG
    found = _read(file)
    return log == LOG if found is None else found[0] == [log]


def _read(file: Path) -> tuple[list[str], dict[str, int]] | None:
    """Return files and messages of every topic as ``metadata.yaml`` has them; None where it cannot be read."""
    try:
        information = yaml.safe_load(file.read_text(encoding="utf-8"))[BAG]
        return information["relative_file_paths"], _counts(information)
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError, AttributeError):
        return None


def _counts(information: dict[str, Any]) -> dict[str, int]:
    topics = information["topics_with_message_count"]
    return {entry["topic_metadata"]["name"]: entry["message_count"] for entry in topics}
