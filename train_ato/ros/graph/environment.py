"""Environment of a run's nodes: a ROS domain of its own, discovery on this machine only, logs in the run folder."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.resources import files
from pathlib import Path

from filelock import FileLock, Timeout

DOMAINS = range(1, 102)
"""Domains whose ports stay clear of the ephemeral ones."""


def discovery_profile() -> Path:
    """Return the file that makes Fast DDS find the nodes of a run quickly."""
    return Path(str(files("train_ato"))) / "graph" / "fastdds.xml"


def _lock(domain: int) -> FileLock:
    return FileLock(Path(tempfile.gettempdir()) / f"train_ato-domain-{domain}.lock", mode=0o666)


def _taken(lock: FileLock) -> bool:
    """Try to take a lock; its file may just be on its way out in the hands of another run."""
    try:
        lock.acquire(timeout=0)
    except (Timeout, OSError):
        return True
    if not Path(lock.lock_file).exists():
        lock.release()
        return True
    return False


def _give_back(lock: FileLock) -> None:
    """Remove the lock's file while it is still held, then release it: nothing stays behind."""
    with suppress(OSError):
        Path(lock.lock_file).unlink()
    lock.release()


def check_domain(wanted: int | None) -> None:
    """Refuse a ROS domain out of range; None stands for any free one."""
    if wanted is not None and wanted not in DOMAINS:
        raise ValueError(f"--domain {wanted}: give a domain from {DOMAINS.start} to {DOMAINS.stop - 1}")


@contextmanager
def claim_domain(wanted: int | None = None) -> Iterator[int]:
    """Hold a ROS domain for the time of a run, so that two runs on one machine never hear each other.

    Parameters
    ----------
    wanted
        Domain to use; default: a free one.

    Raises
    ------
    ValueError
        If it is out of range, or another run holds it.
    """
    check_domain(wanted)
    start = os.getpid() % len(DOMAINS)
    order = [DOMAINS[(start + i) % len(DOMAINS)] for i in range(len(DOMAINS))] if wanted is None else [wanted]
    for domain in order:
        lock = _lock(domain)
        if not _taken(lock):
            try:
                yield domain
            finally:
                _give_back(lock)
            return
    if wanted is not None:
        raise ValueError(f"--domain {wanted}: another run holds it ({_lock(wanted).lock_file}); leave --domain out")
    raise ValueError(f"all domains from {DOMAINS.start} to {DOMAINS.stop - 1} are held by other runs; end one of them")


def held_domains() -> list[int]:
    """Return the domains that runs on this machine hold now."""
    held = []
    for domain in DOMAINS:
        lock = _lock(domain)
        if Path(lock.lock_file).exists():
            if _taken(lock):
                held.append(domain)
            else:
                _give_back(lock)
    return held


def variables(domain: int, log_folder: Path) -> dict[str, str]:
    """Return the environment variables of a run's nodes.

    Field checks are on because rclpy otherwise sends an int in a float64 field as another number, silently.
    """
    return {
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(log_folder),
        "ROS_PYTHON_CHECK_FIELDS": "1",
        "RMW_IMPLEMENTATION": os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp"),
        "FASTRTPS_DEFAULT_PROFILES_FILE": os.environ.get("FASTRTPS_DEFAULT_PROFILES_FILE", str(discovery_profile())),
    }


@contextmanager
def applied(values: dict[str, str]) -> Iterator[None]:
    """Set environment variables of this process and put the old ones back afterwards."""
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
