"""What made a run: the versions and the processor that its numbers depend on, as they are attached to the log."""

from __future__ import annotations

import platform
import sys
import zlib
from collections.abc import Mapping
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import yaml

from train_ato.version import VERSION

SCENARIO = "scenario.yaml"
VERSIONS = "versions.yaml"
SUMMARY = "summary.json"
"""Names of what is attached to a log; the summary only to that of a measured run, which nothing can work out again."""
NUMERIC = ("python", "numpy", "numba", "llvmlite", "libc", "machine", "processor")
"""Where these are equal, two runs of one scenario are equal bit for bit."""
_PACKAGES = ("numpy", "numba", "llvmlite", "rclpy", "mcap", "rosbags")


@lru_cache(maxsize=1)
def versions() -> dict[str, str]:
    """Return the versions in force here; ``absent`` stands for a package that is not installed."""
    return {
        "train_ato": VERSION,
        "python": platform.python_version(),
        **{package: _version(package) for package in _PACKAGES},
        "libc": " ".join(platform.libc_ver()),
        "system": sys.platform,
        "machine": platform.machine(),
        "processor": _processor(),
    }


def versions_yaml() -> str:
    """Return the versions as the text that is attached to a log."""
    return yaml.safe_dump(versions(), sort_keys=False, width=1000)


def attachments_for(scenario: str) -> dict[str, bytes]:
    """Return what is attached to the log of a run: its resolved scenario and what drives it."""
    return {SCENARIO: scenario.encode(), VERSIONS: versions_yaml().encode()}


def read_versions(text: bytes) -> dict[str, str]:
    """Return the versions in an attachment; empty where it is none."""
    try:
        found = yaml.safe_load(text)
    except yaml.YAMLError:
        return {}
    return {str(key): str(value) for key, value in found.items()} if isinstance(found, dict) else {}


def other_numbers(recorded: Mapping[str, str]) -> list[str]:
    """Name what differs here from a recording so that its numbers may differ in their last digits."""
    here = versions()
    return [name for name in NUMERIC if recorded.get(name) != here[name]]


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "absent"


def _processor() -> str:
    """Return name and features of the processor: compiled code and array functions follow the features."""
    wanted = {"model name": "unknown", "flags": ""}
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            key, _, value = line.partition(":")
            if key.strip() in wanted:
                wanted[key.strip()] = value.strip()
    except OSError:
        wanted["model name"] = platform.processor() or "unknown"
    features = " ".join(sorted(wanted["flags"].split()))
    return f"{wanted['model name']}, features {zlib.crc32(features.encode()):08x}"
