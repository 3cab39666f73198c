"""Layout of the log of a run: names, quality of service, and ``metadata.yaml`` as of ``ros2 bag`` (Jazzy)."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from plant_sim.data_text import parse_yaml
from train_ato.messages.topics import TOPICS, Topic

LOG = "run.mcap"
PARTIAL = "run.mcap.partial"
METADATA = "metadata.yaml"
NEVER = 9223372036854775807
"""Start time of a bag without messages [ns]."""
_SHOWN = 3
_FOREVER = {"sec": 9223372036, "nsec": 854775807}


def not_a_run(path: Path, remedy: str) -> ValueError:
    """Return the refusal of a folder without a run; the folder of several runs, as of following trains, names them."""
    found = sorted(str(log.parent) for name in (LOG, PARTIAL) for log in path.glob(f"*/{name}"))
    if not found:
        return ValueError(f"{path}: not a run folder: {remedy}")
    more = " or another one of its runs" if len(found) > _SHOWN else ""
    return ValueError(f"{path}: not a run folder, but the folder of runs; name {' or '.join(found[:_SHOWN])}{more}")


def log_name(topic: Topic, resolved: str = "") -> str:
    """Return the name of a topic in the log: ``resolved`` (of the graph) if this ends with the name of the table."""
    return resolved if table_name(resolved) == topic.name else f"/{topic.name.lstrip('/')}"


def table_name(name: str) -> str | None:
    """Return the name in the topic table for a name in a log, None for other topics."""
    return next((topic.name for topic in TOPICS if _names(name, topic.name)), None)


def _names(name: str, topic: str) -> bool:
    return name == topic or name.endswith(f"/{topic.lstrip('/')}")


def qos_profiles(topic: Topic) -> list[dict[str, Any]]:
    """Return the offered quality of service in the format of ``ros2 bag``, used by players."""
    return [
        {
            "history": "keep_last",
            "depth": topic.depth,
            "reliability": "reliable",
            "durability": "transient_local" if topic.latched else "volatile",
            "deadline": dict(_FOREVER),
            "lifespan": dict(_FOREVER),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(_FOREVER),
            "avoid_ros_namespace_conventions": False,
        }
    ]


def qos_text(profiles: list[dict[str, Any]]) -> str:
    """Return the quality of service as YAML sequence for the metadata of a channel."""
    return yaml.dump(profiles, Dumper=_Plain, sort_keys=False)


def offered_qos(text: str) -> list[Any]:
    """Return the quality of service from the metadata of a channel; empty if the text is not a YAML sequence."""
    try:
        found = parse_yaml(text)
    except ValueError:
        return []
    return found if isinstance(found, list) else []


_Dumper: Any = yaml.CSafeDumper if yaml.__with_libyaml__ else yaml.SafeDumper


class _Plain(_Dumper):  # type: ignore[misc]  # in C a run ends 16 ms earlier
    """YAML writer without anchors, which readers of bags do not support."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


@dataclass(frozen=True)
class ChannelCount:
    """Entry of one topic in ``metadata.yaml``."""

    name: str
    type: str
    encoding: str
    hash: str
    qos: str
    count: int


def bag_information(file_name: str, channels: Sequence[ChannelCount], begin: int, end: int) -> dict[str, Any]:
    """Return the bag information of ``ros2 bag`` for ``metadata.yaml`` and for the record inside the file.

    Parameters
    ----------
    file_name
        Name of the log beside it.
    channels
        All topics, including those without messages.
    begin, end
        Log time of the first and the last message [ns since 1970].
    """
    count = sum(channel.count for channel in channels)
    start, duration = {"nanoseconds_since_epoch": begin}, {"nanoseconds": end - begin}
    topics = [
        {
            "topic_metadata": {
                "name": channel.name,
                "type": channel.type,
                "serialization_format": channel.encoding,
                "offered_qos_profiles": offered_qos(channel.qos),
                "type_description_hash": channel.hash,
            },
            "message_count": channel.count,
        }
        for channel in channels
    ]
    return {
        "version": 9,
        "storage_identifier": "mcap",
        "duration": duration,
        "starting_time": start,
        "message_count": count,
        "topics_with_message_count": topics,
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file_name],
        "files": [{"path": file_name, "starting_time": start, "duration": duration, "message_count": count}],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


def metadata_yaml(information: dict[str, Any]) -> str:
    """Return the text of ``metadata.yaml``."""
    return yaml.dump({"rosbag2_bagfile_information": information}, Dumper=_Plain, sort_keys=False)


def metadata_record(information: dict[str, Any]) -> dict[str, str]:
    """Return the record ``rosbag2`` inside the file: the content of ``metadata.yaml`` without its top-level key."""
    return {"serialized_metadata": yaml.dump(information, Dumper=_Plain, sort_keys=False)}
