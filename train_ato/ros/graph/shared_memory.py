"""Removal of abandoned shared memory of Fast DDS, as ``fastdds shm clean`` does it."""

import contextlib
import fcntl
import os
import time
from pathlib import Path

SHARED = Path("/dev/shm")
SETTLING_S = 0.2
"""Wall time between two looks for abandoned memory [s]; a starting node creates a file shortly before it locks it."""


def _locked(lock_file: Path) -> bool:
    """Return True if a running process holds the lock of a segment or a port."""
    try:
        descriptor = os.open(lock_file, os.O_RDWR)
    except FileNotFoundError:
        return False
    except OSError:
        return True
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(descriptor)
    return False


def _mapped() -> set[str]:
    """Return the names of the shared memory mapped by processes of this user."""
    names = set()
    for maps in Path("/proc").glob("[0-9]*/maps"):
        with contextlib.suppress(OSError):
            for line in maps.read_text(errors="replace").splitlines():
                place = line.find(f"{SHARED}/")
                if place >= 0:
                    names.add(line[place + len(f"{SHARED}/") :])
    return names


def abandoned() -> set[str]:
    """Return the names of the segments and ports of this user without a running process.

    A port of a killed node that another node has opened again has no lock file, so mappings are checked too.
    """
    ours = os.getuid()
    found = set()
    for path in SHARED.glob("fastrtps_*"):
        name = path.name.removesuffix("_el")
        with contextlib.suppress(OSError):
            if path.stat().st_uid == ours and not _locked(SHARED / f"{name}_el"):
                found.add(name)
    return found - _mapped() if found else found


def clean() -> None:
    """Remove the shared memory of killed nodes of this user; locked or mapped memory is kept."""
    found = abandoned()
    if not found:
        return
    time.sleep(SETTLING_S)
    for name in found & abandoned():
        for path in (SHARED / name, SHARED / f"{name}_el", SHARED / f"sem.{name}_mutex"):
            with contextlib.suppress(OSError):
                path.unlink()
