"""Shared memory of Fast DDS that nobody holds any more, as ``fastdds shm clean`` removes it."""

from __future__ import annotations

import contextlib
import fcntl
import os
from pathlib import Path

SHARED = Path("/dev/shm")


def _locked(lock_file: Path) -> bool:
    """Tell whether a living process holds the lock that belongs to a segment or a port."""
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
    """Return the names of shared memory that processes of this user have mapped."""
    names = set()
    for maps in Path("/proc").glob("[0-9]*/maps"):
        with contextlib.suppress(OSError):
            for line in maps.read_text(errors="replace").splitlines():
                place = line.find(f"{SHARED}/")
                if place >= 0:
                    names.add(line[place + len(f"{SHARED}/") :])
    return names


def abandoned() -> set[str]:
    """Return the names of segments and ports of this user that no living process uses.

    A port that a killed node left and another node opened once more has no lock file; so its mapping counts too.
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
    """Remove what killed nodes left; what living processes use is locked or mapped, and stays."""
    for name in abandoned():
        for path in (SHARED / name, SHARED / f"{name}_el", SHARED / f"sem.{name}_mutex"):
            with contextlib.suppress(OSError):
                path.unlink()
