"""Text and type hash of message definitions for a log.

The source is the installed packages, or the Jazzy type store of ``rosbags`` on a machine without ROS; both are equal
except for comments.
"""

import json
import os
import re
import sys
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from train_ato.messages.cdr import typestore

_FIELD = re.compile(r"^([A-Za-z]\w*(?:/[A-Za-z]\w*)?)(?:<=\d+)?(?:\[[^\]]*\])?\s+[A-Za-z]\w*")
_PRIMITIVE = frozenset(("bool", "byte", "char", "string", "wstring", "float32", "float64")) | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}
_SEPARATOR = "=" * 80 + "\n"


@dataclass(frozen=True)
class Definition:
    """Definition of one message type: text with all dependencies, and RIHS01 hash."""

    text: str
    hash: str


def _file(type_name: str, suffix: str) -> Path | None:
    """Return a file of a message type in the installation of this interpreter (wheels), or of a sourced ROS 2."""
    package, _, name = type_name.split("/")
    prefixes = (sys.prefix, *os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    paths = (Path(prefix, "share", package, "msg", f"{name}{suffix}") for prefix in prefixes if prefix)
    return next(filter(Path.is_file, paths), None)


def dependencies(text: str, package: str) -> list[str]:
    """Return the message types of the fields in a ``.msg`` text, in order, each once."""
    found: list[str] = []
    for line in text.splitlines():
        match = _FIELD.match(line.strip())
        if match is None or match[1] in _PRIMITIVE:
            continue
        owner, _, name = match[1].rpartition("/")
        full = f"{owner or package}/msg/{name}"
        if full not in found:
            found.append(full)
    return found


def installed(type_name: str) -> Definition | None:
    """Return the definition in the installed packages, None if a type or dependency is missing."""
    order, texts = [type_name], {}
    for name in order:
        path = _file(name, ".msg")
        if path is None:
            return None
        texts[name] = path.read_text(encoding="utf-8")
        order += [found for found in dependencies(texts[name], name.split("/")[0]) if found not in order]
    described = _file(type_name, ".json")
    if described is None:
        return None
    hashes = {entry["type_name"]: entry["hash_string"] for entry in json.loads(described.read_text())["type_hashes"]}
    parts = [texts[type_name]]
    for name in order[1:]:
        package, _, short = name.split("/")
        parts.append(f"{_SEPARATOR}MSG: {package}/{short}\n{texts[name]}")
    return Definition("\n".join(part.rstrip("\n") for part in parts) + "\n", hashes[type_name])


def from_typestore(type_name: str) -> Definition:
    """Return the definition in the Jazzy type store of ``rosbags``, without comments."""
    text, _ = typestore().generate_msgdef(type_name, ros_version=2)
    return Definition(text, typestore().hash_rihs01(type_name))


@lru_cache(maxsize=64)
def definition(type_name: str) -> Definition:
    """Return the definition of a message type, for example ``sensor_msgs/msg/JointState``."""
    return installed(type_name) or from_typestore(type_name)
