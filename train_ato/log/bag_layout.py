"""How a run's log is laid out: names, quality of service, and ``metadata.yaml`` as ``ros2 bag`` (Jazzy) writes it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import yaml

from train_ato.topics import TOPICS, Topic

LOG = "run.mcap"
PARTIAL = "run.mcap.partial"
METADATA = "metadata.yaml"
NEVER = 9223372036854775807
"""Start of a bag that holds no message yet [ns]."""
_FOREVER = {"sec": 9223372036, "nsec": 854775807}


def log_name(topic: Topic, namespace: str = "") -> str:
    """Return a topic's name in the graph and in the log: relative names go under the namespace."""
    if topic.name.startswith("/"):
        return topic.name
    prefix = namespace.strip("/")
    return f"/{prefix}/{topic.name}" if prefix else f"/{topic.name}"


def table_name(name: str) -> str | None:
    """Return the name in the topic table of a name in a log, None for a topic that is not ours."""
    for topic in TOPICS:
        if name == topic.name or (not topic.name.startswith("/") and name.endswith("/" + topic.name)):
            return topic.name
    return None


def qos_profiles(topic: Topic) -> list[dict[str, Any]]:
    """Return the offered quality of service as ``ros2 bag`` writes it; players publish with it."""
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
    """Return the quality of service as the YAML sequence that stands in the channel's metadata."""
    return yaml.dump(profiles, Dumper=_Plain, sort_keys=False)


class _Plain(yaml.SafeDumper):
    """YAML without anchors: readers of bags do not expect them."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


@dataclass(frozen=True)
class ChannelCount:
    """What ``metadata.yaml`` says of one topic."""

    name: str
    type: str
    encoding: str
    hash: str
    qos: str
    count: int


def bag_information(file_name: str, channels: Sequence[ChannelCount], begin: int, end: int) -> dict[str, Any]:
    """Return what ``ros2 bag`` says of a bag, in ``metadata.yaml`` and inside the file.

    Parameters
    ----------
    file_name
        Name of the log beside it.
    channels
        Every topic, those without messages included.
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
                "offered_qos_profiles": yaml.safe_load(channel.qos),
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
    """Return the record ``rosbag2`` inside the file: the same without the key above it."""
    return {"serialized_metadata": yaml.dump(information, Dumper=_Plain, sort_keys=False)}
