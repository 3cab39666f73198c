"""Environment of the nodes of a run: exclusive ROS domain, this machine only by default, logs in the run folder."""

import os
import random
import socket
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path

from train_ato.ros import DEFAULT_MIDDLEWARE
from train_ato.ros.graph.domain_lock import DomainLock, locked_runs

DOMAINS = range(1, 102)
"""Domains with ports below the ephemeral ones, for runs without a wanted one."""
VALID = range(233)
"""Domains of ROS 2."""
_RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")

_PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_PEERS = "ROS_STATIC_PEERS"


def discovery_profile(name: str = "fastdds.xml") -> Path:
    """Return the path of a Fast DDS profile with fast discovery."""
    return Path(str(files("train_ato"))) / "ros" / "graph" / name


def opened_by() -> str | None:
    """Return the environment variable that permits other hosts of the network; None if they are excluded."""
    own_profile = os.environ.get(_PROFILE)
    if own_profile and not Path(own_profile).is_file():
        raise ValueError(f"{_PROFILE}={own_profile}: no such file; name a profile, or unset {_PROFILE}")
    if own_profile:
        _check_profile(own_profile)
    if (reach := os.environ.get(_RANGE)) and reach not in _RANGES:
        raise ValueError(f"{_RANGE}={reach}: unknown; choose from {', '.join(_RANGES)}, or unset it")
    if own_profile and Path(own_profile).parent != discovery_profile().parent:
        return f"{_PROFILE}={own_profile}"
    if os.environ.get(_RANGE) == "SUBNET":
        return f"{_RANGE}=SUBNET"
    return f"{_PEERS}={os.environ[_PEERS]}" if os.environ.get(_PEERS) else None


def _check_profile(file: str) -> None:
    """Refuse a file without profiles: Fast DDS takes its own defaults then, which open the run to the network."""
    try:
        found = ET.parse(file).getroot().tag.rpartition("}")[2]
    except (ET.ParseError, OSError) as error:
        raise ValueError(f"{_PROFILE}={file}: no XML ({error}); mend it, or unset {_PROFILE}") from None
    if found not in ("dds", "profiles"):
        raise ValueError(f"{_PROFILE}={file}: <{found}> in place of <dds> or <profiles>; mend it, or unset {_PROFILE}")


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
    peers = os.environ.get(_PEERS, "")
    for host in filter(None, peers.split(";")):
        try:
            socket.getaddrinfo(host, None)
        except (OSError, UnicodeError):
            raise ValueError(f"{_PEERS}={peers}: host '{host}' is not found; mend it, or unset {_PEERS}") from None
    if opened is None:
        return {_RANGE: "SYSTEM_DEFAULT", _PROFILE: str(discovery_profile(profile))}
    file = os.environ[_PROFILE] if opened.startswith(_PROFILE) else str(discovery_profile("fastdds_network.xml"))
    return {_RANGE: "SUBNET" if os.environ.get(_RANGE) == "SUBNET" else "LOCALHOST", _PROFILE: file}


def check_domain(wanted: int | None) -> None:
    """Refuse a ROS domain out of range, given or in ``ROS_DOMAIN_ID``; None without one is any free one."""
    if wanted is not None and wanted not in VALID:
        raise ValueError(f"--domain {wanted!r}: give a domain from {VALID.start} to {VALID.stop - 1}")
    if wanted is None:
        domain_of_environment()


def domain_of_environment() -> int | None:
    """Return the domain of ``ROS_DOMAIN_ID``, None if it is not set; ValueError if it is not a ROS domain."""
    text = os.environ.get("ROS_DOMAIN_ID", "")
    if text and not (text.isdecimal() and int(text) in VALID):
        raise ValueError(
            f"ROS_DOMAIN_ID {text}: not a ROS domain; set it to {VALID.start} to {VALID.stop - 1}, or unset it"
        )
    return int(text) if text else None


@contextmanager
def claim_domain(wanted: int | None = None, name: str = "--domain", namespace: str = "") -> Iterator[int]:
    """Lock a ROS domain for the duration of a run, so that the runs in one network are separate.

    Several trains share a domain by a namespace each, which is locked in place of the whole domain.

    Parameters
    ----------
    wanted
        Domain to use; default: a free one with ports below the ephemeral ones.
    name
        Option or variable of ``wanted`` in messages.
    namespace
        Namespace of the nodes; "" for none.

    Raises
    ------
    ValueError
        If it is out of range, or another run holds it.
    """
    if wanted is not None:
        check_domain(wanted)
    free = [wanted] if wanted is not None else sorted({*DOMAINS} - {locked for locked, _ in locked_runs()})
    order = random.SystemRandom().sample(free, len(free))
    for domain in order:
        lock = DomainLock(domain, namespace)
        if lock.acquire():
            try:
                yield domain
            finally:
                lock.release()
            return
    if wanted is not None:
        taken = f"{wanted} with the namespace {namespace}" if namespace else f"{wanted}"
        raise ValueError(f"{name} {taken}: another run holds it; end that run, or leave the domain out for a free one")
    raise ValueError(f"all domains from {DOMAINS.start} to {DOMAINS.stop - 1} are held by other runs; end one of them")


def print_domain(domain: int, external: str | None = None, namespace: str = "") -> None:
    """Print the ROS domain of a run on stderr, for other terminals and for the program in place of a node."""
    start = f"; start the program in place of {external} with ROS_DOMAIN_ID={domain}" if external else ""
    start += f" and --ros-args -r __ns:={namespace}" if start and namespace else ""
    sys.stderr.write(f"ROS domain {domain}{start}\n")
    sys.stderr.flush()


def held_domains(namespace: str = "") -> list[int]:
    """Return the domains that are locked by runs in this network, by trains of a namespace if there is one."""
    return [domain for domain in VALID if DomainLock(domain, namespace).held]


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
