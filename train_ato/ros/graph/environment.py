"""Environment of the nodes of a run: exclusive ROS domain, this machine only by default, logs in the run folder."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path

from train_ato.ros import DEFAULT_MIDDLEWARE
from train_ato.ros.graph.domain_lock import DomainLock

DOMAINS = range(1, 102)
"""Domains with ports below the ephemeral ones."""

_PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_PEERS = "ROS_STATIC_PEERS"


def discovery_profile(name: str = "fastdds.xml") -> Path:
    """Return the path of a Fast DDS profile with fast discovery."""
    return Path(str(files("train_ato"))) / "ros" / "graph" / name


def opened_by() -> str | None:
    """Return the environment variable that permits other hosts of the network; None if they are excluded."""
    own_profile = os.environ.get(_PROFILE)
    if own_profile is not None and Path(own_profile).parent != discovery_profile().parent:
        return f"{_PROFILE}={own_profile}"
    if os.environ.get(_RANGE) == "SUBNET":
        return f"{_RANGE}=SUBNET"
    return f"{_PEERS}={os.environ[_PEERS]}" if os.environ.get(_PEERS) else None


def middleware(profile: str = "fastdds.xml") -> dict[str, str]:
    """Return the environment variables that limit the hosts of a run.

    Default: this machine only, by the profile; the discovery range ``LOCALHOST`` binds the sockets to all interfaces.
    A profile set by the user is kept.

    Parameters
    ----------
    profile
        Name of the shipped profile for this machine only.
    """
    opened = opened_by()
    if opened is None:
        return {_RANGE: "SYSTEM_DEFAULT", _PROFILE: str(discovery_profile(profile))}
    file = os.environ[_PROFILE] if opened.startswith(_PROFILE) else str(discovery_profile("fastdds_network.xml"))
    return {_RANGE: "SUBNET" if os.environ.get(_RANGE) == "SUBNET" else "LOCALHOST", _PROFILE: file}


def check_domain(wanted: int | None) -> None:
    """Refuse a ROS domain out of range; None is any free one."""
    if wanted is not None and wanted not in DOMAINS:
        raise ValueError(f"--domain {wanted}: give a domain from {DOMAINS.start} to {DOMAINS.stop - 1}")


@contextmanager
def claim_domain(wanted: int | None = None) -> Iterator[int]:
    """Lock a ROS domain for the duration of a run, so that runs on one machine are separate.

    Parameters
    ----------
    wanted
        Domain to use; default: a free one.

    Raises
    ------
    ValueError
        If it is out of range, another run holds it, or its lock file is not a plain file.
    """
    check_domain(wanted)
    start = os.getpid() % len(DOMAINS)
    order = [DOMAINS[(start + i) % len(DOMAINS)] for i in range(len(DOMAINS))] if wanted is None else [wanted]
    for domain in order:
        lock = DomainLock(domain)
        try:
            acquired = lock.acquire()
        except ValueError:
            if wanted is not None:
                raise
            continue
        if acquired:
            try:
                yield domain
            finally:
                lock.release()
            return
    if wanted is not None:
        raise ValueError(f"--domain {wanted}: another run holds it ({DomainLock(wanted).path}); leave --domain out")
    raise ValueError(f"all domains from {DOMAINS.start} to {DOMAINS.stop - 1} are held by other runs; end one of them")


def print_domain(domain: int) -> None:
    """Print the ROS domain of a run on stderr, for other terminals and programs."""
    sys.stderr.write(f"ROS domain {domain}\n")
    sys.stderr.flush()


def held_domains() -> list[int]:
    """Return the domains that are locked by runs on this machine."""
    return [domain for domain in DOMAINS if DomainLock(domain).held]


def variables(domain: int, log_folder: Path) -> dict[str, str]:
    """Return the environment variables of the nodes of a run.

    Field checks are on: without them rclpy sends an int in a float64 field as another number, without an error.
    """
    return {
        "ROS_DOMAIN_ID": str(domain),
        **middleware(),
        "ROS_LOG_DIR": str(log_folder),
        "ROS_PYTHON_CHECK_FIELDS": "1",
        "RMW_IMPLEMENTATION": os.environ.get("RMW_IMPLEMENTATION") or DEFAULT_MIDDLEWARE,
    }


@contextmanager
def applied(values: dict[str, str]) -> Iterator[None]:
    """Set environment variables of this process; restore them on exit."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
