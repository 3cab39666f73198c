"""Versions and processor with an effect on the numbers of a run, attached to its log."""

import hashlib
import platform
import sys
import zlib
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import yaml

from plant_sim.data_text import parse_yaml
from train_ato.program.version import VERSION

SCENARIO = "scenario.yaml"
VERSIONS = "versions.yaml"
SUMMARY = "summary.json"
"""Names of attachments of a log; the summary is attached for a measured run only, because it cannot be recalculated."""
_PACKAGES = ("numpy", "numba", "llvmlite", "rclpy", "mcap", "rosbags")


@lru_cache(maxsize=1)
def versions() -> dict[str, str]:
    """Return the versions of this installation; ``absent`` for a package that is not installed."""
    return {
        "train_ato": VERSION,
        "python": platform.python_version(),
        **{package: _version(package) for package in _PACKAGES},
        "libc": " ".join(platform.libc_ver()),
        "system": sys.platform,
        "machine": platform.machine(),
        "processor": _processor(),
    }


def source_hash() -> str:
    """Return the SHA-256 of all source and scenario files of the packages, in hexadecimal digits."""
    digest = hashlib.sha256()
    root = Path(__file__).parents[2]
    for package in ("plant_sim", "train_ato"):
        for path in sorted((root / package).rglob("*")):
            if path.suffix in (".py", ".yaml", ".csv"):
                digest.update(str(path.relative_to(root)).encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()


def attachments_for(scenario: str) -> dict[str, bytes]:
    """Return the attachments of the log of a run: resolved scenario and versions."""
    text: str = yaml.safe_dump(versions(), sort_keys=False, width=1000)
    return {SCENARIO: scenario.encode(), VERSIONS: text.encode()}


def read_versions(text: bytes) -> dict[str, str]:
    """Return the versions in an attachment; empty if it is not valid."""
    try:
        found = parse_yaml(text)
    except ValueError:
        return {}
    return {str(key): str(value) for key, value in found.items()} if isinstance(found, dict) else {}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "absent"


def _processor() -> str:
    """Return name and features of the processor; compiled code depends on the features."""
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
