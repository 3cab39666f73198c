"""Check and repair of ``metadata.yaml`` beside an undamaged log.

``ros2 bag`` and ``rosbags`` open a bag by this file and refuse a log without it, or with that of another log.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from plant_sim.data_text import parse_yaml
from train_ato.log.bag_layout import LOG, METADATA, NEVER, ChannelCount, bag_information, metadata_yaml
from train_ato.log.mcap_records import summary_of
from train_ato.log.whole_file import write_whole

BAG = "rosbag2_bagfile_information"


def rewritten(log: Path) -> Path | None:
    """Write ``metadata.yaml`` of an undamaged log if it is missing or belongs to another log.

    Parameters
    ----------
    log
        Undamaged MCAP file.

    Returns
    -------
    Path or None
        New name of the replaced file, or the new file if there was none; None if no repair was necessary.
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
    write_whole(file, metadata_yaml(information))
    return kept


def _information(log: Path) -> dict[str, Any] | None:
    """Return the bag information of a log from its summary; None without a summary."""
    with log.open("rb") as file:
        summary = summary_of(file, log.stat().st_size)
    if summary is None or summary.statistics is None:
        return None
    statistics, channels = summary.statistics, []
    for number in sorted(summary.known.channels):
        channel, schema = summary.known.kind(number)
        found, count = channel.metadata, statistics.channel_message_counts.get(number, 0)
        offered = (found.get("topic_type_hash", ""), found.get("offered_qos_profiles", "[]"))
        channels.append(ChannelCount(channel.topic, schema.name, channel.message_encoding, *offered, count))
    some = statistics.message_count > 0
    span = (statistics.message_start_time, statistics.message_end_time) if some else (NEVER, NEVER)
    return bag_information(log.name, channels, *span)


def belongs(file: Path, log: str) -> bool:
    """Return True if a ``metadata.yaml`` belongs to one log alone and not to a bag of several files.

    Parameters
    ----------
    file
        ``metadata.yaml``; it may be missing or unreadable.
    log
        Name of the log beside it.
    """
    if not file.exists():
        return log == LOG
    found = _read(file)
    return log == LOG if found is None else found[0] == [log]


def _read(file: Path) -> tuple[list[str], dict[str, int]] | None:
    """Return files and message counts of ``metadata.yaml``; None if it is unreadable."""
    try:
        information = parse_yaml(file.read_text(encoding="utf-8"))[BAG]
        return information["relative_file_paths"], _counts(information)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def _counts(information: dict[str, Any]) -> dict[str, int]:
    topics = information["topics_with_message_count"]
    return {entry["topic_metadata"]["name"]: entry["message_count"] for entry in topics}
